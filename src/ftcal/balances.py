"""What holds together the sensors around a part of the robot that touches nothing.

The sensors cut the robot into sub-models. For one that touches nothing, every sample says

    sum over the sensors on its border   X_s (C_s r_s + o_s)   =   h                            (B)

(method 5): `h` is the rate of change of momentum of its links less their weight, `X_s` moves the
reading of sensor s to the frame of the sub-model, with the sign of the side that it acts on. What
is left over is the external wrench of the paper's second validation, which should be zero.

Sensors log on clocks of their own; a recording is balanced on that of the first.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from ftcal.contact import ContactSchedule
from ftcal.errors import DataError
from ftcal.external import external_wrenches
from ftcal.kinematics import sensor_pose
from ftcal.motion import Contact, Motion
from ftcal.pairing import FtChannel, SignalOptions, contact_motion
from ftcal.recording import Finding, Recording
from ftcal.robot import Robot, SubModel
from ftcal.run_filter import odd_window
from ftcal.signals import SMOOTHING_ORDER, interpolate, joint_motion, smooth_runs, usable
from ftcal.spatial import wrench_transform

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray as Array


PIECE = 10_000
"""Samples whose transforms are held at once."""

KEPT = 5
"""Samples of every smoothing window that are kept: a parabola fitted to it has three unknowns."""


@dataclass(frozen=True, slots=True)
class Leftover:
    """The external wrench that is seen where there is none, as means over the samples."""

    force: float
    """Mean length of the force [N]."""
    torque: float
    """Mean length of the torque [Nm]."""
    axes: tuple[float, ...]
    """Mean size of each component [N, Nm]."""

    @staticmethod
    def of(wrench: Float[Array, "N 6"]) -> Leftover:
        """Return the means of a wrench."""
        force, torque = (np.linalg.norm(half, axis=1) for half in np.hsplit(wrench, 2))
        sizes = np.abs(wrench).mean(axis=0)
        return Leftover(float(force.mean()), float(torque.mean()), tuple(map(float, sizes)))


@dataclass(frozen=True, slots=True, eq=False)
class Balance:
    """Equation (B) of one sub-model, sample by sample, in the frame of its first link."""

    sub_model: str
    """Its link nearest the root of the robot."""
    time: Float[Array, "N"]
    """Seconds since the start of the recording, where nothing touches the sub-model."""
    inputs: dict[str, Float[Array, "N P"]]
    """Raw channels r of each sensor on the border; T - T_ref last, where it has a thermometer."""
    transforms: dict[str, Float[Array, "N 6 6"]]
    """X of each: from the sensor's frame to the sub-model's, the sign of its side included."""
    required: Float[Array, "N 6"]
    """h: what the readings must add up to [N, Nm]."""
    by_mass: bool = False
    """Whether joints inside it are not logged: the three rows of the forces alone hold, as long as
    nothing beyond those joints is thrown about."""
    model_errors: dict[str, Float[Array, "N 6"]] = field(default_factory=dict)
    """What one standard deviation of an error of the model adds to what the readings add up to,
    less h [N, Nm]; by its name, where any is suspected."""
    taken_on: dict[str, float] = field(default_factory=dict)
    """How much of some of them the balance takes on already, in their standard deviations."""

    @property
    def equations(self) -> int:
        """Rows of (B) that hold: six, or the three of the forces."""
        return 3 if self.by_mass else 6

    def rows(
        self,
        where: Int[Array, "M"] | slice,
        inputs: Mapping[str, Float[Array, "N P"]] | None = None,
        required: Float[Array, "N 6"] | None = None,
    ) -> Balance:
        """Return the samples that `where` selects; `inputs` and h may be others."""
        return Balance(
            self.sub_model,
            self.time[where],
            {name: values[where] for name, values in (inputs or self.inputs).items()},
            {name: X[where] for name, X in self.transforms.items()},
            (self.required if required is None else required)[where],
            self.by_mass,
            {name: change[where] for name, change in self.model_errors.items()},
            self.taken_on,
        )

    def residual(self, readings: Mapping[str, Float[Array, "N 6"]]) -> Float[Array, "N 6"]:
        """Return what the wrenches that the sensors read [N, Nm] add up to, less h.

        It is the external wrench that the sensors see, with its sign reversed.
        """
        total = -self.required
        for name, X in self.transforms.items():
            total = total + np.einsum("nij,nj->ni", X, readings[name])
        return np.asarray(total)

    def implied(
        self, sensor: str, readings: Mapping[str, Float[Array, "N 6"]]
    ) -> Float[Array, "N 6"]:
        """Return what `sensor` should read [N, Nm], in its own frame, if all others are right.

        The residual of a row of its matrix is then that of one axis: axes are separate problems.
        """
        others = {name: readings[name] for name in self.transforms if name != sensor}
        nothing = np.zeros_like(self.required)
        missing = -self.residual({**others, sensor: nothing})
        return np.asarray(np.linalg.solve(self.transforms[sensor], missing[..., None])[..., 0])


def smoothed(balance: Balance, seconds: float) -> Balance | None:
    """Return a balance whose channels and h have passed one zero-phase filter of some `seconds`.

    The transforms stay, so the filter must be shorter than the motion of the joints between the
    sensors; it takes away the noise of the channels that would bias a fit. What is left varies
    slowly: `KEPT` samples of every window are kept. None where no stretch is as long as the filter.
    """
    step = np.diff(balance.time)
    if not len(step):
        return None
    period = float(np.median(step))
    edges = [0, *(np.flatnonzero(step > max(0.05, 5.0 * period)) + 1).tolist(), len(balance.time)]
    stretches = [slice(a, b) for a, b in itertools.pairwise(edges)]
    window = odd_window(seconds, period)

    def smooth(values: Float[Array, "N K"]) -> Float[Array, "N K"]:
        return smooth_runs(values, stretches, window, SMOOTHING_ORDER)

    inputs = {name: smooth(values) for name, values in balance.inputs.items()}
    required = smooth(balance.required)
    kept = np.flatnonzero(np.isfinite(required).all(axis=1))[:: max(1, window // KEPT)]
    return balance.rows(kept, inputs, required) if len(kept) else None


def free_sub_models(
    robot: Robot, sensors: Sequence[str], touching: Sequence[str]
) -> tuple[SubModel, ...]:
    """Return the sub-models cut out by `sensors` that none of the `touching` links belongs to."""
    touched = {robot.link(name).name for name in touching}
    return tuple(
        model
        for model in robot.sub_models(sensors)
        if model.sensors and not touched & set(model.links)
    )


def balances(
    recording: Recording,
    robot: Robot,
    channels: Sequence[FtChannel],
    schedule: ContactSchedule,
    *,
    gravity: tuple[float, float, float],
    imu: str | None = None,
    findings: Iterable[Finding] = (),
    options: SignalOptions | None = None,
    by_mass: bool = False,
    reduced: Callable[[Balance], Balance | None] = lambda balance: balance,
) -> tuple[Balance, ...]:
    """Return the balance of every sub-model that is free in some interval of the schedule.

    `channels` cut the robot; a sample needs every sensor on its border to be usable. Sub-models
    with joints that are not logged are left out, or enter `by_mass` with those joints at zero,
    where the way from the contact to their sensors is logged. Readings are what a controller sees;
    a fit has them `reduced` (by `smoothed`), piece by piece of at most `PIECE` samples. Raises
    `DataError` where none is left, `RobotError` for unknown names.
    """
    options = options or SignalOptions()
    findings = tuple(findings)
    clock = recording.channel(channels[0].signal)
    seconds = recording.seconds(clock)
    logged = {column for signal in recording.joints for column in signal.columns}
    joints = [name for name in robot.moving_joints if name in logged]
    motion, known = joint_motion(
        recording,
        joints,
        clock.stamps,
        window=options.joint_window,
        order=options.joint_order,
        max_gap=options.max_gap,
        findings=findings,
    )
    raw = {
        robot.sensor(channel.sensor).name: _inputs(
            recording, channel, clock.stamps, findings, options.max_gap
        )
        for channel in channels
    }
    parts: dict[str, list[Balance]] = {}
    unknown: list[DataError] = []
    for interval in schedule.intervals:
        contact, steady = contact_motion(
            recording, interval, clock, gravity=gravity, imu=imu, options=options
        )
        rows = known & steady & (seconds >= interval.start) & (seconds < interval.stop)
        if not rows.any():
            continue
        where = np.flatnonzero(rows)
        for piece in np.array_split(where, -(-len(where) // PIECE)):
            here = replace(motion.rows(piece), time=seconds[piece])
            inside = {name: values[piece] for name, values in raw.items()}
            touching = interval.touching
            try:
                some = _in_interval(robot, here, contact.rows(piece), inside, touching, by_mass)
            except DataError as error:  # of no sub-model are all joints logged
                unknown.append(error)
                break
            for part in map(reduced, some):
                if part is not None:
                    parts.setdefault(part.sub_model, []).append(part)
    if not parts and unknown:
        raise DataError(f"recording {recording.name!r}: {unknown[0]}") from unknown[0]
    if not parts:
        raise DataError(
            f"recording {recording.name!r}: no sub-model is ever free with all its sensors usable"
            " and its joints logged; name more sensors, or other contacts"
        )
    return tuple(_joined(some) for some in parts.values())


def _inputs(
    recording: Recording,
    channel: FtChannel,
    clock: Int[Array, "N"],
    findings: Iterable[Finding],
    max_gap: float | None,
) -> Float[Array, "N P"]:
    """Return a sensor's channels, and temperature where it has one, on `clock` [ns]."""
    signal = recording.channel(channel.signal)
    good = usable(recording, signal, findings)
    values = channel.workbench.channels(signal.values)
    felt = interpolate(replace(signal, values=values), clock, max_gap=max_gap, usable=good)
    if channel.temperature is None:
        return felt
    return np.hstack([felt, interpolate(recording.temperature(channel.temperature), clock)])


def _in_interval(
    robot: Robot,
    motion: Motion,
    contact: Contact,
    inputs: Mapping[str, Float[Array, "N P"]],
    touching: Sequence[str],
    by_mass: bool,
) -> list[Balance]:
    """Return the balances of one interval, each without the samples that it lacks a sensor for."""
    sensors = list(inputs)
    free = free_sub_models(robot, sensors, touching)
    silent = {name: np.zeros((len(motion), 6)) for name in sensors}
    # readings of zero leave what they should have been
    needed = external_wrenches(robot, motion, contact, silent)
    wrench = dict(needed.wrench)
    if by_mass and needed.left_out:
        stiff = _stiffened(robot, tuple(n for names in needed.left_out.values() for n in names))
        frames = {name: name for name in needed.left_out}
        wrench |= external_wrenches(stiff, motion, contact, silent, frames).wrench
    found = []
    for model in free:
        if model.name not in wrench or not _reachable(robot, model, motion, contact):
            continue
        border = {name: inputs[name] for name in model.sensors}
        whole = np.all([np.isfinite(values).all(axis=1) for values in border.values()], axis=0)
        if not whole.any():
            continue
        moved = motion.rows(whole)
        found.append(
            Balance(
                model.name,
                moved.time,
                {name: values[whole] for name, values in border.items()},
                {name: _transform(robot, moved, model, name) for name in border},
                wrench[model.name][whole],
                model.name in needed.left_out,
            )
        )
    return found


@lru_cache(maxsize=32)
def _stiffened(robot: Robot, joints: tuple[str, ...]) -> Robot:
    """Return the robot with some joints fixed at zero, kept: kernels are kept with a robot."""
    return robot.stiffened(joints)


def _reachable(robot: Robot, model: SubModel, motion: Motion, contact: Contact) -> bool:
    """Return whether the joints from the contact to the sub-model and its sensors are logged."""
    ends = [contact.link, *(robot.sensor(name).child for name in model.sensors)]
    ways = {j.name for end in ends for j in robot.path(model.name, end) if j.kind != "fixed"}
    return ways <= set(motion.joints)


def _transform(robot: Robot, motion: Motion, model: SubModel, sensor: str) -> Float[Array, "N 6 6"]:
    """Return X of a sensor on the border: plus where its reading acts on the sub-model."""
    ft = robot.sensor(sensor)
    acted = ft.child if ft.acts_on == "child" else ft.parent
    X = wrench_transform(sensor_pose(robot, motion, model.name, sensor))
    return X if acted in model.links else -X


def _joined(parts: Sequence[Balance]) -> Balance:
    """Return one balance of the same sub-model in several intervals."""
    sensors = list(parts[0].inputs)
    return Balance(
        parts[0].sub_model,
        np.concatenate([part.time for part in parts]),
        {name: np.concatenate([part.inputs[name] for part in parts]) for name in sensors},
        {name: np.concatenate([part.transforms[name] for part in parts]) for name in sensors},
        np.concatenate([part.required for part in parts]),
        parts[0].by_mass,
    )
