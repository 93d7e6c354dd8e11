"""Blocked K-fold of one sensor: every block of its training read by a fit that never saw it."""

from __future__ import annotations

import numpy as np

from ftcal.errors import DataError
from ftcal.fit import FitOptions, fit
from ftcal.folds import Cells, Pool, blocked_folds, by_segment
from ftcal.progress import Steps
from ftcal.segments import Segment, enveloping
from ftcal.sensor import Workbench
from ftcal.validate import HeldOut, Scores, held_out, named, score


def validate_by_folds(
    tiles: Cells, workbench: Workbench, options: FitOptions, pool: Pool, steps: Steps
) -> Scores | None:
    """Return the scores of blocked K-fold: each block read by a fit that never saw it.

    The prior's strength is chosen anew inside every fold (nested). None where the data are too
    short for the folds.
    """
    try:
        folds = blocked_folds(tiles, options.folds)
    except DataError:
        return None
    pieces: list[HeldOut] = []
    for fold in folds:
        steps.begin("validating on blocks it never saw")
        try:
            estimate = fit(fold.train, workbench, options, pool).estimate
        except DataError:
            return None
        pieces += [held_out(block, estimate.coefficients, workbench) for block in blocks(fold.held)]
    return score(f"{options.folds}-fold", pieces, named(enveloping(tiles.segments)))


def blocks(held: Cells) -> list[Segment]:
    """Return neighbouring cells as one piece of every segment, with its share of the samples.

    The envelope is that of the segment: the blocks of all folds fill it.
    """
    found = []
    for rows in by_segment(held):
        whole = held.segments[int(held.segment[rows[0]])]
        spans = held.spans[rows]
        samples = whole.samples.between(spans[0, 0], float(np.nextafter(spans[-1, 1], np.inf)))
        found.append(Segment(samples, held.moments[rows], spans, whole.envelope))
    return found
