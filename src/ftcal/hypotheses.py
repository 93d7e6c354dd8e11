"""The ways in which a sensor is not what the description says, each with its cure in words.

A hypothesis is a 6x6 matrix: what was logged, times it, is what the description means. Signs,
swapped axes and another frame have no free number; a mounting turned by any angle and a wrench
reduced at another point have three each, and are judged on samples that did not choose them.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal.robot import Robot
from ftcal.sensor import AXES
from ftcal.spatial import inverse, pose, rotation_about, skew, wrench_transform

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

NEGLIGIBLE = 1e-6
"""Two frames closer than this [m, rad] are one."""

STEPS = 50
"""Most Gauss-Newton steps towards a rotation."""


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """One way to read the log of a sensor."""

    words: str
    """What was done to the readings, as a phrase that follows "the readings are"."""
    cure: str
    """What the user does about it, as an order; `{}` is the sensor."""
    map: Float[Array, "6 6"]
    """Logged wrench to the wrench that the description means."""
    rank: int
    """How far-fetched: of two that fit alike the lower one is believed."""


AS_DESCRIBED = Hypothesis("as described", "", np.eye(6), 0)


def signed_axes() -> dict[str, Float[Array, "3 3"]]:
    """Return the 48 ways to relabel and reverse three axes: 24 quarter turns, and their mirrors."""
    found = {}
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            found[_relabelled(order, signs)] = np.diag(signs) @ np.eye(3)[list(order)]
    return found


def _relabelled(order: tuple[int, ...], signs: tuple[float, ...]) -> str:
    moved = [k for k in range(3) if order[k] != k]
    words = []
    if len(moved) == 2:
        words.append(f"{'xyz'[moved[0]]} and {'xyz'[moved[1]]} swapped")
    elif moved:
        words.append(f"x, y, z logged as {', '.join('xyz'[order.index(k)] for k in range(3))}")
    reversed_ = ["xyz"[k] for k in range(3) if signs[k] < 0]
    if reversed_:
        words.append(f"{' and '.join(reversed_)} reversed")
    return ", ".join(words)


def fixed_hypotheses(robot: Robot, sensor: str) -> tuple[Hypothesis, ...]:
    """Return the hypotheses about one sensor that have no free number, least far-fetched first."""
    found = [
        AS_DESCRIBED,
        Hypothesis(
            "of the opposite sign",
            "reverse the sign of {} (or the measure_direction of its description)",
            -np.eye(6),
            1,
        ),
    ]
    for words, turn in signed_axes().items():
        for first in (False, True):
            both = np.kron(np.eye(2)[::-1] if first else np.eye(2), turn)
            if not first and abs(np.trace(both)) == 6.0:
                continue  # the first two
            said = ", ".join(w for w in ("torque first" if first else "", words) if w)
            rank = 2 if first and not words else 4 + first + (np.linalg.det(turn) < 0)
            order = [("-" if s < 0 else "") + AXES[k] for k, s in _sources(both)]
            cure = f"read the columns of {{}} as {', '.join(order)}"
            found.append(Hypothesis(said, cure, both, rank))
    ft = robot.sensor(sensor)
    S_H_child = inverse(ft.child_H_sensor)
    S_H_parent = S_H_child @ inverse(robot.joints[ft.joint].parent_H_child)
    frames = {"parent": S_H_parent, "child": S_H_child}
    for side, S_H_L in frames.items():
        if not np.allclose(S_H_L, np.eye(4), rtol=0.0, atol=NEGLIGIBLE):
            words = f"in the frame of the {side} link"
            cure = f"describe {{}} with <frame>{side}</frame>"
            found.append(Hypothesis(words, cure, wrench_transform(S_H_L), 3))
    return tuple(sorted(found, key=lambda hypothesis: hypothesis.rank))


def _sources(both: Float[Array, "6 6"]) -> list[tuple[int, float]]:
    """Return which logged channel holds each axis, and its sign."""
    columns = np.abs(both).argmax(axis=1)
    return [(int(k), float(both[axis, k])) for axis, k in enumerate(columns)]


def nearest_turn(
    A: Float[Array, "36 36"], b: Float[Array, "36"], start: Float[Array, "3 3"]
) -> Float[Array, "3 3"]:
    """Return the Q that minimises `t'At + 2 b't`, `t` the entries of `diag(Q, Q)` row by row.

    Q is orthogonal and of the handedness of `start`: Gauss-Newton on the rotation vector, halving
    steps that do not descend.
    """
    rows = np.arange(36).reshape(6, 6)
    pick = np.zeros((36, 9))
    for half in (0, 3):
        pick[rows[half : half + 3, half : half + 3].ravel(), np.arange(9)] = 1.0
    A, b = pick.T @ A @ pick, pick.T @ b

    def value(Q: Float[Array, "3 3"]) -> float:
        q = Q.ravel()
        return float(q @ A @ q + 2.0 * b @ q)

    Q, step = start, 1.0
    for _ in range(STEPS):
        tangent = np.stack([(Q @ skew(e)).ravel() for e in np.eye(3)], axis=1)
        slope = tangent.T @ (A @ Q.ravel() + b)
        turn = -np.linalg.lstsq(tangent.T @ A @ tangent, slope, rcond=1e-12)[0]
        angle = float(np.linalg.norm(turn))
        if angle * step < NEGLIGIBLE:
            break
        moved = Q @ rotation_about(turn / angle, np.asarray(step * angle))
        descends = value(moved) < value(Q)
        Q, step = (moved, 1.0) if descends else (Q, step / 2)
    return Q


def turned(Q: Float[Array, "3 3"]) -> Hypothesis:
    """Return the hypothesis that a sensor's frame is turned by Q, or reversed and turned."""
    proper = np.linalg.det(Q) > 0
    angle, axis = angle_and_axis(Q if proper else -Q)
    about = ", ".join(f"{x:+.2f}" for x in axis)
    words = f"turned by {np.degrees(angle):.0f} deg about ({about})"
    cure = f"turn the frame of {{}} by {np.degrees(angle):.0f} deg about ({about}) in the URDF"
    if not proper:
        words, cure = f"of the opposite sign and {words}", f"reverse the sign of {{}}, and {cure}"
    return Hypothesis(words, cure, np.kron(np.eye(2), Q), 7 if proper else 8)


def angle_and_axis(R: Float[Array, "3 3"]) -> tuple[float, Float[Array, "3"]]:
    """Return angle [rad] and unit axis of a rotation."""
    angle = float(np.arccos(np.clip((np.trace(R) - 1.0) / 2.0, -1.0, 1.0)))
    # the eigenvector of 1 is well conditioned up to a half turn; the skew part has its sign
    values, vectors = np.linalg.eigh((R + R.T) / 2.0)
    axis = vectors[:, values.argmax()]
    around = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return angle, axis if axis @ around >= 0 else -axis


def reduced_elsewhere(offset: Float[Array, "3"]) -> Hypothesis:
    """Return the hypothesis that a wrench is reduced at the point `offset` [m] in the frame."""
    at = ", ".join(f"{x:+.3f}" for x in offset)
    return Hypothesis(
        f"reduced at ({at}) m in its frame",
        f"move the origin of {{}} by ({at}) m in the URDF",
        wrench_transform(pose(np.eye(3), offset)),
        6,
    )


def nearest_point(A: Float[Array, "36 36"], b: Float[Array, "36"]) -> Float[Array, "3"]:
    """Return the point of reduction [m] that minimises `t'At + 2 b't`, `t` the entries of its map.

    `t` is that of the identity and, linearly, of the lever.
    """
    levers = np.stack(
        [wrench_transform(pose(np.eye(3), e)).ravel() - np.eye(6).ravel() for e in np.eye(3)],
        axis=1,
    )
    slope = levers.T @ (A @ np.eye(6).ravel() + b)
    return np.asarray(-np.linalg.lstsq(levers.T @ A @ levers, slope, rcond=1e-12)[0])
