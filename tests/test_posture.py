"""Postures in which a robot stands: found by the joints that carry it, within their limits."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ftcal.errors import DataError, RobotError
from ftcal.kinematics import centre_of_mass, relative_pose
from ftcal.limits import Pace, home_posture, spans
from ftcal.motion import Motion
from ftcal.posture import (
    Demand,
    Poser,
    Sole,
    _least_change,
    balance_margin,
    held,
    level,
    over,
    poser,
)
from ftcal.robot import Robot
from ftcal.skeleton import skeleton
from ftcal.urdf import read_robot
from walker import LEG as WALKER_LEG
from walker import walker

LEG = ("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")
LEFT, RIGHT = (tuple(f"{side}_{joint}" for joint in LEG) for side in "lr")
SOLE = Sole("l_sole")


@functools.cache
def icub() -> Robot:
    icub_models = pytest.importorskip("icub_models", reason="the iCub's models are an extra")
    return read_robot(icub_models.get_model_file("iCubGenova04"))


def at_home(robot: Robot) -> np.ndarray:
    return home_posture(robot, {}, Pace())


def motion_of(robot: Robot, postures: np.ndarray) -> Motion:
    zeros = np.zeros_like(postures)
    time = np.arange(len(postures), dtype=np.float64)
    return Motion(time, robot.moving_joints, postures, zeros, zeros)


def icub_poser(joints: tuple[str, ...]) -> Poser:
    bones = skeleton(icub(), SOLE.frame, at_home(icub()), (*LEFT, *RIGHT))
    return poser(bones, icub(), joints, Pace())


def planted() -> np.ndarray:
    standing = motion_of(icub(), at_home(icub())[None])
    return np.asarray(relative_pose(icub(), standing, "l_sole", "r_sole")[0])


@given(x=st.floats(-0.2, 0.2), y=st.floats(-0.2, 0.2))
def test_margin_is_positive_inside_only_and_no_longer_than_the_way_to_an_edge(
    x: float, y: float
) -> None:
    sole = Sole("any", x=(-0.1, 0.05), y=(-0.03, 0.04))
    margin = sole.inside(np.array([[x, y]]))[0]
    assert (margin > 0.0) == (-0.1 < x < 0.05 and -0.03 < y < 0.04)
    assert margin <= min(abs(x + 0.1), abs(x - 0.05), abs(y + 0.03), abs(y - 0.04)) or margin < 0.0


def test_icub_on_both_feet_at_zero_would_tip_off_one() -> None:
    margin = balance_margin(icub(), motion_of(icub(), at_home(icub())[None]), SOLE)
    # half the distance of its soles (0.1403 m), less half the width of one
    np.testing.assert_allclose(margin, -(0.0701 - 0.025), atol=2e-4)


@pytest.mark.parametrize("name", ["icub", "walker"])
def test_skeleton_is_where_kinematics_says(name: str) -> None:
    robot, legs = (
        (icub(), (*LEFT, *RIGHT))
        if name == "icub"
        else (walker(), tuple(f"{side}_{joint}" for side in "lr" for joint in WALKER_LEG))
    )
    home = at_home(robot)
    postures = np.tile(home, (7, 1))
    columns = [robot.moving_joints.index(joint) for joint in legs]
    low, high = spans(robot, Pace())
    rng = np.random.default_rng(0)
    postures[:, columns] = rng.uniform(low[columns], high[columns], (7, len(columns)))
    figure = skeleton(robot, "l_sole", home, legs).figure(postures)
    motion = motion_of(robot, postures)
    com = centre_of_mass(robot, motion, tuple(robot.links), "l_sole")
    # both multiply some twenty matrices of size one
    np.testing.assert_allclose(figure.com, com, atol=1e-13)
    for frame in ("r_sole", robot.root):
        expected = relative_pose(robot, motion, "l_sole", frame)
        np.testing.assert_allclose(figure.pose(frame), expected, atol=1e-13)


@pytest.mark.parametrize("point", [(0.02, 0.0), (-0.03, 0.01), (0.05, -0.02)])
def test_weight_comes_over_a_point_by_the_support_alone(point: tuple[float, float]) -> None:
    home = at_home(icub())
    found = icub_poser(LEFT).reach(home, [over(np.array(point))], aim="point")
    com = centre_of_mass(icub(), motion_of(icub(), found[None]), tuple(icub().links), "l_sole")
    np.testing.assert_allclose(com[0, :2], point, atol=1e-6)
    changed = {name for name, d in zip(icub().moving_joints, found - home, strict=True) if d}
    assert changed <= set(LEFT)


def test_weight_shifts_with_both_feet_planted_and_the_trunk_level() -> None:
    demands = [over(SOLE.middle), held("r_sole", planted()), level("root_link")]
    found = icub_poser((*LEFT, *RIGHT)).reach(at_home(icub()), demands, aim="shift")
    motion = motion_of(icub(), found[None])
    np.testing.assert_allclose(
        balance_margin(icub(), motion, SOLE), (SOLE.y[1] - SOLE.y[0]) / 2, atol=1e-6
    )
    np.testing.assert_allclose(
        relative_pose(icub(), motion, "l_sole", "r_sole")[0], planted(), atol=2e-6
    )
    up = relative_pose(icub(), motion, "l_sole", "root_link")[0, :3, 2]
    np.testing.assert_allclose(up, [0.0, 0.0, 1.0], atol=2e-6)


def test_straight_leg_gets_shorter() -> None:
    # its length does not change to first order
    up = planted()
    up[2, 3] += 0.03
    demands = [over(SOLE.middle), held("r_sole", up), level("root_link")]
    found = icub_poser((*LEFT, *RIGHT)).reach(at_home(icub()), demands, aim="lift")
    bent = found[icub().moving_joints.index("r_knee")]
    assert bent < -0.3


def test_balanced_posture_stays_as_it_is() -> None:
    asked: list[Demand] = [over(SOLE.middle)]
    found = icub_poser(LEFT).reach(at_home(icub()), asked, aim="balance")
    again = icub_poser(LEFT).reach(found, asked, aim="balance")
    # the search stops when its steps are shorter than this
    np.testing.assert_allclose(again, found, atol=1e-3)


def test_change_is_nearly_the_least_one() -> None:
    # against the change with any other joint of the leg locked where it is
    home, demand = at_home(icub()), over(SOLE.middle)
    free = icub_poser(LEFT).reach(home, [demand], aim="balance")
    for locked in LEFT:
        fewer = icub_poser(tuple(name for name in LEFT if name != locked))
        other = fewer.approach(home, [demand])
        if other.reached:
            assert np.linalg.norm(free - home) <= np.linalg.norm(other.posture - home) + 1e-4


def test_other_joints_do_the_part_of_one_that_is_stopped_at_its_limit() -> None:
    ends = np.array([-1.0, -1.0]), np.array([0.2, 5.0])
    step = _least_change(np.zeros(2), np.ones(1), np.ones((1, 2)), *ends)
    # damping takes 1e-8 of it away
    np.testing.assert_allclose(step, [0.2, 0.8], rtol=1e-7)


@given(seed=st.integers(0, 2**32))
@settings(max_examples=25, deadline=None)
def test_limits_are_kept_whatever_is_asked(seed: int) -> None:
    rng = np.random.default_rng(seed)
    low, high = spans(icub(), Pace())
    found = icub_poser(LEFT).approach(
        rng.uniform(low, high), [over(rng.uniform(-0.3, 0.3, 2)), level("root_link")]
    )
    assert (found.posture >= low).all()
    assert (found.posture <= high).all()


def test_what_is_out_of_reach_is_told_with_the_figure() -> None:
    with pytest.raises(DataError, match=r"far: out of reach of the joints by 0\.\d+ m"):
        icub_poser(LEFT).reach(at_home(icub()), [over(np.array([0.9, 0.0]))], aim="far")


def test_soles_and_frames_that_make_no_sense_are_refused() -> None:
    with pytest.raises(DataError, match=r"sole 'foot': x = .* must be finite and increase; y ="):
        Sole("foot", x=(0.1, -0.1), y=(0.0, np.inf))
    with pytest.raises(RobotError, match="did you mean l_sole"):
        skeleton(icub(), "l_soel", at_home(icub()), LEFT)
    with pytest.raises(RobotError, match="did you mean"):
        poser(skeleton(icub(), "l_sole", at_home(icub()), LEFT), icub(), ["l_kne"], Pace())
