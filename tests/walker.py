"""A walker of two legs and four sensors, standing as it is told, its loads known to the sample.

Each foot's sensor reads a blend of what it reads in the air and what it reads when it carries all,
by the foot's share of the weight: that of a robot that shifts its weight slowly.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ftcal.dynamics import expected_wrenches
from ftcal.kinematics import relative_pose
from ftcal.motion import FixedContact, Motion
from ftcal.recording import Recording, Signal
from ftcal.robot import Robot
from ftcal.urdf import parse_robot

RATE = 100
WEIGHT = 30.0
"""Mass of the walker [kg]: 18 of trunk, 6 a leg, of which a foot is half a kilogram."""
LEG = ("hip_roll", "hip_pitch", "knee", "ankle")
AXES = {"hip_roll": "1 0 0", "hip_pitch": "0 1 0", "knee": "0 1 0", "ankle": "0 1 0"}
SIDES = ("l", "r")
SENSORS = tuple(f"{side}_{place}_ft_sensor" for side in SIDES for place in ("leg", "foot"))
SIGNALS = {
    f"{side}_{place}_ft_sensor": f"{long}_{place}/analog:o"
    for side, long in (("l", "left"), ("r", "right"))
    for place in ("leg", "foot")
}


def body(name: str, mass: float, z: float) -> str:
    return (
        f'<link name="{name}"><inertial><origin xyz="0.01 0 {z}"/><mass value="{mass}"/>'
        '<inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )


def fixed(name: str, parent: str, child: str, xyz: str, rpy: str = "0 0 0") -> str:
    return (
        f'<joint name="{name}" type="fixed"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/></joint>'
    )


def turning(name: str, parent: str, child: str, xyz: str) -> str:
    return (
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}"/><axis xyz="{AXES[name[2:]]}"/>'
        '<limit lower="-3" upper="3" velocity="9" effort="9"/></joint>'
    )


def walker(direction: str = "child_to_parent") -> Robot:
    parts = [body("trunk", 18, 0.2)]
    for side, y in (("l", 0.08), ("r", -0.08)):
        hip, thigh, shin, ankle, foot = (
            f"{side}_{link}" for link in ("hip", "thigh", "shin", "ankle_link", "foot")
        )
        roll = f"{side}_roll_link"
        parts += [
            body(roll, 1, 0), body(hip, 1, 0), body(thigh, 2, -0.1), body(shin, 1, -0.1),
            body(ankle, 0.5, 0), body(foot, 0.5, 0.02), f'<link name="{side}_sole"/>',
            turning(f"{side}_hip_roll", "trunk", roll, f"0 {y} 0"),
            turning(f"{side}_hip_pitch", roll, hip, "0 0 0"),
            fixed(f"{side}_leg_ft_sensor", hip, thigh, "0 0 -0.05"),
            turning(f"{side}_knee", thigh, shin, "0 0 -0.2"),
            turning(f"{side}_ankle", shin, ankle, "0 0 -0.2"),
            # turned over: the offset of the sensor is nowhere near the vertical of the sole
            fixed(f"{side}_foot_ft_sensor", ankle, foot, "0 0 -0.03", "3.1 0.1 0.4"),
            fixed(f"{side}_sole_joint", foot, f"{side}_sole", "0 0 0.03", "-3.1 0 0"),
        ]  # fmt: skip
    parts += [
        f'<sensor name="{name}" type="force_torque"><parent joint="{name}"/><force_torque>'
        f"<frame>child</frame><measure_direction>{direction}</measure_direction></force_torque>"
        "</sensor>"
        for name in SENSORS
    ]
    level = parse_robot(f'<robot name="walker">{"".join(parts)}</robot>', name="walker")
    return on_level_soles(level)


def on_level_soles(robot: Robot) -> Robot:
    """Turn the soles level at zero: their frames were given only roughly."""
    still = Motion(np.zeros(1), (), *(np.zeros((1, 0)) for _ in range(3)))
    joints = dict(robot.joints)
    for side in SIDES:
        zero = {name: replace(j, kind="fixed") for name, j in robot.joints.items()}
        rigid = replace(robot, joints=zero)
        trunk_H_foot = relative_pose(rigid, still, "trunk", f"{side}_foot")[0]
        foot_H_sole = robot.joints[f"{side}_sole_joint"].parent_H_child.copy()
        foot_H_sole[:3, :3] = trunk_H_foot[:3, :3].T
        joints[f"{side}_sole_joint"] = replace(
            joints[f"{side}_sole_joint"], parent_H_child=foot_H_sole
        )
    return replace(robot, joints=joints)


Knots = list[tuple[float, float]]
"""Time [s] and share of the weight on the right foot, linear between."""

SWITCH: Knots = [
    (0, 0.5), (8, 0.5), (10, 0.3), (10.05, 0.04), (12, 0.03), (12.02, 0), (25, 0), (25.02, 0.04),
    (26, 0.05), (26.05, 0.3), (28, 0.5), (31, 0.7), (33, 1), (45, 1), (47, 0.6), (50, 0.5),
]  # fmt: skip
"""Right foot lifted at 10, brushing to 12, down at 25, carrying from 26; left one up at 33-45."""


def swing(time: np.ndarray, start: float, stop: float, kick: float = 0.0) -> np.ndarray:
    """Return angles (N, 4) of a leg [rad]: nought outside [start, stop], the foot high inside.

    `kick` [rad] is how far the whole leg turns at the hip besides.
    """
    phase = np.clip((time - start) / (stop - start), 0, 1)
    lift = np.sin(np.pi * phase) ** 2
    wiggle = lift * np.sin(2 * np.pi * 3 * phase)
    hip = -(0.7 + kick) * lift
    return np.column_stack([0.2 * wiggle, hip + 0.3 * wiggle, 1.1 * lift, -0.3 * lift])


def recorded(
    robot: Robot,
    knots: Knots,
    swings: dict[str, list[tuple[float, ...]]],
    *,
    seed: int = 0,
    lifted: tuple[float, float] = (0.0, 0.0),
) -> Recording:
    """Return a log of the walker; `lifted` off the floor by a crane in between."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(knots[-1][0] * RATE)) / RATE
    names = tuple(f"{side}_{joint}" for side in SIDES for joint in LEG)
    angles = np.column_stack(
        [sum((swing(time, *s) for s in swings.get(side, [])), np.zeros((len(time), 4)))
         for side in SIDES]
    )  # fmt: skip
    speed = np.gradient(angles, 1 / RATE, axis=0)
    motion = Motion(time, names, angles, speed, np.gradient(speed, 1 / RATE, axis=0))
    at, shares = np.array(knots, dtype=np.float64).T
    right = np.interp(time, at, shares)
    on_floor = ~((time >= lifted[0]) & (time < lifted[1]))
    stamps = np.round(time * 1e9).astype(np.int64) + 1_700_000_000_000_000_000
    channels = []
    for side, other, share in (("l", "r", 1 - right), ("r", "l", right)):
        for sensor in (f"{side}_leg_ft_sensor", f"{side}_foot_ft_sensor"):
            free, own = (
                expected_wrenches(robot, motion, FixedContact(f"{foot}_sole"), [sensor])[sensor]
                for foot in (other, side)
            )
            felt = free + (share * on_floor)[:, None] * (own - free)
            felt += rng.uniform(-200, 200, 6) + rng.normal(scale=0.3, size=felt.shape)
            channels.append(Signal(SIGNALS[sensor], tuple("abcdef"), stamps, felt))
    joints = (Signal("legs", names, stamps, angles),)
    return Recording("walk", "memory", int(stamps[0]), joints, tuple(channels))
