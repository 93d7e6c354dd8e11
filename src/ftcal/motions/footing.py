"""The ground under a motion: which postures and which moves a robot on one foot can make."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal.posture import Demand, Poser, Sole, over

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

SAFE = 2e-3
"""Distance [m] that the centre of mass keeps from the edges of a sole during every move."""

GRAZE = 5e-4
"""Depth [m] to which a free sole may dip below the floor: numbers, not contact."""

LOOK = 0.05
"""Longest stretch of a move [rad or m] between two looks at its balance."""


@dataclass(frozen=True, slots=True, eq=False)
class Footing:
    """A robot that stands on one sole: how it balances a posture, whether it can make a move."""

    sole: Sole
    """The sole that carries all."""
    poser: Poser
    """What takes balanced postures; its skeleton stands on the frame of `sole`."""
    free: tuple[Sole, ...] = ()
    """Soles in the air, which stay above the floor."""
    demands: tuple[Demand, ...] = ()
    """What is asked of a posture besides balance, such as a level trunk."""

    def balanced(self, posture: Float[Array, "J"]) -> Float[Array, "J"]:
        """Return `posture` with the centre of mass over the middle of the sole.

        Raises `DataError` where the support cannot bring it there.
        """
        return self.poser.reach(posture, self._asked(), aim=f"weight over sole {self.sole.frame!r}")

    def middle(
        self, drawn: Float[Array, "J"], before: Float[Array, "J"], home: Float[Array, "J"]
    ) -> Float[Array, "J"] | None:
        """Return the drawn posture balanced over the middle of the sole; None if out of reach."""
        found = self.poser.approach(drawn, self._asked())
        return self._checked(found.posture, before, home) if found.reached else None

    def swaying(
        self, drawn: Float[Array, "J"], before: Float[Array, "J"], home: Float[Array, "J"]
    ) -> Float[Array, "J"] | None:
        """Return the drawn posture balanced, its support then swaying as drawn about home."""
        still = drawn.copy()
        support = self.poser.columns
        still[support] = home[support]
        found = self.poser.approach(still, self._asked())
        swayed = found.posture.copy()
        swayed[support] += drawn[support] - home[support]
        swayed = np.clip(swayed, self.poser.low, self.poser.high)
        return self._checked(swayed, before, home) if found.reached else None

    def safe(self, nodes: Sequence[Float[Array, "J"]]) -> bool:
        """Return whether the robot keeps its balance, and free soles the air, from node to node."""
        postures = np.concatenate([between(a, b) for a, b in itertools.pairwise(nodes)])
        figure = self.poser.bones.figure(postures)
        if self.sole.inside(figure.com[:, :2]).min() < SAFE:
            return False
        heights = [
            (figure.pose(sole.frame)[:, None] @ _points(sole))[..., 2, 0] for sole in self.free
        ]
        return all(height.min() > -GRAZE for height in heights)

    def _asked(self) -> tuple[Demand, ...]:
        return (over(self.sole.middle), *self.demands)

    def _checked(
        self, node: Float[Array, "J"], before: Float[Array, "J"], home: Float[Array, "J"]
    ) -> Float[Array, "J"] | None:
        return node if self.safe([before, node, home]) else None


def between(start: Float[Array, "J"], stop: Float[Array, "J"]) -> Float[Array, "N J"]:
    """Return postures along a move, its ends included; all joints move in proportion."""
    count = int(np.ceil(np.abs(stop - start).max() / LOOK)) + 2
    return np.asarray(start + np.linspace(0.0, 1.0, count)[:, None] * (stop - start))


def _points(sole: Sole) -> Float[Array, "4 4 1"]:
    """Return the corners of a sole as columns (x, y, z, 1)."""
    return np.concatenate([sole.corners, np.ones((4, 1))], axis=1)[..., None]
