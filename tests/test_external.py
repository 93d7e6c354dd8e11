"""External wrenches and joint torques are those of iDynTree, and of the world that made them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
import pytest

from ftcal import jit
from ftcal.dynamics import expected_wrenches
from ftcal.errors import DataError, RobotError
from ftcal.external import external_wrenches
from ftcal.kinematics import relative_pose, sensor_pose
from ftcal.motion import Contact, FixedContact, Motion
from ftcal.robot import Robot
from ftcal.spatial import inverse, wrench_transform
from ftcal.urdf import parse_robot, read_robot
from test_oracles import LIMB, TAGS, model, motion_of, moving

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

pytest.importorskip("icub_models")
MODELS = ["iCubGazeboV2_7", "iCubGenova01", "iCubGenova03", "iCubLisboa01", "iCubGenova02"]
# of the largest force, or torque, of a sub-model; the requirement is 1e-8
TOLERANCE = 1e-10


def readings_of(robot: Robot, count: int, seed: int) -> dict[str, Float[Array, "N 6"]]:
    rng = np.random.default_rng(seed)
    scale = np.array([100, 100, 100, 10, 10, 10])
    return {name: rng.normal(size=(count, 6)) * scale for name in robot.sensors}


def idyntree_estimate(
    path: Path,
    motion: Motion,
    contact: Contact,
    readings: dict[str, Float[Array, "N 6"]],
    frames: list[str],
) -> tuple[dict[str, Float[Array, "N 6"]], dict[str, Float[Array, "N"]]]:
    """Return iDynTree's wrench at each of `frames`, and its torque of each joint."""
    idyn = pytest.importorskip("idyntree.bindings")
    loader = idyn.ModelLoader()
    assert loader.loadModelFromFile(str(path))
    estimator = idyn.ExtWrenchesAndJointTorquesEstimator()
    assert estimator.setModel(loader.model())
    its = estimator.model()
    order = [motion.joints.index(its.getJointName(k)) for k in range(its.getNrOfDOFs())]
    unknowns = idyn.LinkUnknownWrenchContacts(its)
    indices = {frame: its.getFrameIndex(frame) for frame in frames}
    assert min(indices.values()) >= 0
    for index in indices.values():
        unknowns.addNewUnknownFullWrenchInFrameOrigin(its, index)
    measured = idyn.SensorsMeasurements(its.sensors())
    contacts = idyn.LinkContactWrenches(its)
    torques = idyn.JointDOFsDoubleArray(its)
    base = its.getFrameIndex(contact.link)
    kind = idyn.SIX_AXIS_FORCE_TORQUE
    sensors = {name: its.sensors().getSensorIndex(kind, name) for name in readings}
    wrench = {frame: np.empty((len(motion), 6)) for frame in frames}
    torque = np.empty((len(motion), len(order)))
    for n in range(len(motion)):
        state = [
            array.FromPython(signal[n, order])
            for array, signal in (
                (idyn.JointPosDoubleArray, motion.position),
                (idyn.JointDOFsDoubleArray, motion.velocity),
                (idyn.JointDOFsDoubleArray, motion.acceleration),
            )
        ]
        if isinstance(contact, FixedContact):
            gravity = idyn.Vector3.FromPython(list(contact.gravity))
            assert estimator.updateKinematicsFromFixedBase(*state, base, gravity)
        else:
            vectors = [
                idyn.Vector3.FromPython([float(x) for x in values[n]])
                for values in (
                    contact.proper_acceleration(),
                    contact.angular_velocity,
                    contact.angular_acceleration,
                )
            ]
            assert estimator.updateKinematicsFromFloatingBase(*state, base, *vectors)
        for name, index in sensors.items():
            measured.setMeasurement(kind, index, idyn.Wrench.FromPython(readings[name][n]))
        assert estimator.estimateExtWrenchesAndJointTorques(unknowns, measured, contacts, torques)
        for frame, index in indices.items():
            link = its.getFrameLink(index)
            assert contacts.getNrOfContactsForLink(link) == 1
            # in the axes of the link, about the origin of the frame
            there = contacts.contactWrench(link, 0)
            link_H_frame = its.getFrameTransform(index).asHomogeneousTransform().toNumPy()
            halves = np.split(np.array([there.contactWrench.getVal(k) for k in range(6)]), 2)
            wrench[frame][n] = np.concatenate([half @ link_H_frame[:3, :3] for half in halves])
        torque[n] = torques.toNumPy()
    names = [its.getJointName(k) for k in range(its.getNrOfDOFs())]
    return wrench, dict(zip(names, torque.T, strict=True))


def assert_close(actual: Float[Array, "N"], expected: Float[Array, "N"], what: str) -> None:
    worst = abs(actual - expected).max()
    assert worst <= TOLERANCE * abs(expected).max(), f"{what}: {worst:.1e}"


def assert_idyntree_agrees(
    path: Path, robot: Robot, motion: Motion, contact: Contact, frames: dict[str, str]
) -> None:
    readings = readings_of(robot, len(motion), 11)
    # a kernel takes a second to compile: the moving contact runs the same source on NumPy
    engine: Literal["auto", "numpy"] = "auto" if isinstance(contact, FixedContact) else "numpy"
    found = external_wrenches(robot, motion, contact, readings, frames, engine=engine)
    assert set(found.joints) == set(robot.moving_joints)
    wrench, torque = idyntree_estimate(path, motion, contact, readings, list(frames.values()))
    for name, frame in frames.items():
        for part in (slice(0, 3), slice(3, 6)):
            assert_close(found.wrench[name][:, part], wrench[frame][:, part], f"{name} at {frame}")
    for column, joint in enumerate(found.joints):
        assert_close(found.torque[:, column], torque[joint], joint)


def some_frames(robot: Robot, seed: int) -> dict[str, str]:
    """Return a link or frame of each sub-model, taken at random."""
    rng = np.random.default_rng(seed)
    return {model.name: str(rng.choice(model.links)) for model in robot.sub_models()}


@pytest.mark.parametrize(("name", "seed"), [(name, k) for k, name in enumerate(MODELS)])
@pytest.mark.no_cover
def test_icub_estimates_are_those_of_idyntree(name: str, seed: int) -> None:
    robot = read_robot(model(name))
    motion = motion_of(robot, seed, samples=40)
    for link in ("l_sole", "r_sole", "root_link"):
        for contact in (FixedContact(link, (0.3, -0.4, -9.7)), moving(link, len(motion), seed)):
            assert_idyntree_agrees(model(name), robot, motion, contact, some_frames(robot, seed))


@pytest.mark.parametrize("tags", TAGS)
def test_every_reading_of_the_sensor_tag_is_that_of_idyntree(tags: str, tmp_path: Path) -> None:
    path = tmp_path / "limb.urdf"
    path.write_text(LIMB.format(tags=tags))
    robot = parse_robot(path.read_text())
    motion = motion_of(robot, 5, samples=20)
    for link in ("base", "tip", "slide"):
        for frames in ({"base": "before", "after": "tip"}, {"base": "upper", "after": "pump"}):
            assert_idyntree_agrees(path, robot, motion, FixedContact(link), frames)


@pytest.fixture(scope="module")
def icub() -> Robot:
    return read_robot(model(MODELS[0]))


def test_only_what_the_contact_touches_has_an_external_wrench(icub: Robot) -> None:
    motion = motion_of(icub, 1, samples=50)
    contact = FixedContact("l_sole")
    readings = expected_wrenches(icub, motion, contact, list(icub.sensors))
    found = external_wrenches(icub, motion, contact, readings)
    assert found.frames == {name: name for name in found.wrench}
    assert not found.left_out
    for name, wrench in found.wrench.items():
        # rounding of the 1e3 N and 1e3 Nm that the floor gives
        assert name == "l_foot" or abs(wrench).max() < 1e-10, name


def test_the_floor_carries_the_weight_of_a_robot_at_rest(icub: Robot) -> None:
    motion = motion_of(icub, 2, samples=20)
    still = Motion(motion.time, motion.joints, motion.position, *np.zeros((2, 20, 32)))
    contact = FixedContact("l_sole")
    readings = expected_wrenches(icub, still, contact, list(icub.sensors))
    found = external_wrenches(icub, still, contact, readings, {"l_foot": "l_sole"})
    up = [0.0, 0.0, icub.mass * 9.80665]
    assert np.allclose(found.wrench["l_foot"][:, :3], up, rtol=0, atol=1e-10)


def test_a_push_is_found_where_it_acts(icub: Robot) -> None:
    motion = motion_of(icub, 3, samples=50)
    contact = FixedContact("l_sole")
    push = np.random.default_rng(0).normal(size=(50, 6)) * 20.0
    readings = expected_wrenches(icub, motion, contact, list(icub.sensors))
    for name, expected in list(readings.items()):
        sensor = icub.sensor(name)
        crossed = [
            joint for joint in icub.path("l_sole", "r_lower_leg") if joint.name == sensor.joint
        ]
        if crossed:  # the sensor carries it to the floor
            S_X_L = wrench_transform(inverse(sensor_pose(icub, motion, "r_lower_leg", name)))
            sign = 1.0 if icub.free_half(name, ["l_sole"]).side == sensor.acts_on else -1.0
            readings[name] = expected - sign * np.einsum("nij,nj->ni", S_X_L, push)
    found = external_wrenches(icub, motion, contact, readings)
    at_knee = external_wrenches(icub, motion, contact, readings, {"r_hip_3": "r_lower_leg"})
    assert np.allclose(at_knee.wrench["r_hip_3"], push, rtol=0, atol=1e-10)
    B_X_L = wrench_transform(relative_pose(icub, motion, "r_hip_3", "r_lower_leg"))
    moved = np.einsum("nij,nj->ni", B_X_L, push)
    assert np.allclose(found.wrench["r_hip_3"], moved, rtol=0, atol=1e-10)
    assert abs(found.wrench["root_link"]).max() < 1e-10
    assert abs(found.wrench["r_foot"]).max() < 1e-10


@pytest.mark.skipif(not jit.available(), reason="llvmlite is not installed")
def test_machine_code_equals_numpy(icub: Robot) -> None:
    motion = motion_of(icub, 4, samples=301)
    readings = readings_of(icub, len(motion), 1)
    contact = moving("r_sole", len(motion), 2)
    frames = some_frames(icub, 7)
    one, other = (
        external_wrenches(icub, motion, contact, readings, frames, engine=engine)
        for engine in ("llvm", "numpy")
    )
    assert one.joints == other.joints
    assert_close(one.torque, other.torque, "torques")
    for name in frames:
        assert_close(one.wrench[name], other.wrench[name], name)


def without(motion: Motion, *joints: str) -> Motion:
    kept = [column for column, name in enumerate(motion.joints) if name not in joints]
    signals = (motion.position, motion.velocity, motion.acceleration)
    return Motion(
        motion.time, tuple(motion.joints[k] for k in kept), *(signal[:, kept] for signal in signals)
    )


def test_sub_models_with_joints_not_logged_are_left_out_by_name(icub: Robot) -> None:
    motion = motion_of(icub, 5, samples=10)
    readings = readings_of(icub, 10, 1)
    contact = FixedContact("l_sole")
    every = external_wrenches(icub, motion, contact, readings, engine="numpy")
    armless = without(motion, "l_elbow", "r_hip_yaw")
    found = external_wrenches(icub, armless, contact, readings, engine="numpy")
    # the foot's own sub-model has no such joint, but hangs on it
    assert found.left_out["l_upper_arm"] == ("l_elbow",)
    assert "r_hip_yaw" in found.left_out["r_foot"]
    assert set(found.wrench) | set(found.left_out) == set(every.wrench)
    for name, wrench in found.wrench.items():
        assert_close(wrench, every.wrench[name], name)
    assert "l_elbow" not in found.joints
    with pytest.raises(DataError, match="'l_upper_arm' l_elbow"):
        external_wrenches(icub, armless, contact, readings, {"l_upper_arm": "l_upper_arm"})


def test_only_sensors_with_readings_cut(icub: Robot) -> None:
    motion = motion_of(icub, 6, samples=10)
    readings = expected_wrenches(icub, motion, FixedContact("l_sole"), ["r_leg_ft"])
    found = external_wrenches(icub, motion, FixedContact("l_sole"), readings, engine="numpy")
    assert set(found.wrench) == {"root_link", "r_hip_3"}
    assert abs(found.wrench["r_hip_3"]).max() < 1e-10


def test_what_makes_no_sense_is_refused(icub: Robot) -> None:
    motion = motion_of(icub, 7, samples=10)
    readings = readings_of(icub, 10, 1)
    contact = FixedContact("l_sole")
    with pytest.raises(RobotError, match="no sub-model 'l_fot'; did you mean l_foot"):
        external_wrenches(icub, motion, contact, readings, {"l_fot": "l_foot"})
    with pytest.raises(RobotError, match="'r_sole' lies in sub-model 'r_foot', not in 'l_foot'"):
        external_wrenches(icub, motion, contact, readings, {"l_foot": "r_sole"})
    with pytest.raises(DataError, match=r"l_leg_ft has shape \(9, 6\), not \(10, 6\)"):
        external_wrenches(icub, motion, contact, {"l_leg_ft": readings["l_leg_ft"][1:]})
