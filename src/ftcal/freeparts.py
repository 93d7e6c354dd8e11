"""The free parts of the robot in one recording: behind a sensor, and between several.

What a part must balance comes from `ftcal.balances`, cut at one sensor after the other and at all
together. Offsets are unknown: each block of time has its own. Joints that are not logged rest at
zero; that tells a sign, and the mass that hangs on them counts as error.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from ftcal.balances import Balance, balances, free_sub_models
from ftcal.bins import averaged, usual
from ftcal.contact import ContactSchedule, Interval
from ftcal.errors import DataError, raise_all
from ftcal.kinematics import relative_pose
from ftcal.misfit import INDEPENDENT, LINK_SIZE, Misfit, lengths, without
from ftcal.motion import STANDARD_GRAVITY
from ftcal.pairing import FtChannel
from ftcal.recording import NANOSECONDS, Finding, Recording
from ftcal.robot import Robot, SubModel
from ftcal.sensor import Workbench
from ftcal.signals import joint_motion

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

BLOCKS = 4
"""Least number of blocks: each has its own offsets, and each judges what the others fitted."""

SOMEWHERE = 0.5
"""Share of a part's mass that may hang on joints not logged; held at zero, it still tells signs."""

AS_LOGGED = Workbench("as logged", np.eye(6), np.ones(6), "channels")
"""The log is believed, in N and Nm."""


def misfits(
    recording: Recording,
    robot: Robot,
    schedule: ContactSchedule,
    signals: Mapping[str, str],
    *,
    gravity: tuple[float, float, float] = STANDARD_GRAVITY,
    findings: Iterable[Finding] = (),
) -> tuple[Misfit, ...]:
    """Return the balances of every part that touches nothing: behind a sensor, between several.

    `signals` maps F/T sensors to signals of the log in N and Nm; samples that `findings` cut are
    left out. Joints that are not logged rest at zero; a sensor beyond one, and a part with more
    than half of its mass beyond one, say nothing. `DataError` where nothing is left.
    """
    findings = tuple(findings)
    logged = {column for signal in recording.joints for column in signal.columns}
    still = frozenset(robot.moving_joints) - logged
    rested = at_rest(robot, still)
    blocks = blocks_of(schedule, recording)
    placed = [name for name in signals if not _beyond(robot, blocks, still, name)]
    found: dict[tuple[str, tuple[str, ...]], Misfit] = {}
    faults = []
    for cut in [*([name] for name in placed), placed]:
        parts = {
            (model.name, model.sensors): model
            for interval in blocks
            for model in free_sub_models(rested, cut, interval.touching)
            if any(rested.links[link].mass > 0.0 for link in model.links)
        }
        channels = [FtChannel(name, signals[name], AS_LOGGED) for name in cut]
        if not parts.keys() - found.keys():
            continue
        try:
            closed = balances(
                recording,
                rested,
                channels,
                ContactSchedule(blocks),
                gravity=gravity,
                findings=findings,
            )
        except DataError as error:
            faults.append(str(error))
            continue
        for balance in closed:
            key = (balance.sub_model, tuple(balance.transforms))
            if key in parts and key not in found:
                made = _misfit(recording, rested, parts[key], balance, blocks, still, gravity)
                if made is not None:
                    found[key] = made
    if not found:
        faults.append("no part of the robot is free, moved and known; name the contacts or sensors")
        raise_all(DataError, f"recording {recording.name!r}", dict.fromkeys(faults))
    return tuple(found.values())


@lru_cache(maxsize=8)
def at_rest(robot: Robot, still: frozenset[str]) -> Robot:
    """Return a robot with some joints held at zero, kept: what is compiled for it is too."""
    stiff = {name: replace(robot.joints[name], kind="fixed") for name in still}
    return replace(robot, joints={**robot.joints, **stiff})


def blocks_of(schedule: ContactSchedule, recording: Recording) -> tuple[Interval, ...]:
    """Return the intervals of the schedule, cut into at least `BLOCKS` pieces in all."""
    inside = [
        replace(i, start=max(i.start, 0.0), stop=min(i.stop, recording.duration))
        for i in schedule.intervals
        if i.start < recording.duration and i.stop > 0.0
    ]
    longest = sum(i.stop - i.start for i in inside) / BLOCKS
    pieces = []
    for i in inside:
        count = int(np.ceil((i.stop - i.start) / longest * (1.0 - 1e-9)))
        edges = np.linspace(i.start, i.stop, count + 1).tolist()
        pieces += [replace(i, start=a, stop=b) for a, b in itertools.pairwise(edges)]
    return tuple(pieces)


def _beyond(robot: Robot, blocks: Sequence[Interval], still: frozenset[str], sensor: str) -> bool:
    """Return whether a joint in `still` lies between a contact and a sensor."""
    return any(
        joint.name in still
        for contact in {interval.link for interval in blocks}
        for joint in robot.path(contact, robot.sensor(sensor).parent)
    )


def _misfit(
    recording: Recording,
    robot: Robot,
    model: SubModel,
    balance: Balance,
    blocks: Sequence[Interval],
    still: frozenset[str],
    gravity: tuple[float, float, float],
) -> Misfit | None:
    """Return the quadratic form of a balance; None where it is short, or its mass hangs loose.

    `robot` is without the joints in `still`.
    """
    massive = [name for name in model.links if robot.links[name].mass > 0.0]
    ways = {name: {joint.name for joint in robot.path(model.name, name)} for name in massive}
    seen = tuple(name for name in massive if not ways[name] & still)
    mass = sum(robot.links[name].mass for name in massive)
    loose = 1.0 - sum(robot.links[name].mass for name in seen) / mass
    bins = averaged(balance, blocks, recording.duration)
    clock = recording.start + np.round(bins.time * NANOSECONDS).astype(np.int64)
    motion, known = joint_motion(recording, robot.moving_joints, clock)
    keep = known & bins.enough(known)
    if loose > SOMEWHERE or not keep.any():
        return None
    bins, motion = bins.rows(keep), motion.rows(keep)
    weight = robot.mass * float(np.linalg.norm(gravity))
    whitening = np.linalg.inv(np.linalg.cholesky(usual(balance, bins, loose, weight)))
    down = np.empty((len(motion), 3))
    for number, interval in enumerate(blocks):
        here = bins.block == number
        C_R_F = relative_pose(robot, motion.rows(here), interval.link, model.name)[:, :3, :3]
        down[here] = np.einsum("nji,j->ni", C_R_F, gravity)
    moved = {name: bins.about_mean(value) for name, value in bins.readings.items()}
    columns = [bins.required[:, :, None]]
    columns += [
        np.einsum("nij,nk->nijk", bins.carried[name], value).reshape(-1, 6, 36)
        for name, value in moved.items()
    ]
    columns += [inertial(relative_pose(robot, motion, model.name, n), down) for n in seen]
    table = np.einsum("ij,njc->nic", whitening, np.concatenate(columns, axis=2))
    # a sensor carries the weight of the robot at most, on a lever of a link
    most = weight * np.repeat([1.0, LINK_SIZE], 3)
    offsets = [whitening @ (X * most) for X in bins.carried.values()]
    freedom = np.concatenate(offsets, axis=2)
    strength = np.sqrt(INDEPENDENT / bins.length)
    rows, grams = [], {}
    for number in np.unique(bins.block).tolist():
        here = bins.block == number
        left, penalty = without(table[here], freedom[here], strength)
        rows.append(left)
        grams[number] = (left.T @ left + penalty.T @ penalty) / (6 * len(bins.time))
    loads = [lengths(np.einsum("nij,nj->ni", bins.carried[n], y)) for n, y in moved.items()]
    return Misfit(
        model.name,
        tuple(moved),
        {name: robot.links[name].mass for name in seen},
        tuple(sorted(set().union(*ways.values()) & still)),
        len(bins.time) * bins.length,
        np.concatenate(rows),
        grams,
        whitening,
        (max(force for force, _ in loads), max(torque for _, torque in loads)),
    )


def inertial(F_H_L: Float[Array, "N 4 4"], F_g: Float[Array, "N 3"]) -> Float[Array, "N 6 4"]:
    """Return what a kilogram at a link's origin, and a kg m along each of its axes, ask for.

    Less its weight, that is: robots that are diagnosed move slowly.
    """
    asked = np.zeros((len(F_g), 6, 4))
    asked[:, :3, 0] = -F_g
    asked[:, 3:, 0] = -np.cross(F_H_L[:, :3, 3], F_g)
    asked[:, 3:, 1:] = -np.cross(F_H_L[:, :3, :3], F_g[:, :, None], axisa=1, axisb=1, axisc=1)
    return asked
