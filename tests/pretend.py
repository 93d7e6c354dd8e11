"""A pretend sensor for tests of the estimation alone: no robot, no log, truth known."""

from __future__ import annotations

import numpy as np

from ftcal.folds import Cells, cells
from ftcal.samples import Samples
from ftcal.segments import Segment
from ftcal.sensor import Workbench

FULL_SCALE = np.array([1587.0, 1823.0, 2113.0, 37.0, 38.0, 24.0])


def workbench(seed: int = 0) -> Workbench:
    """Return an invented Workbench of the size and condition of an iCub sensor's."""
    rng = np.random.default_rng(seed)
    mixing = np.linalg.qr(rng.normal(size=(6, 6)))[0] * np.linspace(0.4, 1.0, 6)
    return Workbench("SN000", FULL_SCALE[:, None] * mixing / 32767.0, FULL_SCALE)


def bent(prior: Workbench, rng: np.random.Generator, kappa: float = 0.03) -> np.ndarray:
    """Return a true gain drawn from the scaled prior."""
    E = rng.normal(size=(6, prior.gain.shape[1])) * kappa
    return np.asarray(prior.gain + FULL_SCALE[:, None] * (E @ prior.scaling))


def samples(
    gain: np.ndarray,
    rng: np.random.Generator,
    *,
    count: int = 2000,
    offset: float = 0.0,
    noise: float = 1e-4,
    share: float = 0.05,
    recording: str = "pretend",
    axes: int = 6,
    seconds: float = 20.0,
) -> Samples:
    """Return samples of a sensor with `gain`: smooth random wrenches, white noise on them.

    `noise` and `share` (of the load) are fractions of full scale; `axes` of them move.
    """
    time = np.arange(count) * (seconds / count)
    phases = rng.uniform(0, 2 * np.pi, size=(6, 4))
    rates = rng.uniform(0.1, 0.8, size=(6, 4)) * 2 * np.pi
    waves = np.sin(time[:, None, None] * rates + phases).sum(axis=2)
    waves[:, axes:] = 0.0
    wrench = waves * share * FULL_SCALE
    channels = np.linalg.solve(gain, (wrench - offset * FULL_SCALE).T).T
    felt = wrench + rng.normal(size=wrench.shape) * noise * FULL_SCALE
    return Samples(recording, 0.0, seconds, time, channels, felt)


def tiled(*stretches: Samples, length: float = 1.0) -> Cells:
    """Return the cells of so many seconds that tile the stretches, an offset segment each."""
    return cells([Segment.of(stretch, length) for stretch in stretches])
