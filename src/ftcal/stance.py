"""What one foot of a robot on two does: it hangs, touches, carries, or is not seen.

A foot in the air reads the weight of what hangs beyond its sensor and a constant offset; on the
ground it is pushed besides, and never pulled. Offsets are unknown, so the level of a free foot is
the one to which no sample is lower. It is believed only where the soles move against each other: a
robot that sways on two standing feet unloads one, but cannot move it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ftcal.dynamics import expected_wrenches
from ftcal.kinematics import gravity_in_sensor, relative_pose
from ftcal.motion import STANDARD_GRAVITY, FixedContact, Motion
from ftcal.recording import Finding, Recording
from ftcal.robot import Robot
from ftcal.run_filter import odd_window
from ftcal.signals import interpolate, joint_motion, runs, smooth_runs, usable

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int
    from numpy import ndarray as Array

STEP = 0.02
"""Step of the common clock [s]."""

WINDOW = 0.11
"""Readings are averaged over this long [s]: impacts end, steps of walking stay."""

JOINT_WINDOW = 0.31
"""Window of the joints' filter [s]: that of calibration would blunt a step of walking."""

SLACK = 0.03
"""Share of the robot's weight by which a free foot may seem to be pulled: gain error, dynamics."""

TOUCH = 0.01
"""Least load that counts as touching, as a share of the robot's weight (3 N of an iCub)."""

SPREAD = 5.0
"""Touching also exceeds this many standard deviations of the free foot's own reading."""

CARRY = 0.12
"""A foot that bears less than this share of the weight brushes the floor; it carries nothing."""

BLIP = 0.1
"""A state shorter than this [s] is a passage between its neighbours."""

KNOCK = 0.3
"""A foot that carries for less than this [s] between two light touches has knocked the floor."""

SETTLED = 1.0
"""A free foot that touches lightly again within this time [s] is still brushing."""

CLEAR, REACH = 0.03, 0.12
"""A sole higher than this [m] is in the air, if its toes reach no farther from its frame [m]."""

MOVED, TURNED = 0.015, math.radians(6.0)
"""Soles that move [m] or turn [rad] less against each other both stand: gears and soles give."""

EXAMPLE = 0.5
"""Length of the pieces [s] whose median may be the level of the free foot."""

PIECES = 1000
"""Most such pieces: a log of an hour is searched in seconds."""

THIRD = 0.4307
"""Standard deviations within which a third of a normal distribution lies about its mean."""

REFINED = 5
"""Times the level moves to the middle of its neighbours."""

STATES = ("free", "touching", "carrying", "unknown")
"""What one foot does."""

FREE, TOUCHING, CARRYING, UNKNOWN = range(len(STATES))


@dataclass(frozen=True, slots=True)
class Place:
    """A foot, the sensor that feels it, and the other foot."""

    frame: str
    """Contact frame."""
    other: str
    """Contact frame of the other foot."""
    sensor: str
    """F/T sensor between them."""
    signal: str
    """F/T signal of the log, N and Nm."""


@dataclass(frozen=True, slots=True)
class Foot:
    """What one foot's sensor shows, for a plot."""

    place: Place
    free: bool
    """Whether the foot was ever seen off the ground; if not, the zero of `load` is unknown."""
    spread: float
    """Standard deviation of the free foot's load [N]; NaN if it never was."""
    load: Float[Array, "N"]
    """Vertical force of the ground on the foot [N]; NaN where not known."""
    state: Int[Array, "N"]
    """Index into `STATES`."""
    above: Bool[Array, "N"]
    """Where it cannot reach the floor that the other foot's sole lies on."""


def watch(
    recording: Recording,
    robot: Robot,
    place: Place,
    clock: Int[Array, "N"],
    findings: Sequence[Finding] = (),
) -> Foot:
    """Return what the foot at `place` did on the stamps `clock` [ns], `STEP` apart.

    Samples that `findings` cut are unknown. `DataError`: joints between the feet not logged.
    """
    force = read_force(recording, place.signal, clock, findings)
    joints = robot.required_joints(place.sensor, place.other)
    motion, valid = joint_motion(recording, joints, clock, window=JOINT_WINDOW, findings=findings)
    known = valid & np.isfinite(force).all(axis=1)
    load, state = np.full(len(clock), np.nan), np.full(len(clock), UNKNOWN)
    above, spread = np.zeros(len(clock), dtype=bool), math.nan
    if known.any():
        load[known], state[known], spread = weigh(robot, place, motion.rows(known), force[known])
        soles = relative_pose(robot, motion, place.other, place.frame)
        above = out_of_reach(soles)
        state = standing_still(settled(state), soles)
    free = bool((state == FREE).any())
    return Foot(place, free, spread if free else math.nan, load, state, above)


def read_force(
    recording: Recording, name: str, clock: Int[Array, "N"], findings: Sequence[Finding]
) -> Float[Array, "N 3"]:
    """Return the force of an F/T signal [N], averaged; NaN where it is cut or has a hole."""
    signal = recording.channel(name)
    stretches = runs(signal, usable=usable(recording, signal, findings))
    window = odd_window(WINDOW, signal.period)
    mean = smooth_runs(signal.values[:, :3], stretches, window, 1)
    smoothed = replace(signal, values=mean, columns=signal.columns[:3])
    return interpolate(smoothed, clock, usable=np.isfinite(mean).all(axis=1))


def weigh(
    robot: Robot, place: Place, motion: Motion, force: Float[Array, "N 3"]
) -> tuple[Float[Array, "N"], Int[Array, "N"], float]:
    """Return the vertical load on a foot [N], its state by load alone, and the free foot's spread.

    The foot that hangs has the other foot's floor for its vertical, the foot that carries its own.
    """
    half = robot.free_half(place.sensor, [place.other])
    # what the foot's half does to the rest is measured, or what the rest does to it
    sign = -1.0 if robot.sensor(place.sensor).acts_on == half.side else 1.0
    g = float(np.linalg.norm(STANDARD_GRAVITY))
    weight = robot.mass * g
    hung = g * sum(robot.links[link].mass for link in half.links)
    there, here = FixedContact(place.other), FixedContact(place.frame)
    up_hanging = -sign * gravity_in_sensor(robot, motion, there, place.sensor) / g
    up_standing = -sign * gravity_in_sensor(robot, motion, here, place.sensor) / g
    model = expected_wrenches(robot, motion, there, [place.sensor])[place.sensor][:, :3]
    residual = force - model
    offset = free_level(residual, up_standing, force, hung, SLACK * weight)
    hanging = np.einsum("ni,ni->n", up_hanging, residual - offset)
    standing = np.einsum("ni,ni->n", up_standing, force - offset) + hung
    centre, spread = densest(hanging[np.abs(hanging) < SLACK * weight])
    hanging, standing = hanging - centre, standing - centre
    touch = max(TOUCH * weight, SPREAD * spread)
    # a foot that carries sees the floor askew where the other one kicks high
    free = (hanging < touch) & (np.linalg.norm(residual - offset, axis=1) < CARRY * weight)
    state = np.where(free, FREE, np.where(standing < CARRY * weight, TOUCHING, CARRYING))
    return np.where(state == FREE, hanging, standing), state, spread


def free_level(
    residual: Float[Array, "N 3"],
    up: Float[Array, "N 3"],
    force: Float[Array, "N 3"],
    hanging: float,
    slack: float,
) -> Float[Array, "3"]:
    """Return the offset [N] below which the ground would pull the foot, by `slack` at most.

    Among the medians of short pieces: least pulled in time, but for one piece's worth, and of
    those the one which most samples are near; then the median of these, until it rests.
    """
    size = round(EXAMPLE / STEP)
    stride = max(size // 2, len(residual) // PIECES)
    starts = range(0, max(1, len(residual) - size + 1), stride)
    levels = np.array([np.median(residual[i : i + size], axis=0) for i in starts])
    read = np.einsum("ni,ni->n", up, force) + hanging
    pulled = np.array([np.count_nonzero(read - up @ level < -slack) for level in levels])
    near = [np.count_nonzero(np.linalg.norm(residual - c, axis=1) < slack) for c in levels]
    allowed = pulled <= pulled.min() + size
    level = levels[np.argmax(np.where(allowed, near, -1))]
    for _ in range(REFINED):
        around = residual[np.linalg.norm(residual - level, axis=1) < slack]
        level = np.median(around, axis=0) if len(around) else level
    return np.asarray(level)


def densest(values: Float[Array, "N"]) -> tuple[float, float]:
    """Return centre and standard deviation as the shortest third of `values` tells them.

    Touches push to one side only, and much wider than a free foot trembles: they do not move it
    (after the "shorth" of Andrews et al., Robust Estimates of Location, 1972, which takes half).
    No values: 0 and infinity.
    """
    if len(values) == 0:
        return 0.0, math.inf
    ordered = np.sort(values)
    some = len(ordered) // 3
    widths = ordered[some:] - ordered[: len(ordered) - some]
    first = int(widths.argmin())
    half_width = float(widths[first]) / 2
    return float(ordered[first]) + half_width, half_width / THIRD


def settled(state: Int[Array, "N"]) -> Int[Array, "N"]:
    """Return the states of a foot without passages, knocks and hops."""
    state = state.copy()
    for span in same(state):
        beside = _beside(state, span)
        if _seconds(span) < BLIP and len(beside) == 1:
            state[span] = beside.pop()
        elif _seconds(span) < BLIP and state[span.start] == TOUCHING and UNKNOWN not in beside:
            state[span] = CARRYING  # load rises and falls through the light range
    for span in same(state):
        light = _beside(state, span) <= {FREE, TOUCHING}
        if state[span.start] == CARRYING and _seconds(span) < KNOCK and light:
            state[span] = TOUCHING
    for span in same(state):
        brushes = TOUCHING in _beside(state, span)
        if state[span.start] == FREE and _seconds(span) < SETTLED and brushes:
            state[span] = TOUCHING
    return state


def standing_still(state: Int[Array, "N"], soles: Float[Array, "N 4 4"]) -> Int[Array, "N"]:
    """Return the states, carrying where a foot seemed free but its sole stood still.

    A foot never free has no zero of load: it carries throughout. One that carries before and after
    it was not seen has carried in between if its sole stood still.
    """
    state = state.copy()
    known = np.isfinite(soles).all(axis=(1, 2))
    for span in same(state):
        if state[span.start] == FREE and not moves(soles[span][known[span]]):
            state[span] = CARRYING
    if not (state == FREE).any():
        state[state != UNKNOWN] = CARRYING
    for span in same(state):
        around = slice(max(0, span.start - 1), span.stop + 1)
        stood = known[around].all() and not moves(soles[around])
        if state[span.start] == UNKNOWN and _beside(state, span) == {CARRYING} and stood:
            state[span] = CARRYING
    return state


def moves(soles: Float[Array, "N 4 4"]) -> bool:
    """Return whether one sole moves or turns against the other."""
    if len(soles) == 0:
        return False
    away = float(np.linalg.norm(np.ptp(soles[:, :3, 3], axis=0)))
    turned = np.einsum("ji,nji->n", soles[0, :3, :3], soles[:, :3, :3])  # traces of R0' R
    return away > MOVED or float(turned.min()) < 1.0 + 2.0 * math.cos(TURNED)


def out_of_reach(soles: Float[Array, "N 4 4"]) -> Bool[Array, "N"]:
    """Return where even the toes of a sole are clear of the plane of the other."""
    tilt = np.hypot(soles[:, 2, 0], soles[:, 2, 1])
    return np.asarray(soles[:, 2, 3] > CLEAR + REACH * tilt)


def same(state: Int[Array, "N"]) -> list[slice]:
    """Return the stretches of equal values."""
    edges = [0, *(np.flatnonzero(np.diff(state)) + 1).tolist(), len(state)]
    return [slice(a, b) for a, b in itertools.pairwise(edges)]


def _beside(state: Int[Array, "N"], span: slice) -> set[int]:
    """Return the states before and after a span."""
    return {int(state[row]) for row in (span.start - 1, span.stop) if 0 <= row < len(state)}


def _seconds(span: slice) -> float:
    return float(span.stop - span.start) * STEP
