"""Moments at which something touched a part of the robot that was said to be free.

A foot that brushes the floor at lift-off, a hand on a cover: for a second or two the balance of the
part is violated by far more than before and after. What lasts longer is a step (`ftcal.steps`);
what is large everywhere is no touch, but a matrix or a model that is wrong.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ftcal.step_search import StepFit

if TYPE_CHECKING:
    from jaxtyping import Bool, Float
    from numpy import ndarray as Array

Span = tuple[float, float]
"""[start, stop) in seconds since the start of the recording."""

HALF = 5
"""Blocks on either side whose median a block is compared with: a touch is shorter than that, and a
median keeps the edge of a step."""

LOUD, BESIDE = 8.0, 3.0
"""Robust standard deviations, over all equations, that make a touch; and what lies beside one and
still belongs to it."""

COMMON = 0.1
"""Share of loud blocks that is no longer for a short time: none of them is a touch then."""


def touched(fit: StepFit) -> dict[str, tuple[Span, ...]]:
    """Return the spans [s] in which something touched, by the owner of the equations."""
    blocks = fit.problem.blocks
    left = np.full((len(blocks.start), len(fit.sd)), np.nan)
    for part in fit.problem.parts:
        left[part.block, part.group] = fit.solved(part)[1]
    found = {}
    for owner in dict.fromkeys(fit.problem.owners):
        mine = np.flatnonzero([name == owner for name in fit.problem.owners])
        where = np.flatnonzero(np.isfinite(left[:, mine]).any(axis=1))
        score = loudness(left[np.ix_(where, mine)], fit.problem.least[mine])
        spans = [
            (float(blocks.start[where[a]]), float(blocks.stop[where[b - 1]]))
            for a, b in loud_spans(score)
        ]
        if spans:
            found[owner] = tuple(spans)
    return found


def loudness(left: Float[Array, "B G"], least: Float[Array, "G"]) -> Float[Array, "B"]:
    """Return by how many robust standard deviations each block departs from those around it."""
    if len(left) <= 2 * HALF:
        return np.zeros(len(left))
    around = np.lib.stride_tricks.sliding_window_view(
        np.pad(left, ((HALF, HALF), (0, 0)), mode="edge"), 2 * HALF + 1, axis=0
    )
    apart = left - np.median(around, axis=-1)
    # 1.4826 turns a median deviation into the standard deviation of a Gaussian
    usual = np.maximum(1.4826 * np.median(np.abs(apart), axis=0), least)
    return np.asarray(np.sqrt(np.mean((apart / usual) ** 2, axis=1)))


def loud_spans(score: Float[Array, "B"]) -> list[tuple[int, int]]:
    """Return first and last block, exclusive, of every run that is loud somewhere."""
    loud = score > LOUD
    if not loud.any() or loud.mean() > COMMON:
        return []
    beside: Bool[Array, "B"] = score > BESIDE
    edges = np.flatnonzero(np.diff(beside, prepend=False, append=False))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2) if loud[a:b].any()]
