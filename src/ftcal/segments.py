"""One sensor while its offset is one unknown: what a fit needs of hours, and what eyes need.

A fit needs moments, of stretches of about a second each (cells): folds hold them out in blocks,
error bars ask how they vary. Eyes need a curve: every so-manieth sample. Both are gathered while
samples pass by, in whatever portions they come, and neither grows with the recording: where room
runs out, neighbouring cells are merged in pairs, and every other sample is let go.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from ftcal.moments import Moments, Stacked, total
from ftcal.samples import Samples
from ftcal.thinning import Thinning

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray as Array

MOST_CELLS = 2000
"""More cells tell neither folds nor error bars any better: of hours of data they get longer."""

MOST_SAMPLES = 1 << 16
"""Samples of a segment that are kept at most: eleven minutes at 100 Hz, then every other one."""


@dataclass(frozen=True, slots=True)
class Segment:
    """One offset segment of one sensor."""

    samples: Samples
    """Its samples: all of them, or every so-manieth."""
    cells: Stacked
    """Moments of `Samples.rows` of its cells, of all samples, in order."""
    spans: Float[Array, "B 2"]
    """Times of the first and the last sample of each cell [s]."""
    envelope: Float[Array, "2 8"]
    """Least and greatest model wrench per axis, of force and of torque in magnitude [N, Nm]."""
    attitude: Moments | None = None
    """Of `[channels, gravity, centre of mass]` of all samples, where the in situ offset is asked
    for."""

    def __len__(self) -> int:
        return round(float(self.cells.count.sum()))

    @property
    def label(self) -> str:
        """Name for tables and messages."""
        return self.samples.label

    @property
    def whole(self) -> bool:
        """Whether `samples` are all there are."""
        return len(self.samples) == len(self)

    @property
    def step(self) -> int:
        """One sample in so many is kept."""
        return round(len(self) / len(self.samples))

    def moments(self) -> Moments:
        """Return the moments of `Samples.rows` of all samples."""
        return self.cells.total()

    def moved(self, channels: Float[Array, "K"], temperature: float = 0.0) -> Segment:
        """Return the segment with something added to its channels and its temperature [K]."""
        by = np.concatenate([channels, np.zeros(self.cells.mean.shape[1] - len(channels))])
        by[len(channels) : -6] = temperature
        return replace(
            self, samples=self.samples.moved(channels, temperature), cells=self.cells.moved(by)
        )

    def thinned(self, most: int) -> Segment:
        """Return the segment with at most so many of its samples for eyes."""
        return replace(self, samples=self.samples.thinned(most))

    @staticmethod
    def of(samples: Samples, length: float) -> Segment:
        """Return the segment of samples that are in memory; cells of about `length` seconds."""
        growing = Growing(samples.recording, (samples.start, samples.stop), length)
        growing.add(samples.time, samples.rows(), samples.channels.shape[1])
        return growing.segment()


def _nothing() -> Float[Array, "2 8"]:
    return np.array([np.full(8, np.inf), np.full(8, -np.inf)])


@dataclass(slots=True)
class Growing:
    """A segment while its samples pass by, in order.

    What becomes of it does not depend on how many come at a time.
    """

    recording: str
    window: tuple[float, float]
    """[start, stop) in seconds since the start of the recording; infinite: as far as samples go."""
    length: float
    """Of a cell [s]."""
    most_samples: int = MOST_SAMPLES
    """Kept at most."""
    channels: int = 0
    """Of the sensor."""
    count: int = 0
    """Samples that passed."""
    halvings: int = 0
    """How often cells were merged in pairs."""
    first: float = 0.0
    """Time of the first sample [s]."""
    last: float = 0.0
    """Time of the last sample [s]."""
    cells: list[Stacked] = field(default_factory=list)
    numbers: list[Int[Array, "B"]] = field(default_factory=list)
    """Of the cells, counted in cells of the first length."""
    spans: list[Float[Array, "B 2"]] = field(default_factory=list)
    """Times of the first and the last sample of each cell [s]."""
    kept: Thinning = field(init=False)
    """Times and rows."""
    envelope: Float[Array, "2 8"] = field(default_factory=_nothing)
    attitude: list[Moments] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.kept = Thinning(self.most_samples)

    def add(
        self,
        time: Float[Array, "N"],
        rows: Float[Array, "N D"],
        channels: int,
        attitude: Float[Array, "N 6"] | None = None,
    ) -> None:
        """Take in the next samples: `Samples.rows` of a sensor of so many channels."""
        if not len(time):
            return
        if not self.count:
            self.first = float(time[0])
            self.channels = channels
        self.last = float(time[-1])
        number = ((time - self.first) / self.length).astype(np.int64)
        edges = np.flatnonzero(np.concatenate([[True], np.diff(number) > 0, [True]]))
        self.numbers.append(number[edges[:-1]])
        self.cells.append(Stacked.of_each(rows, edges))
        self.spans.append(np.stack([time[edges[:-1]], time[edges[1:] - 1]], axis=1))
        self._merge(MOST_CELLS)
        self.kept.add(time, rows)
        self.count += len(time)
        self.envelope = _around(self.envelope, loads(rows[:, -6:]))
        if attitude is not None:
            self.attitude.append(Moments.of(np.hstack([rows[:, :channels], attitude])))
            if len(self.attitude) > MOST_CELLS:
                self.attitude = [total(self.attitude)]

    def segment(self) -> Segment:
        """Return what has become of it; `ValueError` without a sample."""
        if not self.count:
            raise ValueError("a segment without samples")
        self._merge(MOST_CELLS, settle=True)
        kept, K = self.kept.rows(), self.channels
        start, stop = self.window
        # tables of their own: columns of a wider one are slow to add and to multiply
        time, channels, *warm, wrench = (
            np.ascontiguousarray(kept[:, columns])
            for columns in (0, slice(1, K + 1), *range(K + 1, kept.shape[1] - 6), slice(-6, None))
        )
        return Segment(
            Samples(
                self.recording,
                start if np.isfinite(start) else self.first,
                stop if np.isfinite(stop) else float(np.nextafter(self.last, np.inf)),
                time,
                channels,
                wrench,
                warm[0] if warm else None,
            ),
            *self._whole_cells(),
            self.envelope,
            total(self.attitude) if self.attitude else None,
        )

    def _merge(self, most: int, *, settle: bool = False) -> None:
        """Put parts of one cell together, and pairs of cells where there are more than `most`."""
        if not settle and sum(map(len, self.cells)) <= most + most // 4:
            return
        cells = Stacked.joined(self.cells, 0)
        numbers = np.concatenate(self.numbers)
        while True:
            halved = numbers >> self.halvings
            starts = np.flatnonzero(np.concatenate([[True], np.diff(halved) > 0]))
            if len(starts) <= most:
                break
            self.halvings += 1
        self.cells, self.numbers = [cells.merged(starts)], [numbers[starts]]
        self.spans = [covered(np.concatenate(self.spans), starts)]

    def _whole_cells(self) -> tuple[Stacked, Float[Array, "B 2"]]:
        """Return cells and spans, the last put to the one before where it is less than half."""
        (cells,), (numbers,), (spans,) = self.cells, self.numbers, self.spans
        length = self.length * (1 << self.halvings)
        began = self.first + length * float(numbers[-1] >> self.halvings)
        if len(cells) > 1 and self.last - began < 0.5 * length:
            starts = np.arange(len(cells) - 1)
            return cells.merged(starts), covered(spans, starts)
        return cells, spans


def covered(spans: Float[Array, "B 2"], starts: Int[Array, "G"]) -> Float[Array, "G 2"]:
    """Return the spans of neighbours put together, as `Stacked.merged` puts their moments."""
    last = np.append(starts[1:], len(spans)) - 1
    return np.stack([spans[starts, 0], spans[last, 1]], axis=1)


def loads(wrench: Float[Array, "N 6"]) -> Float[Array, "2 8"]:
    """Return the range of each axis of a wrench, and of force and torque in magnitude."""
    # axis by axis: columns of a table are far apart in memory
    axes = np.ascontiguousarray(wrench.T)
    force, torque = (np.einsum("ij,ij->j", half, half) for half in (axes[:3], axes[3:]))
    sizes = [np.sqrt([half.min(), half.max()]) for half in (force, torque)]
    return np.column_stack([np.array([axes.min(axis=1), axes.max(axis=1)]), *sizes])


def enveloping(segments: Sequence[Segment]) -> Float[Array, "2 8"]:
    """Return the range of the loads of all segments."""
    found = _nothing()
    for segment in segments:
        found = _around(found, segment.envelope)
    return found


def _around(one: Float[Array, "2 8"], other: Float[Array, "2 8"]) -> Float[Array, "2 8"]:
    return np.array([np.minimum(one[0], other[0]), np.maximum(one[1], other[1])])
