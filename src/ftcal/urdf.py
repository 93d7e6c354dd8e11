"""URDF (or xacro) → `Robot`.

F/T sensors are read as iDynTree reads them: a `<sensor type="force_torque">` below `<robot>`; its
`<origin>` counts only where its `frame` is `sensor`. Where tags are missing, which iDynTree
refuses, those of SDF hold: frame `child`, `measure_direction` `child_to_parent`. A sensor inside a
`<gazebo reference="joint">` block is taken where no plain tag names that joint. Meshes,
transmissions, plugins and `<mimic>` are not read: a mimic joint is a joint like any other, whose
position the log must contain.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast
from xml.etree.ElementTree import Element, ParseError

import numpy as np

from ftcal.errors import RobotError, raise_all, unknown
from ftcal.robot import FtSensor, Joint, Link, Robot, Side, faults
from ftcal.spatial import inverse, pose, rotation_from_rpy

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

ACTS_ON: dict[str, Side] = {"child_to_parent": "parent", "parent_to_child": "child"}
"""Side on which the wrench acts, of `measure_direction`."""


def read_robot(path: Path | str) -> Robot:
    """Read a `.urdf` (any suffix) or `.xacro` file; `RobotError` says what is wrong and where."""
    path = Path(path)
    if path.suffix == ".xacro":
        return parse_robot(_expand(path), name=str(path))
    try:
        text = path.read_bytes()
    except OSError as error:
        raise RobotError(f"{path}: {error.strerror or error}") from error
    return parse_robot(text, name=str(path))


def parse_robot(text: str | bytes, *, name: str = "URDF") -> Robot:
    """Return the robot that the XML `text` describes; `name` (of the file) opens every error."""
    source = text.encode() if isinstance(text, str) else text
    reader = _Reader([])
    root = _parse(text, name)
    links = reader.named(root, "link", reader.link)
    joints = reader.named(root, "joint", reader.joint)
    if not links:
        reader.found.append("no <link>")
    reader.found += faults(links, joints)
    sensors = reader.sensors(root, joints)
    raise_all(RobotError, name, reader.found)
    below = {joint.child for joint in joints.values()}
    return Robot(
        name=root.get("name", name),
        root=next(link for link in links if link not in below),
        links=links,
        joints=joints,
        sensors=sensors,
        digest=hashlib.sha256(source).hexdigest(),
    )


def _parse(text: str | bytes, name: str) -> Element:
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import fromstring

    try:
        root: Element = fromstring(text, forbid_dtd=True)
    except ParseError as error:
        line, column = error.position
        reason = str(error).split(":")[0]
        raise RobotError(f"{name}, line {line}, column {column}: not XML ({reason})") from error
    except (DefusedXmlException, ValueError, LookupError) as error:
        reason = type(error).__name__
        raise RobotError(
            f"{name}: document types and entities are refused ({reason}); remove them"
        ) from error
    if root.tag != "robot":
        raise RobotError(f"{name}: the root element is <{root.tag}>, not <robot>; give a URDF")
    return root


def _expand(path: Path) -> str:
    try:
        import xacro
    except ImportError as error:
        raise RobotError(f"{path}: xacro is not installed; pip install ftcal[xacro]") from error
    try:
        return str(xacro.process_file(str(path)).toxml())
    except Exception as error:  # xacro evaluates expressions: anything can come out
        reason = " ".join(str(error).split()) or type(error).__name__
        raise RobotError(f"{path}: xacro failed: {reason}") from error


class _Reader:
    """Elements → records; faults are collected in `found`."""

    def __init__(self, found: list[str]) -> None:
        self.found = found

    def named(self, root: Element, tag: str, make: Any) -> dict[str, Any]:
        """Return the records of every `tag` below `root`, by name."""
        records: dict[str, Any] = {}
        for element in root.findall(tag):
            name = element.get("name")
            if not name:
                self.found.append(f"a <{tag}> without a name")
            elif name in records:
                self.found.append(f"two {tag}s named {name!r}")
            else:
                records[name] = make(element, name)
        return records

    def numbers(self, text: str | None, count: int, what: str) -> Float[Array, "count"]:
        """Return `count` finite floats (zeros where `text` is None)."""
        if text is None:
            return np.zeros(count)
        try:
            values = np.array([float(word) for word in text.split()])
        except ValueError:
            values = np.empty(0)
        if len(values) != count:
            self.found.append(f"{what} is {text!r}, not {count} number{'s' * (count > 1)}")
            return np.zeros(count)
        return values

    def origin(self, element: Element | None, what: str) -> Float[Array, "4 4"]:
        """Return the pose that the `<origin>` of `element` gives, identity where there is none."""
        tag = None if element is None else element.find("origin")
        if tag is None:
            return np.eye(4)
        rpy = self.numbers(tag.get("rpy"), 3, f"rpy of {what}")
        xyz = self.numbers(tag.get("xyz"), 3, f"xyz of {what}")
        if not (np.isfinite(rpy).all() and np.isfinite(xyz).all()):
            self.found.append(f"origin of {what} is not finite")
            return np.eye(4)
        return pose(rotation_from_rpy(rpy), xyz)

    def link(self, element: Element, name: str) -> Link:
        """Return the link; its inertia is turned into the axes of the link frame."""
        inertial = element.find("inertial")
        if inertial is None:
            return Link(name, 0.0, np.zeros(3), np.zeros((3, 3)))
        link_H_com = self.origin(inertial, f"inertial of link {name!r}")
        mass = inertial.find("mass")
        value = None if mass is None else mass.get("value")
        if value is None:
            self.found.append(f"inertial of link {name!r} has no mass")
        tag = inertial.find("inertia")
        keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        xx, xy, xz, yy, yz, zz = (
            self.numbers(None if tag is None else tag.get(k), 1, f"{k} of link {name!r}")[0]
            for k in keys
        )
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        R = link_H_com[:3, :3]
        kilograms = float(self.numbers(value, 1, f"mass of link {name!r}")[0])
        with np.errstate(invalid="ignore"):  # infinity is refused later, by name
            turned = R @ inertia @ R.T
        return Link(name, kilograms, link_H_com[:3, 3], turned)

    def joint(self, element: Element, name: str) -> Joint:
        """Return the joint; limits that are not given are infinite."""
        what = f"joint {name!r}"
        kind = element.get("type", "")
        if kind not in ("revolute", "continuous", "prismatic", "fixed"):
            self.found.append(
                f"{what} is {kind or 'without a type'}; only revolute, continuous, prismatic and"
                " fixed joints are understood"
            )
        ends = {}
        for end in ("parent", "child"):
            tag = element.find(end)
            name_of_end = "" if tag is None else tag.get("link", "")
            if not name_of_end:
                self.found.append(f"{what} has no {end} link")
            ends[end] = name_of_end
        axis, tag = np.array([1.0, 0.0, 0.0]), element.find("axis")
        moves = kind != "fixed"
        if tag is not None and moves:
            axis = self.numbers(tag.get("xyz"), 3, f"axis of {what}")
            length = float(np.linalg.norm(axis))
            if not 1e-6 < length < np.inf:
                self.found.append(f"axis of {what} is {tag.get('xyz')!r}; it must have a length")
                length = 1.0
            axis = axis / length
        limit = element.find("limit")

        def bound(key: str, default: float) -> float:
            text = None if limit is None or not moves else limit.get(key)
            return default if text is None else float(self.numbers(text, 1, f"{key} of {what}")[0])

        unlimited = kind == "continuous"
        return Joint(
            name,
            cast("Literal['revolute', 'prismatic', 'fixed']", "revolute" if unlimited else kind),
            ends["parent"],
            ends["child"],
            self.origin(element, what),
            axis,
            -np.inf if unlimited else bound("lower", -np.inf),
            np.inf if unlimited else bound("upper", np.inf),
            bound("velocity", np.inf),
        )

    def sensors(self, root: Element, joints: dict[str, Joint]) -> dict[str, FtSensor]:
        """Return the F/T sensors; plain tags win over those inside `<gazebo>`."""

        def is_wrench(element: Element) -> bool:
            return element.get("type") == "force_torque"

        def make(element: Element, name: str) -> FtSensor | None:
            tag = element.find("parent")
            joint = "" if tag is None else tag.get("joint", "")
            child_H_sensor = self.origin(element, f"sensor {name!r}")
            return self.sensor(element, name, joint, joints, child_H_sensor)

        plain = Element("robot")
        plain.extend(filter(is_wrench, root.findall("sensor")))
        sensors = {n: s for n, s in self.named(plain, "sensor", make).items() if s is not None}
        taken = {sensor.joint for sensor in sensors.values()}
        for block in root.findall("gazebo"):
            joint = block.get("reference", "")
            # Gazebo can measure in moving joints and links; those are not sensors of this kind
            if joint in taken or joint not in joints or joints[joint].kind != "fixed":
                continue
            for element in filter(is_wrench, block.findall("sensor")):
                name = element.get("name") or joint
                numbers = self.numbers(element.findtext("pose"), 6, f"pose of sensor {name!r}")
                child_H_sensor = pose(rotation_from_rpy(numbers[3:]), numbers[:3])
                sensor = self.sensor(element, name, joint, joints, child_H_sensor)
                if sensor is not None:
                    sensors.setdefault(name, sensor)
        return sensors

    def sensor(
        self,
        element: Element,
        name: str,
        joint_name: str,
        joints: dict[str, Joint],
        child_H_sensor: Float[Array, "4 4"],
    ) -> FtSensor | None:
        """Return the sensor in `joint_name`, or None and a fault found."""
        tag = element.find("force_torque")
        tag = Element("force_torque") if tag is None else tag
        frame = (tag.findtext("frame") or "child").strip()
        direction = (tag.findtext("measure_direction") or "child_to_parent").strip()
        found = []
        if frame not in ("child", "parent", "sensor"):
            found.append(f"frame of sensor {name!r} is {frame!r}; give child, parent or sensor")
        if direction not in ACTS_ON:
            found.append(
                f"measure_direction of sensor {name!r} is {direction!r}; give child_to_parent or"
                " parent_to_child"
            )
        joint = joints.get(joint_name)
        if joint is None:
            found.append(f"sensor {name!r}: {unknown('joint', joint_name, joints)}")
        elif joint.kind != "fixed":
            found.append(f"sensor {name!r} sits in {joint.kind} joint {joint.name!r}, not a fixed")
        self.found += found
        if found or joint is None:
            return None
        offsets = {
            "child": np.eye(4),
            "parent": inverse(joint.parent_H_child),
            "sensor": child_H_sensor,
        }
        return FtSensor(
            name,
            joint.name,
            joint.parent,
            joint.child,
            cast("Literal['child', 'parent', 'sensor']", frame),
            ACTS_ON[direction],
            offsets[frame],
        )
