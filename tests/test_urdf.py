"""Reading robot descriptions, whole and broken."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from ftcal.errors import RobotError
from ftcal.spatial import rotation_from_rpy
from ftcal.urdf import parse_robot, read_robot

LINKS = """<link name="a"><inertial><origin xyz="1 2 3" rpy="0.1 0.2 0.3"/><mass value="2"/>
  <inertia ixx="1" ixy="0.1" ixz="0.2" iyy="2" iyz="0.3" izz="2.5"/></inertial></link>
  <link name="b"/>"""
HINGE = """<joint name="j" type="revolute"><parent link="a"/><child link="b"/>
  <origin xyz="1 0 0" rpy="0 0 1"/><axis xyz="0 3 4"/><limit lower="-1" upper="2" velocity="5"/>
  </joint>"""
SENSOR_JOINT = """<joint name="ft" type="fixed"><parent link="a"/><child link="b"/>
  <origin xyz="0 0 1" rpy="0.5 0 0"/></joint>"""


def wrapped(*parts: str) -> str:
    return f"<robot name='r'>{''.join(parts)}</robot>"


def test_inertia_is_turned_into_the_axes_of_the_link() -> None:
    link = parse_robot(wrapped(LINKS, HINGE)).link("a")
    R = rotation_from_rpy(np.array([0.1, 0.2, 0.3]))
    written = np.array([[1, 0.1, 0.2], [0.1, 2, 0.3], [0.2, 0.3, 2.5]])
    np.testing.assert_allclose(link.inertia, R @ written @ R.T, rtol=1e-14)
    np.testing.assert_array_equal(link.com, [1, 2, 3])


def test_joint_has_unit_axis_pose_and_limits() -> None:
    robot = parse_robot(wrapped(LINKS, HINGE))
    joint = robot.joint("j")
    np.testing.assert_allclose(joint.axis, [0, 0.6, 0.8])
    np.testing.assert_array_equal(joint.parent_H_child[:3, 3], [1, 0, 0])
    assert (joint.lower, joint.upper, joint.velocity) == (-1, 2, 5)
    assert (robot.root, robot.name) == ("a", "r")


def test_continuous_joint_is_a_revolute_one_without_limits() -> None:
    joint = parse_robot(wrapped(LINKS, HINGE.replace("revolute", "continuous"))).joint("j")
    assert joint.kind == "revolute"
    assert (joint.lower, joint.upper) == (-np.inf, np.inf)


def test_axis_left_out_is_x() -> None:
    joint = parse_robot(wrapped(LINKS, HINGE.replace('<axis xyz="0 3 4"/>', ""))).joint("j")
    np.testing.assert_array_equal(joint.axis, [1, 0, 0])


def test_mimic_joint_is_a_joint_of_its_own() -> None:
    mimic = HINGE.replace("<axis", '<mimic joint="other" multiplier="2"/><axis')
    assert parse_robot(wrapped(LINKS, mimic)).moving_joints == ("j",)


def test_digest_is_that_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "r.urdf"
    path.write_text(wrapped(LINKS, HINGE))
    assert read_robot(path).digest == parse_robot(wrapped(LINKS, HINGE)).digest
    assert read_robot(path).digest != parse_robot(wrapped(LINKS, HINGE, " ")).digest


@pytest.mark.parametrize(
    ("tags", "frame", "acts_on"),
    [
        ("", "child", "parent"),
        ("<force_torque/>", "child", "parent"),
        ("<force_torque><frame> parent </frame></force_torque>", "parent", "parent"),
        (
            "<force_torque><frame>sensor</frame>"
            "<measure_direction>parent_to_child</measure_direction></force_torque>",
            "sensor",
            "child",
        ),
    ],
)
def test_sensor_tags_say_frame_and_side(tags: str, frame: str, acts_on: str) -> None:
    origin = '<origin xyz="0.1 0.2 0.3" rpy="0 0 1"/>'
    sensor = f'<sensor name="s" type="force_torque"><parent joint="ft"/>{tags}{origin}</sensor>'
    robot = parse_robot(wrapped(LINKS, SENSOR_JOINT, sensor))
    made = robot.sensor("s")
    assert (made.frame, made.acts_on, made.parent, made.child) == (frame, acts_on, "a", "b")
    at = {"child": [0, 0, 0], "sensor": [0.1, 0.2, 0.3]}
    parent_H_sensor = robot.joint("ft").parent_H_child @ made.child_H_sensor
    if frame == "parent":
        np.testing.assert_allclose(parent_H_sensor, np.eye(4), atol=1e-15)
    else:
        np.testing.assert_array_equal(made.child_H_sensor[:3, 3], at[frame])


GAZEBO = """<gazebo reference="ft"><sensor name="g" type="force_torque">
  <force_torque><frame>sensor</frame></force_torque><pose>0 0 1 0 0 0</pose></sensor></gazebo>"""


def test_plain_sensor_wins_over_gazebo() -> None:
    plain = '<sensor name="s" type="force_torque"><parent joint="ft"/></sensor>'
    assert list(parse_robot(wrapped(LINKS, SENSOR_JOINT, GAZEBO, plain)).sensors) == ["s"]


def test_gazebo_sensor_is_taken_where_it_is_the_only_one() -> None:
    sensor = parse_robot(wrapped(LINKS, SENSOR_JOINT, GAZEBO)).sensor("g")
    assert sensor is not None
    assert (sensor.joint, sensor.frame) == ("ft", "sensor")
    np.testing.assert_array_equal(sensor.child_H_sensor[:3, 3], [0, 0, 1])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (wrapped(LINKS, HINGE.replace("revolute", "floating")), "joint 'j' is floating"),
        (wrapped(LINKS, HINGE.replace("revolute", "planar")), "joint 'j' is planar"),
        (wrapped(LINKS, HINGE.replace("0 3 4", "0 0 0")), "axis of joint 'j' is '0 0 0'"),
        (wrapped(LINKS, HINGE.replace("0 3 4", "0 3")), "axis of joint 'j' is '0 3', not 3"),
        (wrapped(LINKS, HINGE.replace("1 0 0", "1 nan 0")), "origin of joint 'j' is not finite"),
        (wrapped(LINKS, HINGE.replace('link="b"', 'link="bb"')), "no link 'bb'"),
        (wrapped(LINKS, LINKS, HINGE), "two links named 'a'"),
        (wrapped(LINKS, HINGE, HINGE), "two joints named 'j'"),
        (wrapped(LINKS.replace('value="2"', 'value="nan"'), HINGE), "mass of link 'a' is nan"),
        (wrapped(LINKS.replace('value="2"', 'value="two"'), HINGE), "mass of link 'a' is 'two'"),
        (wrapped(LINKS.replace('izz="2.5"', 'izz="-9"'), HINGE), "inertia of link 'a'"),
        (wrapped(), "no <link>"),
        ("<sdf/>", "root element is <sdf>"),
        (
            wrapped(
                LINKS, HINGE, '<sensor name="s" type="force_torque"><parent joint="j"/></sensor>'
            ),
            "'s' sits in revolute joint 'j'",
        ),
        (
            wrapped(LINKS, HINGE, '<sensor name="s" type="force_torque"/>'),
            "sensor 's': no joint ''",
        ),
        (
            wrapped(
                LINKS,
                SENSOR_JOINT,
                '<sensor name="s" type="force_torque"><parent joint="ft"/><force_torque>'
                "<frame>world</frame><measure_direction>up</measure_direction></force_torque>"
                "</sensor>",
            ),
            "frame of sensor 's' is 'world'.*measure_direction of sensor 's' is 'up'",
        ),
    ],
)
def test_broken_description_names_the_culprit(text: str, words: str) -> None:
    with pytest.raises(RobotError, match=words) as caught:
        parse_robot(text, name="robot.urdf")
    assert str(caught.value).startswith("robot.urdf")
    assert "\n" not in str(caught.value)


def test_text_that_is_not_xml_is_placed(tmp_path: Path) -> None:
    path = tmp_path / "r.urdf"
    path.write_text("<robot>\n<link></robot>")
    with pytest.raises(RobotError, match=r"r\.urdf, line 2, column \d+: not XML"):
        read_robot(path)


def test_entities_are_refused() -> None:
    bomb = '<!DOCTYPE r [<!ENTITY a "aaaa">]><robot name="&a;"/>'
    with pytest.raises(RobotError, match="entities are refused"):
        parse_robot(bomb)


def test_missing_file_is_a_robot_error(tmp_path: Path) -> None:
    with pytest.raises(RobotError, match="No such file"):
        read_robot(tmp_path / "none.urdf")


def test_xacro_is_expanded(tmp_path: Path) -> None:
    pytest.importorskip("xacro")
    path = tmp_path / "r.urdf.xacro"
    path.write_text(
        '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
        '<xacro:property name="m" value="${1 + 2}"/>'
        '<link name="a"><inertial><mass value="${m}"/></inertial></link></robot>'
    )
    assert read_robot(path).mass == 3.0


def test_broken_xacro_is_a_robot_error(tmp_path: Path) -> None:
    pytest.importorskip("xacro")
    path = tmp_path / "r.xacro"
    path.write_text('<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><a b="${none}"/></robot>')
    with pytest.raises(RobotError, match="xacro failed"):
        read_robot(path)


def test_xacro_without_the_package_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "xacro", None)
    with pytest.raises(RobotError, match=r"pip install ftcal\[xacro\]"):
        read_robot(tmp_path / "r.xacro")


def test_every_icub_model_is_read() -> None:
    icub_models = pytest.importorskip("icub_models")
    for name in icub_models.get_robot_names():
        assert read_robot(icub_models.get_model_file(name)).mass > 0.0
