"""The unknowns of all sensors together, their normal equations and what solves them.

Entries of E of every sensor with a prior, mass and centre of mass of every sub-model held near the
robot description, an offset a segment; sums of products by group of equations (method 5), so that
noise and prior may change without a second pass over the data.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ftcal.sensor import AXES
from ftcal.terms import MODEL, Frame, Segment, Terms

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray as Array

SCALE_SD = 0.03
"""Standard deviation of the common scale of the three forces, and of the three torques, of a sensor
along their unit vector, whatever kappa is: balances that nothing anchors shrink all matrices to
zero, and no cross-validation sees it."""

Group = tuple[str, str]
"""Sub-model, and `force` or `torque`: equations that share one noise."""


@dataclass(frozen=True)
class Unknowns:
    """Where every unknown stands in the vector of all: the E of every sensor, then the offsets."""

    frames: Mapping[str, Frame]
    """Coordinates by sensor."""
    models: tuple[str, ...]
    """Sub-models, whose mass and centre of mass are unknown too."""
    offsets: tuple[tuple[str, Segment], ...]
    """Sensor and segment of every offset."""
    model_errors: Mapping[str, float] = field(default_factory=dict)
    """Suspected errors of the model and how much of each the balances take on already, in standard
    deviations of their prior; the unknown is what they do not."""

    @staticmethod
    def of(terms: Sequence[Terms], frames: Mapping[str, Frame]) -> Unknowns:
        """Return the unknowns of some terms; sensors that are in none of them are left out."""
        offsets = {key for one in terms for key in zip(one.sensors, one.segments, strict=True)}
        seen = {name for name, _ in offsets}
        models = tuple(dict.fromkeys(one.sub_model for one in terms))
        known = {name: frame for name, frame in frames.items() if name in seen}
        suspected = {name: taken for one in terms for name, taken in one.model_errors.items()}
        return Unknowns(known, models, tuple(sorted(offsets)), suspected)

    @cached_property
    def entries(self) -> dict[str, slice]:
        """Where the E of each sensor stands, row by row."""
        places, start = {}, 0
        for name, frame in self.frames.items():
            places[name] = slice(start, start + frame.unknowns)
            start += frame.unknowns
        return places

    @cached_property
    def prior(self) -> int:
        """Unknowns that have a prior: all entries of E."""
        return sum(frame.unknowns for frame in self.frames.values())

    @cached_property
    def places(self) -> dict[tuple[str, Segment], slice]:
        """Where each offset stands."""
        first = self.described
        return {key: slice(first + 6 * k, first + 6 * k + 6) for k, key in enumerate(self.offsets)}

    @property
    def described(self) -> int:
        """Unknowns before the offsets: those of the matrices and of the robot description."""
        return self.prior + MODEL * len(self.models) + len(self.model_errors)

    @property
    def count(self) -> int:
        """All unknowns."""
        return self.described + 6 * len(self.offsets)

    def model(self, sub_model: str) -> slice:
        """Return where mass and centre of mass of a sub-model stand."""
        first = self.prior + MODEL * self.models.index(sub_model)
        return slice(first, first + MODEL)

    def model_error(self, name: str) -> int:
        """Return where a suspected error of the model stands."""
        return self.prior + MODEL * len(self.models) + list(self.model_errors).index(name)

    def precision(self, kappa: float) -> Float[Array, "U U"]:
        """Return the precision of the unknowns before any data.

        An offset is believed to be within full scale: one that nothing determines (two on one
        static balance) stays near its reference.
        """
        before = np.ones(self.count)
        before[: self.prior] = 1.0 / kappa**2
        precision = np.diag(before)
        for _, along in self.scales():
            precision += np.outer(along, along) / SCALE_SD**2
        return precision

    def scales(self) -> list[tuple[str, Float[Array, "U"]]]:
        """Return the unit vectors along which the forces, or torques, of a sensor scale."""
        found = []
        for name, place in self.entries.items():
            width = len(self.frames[name].basis)
            if self.frames[name].workbench.gain.shape[1] != len(AXES):
                continue  # without a secondary matrix there is no one scale of an axis
            for axes, kind in ((range(3), "forces"), (range(3, 6), "torques")):
                along = np.zeros(self.count)
                along[[place.start + axis * width + axis for axis in axes]] = 3.0**-0.5
                found.append((f"{kind} of {name}", along))
        return found

    def columns(self, terms: Terms) -> Int[Array, "D-1"]:
        """Return where the features of some terms stand."""
        parts = []
        for name, segment in zip(terms.sensors, terms.segments, strict=True):
            for place in (self.entries[name], self.places[name, segment]):
                parts.append(np.arange(place.start, place.stop))
        place = self.model(terms.sub_model)
        suspected = np.array([self.model_error(name) for name in terms.model_errors], dtype=int)
        return np.concatenate([*parts, np.arange(place.start, place.stop), suspected])

    def knows(self, terms: Terms) -> bool:
        """Return whether every offset that some terms need is among the unknowns."""
        needed = zip(terms.sensors, terms.segments, strict=True)
        return all(key in self.places for key in needed)


@dataclass(frozen=True, slots=True)
class GroupNoise:
    """What is left over in one group of equations."""

    sd: float
    """N or Nm."""
    inefficiency: float
    """Samples that count as one."""

    @property
    def weight(self) -> float:
        """What a squared residual of one sample counts."""
        return 1.0 / (self.sd**2 * self.inefficiency)


@dataclass(frozen=True, slots=True, eq=False)
class Normal:
    """Normal equations of some terms, group by group: noise may change without a second pass."""

    unknowns: Unknowns
    products: dict[Group, Float[Array, "U U"]]
    targets: dict[Group, Float[Array, "U"]]
    squares: dict[Group, float]
    """Sum of squared targets."""
    counts: dict[Group, float]
    """Samples times equations."""

    @staticmethod
    def of(terms: Iterable[Terms], unknowns: Unknowns) -> Normal:
        """Return the sums over some terms."""
        size = unknowns.count
        made = Normal(unknowns, {}, {}, {}, {})
        for one in terms:
            columns = unknowns.columns(one)
            for group, equations in groups(one):
                G = one.products[equations].sum(axis=0)
                A = made.products.setdefault(group, np.zeros((size, size)))
                A[np.ix_(columns, columns)] += G[:-1, :-1]
                made.targets.setdefault(group, np.zeros(size))[columns] += G[:-1, -1]
                made.squares[group] = made.squares.get(group, 0.0) + float(G[-1, -1])
                counted = one.count * (equations.stop - equations.start)
                made.counts[group] = made.counts.get(group, 0) + counted
        return made

    def information(self, noise: Mapping[Group, GroupNoise]) -> Float[Array, "U U"]:
        """Return the information that the data give of the unknowns."""
        size = self.unknowns.count
        return sum((noise[g].weight * A for g, A in self.products.items()), np.zeros((size, size)))

    def pull(self, noise: Mapping[Group, GroupNoise]) -> Float[Array, "U"]:
        """Return the right-hand side, that of the prior included.

        Nought is where the prior has an error of the model: what the balances take on pulls back.
        """
        before = np.zeros(self.unknowns.count)
        for name, taken in self.unknowns.model_errors.items():
            before[self.unknowns.model_error(name)] = -taken
        return sum((noise[g].weight * b for g, b in self.targets.items()), before)

    def squared(self, group: Group, theta: Float[Array, "U"]) -> float:
        """Return the sum of squared residuals of a group [N^2, Nm^2]."""
        cross = theta @ self.targets[group]
        own = theta @ self.products[group] @ theta
        return max(float(self.squares[group] - 2.0 * cross + own), 0.0)


def groups(terms: Terms) -> list[tuple[Group, slice]]:
    """Return the groups of some terms with the equations that belong to each."""
    kinds = [((terms.sub_model, "force"), slice(0, 3)), ((terms.sub_model, "torque"), slice(3, 6))]
    return kinds[: len(terms.products) // 3]


@dataclass(frozen=True, slots=True, eq=False)
class Posterior:
    """The unknowns with their covariance."""

    unknowns: Unknowns
    theta: Float[Array, "U"]
    covariance: Float[Array, "U U"]
    """What is unknown of them if the prior is right."""
    kappa: float
    noise: dict[Group, GroupNoise]
    error: Float[Array, "U U"]
    """How far they may be off if entries are as bent as the data show: the covariance, or more."""

    @staticmethod
    def of(
        normal: Normal, noise: dict[Group, GroupNoise], kappa: float, bend: float = 0.0
    ) -> Posterior:
        """Return the unknowns with a prior of `kappa`; entries of E may be bent by `bend`.

        A prior tighter than the truth draws the estimate A^+ b, A^+ = (A + K)^-1, towards zero by
        A^+ K times the truth: the error is A^+ (A + K T K) A^+, with T the covariance of the
        truth, and A^+ where T is 1 / K.
        """
        theta, covariance = solve(normal, noise, kappa)
        if bend <= kappa:
            return Posterior(normal.unknowns, theta, covariance, kappa, noise, covariance)
        K, truth = (normal.unknowns.precision(one) for one in (kappa, bend))
        drawn = covariance @ K
        error = covariance - drawn @ covariance + drawn @ np.linalg.solve(truth, drawn.T)
        return Posterior(normal.unknowns, theta, covariance, kappa, noise, 0.5 * (error + error.T))

    def entries(self, sensor: str) -> Float[Array, "6 P"]:
        """Return E of one sensor."""
        return np.asarray(self.theta[self.unknowns.entries[sensor]].reshape(6, -1))

    @property
    def spent(self) -> float:
        """How many entries of E the data determine, the prior the rest (MacKay's gamma)."""
        held = self.unknowns.prior
        return float(held - np.trace(self.covariance[:held, :held]) / self.kappa**2)


def solve(
    normal: Normal, noise: Mapping[Group, GroupNoise], kappa: float
) -> tuple[Float[Array, "U"], Float[Array, "U U"]]:
    """Return the maximum a posteriori unknowns and their covariance."""
    A = normal.information(noise) + normal.unknowns.precision(kappa)
    # the unknowns differ by orders of magnitude in how well they are known
    scale = 1.0 / np.sqrt(np.diag(A))
    covariance = scale[:, None] * np.linalg.inv(scale[:, None] * A * scale) * scale
    covariance = 0.5 * (covariance + covariance.T)
    return covariance @ normal.pull(noise), covariance


def offsets_alone(
    normal: Normal,
    noise: Mapping[Group, GroupNoise],
    theta: Float[Array, "U"] | None = None,
    known: Container[tuple[str, Segment]] = (),
) -> Float[Array, "U"]:
    """Return the unknowns with the offsets that suit best, all else as in `theta`.

    Offsets that are `known` stay as well. Without `theta` every matrix is the Workbench's and every
    inertia the robot description's.
    """
    unknowns = normal.unknowns
    found = np.zeros(unknowns.count) if theta is None else theta.copy()
    free = np.zeros(unknowns.count, dtype=bool)
    for key, place in unknowns.places.items():
        free[place] = key not in known
    found[free] = 0.0
    A = normal.information(noise)[free]
    pull = normal.pull(noise)[free] - A @ found
    found[free] = np.linalg.solve(A[:, free] + np.eye(int(free.sum())), pull)
    return found


def path(
    normal: Normal, noise: Mapping[Group, GroupNoise], kappas: Float[Array, "L"]
) -> Float[Array, "L U"]:
    """Return the unknowns for every prior strength, from one eigendecomposition.

    Offsets and inertia are eliminated first (Schur complement): only the entries of E are held.
    """
    held = normal.unknowns.prior
    A = normal.information(noise) + normal.unknowns.precision(np.inf)
    b = normal.pull(noise)
    cross = np.linalg.solve(A[held:, held:], np.column_stack([A[held:, :held], b[held:]]))
    d, V = np.linalg.eigh(A[:held, :held] - A[:held, held:] @ cross[:, :-1])
    pulled = V.T @ (b[:held] - A[:held, held:] @ cross[:, -1])
    E = (pulled / (np.maximum(d, 0.0) + 1.0 / np.asarray(kappas)[:, None] ** 2)) @ V.T
    return np.hstack([E, cross[:, -1] - E @ cross[:, :-1].T])
