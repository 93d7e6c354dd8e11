"""iDynTree and Pinocchio, the field's own libraries, say the same as `expected_wrenches`."""

from __future__ import annotations

import re
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from ftcal.dynamics import expected_wrenches
from ftcal.motion import Contact, FixedContact, Motion, MovingContact
from ftcal.robot import Robot
from ftcal.urdf import parse_robot, read_robot

# long, and what they run is covered by the others: tracing would cost half as much again
pytestmark = pytest.mark.no_cover

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

icub_models = pytest.importorskip("icub_models")
SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"
SAMPLES = 200
# of the largest component of a sensor's forces, or torques; 3e-13 is seen, through other frames
TOLERANCE = 1e-11
MODELS = ["iCubGazeboV2_7", "iCubGenova01", "iCubGenova03", "iCubLisboa01", "iCubGenova02"]

LIMIT = '<limit lower="-9" upper="9" velocity="9" effort="9"/>'
LIMB = """
<robot name="limb">
  <link name="base"><inertial><origin xyz=".1 .02 -.03" rpy=".3 .2 .1"/><mass value="3"/>
    <inertia ixx=".02" ixy=".001" ixz="-.002" iyy=".03" iyz=".003" izz=".025"/></inertial></link>
  <link name="upper"><inertial><origin xyz="0 .05 .1" rpy="1 2 3"/><mass value="2"/>
    <inertia ixx=".02" ixy=".001" ixz="-.002" iyy=".03" iyz=".003" izz=".025"/></inertial></link>
  <link name="slide"><inertial><origin xyz=".01 .02 .03"/><mass value=".7"/>
    <inertia ixx=".002" ixy="0" ixz="0" iyy=".003" iyz="0" izz=".002"/></inertial></link>
  <link name="before"><inertial><origin xyz="0 0 .1"/><mass value="1"/>
    <inertia ixx=".01" ixy="0" ixz=".001" iyy=".01" iyz="0" izz=".01"/></inertial></link>
  <link name="after"><inertial><origin xyz=".1 .1 .1" rpy=".1 0 0"/><mass value="1.5"/>
    <inertia ixx=".01" ixy="0" ixz=".001" iyy=".01" iyz="0" izz=".01"/></inertial></link>
  <link name="pump"><inertial><origin xyz="-.1 .1 .2"/><mass value=".8"/>
    <inertia ixx=".01" ixy="0" ixz=".001" iyy=".01" iyz="0" izz=".01"/></inertial></link>
  <link name="tip"><inertial><origin xyz=".2 0 .1"/><mass value=".4"/>
    <inertia ixx=".004" ixy="0" ixz="0" iyy=".003" iyz=".001" izz=".002"/></inertial></link>
  <joint name="j1" type="revolute"><parent link="base"/><child link="upper"/>
    <origin xyz=".1 .2 .3" rpy=".5 -.4 .3"/><axis xyz="1 2 -1"/>
    <limit lower="-2" upper="2" velocity="3" effort="9"/></joint>
  <joint name="j2" type="prismatic"><parent link="upper"/><child link="slide"/>
    <origin xyz="0 .1 .2" rpy="1.5 0 .3"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" velocity="3" effort="9"/></joint>
  <joint name="j3" type="continuous"><parent link="slide"/><child link="before"/>
    <origin xyz=".05 0 .2" rpy="0 .3 .3"/><axis xyz="0 0 -2"/>
    <limit velocity="3" effort="9"/></joint>
  <joint name="ft" type="fixed"><parent link="before"/><child link="after"/>
    <origin xyz=".01 .02 .1" rpy=".2 .1 1"/></joint>
  <joint name="j4" type="prismatic"><parent link="after"/><child link="pump"/>
    <origin xyz="0 .1 .2" rpy="0 0 .3"/><axis xyz="1 1 0"/>
    <limit lower="-1" upper="1" velocity="3" effort="9"/></joint>
  <joint name="j5" type="revolute"><parent link="pump"/><child link="tip"/>
    <origin xyz="0 .1 .2" rpy="0 0 .3"/><axis xyz="1 0 0"/>
    <limit lower="-1" upper="1" velocity="3" effort="9"/></joint>
  <sensor name="wrist" type="force_torque"><parent joint="ft"/>{tags}</sensor>
</robot>
"""


def model(name: str) -> Path:
    return Path(icub_models.get_model_file(name))


def motion_of(robot: Robot, seed: int, samples: int = SAMPLES) -> Motion:
    rng = np.random.default_rng(seed)
    joints = robot.moving_joints
    q, dq, ddq = rng.normal(size=(3, samples, len(joints)))
    return Motion(np.arange(samples) * 0.01, joints, q, 2.0 * dq, 5.0 * ddq)


def moving(link: str, samples: int, seed: int) -> MovingContact:
    return MovingContact(link, *np.random.default_rng(seed).normal(size=(4, samples, 3)) * 3.0)


def idyntree_wrenches(
    path: Path, motion: Motion, contact: Contact, sensors: list[str]
) -> dict[str, Float[Array, "N 6"]]:
    """Return what iDynTree's estimator expects of every sensor."""
    idyn = pytest.importorskip("idyntree.bindings")
    loader = idyn.ModelLoader()
    assert loader.loadModelFromFile(str(path))
    estimator = idyn.ExtWrenchesAndJointTorquesEstimator()
    assert estimator.setModel(loader.model())
    its = estimator.model()
    frame = its.getFrameIndex(contact.link)
    assert frame >= 0  # an unknown frame is only logged
    order = [motion.joints.index(its.getJointName(k)) for k in range(its.getNrOfDOFs())]

    def joint_array(kind: Any, values: Float[Array, "J"]) -> Any:
        array = kind(its)
        for k, value in enumerate(values[order]):
            array.setVal(k, float(value))
        return array

    unknowns = idyn.LinkUnknownWrenchContacts(its)
    unknowns.addNewUnknownFullWrenchInFrameOrigin(its, frame)
    readings = idyn.SensorsMeasurements(its.sensors())
    contacts = idyn.LinkContactWrenches(its)
    torques = idyn.JointDOFsDoubleArray(its)
    kind = idyn.SIX_AXIS_FORCE_TORQUE
    indices = {name: its.sensors().getSensorIndex(kind, name) for name in sensors}
    assert min(indices.values()) >= 0
    expected = {name: np.empty((len(motion), 6)) for name in sensors}
    for n in range(len(motion)):
        state = (
            joint_array(idyn.JointPosDoubleArray, motion.position[n]),
            joint_array(idyn.JointDOFsDoubleArray, motion.velocity[n]),
            joint_array(idyn.JointDOFsDoubleArray, motion.acceleration[n]),
        )
        if isinstance(contact, FixedContact):
            gravity = idyn.Vector3.FromPython(list(contact.gravity))
            assert estimator.updateKinematicsFromFixedBase(*state, frame, gravity)
        else:
            base = (
                contact.proper_acceleration()[n],
                contact.angular_velocity[n],
                contact.angular_acceleration[n],
            )
            vectors = [idyn.Vector3.FromPython([float(x) for x in v]) for v in base]
            assert estimator.updateKinematicsFromFloatingBase(*state, frame, *vectors)
        assert estimator.computeExpectedFTSensorsMeasurements(unknowns, readings, contacts, torques)
        for name, index in indices.items():
            wrench = idyn.Wrench()
            readings.getMeasurement(kind, index, wrench)
            expected[name][n] = [wrench.getVal(k) for k in range(6)]
    return expected


def assert_same(
    actual: dict[str, Float[Array, "N 6"]],
    expected: dict[str, Float[Array, "N 6"]],
    tolerance: float = TOLERANCE,
) -> None:
    assert actual.keys() == expected.keys()
    for name, wrench in expected.items():
        for part in (slice(0, 3), slice(3, 6)):
            scale = abs(wrench[:, part]).max()
            worst = abs(actual[name][:, part] - wrench[:, part]).max()
            assert worst <= tolerance * scale, f"{name}: {worst / scale:.1e}"


@pytest.mark.parametrize(("name", "seed"), [(name, k) for k, name in enumerate(MODELS)])
def test_icub_wrenches_are_those_of_idyntree(name: str, seed: int) -> None:
    robot = read_robot(model(name))
    sensors = list(robot.sensors)
    motion = motion_of(robot, seed)
    for link in ("l_sole", "r_sole", "root_link"):
        short = motion.rows(slice(50))
        for states, contact in (
            (motion, FixedContact(link, (0.3, -0.4, -9.7))),
            (short, moving(link, len(short), seed)),
        ):
            expected = idyntree_wrenches(model(name), states, contact, sensors)
            assert_same(expected_wrenches(robot, states, contact, sensors), expected)


def test_legacy_icub_wrenches_are_those_of_idyntree() -> None:
    path = SHARED / "icub-genova02" / "iCubGenova02.urdf"
    if not path.exists():
        pytest.skip("the shared recordings are not here")
    robot = read_robot(path)
    motion = motion_of(robot, 3)
    for link in ("l_sole", "r_sole", "root_link"):
        expected = idyntree_wrenches(path, motion, FixedContact(link), list(robot.sensors))
        actual = expected_wrenches(robot, motion, FixedContact(link), list(robot.sensors))
        assert_same(actual, expected)


TAGS = [
    f"<force_torque><frame>{frame}</frame><measure_direction>{direction}</measure_direction>"
    f"</force_torque>{origin}"
    for frame, direction, origin in product(
        ("child", "parent", "sensor"),
        ("child_to_parent", "parent_to_child"),
        ("", '<origin xyz=".1 .2 -.3" rpy=".3 .5 .7"/>'),
    )
]


@pytest.mark.parametrize("tags", TAGS)
def test_every_reading_of_the_sensor_tag_is_that_of_idyntree(tags: str, tmp_path: Path) -> None:
    path = tmp_path / "limb.urdf"
    path.write_text(LIMB.format(tags=tags))
    robot = read_robot(path)
    motion = motion_of(robot, 5, samples=20)
    for link in ("base", "tip", "slide"):
        for contact in (FixedContact(link, (1.0, 2.0, -9.0)), moving(link, len(motion), 1)):
            expected = idyntree_wrenches(path, motion, contact, ["wrist"])
            assert_same(expected_wrenches(robot, motion, contact, ["wrist"]), expected)


def pinocchio_wrenches(
    text: str, robot: Robot, motion: Motion, sensors: list[str]
) -> dict[str, Float[Array, "N 6"]]:
    """Return what Pinocchio says the parent does to the child, the root link standing still.

    It lumps fixed joints: each F/T joint gets a degree of freedom that stays at zero.
    """
    pin = pytest.importorskip("pinocchio")
    joints = {name: robot.sensor(name).joint for name in sensors}
    for joint in joints.values():
        text, count = re.subn(
            rf'(<joint name="{joint}" type=)"fixed">', rf'\1"revolute">{LIMIT}', text
        )
        assert count == 1
    # a continuous joint is two numbers to Pinocchio
    its = pin.buildModelFromXML(text.replace('"continuous"', '"revolute"'))
    memory = its.createData()
    its.gravity.linear = np.array([0.0, 0.0, -9.80665])
    felt = {name: np.empty((len(motion), 6)) for name in sensors}
    names = list(its.names)[1:]
    for n in range(len(motion)):
        state = []
        for signal in (motion.position, motion.velocity, motion.acceleration):
            row = dict(zip(motion.joints, signal[n], strict=True))
            state.append(np.array([row.get(name, 0.0) for name in names]))
        pin.rnea(its, memory, *state)
        for name, joint in joints.items():
            felt[name][n] = memory.f[its.getJointId(joint)].vector
    return felt


def test_pinocchio_feels_the_opposite_of_child_to_parent() -> None:
    text = LIMB.format(tags="<force_torque/>")  # child frame, child to parent
    robot = parse_robot(text)
    motion = motion_of(robot, 7)
    opposite = pinocchio_wrenches(text, robot, motion, ["wrist"])["wrist"]
    actual = expected_wrenches(robot, motion, FixedContact("base"), ["wrist"])
    assert_same(actual, {"wrist": -opposite})


def test_pinocchio_agrees_on_all_six_sensors_of_an_icub() -> None:
    text = model("iCubGenova03").read_text()
    robot = read_robot(model("iCubGenova03"))
    sensors = [s.name for s in robot.sensors.values() if s.frame == "child"]
    assert len(sensors) == 6
    motion = motion_of(robot, 8)
    felt = pinocchio_wrenches(text, robot, motion, sensors)
    sign = {name: -1.0 if robot.sensor(name).acts_on == "parent" else 1.0 for name in sensors}
    actual = expected_wrenches(robot, motion, FixedContact("root_link"), sensors)
    assert_same(actual, {name: sign[name] * wrench for name, wrench in felt.items()})
