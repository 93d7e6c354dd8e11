"""What touches each sub-model, and the torques its motors give: Newton and Euler between sensors.

The sensors that have readings cut the robot into sub-models. The momentum balance of one of them,

    rate of change of momentum - weight = external wrench + what the sensors say acts on it,

has one unknown wrench, reduced at a frame of choice; a joint's torque is what the links beyond it
still need of force about their axis. M. Fumagalli et al., *Force feedback exploiting tactile and
proximal force/torque sensing*, Autonomous Robots 33, 2012, in the closed form of iDynTree's
`estimateExtWrenchesAndJointTorques`.

Two devices make it a matter of `ftcal.newton_euler`: the floor is one more sensor, under the
contact, which reads nothing (what the floor does is an external wrench like any other); and a
sensor hands inwards what it *measured*, not what the links beyond it need.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ftcal import jit
from ftcal.dynamics import CHUNK, motion_columns
from ftcal.errors import DataError, RobotError, raise_all, unknown
from ftcal.kernel import WrenchKernel
from ftcal.motion import Contact, FixedContact, Motion
from ftcal.newton_euler import Vector, arguments, carried_outwards, reading, sweep
from ftcal.program import Program
from ftcal.robot import FtSensor, Joint, Link, Robot, SubModel
from ftcal.spatial import inverse
from ftcal.trace import Number, Trace
from ftcal.tree import Tree, grow

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

FLOOR = " floor"
"""Imaginary sensor under the contact; the blank keeps it apart from names of the description."""
TOUCH = " touch "
"""Prefix of the imaginary limb through which the world touches a sub-model."""


@dataclass(frozen=True, slots=True, eq=False)
class ExternalWrenches:
    """The wrenches that close the balances of the sub-models, and their joint torques."""

    frames: dict[str, str]
    """Frame of each sub-model in which its wrench is expressed, at whose origin it acts."""
    wrench: dict[str, Float[Array, "N 6"]]
    """What the world does to each sub-model: force [N] then torque [Nm]."""
    joints: tuple[str, ...]
    """Moving joints inside the sub-models; without those that carry neither mass nor sensor."""
    torque: Float[Array, "N J"]
    """What each joint does to its child about (along) its axis [Nm, N]."""
    left_out: dict[str, tuple[str, ...]]
    """Sub-models whose balance is unknown, with the joints not logged."""


def external_wrenches(
    robot: Robot,
    motion: Motion,
    contact: Contact,
    readings: Mapping[str, Float[Array, "N 6"]],
    frames: Mapping[str, str] | None = None,
    *,
    engine: Literal["auto", "llvm", "numpy"] = "auto",
) -> ExternalWrenches:
    """Return the external wrench of each sub-model that the sensors in `readings` cut out.

    `readings` are wrenches at the sensors' frames [N, Nm], on the side each acts on. `frames` asks
    for sub-models by name (the link nearest the root) and says where the unknown wrench of each
    acts; without it every sub-model whose joints are logged is balanced at its first link, the
    others are named in `left_out`. `contact` gives the motion only: its sub-model's external
    wrench is found like any other. `DataError`: joints not logged, readings of another length,
    nothing left; `RobotError`: unknown names, a frame of another sub-model.
    """
    felt = {robot.sensor(name).name: np.asarray(value) for name, value in readings.items()}
    count = len(motion)
    raise_all(
        DataError,
        "sensor readings",
        (
            f"{name} has shape {value.shape}, not ({count}, 6)"
            for name, value in felt.items()
            if value.shape != (count, 6)
        ),
    )
    asked = None if frames is None else tuple(frames.items())
    stage = staged(robot, contact.link, tuple(felt), asked, motion.joints)
    columns = motion_columns(stage.tree, motion, contact)
    columns += [np.asarray(felt[name][:, k], np.float64) for name in felt for k in range(6)]
    fixed = isinstance(contact, FixedContact)
    gravity = tuple(float(g) for g in contact.gravity) if fixed else None
    if engine == "numpy" or (engine == "auto" and not jit.available()):
        results = _by_numpy(stage, gravity, columns, count)
    else:
        results = compiled(stage, gravity)(columns, count)
    torques = results[len(stage.balances) :]
    torque = np.hstack(torques) if torques else np.empty((count, 0))
    return ExternalWrenches(
        {balance.name: balance.frame for balance in stage.balances},
        {balance.name: wrench for balance, wrench in zip(stage.balances, results, strict=False)},
        tuple(stage.tree.bodies[index].joint for index in stage.turning),
        torque[:, : len(stage.turning)],
        dict(stage.left_out),
    )


@dataclass(frozen=True, slots=True)
class Balance:
    """A sub-model on the stage."""

    name: str
    """Its link nearest the root of the robot."""
    frame: str
    """Where the world touches it."""
    way: tuple[int, ...]
    """Bodies from the first, behind the sensor nearest the contact, to the frame's."""


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """The tree of a robot that stands on an imaginary sensor, and what is asked of it."""

    tree: Tree
    """Its cuts: the floor, the sensors in the order of their readings, a touch a balance."""
    sensors: int
    """Sensors that have readings."""
    balances: tuple[Balance, ...]
    turning: tuple[int, ...]
    """Bodies whose joints have a torque."""
    left_out: dict[str, tuple[str, ...]]
    """Sub-models with joints not logged."""


@lru_cache(maxsize=32)
def staged(
    robot: Robot,
    contact: str,
    sensors: tuple[str, ...],
    asked: tuple[tuple[str, str], ...] | None,
    logged: tuple[str, ...],
) -> Stage:
    """Return what `external_wrenches` computes with, kept; arguments and errors as there."""
    models = {model.name: model for model in robot.sub_models(sensors)}
    frames = {name: name for name in models} if asked is None else dict(asked)
    raise_all(RobotError, "external wrenches", _misplaced(robot, models, frames))
    needed = {name: _needed(robot, models[name], contact, frames[name]) for name in frames}
    left_out = {
        name: missing
        for name, joints in needed.items()
        if (missing := tuple(joint for joint in joints if joint not in logged))
    }
    if left_out and (asked is not None or len(left_out) == len(frames)):
        raise DataError(
            "external wrenches need joints that are not logged: "
            + "; ".join(f"sub-model {name!r} {', '.join(j)}" for name, j in left_out.items())
            + "; log them, name another contact, or ask for other sub-models"
        )
    frames = {name: frame for name, frame in frames.items() if name not in left_out}
    moving = {joint for name in frames for joint in needed[name]}
    tree = grow(
        _with_touches(robot, contact, frames.values(), moving),
        FLOOR,
        [FLOOR, *sensors, *(TOUCH + frame for frame in frames.values())],
    )
    first = {cut.body for cut in tree.cuts[: len(sensors) + 1]}
    balances = []
    for cut, (name, frame) in zip(tree.cuts[len(sensors) + 1 :], frames.items(), strict=True):
        way = [tree.bodies[cut.body].before]
        while way[0] not in first:
            way.insert(0, tree.bodies[way[0]].before)
        balances.append(Balance(name, frame, tuple(way)))
    inside = {link for name in frames for link in models[name].links}
    body_of = {body.joint: index for index, body in enumerate(tree.bodies)}
    turning = tuple(
        body_of[name]
        for name in robot.moving_joints
        if name in body_of and robot.joints[name].child in inside
    )
    return Stage(tree, len(sensors), tuple(balances), turning, left_out)


def _misplaced(
    robot: Robot, models: Mapping[str, SubModel], frames: Mapping[str, str]
) -> Iterator[str]:
    """Yield what is wrong with the sub-models and frames asked for."""
    for name, frame in frames.items():
        if name not in models:
            yield unknown("sub-model", name, models)
        elif robot.link(frame).name not in models[name].links:
            owner = next(model.name for model in models.values() if frame in model.links)
            yield f"frame {frame!r} lies in sub-model {owner!r}, not in {name!r}"


def _needed(robot: Robot, model: SubModel, contact: str, frame: str) -> tuple[str, ...]:
    """Return the moving joints on the way from `contact` to `model`, and those that matter in it.

    Which are those that move mass, a sensor of its border, or the frame.
    """
    border = [robot.sensor(name) for name in model.sensors]
    ends = {frame, *(s.parent for s in border), *(s.child for s in border)} & set(model.links)
    massive = {name for name in model.links if robot.links[name].mass > 0.0}
    ways = {joint.name for link in ends | massive for joint in robot.path(contact, link)}
    return tuple(name for name in robot.moving_joints if name in ways)


def _with_touches(
    robot: Robot, contact: str, frames: Iterable[str], moving: Container[str]
) -> Robot:
    """Return `robot` on a floor, touched at `frames`; joints not in `moving` are stiff.

    A limb behind a sensor needs a mass to be one; nothing is handed inwards from it.
    """
    links = dict(robot.links)
    joints = {
        name: joint if name in moving else replace(joint, kind="fixed")
        for name, joint in robot.joints.items()
    }
    sensors = dict(robot.sensors)
    touches = {FLOOR: (contact, 0.0), **{TOUCH + frame: (frame, 1.0) for frame in frames}}
    for name, (parent, mass) in touches.items():
        links[name] = Link(name, mass, np.zeros(3), np.zeros((3, 3)))
        joints[name] = Joint(name, "fixed", robot.link(parent).name, name, np.eye(4), np.zeros(3))
        sensors[name] = FtSensor(name, name, parent, name, "child", "child", np.eye(4))
    return replace(robot, links=links, joints=joints, sensors=sensors)


def balances(
    stage: Stage,
    gravity: Sequence[float] | None,
    numbers: Sequence[Any],
    sin_cos: Callable[[Any], tuple[Any, Any]],
    section: Callable[[], None] = lambda: None,
) -> tuple[list[Vector], list[Any]]:
    """Return the external wrench of each balance, then the torque of each body in `turning`.

    `numbers` are those of `newton_euler.arguments`, then six a sensor.
    """
    tree = stage.tree
    first = len(numbers) - 6 * stage.sensors
    base, joints = arguments(tree, gravity, numbers[:first])
    nothing: tuple[Vector, Vector] = ([0.0] * 3, [0.0] * 3)
    measured = {cut.body: nothing for cut in tree.cuts}
    for k, cut in enumerate(tree.cuts[1 : stage.sensors + 1]):
        six = numbers[first + 6 * k : first + 6 * k + 6]
        back = replace(cut, sensor_H_body=inverse(cut.sensor_H_body))
        here = reading(back, list(six[:3]), list(six[3:]))
        measured[cut.body] = (here[:3], here[3:])
    carried: dict[int, tuple[Vector, Vector]] = {}

    def handed(index: int, f: Vector, n: Vector) -> tuple[Vector, Vector]:
        carried[index] = (f, n)
        return measured.get(index, (f, n))

    sweep(tree, base, joints, sin_cos, section, handed)
    external = []
    for balance, cut in zip(stage.balances, tree.cuts[stage.sensors + 1 :], strict=True):
        section()
        start = balance.way[0]
        f, n = _minus(carried[start], measured[start])
        for index in balance.way[1:]:
            body = tree.bodies[index]
            q = joints[body.joint][0] if body.joint else 0.0
            f, n = carried_outwards(body, f, n, q, sin_cos)
            # what the world does beyond a joint, the joint need not
            carried[index] = _minus(carried[index], (f, n))
        external.append(reading(cut, f, n))
    torques = [
        carried[index][0 if tree.bodies[index].kind == "prismatic" else 1][2]
        for index in stage.turning
    ]
    return external, torques


def _minus(one: tuple[Vector, Vector], other: tuple[Vector, Vector]) -> tuple[Vector, Vector]:
    f, n = ([a - b for a, b in zip(u, v, strict=True)] for u, v in zip(one, other, strict=True))
    return f, n


@lru_cache(maxsize=32)
def compiled(stage: Stage, gravity: tuple[float, ...] | None) -> WrenchKernel:
    """Return `balances` as machine code, kept; the torques follow in sixes."""
    if not jit.available():
        raise DataError("engine 'llvm' needs llvmlite; install it or use engine='numpy'")
    trace = Trace()
    inputs = 3 * len(stage.tree.joints) + (9 if gravity is None else 0) + 6 * stage.sensors
    numbers = [trace.input(k) for k in range(inputs)]
    external, torques = balances(stage, gravity, numbers, trace.sin_cos, trace.next_section)
    outputs: list[Number] = [number for wrench in external for number in wrench]
    outputs += torques
    outputs += [0.0] * (-len(outputs) % 6)
    program = Program(trace, outputs, jit.vector_width())
    module = jit.compile_ir(program.text())
    rows, sections = program.rows, len(program.sections)
    return WrenchKernel(len(outputs) // 6, rows, sections, program.width, module)


def _by_numpy(
    stage: Stage,
    gravity: tuple[float, ...] | None,
    columns: Sequence[Float[Array, "N"]],
    count: int,
) -> list[Float[Array, "N 6"]]:
    """Return what the compiled `balances` would, by NumPy."""
    sixes = -(-len(stage.turning) // 6)
    results = [np.zeros((count, 6)) for _ in range(len(stage.balances) + sixes)]
    for start in range(0, count, CHUNK):
        rows = slice(start, min(start + CHUNK, count))
        numbers = [np.ascontiguousarray(column[rows]) for column in columns]
        external, torques = balances(stage, gravity, numbers, lambda q: (np.sin(q), np.cos(q)))
        for k, value in enumerate([*(x for wrench in external for x in wrench), *torques]):
            results[k // 6][rows, k % 6] = value
    return results
