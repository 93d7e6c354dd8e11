"""A recording seen once from its beginning to its end: what must be known before it is paired.

What is wrong with it, when its signals were logged, where they end, and how warm it was.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from ftcal.clocks import Clocks, GrowingClocks, clocks_of
from ftcal.health import Doctor
from ftcal.logs.pieces import ROLES, Pieces, mapped
from ftcal.pairing import FtChannel
from ftcal.recording import Finding, Recording, Signal
from ftcal.robot import Robot


@dataclass(frozen=True, slots=True, eq=False)
class Overview:
    """What one look at a recording tells."""

    outline: Recording
    """With the first and last sample of every signal only."""
    findings: tuple[Finding, ...]
    """What the reader and the data doctor noticed."""
    clocks: Clocks
    warmth: Mapping[str, tuple[int, float]]
    """Readings of every thermometer: how many, and their mean [degree Celsius]."""


class Onlooker(Protocol):
    """Something else that looks at a recording on the same way."""

    def see(self, own: Recording) -> None:
        """Take in the next samples of every signal."""


def overview(
    log: Pieces,
    robot: Robot | None,
    channels: Sequence[FtChannel],
    *,
    max_gap: float | None = None,
    onlookers: Sequence[Onlooker] = (),
) -> Overview:
    """Return what a log tells that was opened; `max_gap` [s] ends a run, None: five periods.

    Raises `LogError` where it cannot be believed, `DataError` where a signal is not in it.
    """
    firmware = {channel.signal: channel.workbench.firmware for channel in channels}
    growing = GrowingClocks.of(log, log.head.findings, max_gap)
    doctor = Doctor(log.head, growing.periods, sensors=firmware, robot=robot)
    ends: dict[tuple[str, str], Signal] = {}
    sums = {signal.name: (0, 0.0) for signal in log.head.temperatures}
    seeing: tuple[Onlooker, ...] = (growing, doctor, *onlookers)
    for piece in log.pieces():
        own = piece.own
        for one in seeing:
            one.see(own)
        for role in ROLES:
            ends |= {(role, s.name): s.outline() for s in getattr(own, role) if len(s)}
        for signal in own.temperatures:
            count, total = sums[signal.name]
            sums[signal.name] = (count + len(signal), total + float(signal.values.sum()))
    found = doctor.findings()
    findings = (*log.head.findings, *found)
    clocks = growing.clocks()
    sensors = {signal.name for signal in log.head.channels}
    if any(finding.cut and finding.signal not in sensors for finding in found):
        clocks = clocks_of(log, findings, max_gap)
    return Overview(
        outlined(log.head, ends),
        findings,
        clocks,
        {name: (count, total / count) for name, (count, total) in sums.items() if count},
    )


def outlined(head: Recording, ends: Mapping[tuple[str, str], Signal]) -> Recording:
    """Return the first samples of a recording with the last of every signal, by role and name."""
    last = {
        id(signal): ends.get((role, signal.name))
        for role in ROLES
        for signal in getattr(head, role)
    }

    def with_end(signal: Signal) -> Signal:
        end = last[id(signal)]
        if end is None or end.stamps[-1] == signal.stamps[0]:
            return replace(signal, breaks=())
        return replace(
            signal,
            stamps=np.concatenate([signal.stamps[:1], end.stamps[-1:]]),
            values=np.concatenate([signal.values[:1], end.values[-1:]]),
            breaks=(),
        )

    return mapped(head, with_end)
