"""What the data say of a few numbers, all other unknowns fitted to suit: the Schur complement.

The numbers are those of the robot's model: the inertia of the sub-models and the errors suspected.
Each has a prior of standard deviation one. With the others eliminated once, every choice of which
numbers are free and which are zero is small algebra: their estimates, how far the matrices follow,
and the evidence (D. MacKay, "Bayesian interpolation", Neural Computation 4, 1992), which for a
linear model and given noise is exact.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal.unknowns import Group, GroupNoise, Normal, Unknowns

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

INERTIA = ("mass", "com x", "com y", "com z")
"""Unknowns of a sub-model."""


def inertia_names(sub_model: str) -> tuple[str, ...]:
    """Return the names of mass and centre of mass of a sub-model."""
    return tuple(f"inertia of {sub_model}, {name}" for name in INERTIA)


def model_places(unknowns: Unknowns) -> dict[str, int]:
    """Return where the numbers of the robot's model stand, by name."""
    places: dict[str, int] = {}
    for sub_model in unknowns.models:
        first = unknowns.model(sub_model).start
        places |= {name: first + k for k, name in enumerate(inertia_names(sub_model))}
    return places | {name: unknowns.model_error(name) for name in unknowns.model_errors}


@dataclass(frozen=True, slots=True, eq=False)
class Eliminated:
    """The numbers of the model alone, in standard deviations of their priors."""

    unknowns: Unknowns
    order: dict[str, int]
    """Place of each number in what follows."""
    information: Float[Array, "H H"]
    """Prior included."""
    pull: Float[Array, "H"]
    rest: Float[Array, "U"]
    """All unknowns where every number of the model is zero."""
    response: Float[Array, "U H"]
    """How much the unknowns move with each; the numbers themselves by one."""

    @staticmethod
    def of(
        normal: Normal,
        noise: Mapping[Group, GroupNoise],
        kappa: float,
    ) -> Eliminated:
        """Return what some sums say of the numbers, what their balances take on included."""
        places = model_places(normal.unknowns)
        at = np.array(list(places.values()), dtype=int)
        others = np.setdiff1d(np.arange(normal.unknowns.count), at)
        A = normal.information(noise) + normal.unknowns.precision(kappa)
        taken = np.array([normal.unknowns.model_errors.get(name, 0.0) for name in places])
        b = normal.pull(noise) + A[:, at] @ taken
        # the unknowns differ by orders of magnitude in how well they are known
        scale = 1.0 / np.sqrt(np.diag(A)[others])
        inner = scale[:, None] * A[np.ix_(others, others)] * scale
        cross = A[np.ix_(others, at)]
        sides = scale[:, None] * np.column_stack([cross, b[others]])
        solved = scale[:, None] * np.linalg.solve(inner, sides)
        rest, response = np.zeros(len(A)), np.zeros((len(A), len(at)))
        rest[others], response[others] = solved[:, -1], -solved[:, :-1]
        response[at] = np.eye(len(at))
        information = A[np.ix_(at, at)] - cross.T @ solved[:, :-1]
        return Eliminated(
            normal.unknowns,
            {name: k for k, name in enumerate(places)},
            0.5 * (information + information.T),
            b[at] - cross.T @ solved[:, -1],
            rest,
            response,
        )

    def among(self, names: Iterable[str]) -> list[int]:
        """Return the places of some numbers, once each, those that the sums know."""
        return [self.order[name] for name in dict.fromkeys(names) if name in self.order]

    def estimate(self, free: Iterable[str]) -> tuple[Float[Array, "F"], Float[Array, "F F"]]:
        """Return the numbers that are `free`, and their covariance; all others are zero."""
        at = self.among(free)
        covariance = np.linalg.inv(self.information[np.ix_(at, at)])
        return covariance @ self.pull[at], covariance

    def gain(self, free: Iterable[str]) -> float:
        """Return how much more probable the data are than with none of them free, log [nats]."""
        at = self.among(free)
        _, size = np.linalg.slogdet(self.information[np.ix_(at, at)])
        found, _ = self.estimate(free)
        return 0.5 * float(self.pull[at] @ found) - 0.5 * float(size)

    def fitted(self, free: Iterable[str]) -> Float[Array, "U"]:
        """Return all unknowns with some numbers `free`."""
        return np.asarray(self.rest + self.response[:, self.among(free)] @ self.estimate(free)[0])

    def follows(self, name: str, free: Iterable[str]) -> Float[Array, "U"]:
        """Return how much all unknowns move per standard deviation of one number.

        Others that are `free` are fitted to suit as well.
        """
        at = [k for k in self.among(free) if k != self.order[name]]
        own = self.order[name]
        _, covariance = self.estimate([n for n, k in self.order.items() if k in at])
        along = covariance @ self.information[np.ix_(sorted(at), [own])][:, 0]
        return np.asarray(self.response[:, own] - self.response[:, sorted(at)] @ along)
