"""Errors of the robot's model that were tried, in the words that terminal and page share."""

from __future__ import annotations

from ftcal.model_errors import Tried
from ftcal.terms import MODEL

BELIEVED = {"believed": "yes", "no evidence": "no", "always": "always"}
"""What became of a suspect, in the column "believed"."""


def found_words(one: Tried) -> list[str]:
    """Return its numbers, a line each; of more than a suspect has alone, only how many."""
    if len(one.numbers) > MODEL:
        return [f"{len(one.numbers)} numbers"]
    return [str(number) for number in one.numbers]


def suspect_words(one: Tried) -> str:
    """Return what is suspected, and what would explain the data as well."""
    return one.words + "".join(f", or {words}" for words in one.rivals)


def unseen(tried: tuple[Tried, ...]) -> list[str]:
    """Return the suspects that the data say nothing of, by their words."""
    return [one.words for one in tried if not one.seen]
