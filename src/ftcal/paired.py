"""One sensor over a whole recording that is in memory: `ftcal.piece_pairing`, put together."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal.clocks import clocks_of
from ftcal.contact import ContactSchedule
from ftcal.logs.pieces import WholeLog
from ftcal.moments import Moments
from ftcal.pairing import FtChannel, SignalOptions, Windows
from ftcal.piece_pairing import Pairing
from ftcal.recording import NANOSECONDS, Finding, Recording
from ftcal.robot import Robot
from ftcal.samples import Samples

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array


@dataclass(frozen=True, slots=True)
class Attitude:
    """How the free half hangs on the sensor, in the sensor's frame."""

    gravity: Float[Array, "N 3"]
    """Gravity acceleration [m/s^2]."""
    centre_of_mass: Float[Array, "N 3"]
    """Centre of mass of the free half [m]."""


@dataclass(frozen=True, slots=True)
class Paired:
    """One sensor over one whole recording: channels beside the model wrench, smoothed alike."""

    samples: Samples
    """All usable samples of the recording."""
    logged: int
    """Samples that the log holds of this sensor."""
    attitude: Attitude | None
    """What the in situ offset needs, row by row of `samples`; None unless asked for."""

    def windows(self, windows: Windows) -> list[Samples]:
        """Return an offset segment for each window; windows without a sample are left out."""
        segments = [self.samples.between(start, stop) for start, stop in windows]
        return [segment for segment in segments if len(segment)]

    def attitude_during(self, segment: Samples) -> Moments:
        """Return the moments of `[channels, gravity, centre of mass]` of one of its segments."""
        if self.attitude is None:
            raise ValueError("pair the recording with its attitude")
        first = int(np.searchsorted(self.samples.time, segment.time[0]))
        rows = slice(first, first + len(segment))
        attitude = self.attitude
        return Moments.of(
            np.hstack([segment.channels, attitude.gravity[rows], attitude.centre_of_mass[rows]])
        )


def pair(
    recording: Recording,
    robot: Robot,
    channel: FtChannel,
    schedule: ContactSchedule,
    *,
    gravity: tuple[float, float, float],
    imu: str | None = None,
    findings: Iterable[Finding] = (),
    reference_temperature: float = 0.0,
    options: SignalOptions | None = None,
    with_attitude: bool = False,
) -> Paired:
    """Return the usable samples of one sensor in one recording.

    `gravity` [m/s^2] is that of the contact frame while it stands still; with `imu` its motion is
    that signal's. Intervals in which both halves touch are passed over. Raises `DataError` where a
    needed joint is not logged, where no sample is left, or where no stretch is as long as the
    filter; `RobotError` for unknown names, or where both halves touch throughout.
    """
    log, cuts = WholeLog(recording), tuple(findings)
    options = options or SignalOptions()
    pairing = Pairing.of(
        log,
        robot,
        [channel],
        schedule,
        gravity=gravity,
        imu=imu,
        findings=cuts,
        clocks=clocks_of(log, cuts, options.max_gap),
        options=options,
        with_attitude=with_attitude,
    )
    found = [rows for piece in log.pieces(overlap=pairing.overlap)
             for _, rows in pairing.rows(piece)]  # fmt: skip
    pairing.check()
    stamps = np.concatenate([rows.stamps for rows in found])
    values = np.concatenate([rows.values for rows in found])
    beside = np.concatenate([rows.beside for rows in found])
    seconds = (stamps - recording.start) / NANOSECONDS
    warm = channel.temperature is not None
    samples = Samples(
        recording.name,
        float(seconds[0]),
        float(seconds[-1]),
        seconds,
        values[:, :-6],
        values[:, -6:],
        beside[:, 0] - reference_temperature if warm else None,
    )
    hanging = Attitude(beside[:, -6:-3], beside[:, -3:]) if with_attitude else None
    return Paired(samples, pairing.logged[channel.sensor], hanging)
