"""A tool on a wrist sensor in many attitudes: the wrench read, and where gravity pointed.

Attitude is logged as a rotation (sensor to base, z of the base up), as gravity in the sensor's
frame, or as what an accelerometer in that frame reads, which at rest is the reaction to gravity.
Numbers are left as logged: scaled to its norm, gravity from a biased accelerometer would be bent;
unscaled, the bias goes into the offset alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal

import numpy as np

from ftcal.errors import DataError

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray as Array

Attitude = Literal["gravity", "rotation", "acceleration"]
Unit = Literal["m/s^2", "g"]

STANDARD_GRAVITY = 9.80665
"""What is said to act along -z of the base where only a rotation is logged [m/s^2]."""

SCALES: Mapping[Unit, float] = MappingProxyType({"m/s^2": 1.0, "g": STANDARD_GRAVITY})
"""Unit of gravity or acceleration -> m/s^2; unit vectors are in g."""

NEAR_GRAVITY = 0.15
"""A median norm may miss standard gravity by this share: cheap accelerometers do, units do not."""

STEADY_NORM = 0.01
"""A norm that leaves its median by more than this share is told: bias, or motion."""

ODD_NORM = 4.0
"""A vector this many times longer or shorter than the median does not say where gravity points."""

ROTATION_ERROR = 0.02
"""Largest entry of R'R - 1 of a rotation: rounding and interpolation stay below."""

ONE_POSE = np.radians(1.0)
"""Neighbouring rows whose gravity stays within this angle of the first are one pose."""


@dataclass(frozen=True, slots=True, eq=False)
class Alternative:
    """Another way in which the same columns may be meant."""

    words: str
    """What it takes the columns for, after "read as"."""
    cure: str
    """What the user does about it, as an order."""
    gravity: Float[Array, "N 3"]
    """Gravity in the sensor's frame then [m/s^2]."""
    wrench: Float[Array, "N 6"]
    """Wrench in the sensor's frame then [N, Nm]."""


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """Wrenches and gravity, paired."""

    source: str
    """The tables as the user named them."""
    attitude: Attitude
    """What the attitude was logged as."""
    read_as: str
    """Columns and unit that were used, in words."""
    rows: Int[Array, "N"]
    """Row of each sample in the table of the wrench, as a person counts them."""
    wrench: Float[Array, "N 6"]
    """As logged [N, Nm]."""
    gravity: Float[Array, "N 3"]
    """In the sensor's frame [m/s^2]; it points down."""
    alternatives: tuple[Alternative, ...] = ()
    """Conventions of the attitude that were not told."""
    notes: tuple[str, ...] = ()
    """What was left out or looks odd, a line each."""
    moving: str = ""
    """Why the tool's weight is not all that acts; empty where it rests or nothing is known."""

    @property
    def number(self) -> Int[Array, "N"]:
        """The pose of each row, from 0: rows in sequence whose gravity is the same to a degree."""
        unit = self.gravity / np.linalg.norm(self.gravity, axis=1, keepdims=True)
        numbers = np.zeros(len(unit), dtype=np.int64)
        least, begin, pose = float(np.cos(ONE_POSE)), 0, 0
        while begin < len(unit):
            span = 64  # doubled until the pose ends: one pass, whatever the lengths
            while True:
                left = unit[begin : begin + span] @ unit[begin] < least
                if left.any() or begin + span >= len(unit):
                    break
                span *= 2
            end = begin + int(left.argmax()) if left.any() else len(unit)
            numbers[begin:end] = pose
            begin, pose = end, pose + 1
        return numbers


def gravity_in_sensor(attitude: Attitude, logged: Float[Array, "N K"]) -> Float[Array, "N 3"]:
    """Return gravity in the sensor's frame, of vectors [m/s^2] or of rotations row by row."""
    if attitude == "rotation":
        return np.asarray(-STANDARD_GRAVITY * logged[:, 6:9])  # the base's z axis in the sensor
    return -logged if attitude == "acceleration" else logged


def other_conventions(
    rotation: Float[Array, "N 9"], wrench: Float[Array, "N 6"]
) -> tuple[Alternative, ...]:
    """Return what a table with rotations may mean if not sensor to base with z up."""
    W_R_S = rotation.reshape(-1, 3, 3)
    ways = {False: W_R_S, True: np.swapaxes(W_R_S, 1, 2)}
    transposed = "name the columns of --rotation transposed: r11 r21 r31 r12 …"
    found = []
    for turned, R in ways.items():
        words, cures = (["rotation transposed"], [transposed]) if turned else ([], [])
        for axis, up in enumerate("xyz"):
            more = [f"base {up} vertical"] if up != "z" else []
            cure = [f"turn the base so that z is up, which is {up} here"] if up != "z" else []
            if turned or more:
                g = -STANDARD_GRAVITY * R[:, axis, :]
                said = ", ".join([*words, *more]), "; ".join([*cures, *cure])
                found.append(Alternative(*said, g, wrench))
        more, cure = ["wrench in the base frame"], ["turn each wrench into the sensor's frame"]
        turned_back = (wrench.reshape(-1, 2, 3) @ R).reshape(-1, 6)
        said = ", ".join([*words, *more]), "; ".join([*cures, *cure])
        found.append(Alternative(*said, -STANDARD_GRAVITY * R[:, 2, :], turned_back))
    return tuple(found)


def require_rotations(logged: Float[Array, "N 9"], where: str, *, first_row: int) -> None:
    """Raise `DataError` naming the worst row that is no rotation."""
    R = logged.reshape(-1, 3, 3)
    error = np.abs(np.swapaxes(R, 1, 2) @ R - np.eye(3)).max(axis=(1, 2))
    error = np.where(np.linalg.det(R) > 0, error, np.maximum(error, 2.0))
    bad = int((error > ROTATION_ERROR).sum())
    if bad:
        worst = int(error.argmax())
        raise DataError(
            f"{where}, row {worst + first_row}: no rotation, R'R misses 1 by {error[worst]:.2g} or"
            f" R mirrors ({bad} such rows); name its nine columns row by row"
        )


def unit_of(norms: Float[Array, "N"], declared: Unit | None, where: str, *, first_row: int) -> Unit:
    """Return the unit in which vectors of these norms are gravity.

    Raises `DataError` where there is none, where it is not the one declared, or where a vector is
    far too short or too long.
    """
    median = float(np.median(norms))
    fitting: list[Unit] = [
        unit
        for unit, scale in SCALES.items()
        if abs(median * scale / STANDARD_GRAVITY - 1.0) < NEAR_GRAVITY
    ]
    if not fitting:
        raise DataError(
            f"{where}: the median norm {median:.4g} is neither 1 g nor 9.81 m/s^2; name the columns"
            " of gravity (a gyroscope's are often called gx gy gz as well)"
        )
    if declared not in {None, *fitting}:
        raise DataError(
            f"{where}: the median norm {median:.4g} is not gravity in {declared} but in"
            f" {fitting[0]}; say --unit {fitting[0]}"
        )
    odd = np.abs(np.log(np.maximum(norms, np.finfo(np.float64).tiny) / median))
    if odd.max() > np.log(ODD_NORM):
        row = int(odd.argmax())
        raise DataError(
            f"{where}, row {row + first_row}: norm {norms[row]:.3g}, the median is {median:.4g};"
            " that is not gravity; cut the row"
        )
    return fitting[0]


def unsteady_norm(norms: Float[Array, "N"], attitude: Attitude, unit: Unit) -> tuple[str, ...]:
    """Return a note where vectors that should be as long as gravity are not equally long."""
    median = float(np.median(norms))
    if float(np.abs(norms - median).max()) <= STEADY_NORM * median:
        return ()
    return (
        f"the norm of the {attitude} runs from {norms.min():.4g} to {norms.max():.4g} {unit}:"
        " biased (then the offset takes up mass x bias), or the arm was moving",
    )
