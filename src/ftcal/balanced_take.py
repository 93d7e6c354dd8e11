"""One recording as the fit of all sensors needs it: balances, and where they train or not."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from ftcal.balances import Balance, balances, smoothed
from ftcal.config import Job, RecordingSection
from ftcal.law import Law
from ftcal.pairing import FtChannel, Windows, apart
from ftcal.recording import Finding, Recording
from ftcal.robot import Robot
from ftcal.solution import Solution
from ftcal.terms import Frame, ModelPrior, Segment, Terms, Weights, summed

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

ENOUGH, ALTOGETHER = 5000, 10_000
"""Samples of a sub-model in one recording, and in all, that tables and scores rest on."""


@dataclass(frozen=True, slots=True, eq=False)
class BalancedTake:
    """One recording: its balances, and where they train and are held out."""

    recording: str
    balances: tuple[Balance, ...]
    references: dict[str, Float[Array, "P"]]
    """r0 of each sensor: its mean."""
    segments: dict[str, tuple[Segment, ...]]
    """Offset segments of each sensor."""
    train: tuple[tuple[float, float], ...]
    """Stretches trained on: windows cut by the intervals of the schedule [s]."""
    test: tuple[tuple[float, float], ...]
    """Stretches held out."""

    def thinned(self, enough: int = ENOUGH) -> BalancedTake:
        """Return the take with samples enough for tables and scores; sums have seen all."""
        # numbers, not a slice: what is left out is to leave the memory
        thin = [
            b.rows(np.arange(0, len(b.time), max(1, len(b.time) // enough))) for b in self.balances
        ]
        return replace(self, balances=tuple(thin))

    def span(self, segment: Segment) -> tuple[float, float]:
        """Return first and last second of a segment that the balances hold."""
        time = np.concatenate([balance.time for balance in self.balances])
        inside = time[(time >= segment.start) & (time < segment.stop)]
        return float(inside.min()), float(np.nextafter(inside.max(), np.inf))

    def terms(
        self,
        stretches: Windows,
        frames: Mapping[str, Frame],
        model: ModelPrior,
        weights: Weights | None = None,
    ) -> list[Terms]:
        """Return what some stretches add to the normal equations, every cell as its weight says."""
        return [
            term
            for balance in self.balances
            for stretch in stretches
            for term in summed(
                balance,
                self.recording,
                frames,
                self.references,
                self.segments,
                stretch,
                model,
                weights=weights,
            )
        ]

    def laws(
        self, solution: Solution, frames: Mapping[str, Frame], stretch: tuple[float, float]
    ) -> dict[str, Law]:
        """Return the law of every sensor during a stretch, those whose offset is known there."""
        found = {}
        for name, mine in self.segments.items():
            for segment in mine:
                inside = segment.start <= stretch[0] and stretch[1] <= segment.stop
                if inside and (name, segment) in solution.offsets:
                    found[name] = solution.law(name, frames[name], segment, self.references[name])
        return found


def balanced(
    job: Job,
    robot: Robot,
    channels: Sequence[FtChannel],
    section: RecordingSection,
    recording: Recording,
    findings: Sequence[Finding],
) -> BalancedTake:
    """Return the smoothed balances of one recording and its stretches."""
    options = job.signals.options()
    found = balances(
        recording,
        robot,
        channels,
        section.schedule(),
        gravity=section.gravity,
        imu=section.imu,
        findings=findings,
        options=options,
        by_mass=job.whole_body.by_mass,
        reduced=partial(smoothed, seconds=job.whole_body.smoothing),
    )
    names = {c.sensor: named.name for c, named in zip(channels, job.sensors, strict=True)}
    found = settled(found, section, names)
    inputs: dict[str, list[Array]] = {}
    for balance in found:
        for name, values in balance.inputs.items():
            inputs.setdefault(name, []).append(values)
    steps_at = sorted({time for times in section.known_breaks.values() for time in times})
    pieces = list(itertools.pairwise([-np.inf, *steps_at, np.inf]))
    spans = both([(i.start, i.stop) for i in section.schedule().intervals], pieces)
    train: Windows = ((-np.inf, np.inf),) if section.train is None else section.train
    if section.train is None and section.test:
        train = ()
    held = apart(section.test, train, job.signals.smoothing)
    return BalancedTake(
        recording.name,
        found,
        {name: np.concatenate(parts).mean(axis=0) for name, parts in inputs.items()},
        {sensor: segments(section, name) for sensor, name in names.items() if sensor in inputs},
        both(spans, train),
        both(spans, held),
    )


def settled(
    found: tuple[Balance, ...], section: RecordingSection, names: Mapping[str, str]
) -> tuple[Balance, ...]:
    """Return balances without samples that the job leaves out of training for a sensor of them.

    `names` are those of the sensors in the job.
    """
    if not section.leave_out:
        return found
    kept = []
    for one in found:
        masks = [section.trained_on(names[sensor], one.time) for sensor in one.inputs]
        rows = np.flatnonzero(np.all(masks, axis=0))
        if len(rows):
            kept.append(one.rows(rows))
    return tuple(kept)


def segments(section: RecordingSection, sensor: str) -> tuple[Segment, ...]:
    """Return the offset segments of a sensor, as the job calls it: cut where the offset steps."""
    edges = [-np.inf, *section.known_breaks.get(sensor, ()), np.inf]
    return tuple(Segment(section.label, a, b) for a, b in itertools.pairwise(edges))


def both(spans: Windows, windows: Windows) -> tuple[tuple[float, float], ...]:
    """Return the parts of `windows` inside `spans`, in order."""
    parts = [(max(a, c), min(b, d)) for a, b in spans for c, d in windows]
    return tuple(sorted((a, b) for a, b in parts if b > a))
