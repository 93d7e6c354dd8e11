"""How a table of poses may be meant: attitude transposed, torque first, frames turned.

Weight alone decides it. A force that is mass x gravity, and a torque that is a lever x the same
gravity, leave little over under the right reading and nearly everything under a wrong one. Every
reading is fitted from the moments of (gravity, wrench): no second pass over the rows. A reversed
sign cannot be told from gravity pointing up; both are a negative mass, which the estimate tells.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal.gravity_fit import TINY, GravityFit
from ftcal.hypotheses import angle_and_axis, signed_axes
from ftcal.moments import Moments
from ftcal.poses import Alternative, Poses

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

AS_TOLD = "as told"

ALIKE = 2.0
"""Readings whose misfits differ by less than this factor are not told apart: the least far-fetched
is believed. A turn by any angle has three free numbers: with few poses it fits some noise."""

FREE = 3
"""From this rank on a reading has free numbers, or is two mistakes at once."""

SWAP = np.eye(9)[[0, 1, 2, 6, 7, 8, 3, 4, 5]]
"""(gravity, wrench) with force and torque exchanged."""

FLOOR = 1e-14
"""Rounding of a scatter: residuals below this share of it are zero."""


@dataclass(frozen=True, slots=True)
class Reading:
    """One way to read the table, and what its fit leaves over."""

    words: str
    """What the columns are taken for, a phrase that follows "read as"."""
    cure: str
    """What the user does about it, as an order; empty for the reading that was told."""
    rank: int
    """How far-fetched: of two that fit alike the lower one is believed."""
    force: float
    """RMS of what is left over per component of the force [N]."""
    torque: float
    """The same of the torque [Nm]."""

    @property
    def misfit(self) -> float:
        """Geometric mean of both: the likelihood where neither noise is known."""
        return float(np.sqrt(self.force * self.torque))


@dataclass(frozen=True, slots=True)
class _Change:
    """One thing that is otherwise than told."""

    words: str
    cure: str
    rank: int


def readings(poses: Poses) -> tuple[Reading, ...]:
    """Return every reading of the table, that as told first, the others by misfit and rank.

    Conventions of the attitude x force and torque swapped x the 24 quarter turns between the frame
    of the attitude and that of the wrench, and the turn by any angle that suits the force best.
    """
    ways: list[tuple[tuple[_Change, ...], Alternative]] = [
        ((), Alternative(AS_TOLD, "", poses.gravity, poses.wrench)),
        *(((_Change(way.words, way.cure, 1),), way) for way in poses.alternatives),
    ]
    found = []
    for way, columns in ways:
        as_logged = Moments.of(np.column_stack([columns.gravity, columns.wrench]))
        swap = _Change("torque first", "name the torque's columns last", 1)
        for order, moments in (((), as_logged), ((swap,), as_logged.map(SWAP))):
            for turn, Q in [((), np.eye(3)), *_turns(moments)]:
                found.append(_reading((*way, *order, *turn), moments, Q))
    first, *others = found
    return (first, *sorted(others, key=lambda reading: (reading.misfit, reading.rank)))


def _reading(changes: tuple[_Change, ...], moments: Moments, Q: Float[Array, "3 3"]) -> Reading:
    return Reading(
        ", ".join(change.words for change in changes) or AS_TOLD,
        "; ".join(change.cure for change in changes),
        sum(change.rank for change in changes),
        *_left(moments, Q),
    )


def _turns(moments: Moments) -> list[tuple[tuple[_Change, ...], Float[Array, "3 3"]]]:
    """Return the turns between both frames that are tried."""
    quarters = [Q for Q in signed_axes().values() if np.linalg.det(Q) > 0 and np.trace(Q) < 3]
    cure = "give both in one frame"
    return [
        *(((_Change(_relabelled(Q), cure, 2),), Q) for Q in quarters),
        *(((_Change(_turned(Q), cure, FREE),), Q) for Q in _best_turns(moments)),
    ]


def believed(found: tuple[Reading, ...]) -> Reading:
    """Return the reading that fits best; the least far-fetched of those that fit alike."""
    best = min(reading.misfit for reading in found)
    alike = [reading for reading in found if reading.misfit <= ALIKE * best]
    return min(alike, key=lambda reading: (reading.rank, reading.misfit))


def alike(found: tuple[Reading, ...]) -> tuple[Reading, ...]:
    """Return the other conventions that these poses cannot tell from the one told."""
    told, *others = found
    return tuple(r for r in others if r.rank < FREE and r.misfit <= ALIKE * told.misfit)


def _relabelled(Q: Float[Array, "3 3"]) -> str:
    axes = ", ".join(("-" if row.sum() < 0 else "") + "xyz"[np.abs(row).argmax()] for row in Q)
    return f"the wrench's x, y, z being the attitude's {axes}"


def _turned(Q: Float[Array, "3 3"]) -> str:
    angle, axis = angle_and_axis(Q)
    about = ", ".join(f"{x:+.2f}" for x in axis)
    return f"frame of the attitude turned by {np.degrees(angle):.1f} deg about ({about})"


def _best_turns(moments: Moments) -> list[Float[Array, "3 3"]]:
    """Return the rotations Q that bring `Q gravity` nearest to the force, and to its reverse.

    W. Kabsch, "A solution for the best rotation to relate two sets of vectors", 1976.
    """
    U, _, Vt = np.linalg.svd(moments.scatter[3:6, :3])
    side = np.linalg.det(U) * np.linalg.det(Vt)
    return [U @ np.diag([sign, sign, side]) @ Vt for sign in (1.0, -1.0)]


def _left(moments: Moments, Q: Float[Array, "3 3"]) -> tuple[float, float]:
    """Return the RMS of what mass and lever leave over of force and torque, gravity turned by Q."""
    both = np.eye(9)
    both[:3, :3] = Q
    turned = moments.map(both)
    left = GravityFit.of(turned, np.ones(6)).left(turned).reshape(2, 3).sum(axis=1)
    moved = np.diag(turned.scatter)[3:].reshape(2, 3).sum(axis=1)
    left = np.maximum(left, np.maximum(FLOOR * moved, TINY))
    force, torque = np.sqrt(left / (3 * moments.count))
    return float(force), float(torque)
