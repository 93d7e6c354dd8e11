"""One sensor of one recording as a calibration needs it, gathered while its samples pass by.

The windows of the job say what is trained on and what is held out; a step of the offset cuts them.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ftcal.config import RecordingSection
from ftcal.pairing import FtChannel, Windows, apart
from ftcal.recording import NANOSECONDS
from ftcal.samples import Samples
from ftcal.segments import Growing, Segment
from ftcal.smoothing import Rows
from ftcal.thinning import Thinning

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

MOST_SAMPLES = 1 << 15
"""Samples of a segment that are kept: five minutes at 100 Hz, then every other one."""

ALWAYS: Windows = ((-np.inf, np.inf),)


@dataclass(frozen=True, slots=True)
class PairedSensor:
    """One sensor over one recording: channels beside the model wrench, smoothed alike."""

    samples: Samples
    """Usable samples of the recording: all of them, or every so-manieth."""
    usable: int
    """How many there are, without those that the job leaves out."""
    logged: int
    """Samples that the log holds of this sensor."""
    training: tuple[Segment, ...]
    """Offset segments that the job trains on."""
    test: tuple[Segment, ...]
    """Offset segments that it holds out."""

    def moved(self, *, temperature: float) -> PairedSensor:
        """Return it with something added to its temperature [K], if it has one."""
        if self.samples.temperature is None:
            return self
        K = self.samples.channels.shape[1]
        none = np.zeros(K)
        return PairedSensor(
            self.samples.moved(none, temperature),
            self.usable,
            self.logged,
            tuple(one.moved(none, temperature) for one in self.training),
            tuple(one.moved(none, temperature) for one in self.test),
        )

    def thinned(self, most: int) -> PairedSensor:
        """Return it with at most so many samples of each segment, and of the recording."""
        return PairedSensor(
            self.samples.thinned(most),
            self.usable,
            self.logged,
            tuple(one.thinned(most) for one in self.training),
            tuple(one.thinned(most) for one in self.test),
        )


@dataclass(slots=True, eq=False)
class Gathering:
    """One sensor of one recording, its samples passing by in order."""

    section: RecordingSection
    name: str
    """Of the sensor, in the job."""
    channel: FtChannel
    start: int
    """Second zero of the recording [ns]."""
    training: list[Growing]
    test: list[Growing]
    in_situ: bool
    """Whether gravity and centre of mass go with the rows."""
    whole: Thinning = field(default_factory=lambda: Thinning(MOST_SAMPLES))
    """Of the recording; nothing where one segment is all of it."""
    usable: int = 0
    """Samples that were not left out."""
    first: float = 0.0
    last: float = 0.0
    """Times of the first and the last sample [s]."""

    @staticmethod
    def of(
        section: RecordingSection,
        name: str,
        channel: FtChannel,
        start: int,
        *,
        smoothing: float,
        in_situ: bool,
    ) -> Gathering:
        """Return what gathers a sensor; cells last `smoothing` [s]: so far samples are alike."""
        training, test = split(section, name, smoothing)

        def growing(windows: Windows) -> list[Growing]:
            return [Growing(section.label, window, smoothing, MOST_SAMPLES) for window in windows]

        return Gathering(section, name, channel, start, growing(training), growing(test), in_situ)

    def add(self, rows: Rows) -> None:
        """Take in the next rows, as `Pairing.rows` yields them."""
        time = (rows.stamps - self.start) / NANOSECONDS
        table, beside = self._table(rows), rows.beside
        if self.section.leave_out.get(self.name):
            keep = self.section.trained_on(self.name, time)
            time, table, beside = time[keep], table[keep], beside[keep]
        if not len(time):
            return
        self.usable += len(time)
        if not self.undivided:
            if not self.whole.count:
                self.first = float(time[0])
            self.last = float(time[-1])
            self.whole.add(time, table)
        for growing in (*self.training, *self.test):
            begin, end = np.searchsorted(time, growing.window)
            attitude = beside[begin:end, -6:] if self.in_situ else None
            growing.add(time[begin:end], table[begin:end], self.width, attitude)

    @property
    def undivided(self) -> bool:
        """Whether one segment is the whole recording."""
        return [one.window for one in (*self.training, *self.test)] == list(ALWAYS)

    @property
    def width(self) -> int:
        """Channels of the sensor."""
        return int(self.channel.workbench.gain.shape[1])

    def _table(self, rows: Rows) -> Float[Array, "N D"]:
        """Return `Samples.rows` of rows: the temperature between channels and wrench."""
        if self.channel.temperature is None:
            return rows.values
        K = self.width
        return np.column_stack([rows.values[:, :K], rows.beside[:, :1], rows.values[:, K:]])

    def gathered(self, logged: int) -> PairedSensor:
        """Return what was gathered of so many samples that were logged.

        Windows without a sample are left out.
        """
        training = tuple(one.segment() for one in self.training if one.count)
        return PairedSensor(
            training[0].samples if self.undivided and training else self._recording(),
            self.usable,
            logged,
            training,
            tuple(one.segment() for one in self.test if one.count),
        )

    def _recording(self) -> Samples:
        kept = self.whole.rows() if self.whole.count else np.zeros((0, self.width + 8))
        time, rows, K = kept[:, 0], kept[:, 1:], self.width
        warm = rows[:, K] if self.channel.temperature is not None else None
        return Samples(
            self.section.label, self.first, self.last, time, rows[:, :K], rows[:, -6:], warm
        )


def split(section: RecordingSection, sensor: str, smoothing: float) -> tuple[Windows, Windows]:
    """Return what a recording trains on and what it holds out, cut where offsets step.

    Held-out windows give up what lies within one smoothing window of a training window.
    """
    train: Windows = ALWAYS if section.train is None else section.train
    if section.train is None and section.test:
        train = ()
    held = apart(section.test, train, smoothing)
    return cut(section, sensor, train), cut(section, sensor, held)


def cut(section: RecordingSection, sensor: str, windows: Windows) -> Sequence[tuple[float, float]]:
    """Return windows cut where the offset of a sensor steps."""
    found: list[tuple[float, float]] = []
    for start, stop in windows:
        inside = [t for t in section.known_breaks.get(sensor, ()) if start < t < stop]
        found += itertools.pairwise([start, *inside, stop])
    return found
