"""Expected wrenches: physics, the two engines, the layouts of memory."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ftcal import dynamics, jit
from ftcal.dynamics import expected_wrenches
from ftcal.errors import DataError, RobotError
from ftcal.motion import FixedContact, Motion, MovingContact
from ftcal.robot import Robot
from ftcal.spatial import inverse, wrench_transform
from ftcal.tree import grow
from ftcal.urdf import parse_robot, read_robot

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

icub_models = pytest.importorskip("icub_models")
ROUNDING = 1e-12  # of the largest component: sums of some hundred terms in another order


@pytest.fixture(scope="module")
def icub() -> Robot:
    return read_robot(icub_models.get_model_file("iCubGazeboV2_7"))


def motion_of(robot: Robot, samples: int, seed: int = 0) -> Motion:
    rng = np.random.default_rng(seed)
    signals = rng.normal(size=(3, samples, len(robot.moving_joints)))
    return Motion(np.arange(samples) * 0.01, robot.moving_joints, *signals)


def still(robot: Robot, samples: int) -> Motion:
    motion = motion_of(robot, samples)
    rest = np.zeros_like(motion.position)
    return replace(motion, velocity=rest, acceleration=rest)


def assert_same(
    a: dict[str, Float[Array, "N 6"]], b: dict[str, Float[Array, "N 6"]], tolerance: float
) -> None:
    assert a.keys() == b.keys()
    for name in a:
        for part in (slice(0, 3), slice(3, 6)):
            scale = abs(b[name][:, part]).max(initial=0.0)
            np.testing.assert_allclose(a[name][:, part], b[name][:, part], 0, tolerance * scale)


def test_still_robot_reads_the_weight_of_the_free_half(icub: Robot) -> None:
    wrenches = expected_wrenches(icub, still(icub, 20), FixedContact("l_sole"), list(icub.sensors))
    for name, wrench in wrenches.items():
        half = icub.free_half(name, ["l_sole"])
        mass = sum(icub.links[link].mass for link in half.links)
        force = np.linalg.norm(wrench[:, :3], axis=1)
        np.testing.assert_allclose(force, 9.80665 * mass, rtol=1e-12)


def test_falling_robot_reads_nothing(icub: Robot) -> None:
    motion = still(icub, 5)
    gravity = np.tile([1.0, 2.0, -9.0], (5, 1))
    at_rest = np.zeros((5, 3))
    contact = MovingContact("root_link", gravity, at_rest, gravity, at_rest)
    for wrench in expected_wrenches(icub, motion, contact, list(icub.sensors)).values():
        np.testing.assert_array_equal(wrench, 0.0)


def test_contact_that_moves_not_at_all_is_a_fixed_one(icub: Robot) -> None:
    motion = motion_of(icub, 20)
    rest = np.zeros((20, 3))
    gravity = (1.0, 2.0, -9.0)
    moving = MovingContact("r_sole", np.tile(gravity, (20, 1)), rest, rest, rest)
    sensors = list(icub.sensors)
    assert_same(
        expected_wrenches(icub, motion, moving, sensors),
        expected_wrenches(icub, motion, FixedContact("r_sole", gravity), sensors),
        ROUNDING,
    )


TWO = """<robot name="two">
  <link name="a"><inertial><mass value="1"/>
    <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <link name="b"><inertial><origin xyz="0.1 0 0"/><mass value="2"/>
    <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <joint name="ft" type="fixed"><parent link="a"/><child link="b"/>
    <origin xyz="0 0 1" rpy="1.5707963267948966 0 0"/></joint>
  <sensor name="s" type="force_torque"><parent joint="ft"/><force_torque>
    <frame>{frame}</frame><measure_direction>{direction}</measure_direction></force_torque></sensor>
</robot>"""
NOTHING = Motion(np.zeros(1), (), *np.zeros((3, 1, 0)))


def test_robot_without_joints_reads_its_weight_in_the_sensor_frame() -> None:
    robot = parse_robot(TWO.format(frame="child", direction="child_to_parent"))
    contact = FixedContact("a")
    for wrench in (
        expected_wrenches(robot, NOTHING, contact, ["s"], engine="numpy")["s"],
        expected_wrenches(robot, NOTHING, contact, ["s"], engine="llvm")["s"],
    ):
        # y of the child points up: it pulls the parent down with 2 g, 0.1 m off along x
        expected = [0, -2 * 9.80665, 0, 0, 0, -0.2 * 9.80665]
        np.testing.assert_allclose(wrench[0], expected, atol=1e-12)


def test_measure_direction_turns_the_sign_and_frame_the_reference() -> None:
    contact = FixedContact("a", (1.0, 2.0, -3.0))

    def reading(frame: str, direction: str) -> Float[Array, "N 6"]:
        robot = parse_robot(TWO.format(frame=frame, direction=direction))
        return expected_wrenches(robot, NOTHING, contact, ["s"])["s"]

    child = reading("child", "child_to_parent")
    np.testing.assert_array_equal(child, -reading("child", "parent_to_child"))
    joint = parse_robot(TWO.format(frame="child", direction="child_to_parent")).joint("ft")
    parent = (wrench_transform(joint.parent_H_child) @ child[..., None])[..., 0]
    np.testing.assert_allclose(parent, reading("parent", "child_to_parent"), atol=1e-12)
    back = (wrench_transform(inverse(joint.parent_H_child)) @ parent[..., None])[..., 0]
    np.testing.assert_allclose(back, child, atol=1e-12)


@pytest.mark.parametrize("link", ["root_link", "l_sole", "r_hand", "head"])
def test_both_engines_agree(icub: Robot, link: str) -> None:
    motion = motion_of(icub, 300)
    for contact in (
        FixedContact(link, (1.0, -2.0, -9.0)),
        MovingContact(link, *np.random.default_rng(1).normal(size=(4, 300, 3))),
    ):
        sensors = list(icub.sensors)
        assert_same(
            expected_wrenches(icub, motion, contact, sensors, engine="llvm"),
            expected_wrenches(icub, motion, contact, sensors, engine="numpy"),
            ROUNDING,
        )


@pytest.mark.parametrize("samples", [0, 1, 7, 8, 9, 127, 128, 129, 257])
def test_any_number_of_samples(icub: Robot, samples: int) -> None:
    long = motion_of(icub, 300)
    short = long.rows(slice(samples))
    contact = FixedContact("root_link")
    sensors = ["l_leg_ft", "r_arm_ft"]
    whole = expected_wrenches(icub, long, contact, sensors)
    part = expected_wrenches(icub, short, contact, sensors)
    for name in sensors:
        assert part[name].shape == (samples, 6)
        np.testing.assert_array_equal(part[name], whole[name][:samples])


LAYOUTS: dict[str, Callable[[Float[Array, "N J"]], Float[Array, "N J"]]] = {
    "columns first": np.asfortranarray,
    "every second row": lambda x: np.repeat(x, 2, axis=0)[::2],
    "every second column": lambda x: np.repeat(x, 2, axis=1)[:, ::2],
    "rows backwards": lambda x: np.ascontiguousarray(x[::-1])[::-1],
    "columns backwards": lambda x: np.ascontiguousarray(x[:, ::-1])[:, ::-1],
    "big endian": lambda x: x.astype(">f8"),
    "read only": lambda x: np.broadcast_to(x, (1, *x.shape))[0],
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_layout_of_the_arrays_does_not_matter(icub: Robot, layout: str) -> None:
    motion = motion_of(icub, 150)
    turned = replace(
        motion,
        position=LAYOUTS[layout](motion.position),
        velocity=LAYOUTS[layout](motion.velocity),
        acceleration=LAYOUTS[layout](motion.acceleration),
    )
    contact, sensors = FixedContact("l_sole"), ["r_leg_ft", "l_arm_ft"]
    actual = expected_wrenches(icub, turned, contact, sensors)
    assert_same(actual, expected_wrenches(icub, motion, contact, sensors), 0.0)


def test_order_and_surplus_of_joints_do_not_matter(icub: Robot) -> None:
    motion = motion_of(icub, 50)
    order = np.random.default_rng(3).permutation(len(motion.joints))
    shuffled = Motion(
        motion.time,
        tuple(motion.joints[k] for k in order),
        *(s[:, order] for s in (motion.position, motion.velocity, motion.acceleration)),
    )
    contact = FixedContact("l_sole")
    whole = expected_wrenches(icub, motion, contact, ["r_leg_ft"])
    assert_same(expected_wrenches(icub, shuffled, contact, ["r_leg_ft"]), whole, 0.0)
    needed = icub.required_joints("r_leg_ft", "l_sole")
    where = motion.columns(needed)
    few = Motion(
        motion.time,
        needed,
        *(s[:, where] for s in (motion.position, motion.velocity, motion.acceleration)),
    )
    assert_same(expected_wrenches(icub, few, contact, ["r_leg_ft"]), whole, 0.0)


def test_joints_that_are_missing_are_all_named(icub: Robot) -> None:
    motion = motion_of(icub, 3)
    kept = [k for k, name in enumerate(motion.joints) if name not in ("r_knee", "l_hip_yaw")]
    few = Motion(
        motion.time,
        tuple(motion.joints[k] for k in kept),
        *(s[:, kept] for s in (motion.position, motion.velocity, motion.acceleration)),
    )
    with pytest.raises(DataError, match=r"(?=.*r_knee)(?=.*l_hip_yaw)"):
        expected_wrenches(icub, few, FixedContact("l_sole"), ["r_leg_ft"])


def test_sensors_alone_and_together_read_the_same(icub: Robot) -> None:
    motion = motion_of(icub, 40)
    contact = FixedContact("l_sole")
    together = expected_wrenches(icub, motion, contact, list(icub.sensors))
    for name in icub.sensors:
        alone = expected_wrenches(icub, motion, contact, [name])
        assert_same(alone, {name: together[name]}, ROUNDING)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["root_link", "l_sole", "r_hand"]))
def test_wrench_is_linear_in_acceleration_and_gravity(icub: Robot, seed: int, link: str) -> None:
    motion = motion_of(icub, 4, seed)
    rest = replace(motion, velocity=np.zeros_like(motion.velocity))
    double = replace(rest, acceleration=2.0 * rest.acceleration)
    sensors = list(icub.sensors)

    def run(states: Motion, g: float) -> dict[str, Float[Array, "N 6"]]:
        contact = FixedContact(link, (0.0, 0.0, -g))
        return expected_wrenches(icub, states, contact, sensors, engine="numpy")

    once, twice = run(rest, 9.8), run(double, 19.6)
    assert_same(twice, {name: 2.0 * wrench for name, wrench in once.items()}, ROUNDING)


def test_threads_do_not_disturb_each_other(icub: Robot) -> None:
    motions = [motion_of(icub, 3000, seed) for seed in range(4)]

    def run(motion: Motion) -> dict[str, Float[Array, "N 6"]]:
        return expected_wrenches(icub, motion, FixedContact("l_sole"), ["r_leg_ft"])

    expected = [run(motion) for motion in motions]
    with ThreadPoolExecutor(4) as pool:
        for actual, alone in zip(pool.map(run, motions), expected, strict=True):
            assert_same(actual, alone, 0.0)


def test_moving_contact_of_another_length_is_refused(icub: Robot) -> None:
    contact = MovingContact("root_link", *np.zeros((4, 7, 3)))
    with pytest.raises(DataError, match=r"angular_velocity has shape \(7, 3\), not \(5, 3\)"):
        expected_wrenches(icub, motion_of(icub, 5), contact, ["l_leg_ft"])


def test_unknown_contact_and_sensor_are_refused(icub: Robot) -> None:
    motion = motion_of(icub, 2)
    with pytest.raises(RobotError, match="no link 'l_soel'"):
        expected_wrenches(icub, motion, FixedContact("l_soel"), ["l_leg_ft"])
    with pytest.raises(RobotError, match="no F/T sensor 'left'"):
        expected_wrenches(icub, motion, FixedContact("l_sole"), ["left"])


def test_without_llvmlite_numpy_does_the_work(icub: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    motion, contact = motion_of(icub, 10), FixedContact("l_sole")
    expected = expected_wrenches(icub, motion, contact, ["r_leg_ft"], engine="numpy")
    monkeypatch.setattr(jit, "available", lambda: False)
    monkeypatch.setattr(dynamics, "compiled", None)
    assert_same(expected_wrenches(icub, motion, contact, ["r_leg_ft"]), expected, 0.0)
    with pytest.raises(DataError, match="needs llvmlite"):
        expected_wrenches(icub, motion, contact, ["r_leg_ft"], engine="llvm")


def test_mass_of_the_tree_is_that_behind_the_sensors(icub: Robot) -> None:
    tree = grow(icub, "root_link", ["l_leg_ft", "r_leg_ft"])
    behind = sum(
        icub.links[name].mass
        for sensor in ("l_leg_ft", "r_leg_ft")
        for name in icub.free_half(sensor, ["root_link"]).links
    )
    assert sum(body.moments[3, 3] for body in tree.bodies) == pytest.approx(behind, rel=1e-12)
    # regrouped: mass stays on no revolute axis, it moves up to the sensor
    heavy = [body for body in tree.bodies if body.moments[3, 3] > 0.0]
    assert [body.kind for body in heavy] == ["fixed", "fixed"]
    assert len(tree.joints) == 12
