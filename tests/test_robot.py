"""The tree of links and joints, and the halves and sub-models its sensors cut out."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ftcal.errors import RobotError
from ftcal.robot import Joint, Link, Robot
from ftcal.urdf import read_robot

icub_models = pytest.importorskip("icub_models")


@pytest.fixture(scope="module")
def icub() -> Robot:
    return read_robot(icub_models.get_model_file("iCubGazeboV2_7"))


def body(name: str, mass: float = 1.0) -> Link:
    return Link(name, mass, np.zeros(3), np.eye(3) * mass)


def fixed(name: str, parent: str, child: str) -> Joint:
    return Joint(name, "fixed", parent, child, np.eye(4), np.array([1.0, 0.0, 0.0]))


def hinge(name: str, parent: str, child: str) -> Joint:
    return Joint(name, "revolute", parent, child, np.eye(4), np.array([0.0, 0.0, 1.0]))


def robot_of(links: list[Link], joints: list[Joint], root: str = "a") -> Robot:
    return Robot("r", root, {k.name: k for k in links}, {j.name: j for j in joints}, {}, "")


def test_icub_is_cut_into_seven_sub_models(icub: Robot) -> None:
    models = icub.sub_models()
    assert len(models) == 7
    assert sum(len(model.links) for model in models) == len(icub.links)
    borders = {model.name: set(model.sensors) for model in models}
    assert borders["l_hip_3"] == {"l_leg_ft", "l_foot_ft"}
    assert borders["root_link"] == {"l_leg_ft", "r_leg_ft", "l_arm_ft", "r_arm_ft"}
    assert borders["r_foot"] == {"r_foot_ft"}


def test_fewer_sensors_cut_fewer_sub_models(icub: Robot) -> None:
    upper, leg = icub.sub_models(["r_leg_ft"])
    assert upper.sensors == leg.sensors == ("r_leg_ft",)
    assert not set(upper.links) & set(leg.links)


def test_free_half_is_the_one_without_contact(icub: Robot) -> None:
    leg = icub.free_half("r_leg_ft", ["l_sole"])
    rest = icub.free_half("r_leg_ft", ["r_sole"])
    assert (leg.side, rest.side) == ("child", "parent")
    assert set(leg.links) | set(rest.links) == set(icub.links)
    assert "r_sole" in leg.links
    assert "l_sole" in rest.links


def test_both_halves_touching_is_refused(icub: Robot) -> None:
    with pytest.raises(RobotError, match="l_sole on the parent side, r_sole on the child side"):
        icub.free_half("r_leg_ft", ["l_sole", "r_sole"])
    assert icub.free_half("r_arm_ft", ["l_sole", "r_sole"]).side == "child"


def test_half_without_mass_is_refused() -> None:
    robot = robot_of([body("a"), body("b", 0.0)], [fixed("ft", "a", "b")])
    with pytest.raises(RobotError, match="child side of sensor 'ft' has no mass"):
        robot.free_half("ft", ["a"])
    assert robot.free_half("ft", ["b"]).links == ("a",)


def test_required_joints_lie_on_the_way_and_in_the_free_half(icub: Robot) -> None:
    side = ("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")
    both_legs = {f"{s}_{joint}" for s in "lr" for joint in side}
    assert set(icub.required_joints("r_leg_ft", "l_sole")) == both_legs
    assert set(icub.required_joints("r_foot_ft", "r_hip_3")) == {f"r_{joint}" for joint in side[2:]}
    # seen from the foot, the free half is the rest of the robot
    assert set(icub.required_joints("r_foot_ft", "r_sole")) == set(icub.moving_joints)


def test_joints_that_move_no_mass_are_not_required() -> None:
    links = [body("a"), body("b"), body("frame", 0.0)]
    joints = [fixed("ft", "a", "b"), hinge("j", "b", "frame")]
    assert robot_of(links, joints).required_joints("ft", "a") == ()


def test_path_there_is_the_path_back_reversed(icub: Robot) -> None:
    there = icub.path("l_sole", "r_hand")
    assert there == tuple(reversed(icub.path("r_hand", "l_sole")))
    assert {"l_knee", "torso_yaw", "r_elbow"} <= {joint.name for joint in there}
    assert icub.path("l_sole", "l_sole") == ()


def test_sensor_answers_to_its_name_and_to_its_joint(icub: Robot) -> None:
    assert icub.sensor("l_leg_ft") is icub.sensor("l_leg_ft_sensor")


def test_fixed_joint_without_a_tag_measures_in_the_child_what_it_does_to_the_parent() -> None:
    sensor = robot_of([body("a"), body("b")], [fixed("ft", "a", "b")]).sensor("ft")
    assert (sensor.frame, sensor.acts_on) == ("child", "parent")
    np.testing.assert_array_equal(sensor.child_H_sensor, np.eye(4))


def test_unknown_names_come_with_near_ones(icub: Robot) -> None:
    with pytest.raises(RobotError, match=r"no link 'l_soel'; did you mean .*l_sole"):
        icub.link("l_soel")
    with pytest.raises(RobotError, match="no joint 'r_kne'; did you mean r_knee"):
        icub.joint("r_kne")
    with pytest.raises(RobotError, match="no F/T sensor 'l_leg_tf'; did you mean l_leg_ft"):
        icub.sensor("l_leg_tf")
    with pytest.raises(RobotError, match="'r_knee' is revolute"):
        icub.sensor("r_knee")


def test_mass_is_that_of_all_links(icub: Robot) -> None:
    assert icub.mass == pytest.approx(33.062, abs=1e-3)


def test_all_faults_are_told_at_once() -> None:
    lame = dataclasses.replace(body("b"), inertia=-np.eye(3))
    odd = dataclasses.replace(body("c"), com=np.array([0.0, np.nan, 0.0]))
    with pytest.raises(RobotError) as caught:
        robot_of([body("a", -1.0), lame, odd], [hinge("j", "a", "b"), hinge("k", "a", "nowhere")])
    for words in ("mass of link 'a' is -1", "inertia of link 'b'", "mass of link 'c'", "'nowhere'"):
        assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("joints", "words"),
    [
        ([("a", "b"), ("a", "b")], "child of two joints"),
        ([("a", "b")], "2 root links"),
        ([("b", "c"), ("c", "b")], "kinematic loop"),
        ([("a", "b"), ("b", "c"), ("c", "a")], "kinematic loop"),
    ],
)
def test_what_is_not_a_tree_is_refused(joints: list[tuple[str, str]], words: str) -> None:
    with pytest.raises(RobotError, match=words):
        robot_of(
            [body("a"), body("b"), body("c")],
            [hinge(f"j{k}", *ends) for k, ends in enumerate(joints)],
        )


@given(st.data())
def test_sub_models_share_the_links_and_each_cut_has_two_sides(data: st.DataObject) -> None:
    size = data.draw(st.integers(2, 12))
    parents = [data.draw(st.integers(0, k - 1)) for k in range(1, size)]
    joints = [fixed(f"j{k}", f"l{p}", f"l{k}") for k, p in enumerate(parents, start=1)]
    robot = robot_of([body(f"l{k}") for k in range(size)], joints, root="l0")
    cuts = data.draw(st.lists(st.sampled_from(list(robot.joints)), unique=True))
    models = robot.sub_models(cuts)
    assert len(models) == len(cuts) + 1
    assert sorted(name for m in models for name in m.links) == sorted(robot.links)
    for cut in cuts:
        assert sum(cut in model.sensors for model in models) == 2
