"""Motions of a robot that stands: in balance all the time, on one foot and from foot to foot."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable

import numpy as np
import pytest

from ftcal.errors import DataError, RobotError
from ftcal.kinematics import centre_of_mass, relative_pose
from ftcal.limits import home_posture
from ftcal.motion import Motion
from ftcal.motions import (
    Leg,
    MinimumJerk,
    Pace,
    Sole,
    Walk,
    balance_margin,
    balancing,
    extended_balancing,
    feet,
    switching,
)
from ftcal.robot import Robot
from ftcal.urdf import read_robot
from walker import LEG as WALKER_LEG
from walker import walker

JOINTS = ("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")
LEFT, RIGHT = (Leg(Sole(f"{s}_sole"), tuple(f"{s}_{joint}" for joint in JOINTS)) for s in "lr")
FAR, NEAR = (tuple(f"{side}_{joint}" for joint in WALKER_LEG) for side in "rl")
LEANING = {f"{s}_{joint}": 0.4 for s in "lr" for joint in ("hip_pitch", "ankle_pitch")}
"""Soles and waist level, all above the ankles far off the soles."""
RATE = 100.0
SIDES = pytest.mark.parametrize("side", ["left", "right"])
MODELS = pytest.mark.parametrize("model", ["iCubGenova04", "iCubGenova01"])
KINDS = pytest.mark.parametrize("kind", ["balancing", "extended"])
ROBOTS = pytest.mark.parametrize("robot", ["icub", "walker"])


@functools.cache
def icub(model: str = "iCubGenova04") -> Robot:
    icub_models = pytest.importorskip("icub_models", reason="the iCub's models are an extra")
    return read_robot(icub_models.get_model_file(model))


def walk_of(robot: Robot, *, seed: int = 0, swing: float = 35.0) -> Walk:
    rng = np.random.default_rng(seed)
    return switching(robot, pole="root_link", left=LEFT, right=RIGHT, generator=rng, swing=swing)


@functools.cache
def walked(model: str) -> tuple[Robot, Walk, Motion, np.ndarray]:
    """Return a robot, its walk, the walk's samples and the shares of pole, left, right sole."""
    robot = icub(model)
    walk = walk_of(robot)
    motion = walk.trajectory.sampled(RATE)
    return robot, walk, motion, walk.support.at(motion.time)


def alone(model: str, side: str) -> tuple[Robot, Motion, Sole, Sole]:
    """Return the samples of a walk on one foot, the sole that carries and the free one."""
    robot, _, motion, shares = walked(model)
    own, free, column = (LEFT, RIGHT, 1) if side == "left" else (RIGHT, LEFT, 2)
    return robot, motion.rows(shares[:, column] == 1.0), own.sole, free.sole


def both(model: str) -> tuple[Robot, Motion, np.ndarray]:
    """Return the samples of a walk on both feet, the pole gone, and the shares there."""
    robot, _, motion, shares = walked(model)
    rows = (shares[:, 0] == 0.0) & (shares[:, 1:] > 0.0).all(axis=1)
    return robot, motion.rows(rows), shares[rows]


def keeps_limits(robot: Robot, motion: Motion, pace: Pace) -> None:
    for column, name in enumerate(motion.joints):
        joint = robot.joint(name)
        assert motion.position[:, column].min() >= joint.lower + pace.margin - 1e-9
        assert motion.position[:, column].max() <= joint.upper - pace.margin + 1e-9
        assert np.abs(motion.velocity[:, column]).max() <= min(joint.velocity, pace.speed) + 1e-9
    assert np.abs(motion.acceleration).max() <= pace.acceleration + 1e-9


def balanced(kind: str, robot: str, seed: int = 0) -> tuple[Robot, Motion]:
    model = icub() if robot == "icub" else walker()
    free, support = (RIGHT.joints, LEFT.joints) if robot == "icub" else (FAR, NEAR)
    make = balancing if kind == "balancing" else extended_balancing
    rng = np.random.default_rng(seed)
    made = make(model, free, generator=rng, duration=40.0, support=support, sole=LEFT.sole)
    return model, made.sampled(RATE)


@KINDS
@ROBOTS
def test_with_a_sole_the_centre_of_mass_stays_over_it(kind: str, robot: str) -> None:
    model, motion = balanced(kind, robot)
    assert balance_margin(model, motion, LEFT.sole).min() > 0.0


@KINDS
@ROBOTS
def test_balanced_motion_keeps_the_limits_and_ends_where_it_began(kind: str, robot: str) -> None:
    model, motion = balanced(kind, robot)
    keeps_limits(model, motion, Pace())
    np.testing.assert_array_equal(motion.position[0], motion.position[-1])


@KINDS
def test_without_a_sole_nobody_looks_after_balance(kind: str) -> None:
    make = balancing if kind == "balancing" else extended_balancing
    rng = np.random.default_rng(0)
    made = make(icub(), RIGHT.joints, generator=rng, support=LEFT.joints)
    # at zero the iCub's centre of mass is between its feet
    assert balance_margin(icub(), made.sampled(), LEFT.sole).max() < 0.0


def test_support_sways_about_balance() -> None:
    rng = np.random.default_rng(0)
    make = functools.partial(
        balancing, icub(), RIGHT.joints, support=LEFT.joints, sole=LEFT.sole, generator=rng
    )
    middle = (LEFT.sole.y[1] - LEFT.sole.y[0]) / 2
    still, swaying = (
        balance_margin(icub(), _stops(make(sway=sway).waypoints), LEFT.sole) for sway in (0.0, 0.02)
    )
    # the joints meet what is demanded to a micrometre
    np.testing.assert_allclose(still, middle, atol=2e-6)
    assert (swaying[2:-2] < middle - 1e-5).all()


def _stops(waypoints: np.ndarray) -> Motion:
    zeros = np.zeros_like(waypoints)
    time = np.arange(len(waypoints), dtype=np.float64)
    return Motion(time, icub().moving_joints, waypoints, zeros, zeros)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda **kw: balancing(icub(), RIGHT.joints, **kw), "needs support joints"),
        (
            lambda **kw: balancing(icub(), RIGHT.joints, support=["l_knee"], **kw),
            "weight over sole 'l_sole': out of reach",
        ),
        (
            lambda **kw: balancing(
                icub(), RIGHT.joints, support=LEFT.joints, **{**kw, "sole": _narrow()}
            ),
            "none of 300 postures",
        ),
    ],
)
def test_balance_that_cannot_be_had_is_refused(make: Callable[..., object], words: str) -> None:
    with pytest.raises(DataError, match=words):
        make(generator=np.random.default_rng(0), sole=LEFT.sole)


def _narrow() -> Sole:
    """Return a sole no wider than what is kept from its edges."""
    return Sole("l_sole", y=(-0.002, 0.002))


@MODELS
def test_walk_keeps_all_limits(model: str) -> None:
    robot, walk, _, _ = walked(model)
    keeps_limits(robot, walk.trajectory.sampled(200.0), Pace(acceleration=2.5))


@MODELS
def test_walk_hangs_then_stands_on_both_left_both_right_both(model: str) -> None:
    _, walk, _, _ = walked(model)
    assert walk.support.frames == ("root_link", "l_sole", "r_sole")
    spans = walk.support.schedule().intervals
    feet = ("l_sole", "r_sole")
    # from both feet to both feet over the one between, never off the floor
    assert [{i.link, *i.others} for i in spans] == [
        {"root_link"}, {"root_link", *feet}, set(feet), {"l_sole"}, set(feet), {"r_sole"}, set(feet)
    ]  # fmt: skip
    assert spans[0].stop == 15.0
    assert all(spans[k].stop - spans[k].start > 35.0 for k in (3, 5))
    assert walk.trajectory.duration == walk.support.times[-1] > spans[-1].start


@MODELS
def test_nothing_moves_while_pole_and_soles_carry(model: str) -> None:
    _, _, motion, shares = walked(model)
    rows = (shares[:, 0] > 0.0) & (shares[:, 0] < 1.0)
    assert np.count_nonzero(rows) > 2.0 * RATE
    assert not np.ptp(motion.position[rows], axis=0).any()


@MODELS
def test_legs_move_in_the_air(model: str) -> None:
    _, _, motion, shares = walked(model)
    ranges = np.ptp(motion.position[shares[:, 0] == 1.0], axis=0)
    moved = dict(zip(motion.joints, ranges, strict=True))
    legs = {*LEFT.joints, *RIGHT.joints}
    assert all((moved[name] > 0.1) == (name in legs) for name in moved)
    assert not any(moved[name] for name in moved.keys() - legs)


@SIDES
@MODELS
def test_on_one_foot_the_centre_of_mass_stays_over_its_sole(model: str, side: str) -> None:
    robot, motion, own, _ = alone(model, side)
    assert balance_margin(robot, motion, own).min() > 0.0


@SIDES
@MODELS
def test_free_foot_goes_up_and_never_below_the_floor(model: str, side: str) -> None:
    robot, motion, own, free = alone(model, side)
    own_H_free = relative_pose(robot, motion, own.frame, free.frame)
    heights = own_H_free[:, 2, 3, None] + own_H_free[:, 2, :2] @ free.corners[:, :2].T
    assert heights.min() > -1e-3
    assert np.median(heights.min(axis=1)) > 0.02
    assert heights.max() > 0.15


@SIDES
@MODELS
def test_free_leg_stretches_and_bends_and_the_standing_knee_bends(model: str, side: str) -> None:
    _, motion, own, free = alone(model, side)
    for frame, least in ((own.frame, 0.3), (free.frame, 0.8)):
        assert np.ptp(motion.position[:, motion.joints.index(f"{frame[0]}_knee")]) > least


@SIDES
@MODELS
def test_trunk_stays_nearly_level(model: str, side: str) -> None:
    robot, motion, own, _ = alone(model, side)
    up = relative_pose(robot, motion, own.frame, "root_link")[:, 2, 2]
    # level to a micrometre at every stop; the arcs of the joints tilt it in between
    assert np.degrees(np.arccos(up.min())) < 5.0


@MODELS
def test_both_soles_stay_planted_while_both_carry(model: str) -> None:
    robot, motion, _ = both(model)
    l_H_r = relative_pose(robot, motion, "l_sole", "r_sole")
    assert np.linalg.norm(l_H_r[:, :3, 3] - l_H_r[0, :3, 3], axis=1).max() < 2e-3
    trace = np.einsum("ij,nij->n", l_H_r[0, :3, :3], l_H_r[:, :3, :3])
    assert np.degrees(np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))).max() < 0.3


@MODELS
def test_feet_come_back_to_the_posture_they_left(model: str) -> None:
    _, _, motion, _ = walked(model)
    _, standing, _ = both(model)
    np.testing.assert_array_equal(standing.position[0], motion.position[0])
    np.testing.assert_array_equal(standing.position[-1], motion.position[0])


@MODELS
def test_feet_share_the_weight_as_the_centre_of_mass_lies_between_them(model: str) -> None:
    robot, motion, shares = both(model)
    com = centre_of_mass(robot, motion, tuple(robot.links), "l_sole")[:, :2]
    right = relative_pose(robot, motion, "l_sole", "r_sole")[:, :2, 3] + RIGHT.sole.middle
    line = right - LEFT.sole.middle
    off = com - (shares[:, 1:2] * LEFT.sole.middle + shares[:, 2:] * right)
    across = np.einsum("ni,ni->n", off, line) / np.linalg.norm(line, axis=1)
    # load follows the knots, the centre of mass the joints: alike at the knots, nearly between
    assert np.abs(across).max() < 2e-3
    assert LEFT.sole.inside(LEFT.sole.middle + off).min() > 0.0


@pytest.mark.parametrize("slip", [1e-4, 1e-5])
def test_shift_has_more_postures_where_the_sole_would_slip(
    slip: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, pace = icub(), Pace()
    home = home_posture(robot, {}, pace)
    stands = feet.feet(robot, LEFT, RIGHT, trunk="root_link", home=home, pace=pace)
    few = stands.shift().postures
    monkeypatch.setattr(feet, "SLIP", slip)
    many = stands.shift().postures
    assert len(many) > len(few)
    moves = MinimumJerk(
        robot.moving_joints, np.arange(len(many) + 1.0), np.array([home, *many])
    ).sampled()
    l_p_r = relative_pose(robot, moves, "l_sole", "r_sole")[:, :3, 3]
    assert np.linalg.norm(l_p_r - l_p_r[0], axis=1).max() < slip
    monkeypatch.setattr(feet, "SLIP", 0.0)
    with pytest.raises(DataError, match="'r_sole' planted: it slips"):
        stands.shift()


@pytest.mark.parametrize("lift", [0.04, 0.06])
def test_straight_legs_are_lifted(lift: float) -> None:
    # from zero the search would end in a lean that cannot be kept
    rng = np.random.default_rng(0)
    walk = switching(
        icub("iCubGenova03"), pole="root_link", left=LEFT, right=RIGHT, generator=rng, lift=lift,
        swing=12.0,
    )  # fmt: skip
    assert walk.trajectory.duration > 2 * 12.0


def test_same_seed_same_walk() -> None:
    one, two = (walk_of(icub(), seed=3, swing=15.0) for _ in range(2))
    np.testing.assert_array_equal(one.trajectory.waypoints, two.trajectory.waypoints)
    np.testing.assert_array_equal(one.support.shares, two.support.shares)


@pytest.mark.parametrize("seed", range(10))
def test_any_seed_finds_its_walk(seed: int) -> None:
    robot, walk = icub(), walk_of(icub(), seed=seed)
    motion = walk.trajectory.sampled(20.0)
    shares = walk.support.at(motion.time)
    for column, leg in ((1, LEFT), (2, RIGHT)):
        rows = shares[:, column] == 1.0
        assert balance_margin(robot, motion.rows(rows), leg.sole).min() > 0.0


@pytest.mark.parametrize(
    ("asked", "error", "words"),
    [
        ({"home": {"l_ankle_pitch": 0.2}}, DataError, "'l_sole' is tilted by 11 deg against"),
        (
            {"home": {"r_hip_pitch": 0.5, "r_knee": -1.0, "r_ankle_pitch": -0.5}},
            DataError,
            r"home: sole 'r_sole' is 0\.\d+ m above 'l_sole'",
        ),
        (
            {"home": LEANING},
            DataError,
            r"home: the centre of mass is 0\.\d+ m outside of what both",
        ),
        ({"lift": 0.0}, DataError, "lift = 0 m must be positive"),
        ({"lift": 0.3}, DataError, "'r_sole' lifted by 0.3 m: out of reach"),
        ({"hanging": 3.0}, DataError, "too short"),
        ({"reach": 0.0}, DataError, "reach = 0"),
        ({"right": dataclasses.replace(RIGHT, joints=LEFT.joints)}, DataError, "in both legs"),
        ({"pole": "root_lnik"}, RobotError, "did you mean root_link"),
        ({"right": dataclasses.replace(RIGHT, sole=Sole("r_soel"))}, RobotError, "r_sole"),
    ],
)
def test_walk_that_no_robot_can_make_is_refused(
    asked: dict[str, object], error: type, words: str
) -> None:
    usual = {"pole": "root_link", "left": LEFT, "right": RIGHT}
    make: Callable[..., Walk] = switching
    with pytest.raises(error, match=words):
        make(icub(), generator=np.random.default_rng(0), **{**usual, **asked})
