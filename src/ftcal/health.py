"""The data doctor: what a log does that a calibration must not believe.

Seen in the one public log of the paper's own robot: the firmware freezes all six outputs of a
sensor while one channel is beyond its range (21 % of the samples of the left hip, and a moment of
the right one just before its offset steps). Every check returns findings; those that cut are left
out of all that follows (`ftcal.signals.usable`), the others are told and change nothing.

The recording passes by, so that one of any length is examined in a few megabytes a signal. What is
found depends on its samples, not on how it was cut into pieces.
"""

from __future__ import annotations

from collections.abc import Mapping

from ftcal.checkups import FtCheckup, ImuCheckup, JointCheckup
from ftcal.firmware import FirmwareMatrix
from ftcal.holes import clock_jumps
from ftcal.recording import Finding, Recording
from ftcal.robot import Robot
from ftcal.saturation import CEILING, NEAR_CEILING, logs_counts
from ftcal.serials import Serial
from ftcal.unit_doubts import doubted_stamps

__all__ = ["CEILING", "NEAR_CEILING", "Doctor", "examine", "logs_counts"]


class Doctor:
    """What is wrong with a recording, found while it passes by piece by piece.

    Exact whatever the length are holes, saturation, plateaus and angles; freezes up to 2^20 samples
    of a signal, the median of an imu up to 2^17, and serial numbers up to 2^15: beyond, some of the
    samples decide (`freezes.ROOM`, `unit_doubts.ROOM`, `turns.Turns`, `serials.ROOM`).
    """

    def __init__(
        self,
        head: Recording,
        periods: Mapping[str, float],
        *,
        sensors: Mapping[str, FirmwareMatrix | None] | None = None,
        robot: Robot | None = None,
    ) -> None:
        """Expect the recording of which `head` has the name, the start and the signals.

        `periods` are the median periods [s] of all signals by name, NaN of fewer than two samples.
        `sensors` maps F/T signals to the matrices in their firmware, as far as known; `DataError`
        names a signal the recording lacks. With the `robot` its joint limits tell of wrong units.
        """
        matrices = dict(sensors or {})
        for name in matrices:
            head.channel(name)
        known = {matrix.serial: matrix for matrix in matrices.values() if matrix is not None}
        self._joints = {
            joint.name: JointCheckup(joint, head.start, periods[joint.name], robot)
            for joint in head.joints
        }
        self._channels = {
            ft.name: FtCheckup(
                ft, head.start, periods[ft.name], Serial(ft.name, matrices.get(ft.name), known)
            )
            for ft in head.channels
        }
        self._imus = {imu.name: ImuCheckup(imu, head.start, periods[imu.name]) for imu in head.imus}

    def see(self, own: Recording) -> None:
        """Take note of the next samples of every signal; `breaks` count within them."""
        for joint in own.joints:
            self._joints[joint.name].see(joint)
        for ft in own.channels:
            self._channels[ft.name].see(ft)
        for imu in own.imus:
            self._imus[imu.name].see(imu)

    def findings(self) -> tuple[Finding, ...]:
        """Return what is wrong, and which sensors wrote it, signal by signal."""
        joints, channels = self._joints.values(), self._channels.values()
        clocks = [*(joint.clock for joint in joints), *(ft.clock for ft in channels)]
        found = list(clock_jumps(clocks))
        for clock in clocks:
            empty = Finding("empty", clock.name, 0.0, 0.0, False, f"{clock.name}: no samples")
            found += clock.gaps() if clock.count else [empty]
        for ft in channels:
            found += ft.findings() if ft.clock.count else ()
        units = [(clock, doubted_stamps(clock.count, clock.period)) for clock in clocks]
        units += [(joint.clock, joint.angles.doubts()) for joint in joints]
        units += [(imu.clock, imu.inertia.doubts()) for imu in self._imus.values()]
        found += [
            Finding("unit", clock.name, *clock.span, cut=False, message=f"{clock.name}: {message}")
            for clock, doubts in units
            for message in doubts
        ]
        return tuple(found)


def examine(
    recording: Recording,
    *,
    sensors: Mapping[str, FirmwareMatrix | None] | None = None,
    robot: Robot | None = None,
) -> tuple[Finding, ...]:
    """Return what is wrong with `recording`, and which sensors wrote it, signal by signal.

    `sensors` and `robot` as `Doctor` has them; `DataError` names a sensor the recording lacks.
    """
    # signals of one table share their clock
    clocks = {id(signal.stamps): signal for signal in recording.signals}
    median = {key: signal.period for key, signal in clocks.items()}
    periods = {signal.name: median[id(signal.stamps)] for signal in recording.signals}
    doctor = Doctor(recording, periods, sensors=sensors, robot=robot)
    doctor.see(recording)
    return doctor.findings()
