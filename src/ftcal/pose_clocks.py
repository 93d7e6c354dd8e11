"""Wrench and attitude on clocks of their own, joined; and whether the tool rested meanwhile."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ftcal.errors import DataError
from ftcal.poses import Attitude, gravity_in_sensor
from ftcal.recording import NANOSECONDS, Signal
from ftcal.signals import interpolate

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray as Array

BROKEN = 1e9
"""Numbers beyond are broken, not large, in any unit."""

FAST, OFTEN = np.radians(10.0), 0.05
"""Gravity that turns faster [rad/s] in this share of the rows: the tool is thrown about."""

RATE_SPAN = 0.2
"""Seconds over which the turning of gravity is taken: an accelerometer's noise averages out."""


def joined(
    wrench: Signal, attitude: Signal, kind: Attitude, *, steady: float | None, where: str, cure: str
) -> tuple[Int[Array, "N"], Float[Array, "N K"], str, list[str]]:
    """Return the rows of the wrench that are kept, and the attitude on their clock.

    Then why the tool did not rest, or nothing; and what was left out. Rows in which gravity turns
    faster than `steady` [rad/s] are left out. Raises `DataError`, `where` first, where no row is
    left; `cure` is what to do where the clocks never meet.
    """
    rate = _rate(attitude, gravity_in_sensor(kind, attitude.values))
    both = Signal(kind, (*attitude.columns, "rate"), attitude.stamps,
                  np.column_stack([attitude.values, rate]))  # fmt: skip
    values = interpolate(both, wrench.stamps)
    covered = np.isfinite(values).all(axis=1)
    notes = []
    if not covered.all():
        notes.append(f"{int((~covered).sum())} of {len(wrench)} rows have no attitude; left out")
    if not covered.any():
        raise DataError(f"{where}: no wrench within the time of the attitude; {cure}")
    moving = ""
    if steady is None and np.mean(rate > FAST) > OFTEN:
        moving = (
            f"gravity turns at up to {np.degrees(rate.max()):.2g} deg/s: inertia is not in the"
            " model; say --steady, or rest in each attitude"
        )
    if steady is not None:
        still = covered & (values[:, -1] <= steady)
        if not still.any():
            raise DataError(
                f"{where}: gravity never turns slower than"
                f" {np.degrees(rate.min()):.3g} deg/s; raise --steady"
            )
        notes.append(f"{int(still.sum())} of {int(covered.sum())} rows are steady; others left out")
        covered = still
    return np.flatnonzero(covered), values[covered, :-1], moving, notes


def _rate(signal: Signal, gravity: Float[Array, "N 3"]) -> Float[Array, "N"]:
    """Return how fast the direction of gravity turns at each stamp [rad/s]."""
    seconds = (signal.stamps - signal.stamps[0]) / NANOSECONDS
    down = gravity / np.linalg.norm(gravity, axis=1, keepdims=True)
    before = np.maximum(seconds - RATE_SPAN / 2, seconds[0])
    after = np.minimum(seconds + RATE_SPAN / 2, seconds[-1])
    turned = [np.interp(after, seconds, d) - np.interp(before, seconds, d) for d in down.T]
    span = np.maximum(after - before, np.finfo(np.float64).tiny)
    return np.asarray(np.linalg.norm(turned, axis=0) / span)
