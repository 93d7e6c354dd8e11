"""How far a run is: steps of about equal size, counted beforehand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

Progress = Callable[[str, int, int], None]
"""Called with what is being done now, how many steps are done and how many there are."""


def silent(doing: str, done: int, total: int) -> None:
    """Show no progress."""


@dataclass(slots=True)
class Steps:
    """Counts the steps of one run and tells each to whoever shows them."""

    tell: Progress
    total: int
    """Steps of the whole run."""
    done: int = -1
    """Steps that are finished; the first `begin` finishes none."""

    def begin(self, doing: str) -> None:
        """Finish the step before and say what is being done now."""
        self.done += 1
        self.tell(doing, min(self.done, self.total), self.total)
