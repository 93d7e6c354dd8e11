"""What each F/T sensor should have measured, from the robot's motion and its one contact.

`ftcal.tree` roots the robot at the contact, `ftcal.newton_euler` is the balance of momentum; here
it runs on NumPy arrays, or as the machine code that `ftcal.kernel` makes of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Literal

import numpy as np

from ftcal import jit
from ftcal.errors import DataError, raise_all
from ftcal.kernel import WrenchKernel, compile_wrenches
from ftcal.motion import Contact, FixedContact, Motion
from ftcal.newton_euler import arguments, wrenches
from ftcal.robot import Robot
from ftcal.tree import Tree, grow

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

CHUNK = 2048
"""Samples NumPy handles at once: what stays in the cache."""


def expected_wrenches(
    robot: Robot,
    motion: Motion,
    contact: Contact,
    sensors: Sequence[str],
    *,
    engine: Literal["auto", "llvm", "numpy"] = "auto",
) -> dict[str, Float[Array, "N 6"]]:
    """Return what ideal `sensors` would read: force [N] then torque [Nm] at their frames.

    Only the joints on the way from the contact to the sensors and behind them need be in `motion`.
    `auto` runs compiled code where llvmlite is installed, NumPy elsewhere; both agree to rounding.
    The GIL is released while compiled code runs. `DataError`: joints missing in `motion`, a moving
    contact of another length. `RobotError`: unknown names, a half without mass.
    """
    names = tuple(dict.fromkeys(sensors))
    fixed = isinstance(contact, FixedContact)
    gravity = tuple(float(g) for g in contact.gravity) if fixed else None
    tree = rooted(robot, contact.link, names)
    columns = motion_columns(tree, motion, contact)
    if engine == "numpy" or (engine == "auto" and not jit.available()):
        results = _by_numpy(tree, gravity, columns, len(motion))
    else:
        if not jit.available():
            raise DataError("engine 'llvm' needs llvmlite; install it or use engine='numpy'")
        results = compiled(robot, contact.link, gravity, names)(columns, len(motion))
    return dict(zip(names, results, strict=True))


@lru_cache(maxsize=64)
def rooted(robot: Robot, contact: str, sensors: tuple[str, ...]) -> Tree:
    """Return `grow(robot, contact, sensors)`, kept."""
    return grow(robot, contact, sensors)


@lru_cache(maxsize=64)
def compiled(
    robot: Robot,
    contact: str,
    gravity: tuple[float, ...] | None,
    sensors: tuple[str, ...],
) -> WrenchKernel:
    """Return the machine code for these sensors, kept; `gravity` None where the contact moves."""
    return compile_wrenches(rooted(robot, contact, sensors), gravity)


def motion_columns(tree: Tree, motion: Motion, contact: Contact) -> list[Float[Array, "N"]]:
    """Return position, velocity, acceleration of each joint, then w, dw, a of a moving contact."""
    where = motion.columns(tree.joints)
    signals = (motion.position, motion.velocity, motion.acceleration)
    columns = [signal[:, column] for column in where for signal in signals]
    if not isinstance(contact, FixedContact):
        proper = contact.proper_acceleration()
        base = {
            "angular_velocity": contact.angular_velocity,
            "angular_acceleration": contact.angular_acceleration,
            "linear_acceleration - gravity": proper,
        }
        raise_all(
            DataError,
            f"moving contact {contact.link!r}",
            (
                f"{name} has shape {np.shape(value)}, not ({len(motion)}, 3)"
                for name, value in base.items()
                if np.shape(value) != (len(motion), 3)
            ),
        )
        columns += [value[:, axis] for value in base.values() for axis in range(3)]
    return [np.asarray(column, dtype=np.float64) for column in columns]


def _by_numpy(
    tree: Tree,
    gravity: tuple[float, ...] | None,
    columns: Sequence[Float[Array, "N"]],
    count: int,
) -> list[Float[Array, "N 6"]]:
    """Run the balance on NumPy arrays."""
    results = [np.empty((count, 6)) for _ in tree.cuts]
    for start in range(0, count, CHUNK):
        rows = slice(start, min(start + CHUNK, count))
        numbers = [np.ascontiguousarray(column[rows]) for column in columns]
        base, joints = arguments(tree, gravity, numbers)
        readings = wrenches(tree, base, joints, lambda q: (np.sin(q), np.cos(q)))
        for result, reading in zip(results, readings, strict=True):
            for axis, value in enumerate(reading):
                result[rows, axis] = value
    return results
