"""All sensors at once: one regularised least squares over the balances of all free sub-models.

Minimises, over the E of every sensor and an offset per segment,

    sum over sub-models, equations, samples   (residual of (B) / sd)^2 / inefficiency
      + sum over sensors   |E_s|^2 / kappa^2

(method 5 with the scaled prior of method 4): a limb in the air fixes all axes at low load, a loaded
one fixes the scale, and neither is asked alone. Noise is one figure for forces and one for torques
of every sub-model, from what a fit leaves over, less the parameters that it spent there.

How strongly the Workbench is believed is chosen by holding out whole stretches in turn, a stance or
a swing: that asks what a matrix says of loads that it did not see. Or by the evidence (D. MacKay,
"Bayesian interpolation", Neural Computation 4, 1992), which believes the noise to be all that is
wrong, and so the data too much where the model of the robot is off.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np

from ftcal.errors import DataError
from ftcal.robust import huber_weights
from ftcal.sensor import AXES
from ftcal.terms import MODEL, Frame, Segment, Terms, Weights

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray as Array

KAPPAS = np.geomspace(1e-3, 0.2, 24)
"""Prior strengths tried, in fractions of full scale."""

WEAK_KAPPA = 0.1
"""Prior held while the noise is measured, as for one sensor."""

FIRST_SD = (1.0, 0.1)
"""Noise of forces [N] and torques [Nm] from which its estimate starts."""

SCALE_SD = 0.03
"""Standard deviation of the common scale of the three forces, and of the three torques, of a sensor
along their unit vector, whatever kappa is: balances that nothing anchors shrink all matrices to
zero, and no cross-validation sees it."""

FIRST_MEMORY = 100.0
"""Samples that count as one, from which its estimate starts."""

ROUNDS = 6
"""Rounds of fit and noise; it moves by less than a percent after the fifth."""

LEAST_SHARE = 0.1
"""Independent samples less parameters spent are at least this share of the former."""

AGREED = 4
"""Rounds at most until the strength of the prior and the noise agree."""

Strength = Literal["stretches", "evidence"]
"""How the strength of the prior is chosen."""

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
    kappa: float
    noise: dict[Group, GroupNoise]

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
    normal: Normal, noise: Mapping[Group, GroupNoise], theta: Float[Array, "U"] | None = None
) -> Float[Array, "U"]:
    """Return the unknowns with the offsets that suit best, all else as in `theta`.

    Without it every matrix is the Workbench's and every inertia the robot description's.
    """
    unknowns = normal.unknowns
    first = unknowns.described
    found = np.zeros(unknowns.count) if theta is None else theta.copy()
    A = normal.information(noise)[first:]
    pull = normal.pull(noise)[first:] - A[:, :first] @ found[:first]
    held = A[:, first:] + np.eye(unknowns.count - first)
    found[first:] = np.linalg.solve(held, pull)
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


def measured_noise(
    terms: Sequence[Terms], normal: Normal, kappa: float = WEAK_KAPPA
) -> dict[Group, GroupNoise]:
    """Return the noise of every group from what a weakly held fit leaves over.

    Parameters that the data spend in a group are counted there: the trace of the posterior
    covariance with the information of the group.
    """
    noise = {g: GroupNoise(FIRST_SD[g[1] == "torque"], FIRST_MEMORY) for g in normal.products}
    for _ in range(ROUNDS):
        theta, covariance = solve(normal, noise, kappa)
        before = offsets_alone(normal, noise)
        noise = {
            group: _noise_of(group, terms, normal, theta, covariance, before, known)
            for group, known in noise.items()
        }
    return noise


def _noise_of(
    group: Group,
    terms: Sequence[Terms],
    normal: Normal,
    theta: Float[Array, "U"],
    covariance: Float[Array, "U U"],
    before: Float[Array, "U"],
    known: GroupNoise,
) -> GroupNoise:
    count = normal.counts[group]
    left = normal.squared(group, theta) / count
    # what is wrong with the model is a matter of the pose, as what is wrong with the Workbench is:
    # it lasts as long. A fit hides that where it has followed a pose that did not change
    repeat = memory(group, terms, normal.unknowns, before, normal.squared(group, before) / count)
    spent = known.weight * float(np.sum(covariance * normal.products[group]))
    independent = count / repeat
    share = max(1.0 - spent / independent, LEAST_SHARE)
    return GroupNoise(float(np.sqrt(max(left / share, 1e-12))), repeat)


def memory(
    group: Group, terms: Sequence[Terms], unknowns: Unknowns, theta: Float[Array, "U"], left: float
) -> float:
    """Return how many samples of a group count as one.

    The variance of the means of longer and longer blocks of cells against that of a sample, at most
    (H. Flyvbjerg, H. Petersen, "Error estimates on averages of correlated data", J. Chem. Phys. 91,
    1989); blocks double as long as there are eight of them.
    """
    series = []
    per_cell = []
    for one in terms:
        for name, equations in groups(one):
            if name == group:
                means = one.cell_means(theta[unknowns.columns(one)])[:, equations]
                series.append(np.sqrt(one.weights)[:, None] * means)
                per_cell.append(one.count / len(means))
    samples = float(np.mean(per_cell))
    # half of all samples at most: exact data leave nothing to compare with
    most = 0.5 * samples * sum(len(means) for means in series)
    best = 1.0
    while sum(len(means) for means in series) >= 8:
        variance = float(np.mean(np.concatenate(series) ** 2))
        best = max(best, samples * variance / max(left, np.finfo(float).tiny))
        series = [0.5 * (means[0 : len(means) - 1 : 2] + means[1::2]) for means in series]
        samples *= 2.0
    return max(1.0, min(best, most))


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """What holding out stretches saw."""

    kappas: Float[Array, "L"]
    error: Float[Array, "L H"]
    """Held-out mean square over the noise's, by strength and stretch."""
    stretches: tuple[str, ...]
    chosen: float
    """The weakest of the best."""


def robust_weights(terms: Sequence[Terms], posterior: Posterior) -> Weights:
    """Return what every cell counts whose residual stands apart from the others of its stretch."""
    found = {}
    for one in terms:
        means = one.cell_means(posterior.theta[posterior.unknowns.columns(one)])
        weights = huber_weights(means)
        if weights.min() < 1.0:
            found[one.sub_model, one.stretch] = weights
    return found


def stretches_of(terms: Sequence[Terms]) -> dict[tuple[str, float], list[Terms]]:
    """Return the terms by the stretch that they are from."""
    found: dict[tuple[str, float], list[Terms]] = {}
    for one in terms:
        found.setdefault((one.stretch.recording, one.stretch.start), []).append(one)
    return found


def choose_kappa(
    terms: Sequence[Terms],
    frames: Mapping[str, Frame],
    noise: Mapping[Group, GroupNoise],
    kappas: Float[Array, "L"] = KAPPAS,
) -> Choice:
    """Return the prior strength that predicts stretches which it did not see best.

    Every stretch is left out in turn. Offsets that the others know are kept; where one is not
    known, the balance is scored about its mean. Raises `DataError` with fewer than two stretches.
    """
    folds = stretches_of(terms)
    if len(folds) < 2:
        raise DataError(
            "one stretch alone cannot choose how strongly the Workbench is believed: give kappa, or"
            " intervals of different contact"
        )
    error = np.zeros((len(kappas), len(folds)))
    for h, (_, held) in enumerate(folds.items()):
        rest = [one for one in terms if all(one is not other for other in held)]
        normal = Normal.of(rest, Unknowns.of(rest, frames))
        known = {g: noise[g] for g in normal.products}
        for k, theta in enumerate(path(normal, known, kappas)):
            error[k, h] = held_out(held, normal.unknowns, theta, noise)
    score = np.log(np.maximum(error, np.finfo(float).tiny)).mean(axis=1)
    best = int(np.flatnonzero(score <= score.min() + 0.01)[-1])
    names = tuple(f"{recording} {start:g} s" for recording, start in folds)
    return Choice(np.asarray(kappas), error, names, float(kappas[best]))


def held_out(
    held: Sequence[Terms],
    unknowns: Unknowns,
    theta: Float[Array, "U"],
    noise: Mapping[Group, GroupNoise],
) -> float:
    """Return the mean square of the residuals of a stretch over the noise's."""
    total, count = 0.0, 0.0
    for one in held:
        if not all(name in unknowns.entries for name in one.sensors):
            continue
        for group, equations in groups(one):
            total += _left(one, equations, unknowns, theta) / noise[group].sd ** 2
            count += one.count * (equations.stop - equations.start)
    return total / max(count, 1)


def _left(one: Terms, equations: slice, unknowns: Unknowns, theta: Float[Array, "U"]) -> float:
    """Return the sum of squared residuals; what no known offset explains is fitted away."""
    direction: list[Array] = []
    free: list[int] = []
    at = 0
    for name, segment in zip(one.sensors, one.segments, strict=True):
        E = theta[unknowns.entries[name]]
        known = (name, segment) in unknowns.places
        offset = theta[unknowns.places[name, segment]] if known else np.zeros(6)
        direction += [E, offset]
        at += len(E) + 6
        free += [] if known else list(range(at - 6, at))
    seen = one.sub_model in unknowns.models
    direction.append(theta[unknowns.model(one.sub_model)] if seen else np.zeros(MODEL))
    suspected = {name: theta[unknowns.model_error(name)] for name in unknowns.model_errors}
    direction.append(np.array([suspected.get(name, 0.0) for name in one.model_errors]))
    full = np.append(-np.concatenate(direction), 1.0)
    G = one.products[equations].sum(axis=0)
    own = float(full @ G @ full)
    if not free:
        return max(own, 0.0)
    pull = G[free] @ full
    return max(own - float(pull @ np.linalg.pinv(G[np.ix_(free, free)]) @ pull), 0.0)


def maximise_evidence(
    normal: Normal, noise: Mapping[Group, GroupNoise], *, rounds: int = 100
) -> float:
    """Return the kappa that makes the data most probable: `|E|^2 / gamma`, to its fixed point."""
    kappa = WEAK_KAPPA
    held = normal.unknowns.prior
    for _ in range(rounds):
        theta, covariance = solve(normal, noise, kappa)
        spent = held - float(np.trace(covariance[:held, :held])) / kappa**2
        last, kappa = kappa, float(np.sqrt(np.sum(theta[:held] ** 2) / max(spent, 1e-9)))
        if abs(kappa - last) < 1e-3 * last:
            break
    return kappa


def fit_all(
    terms: Sequence[Terms],
    frames: Mapping[str, Frame],
    *,
    kappa: float | None = None,
    strength: Strength = "stretches",
) -> tuple[Posterior, Choice | None]:
    """Return the fit of all sensors, and what holding out stretches saw.

    Without a `kappa` its strength is chosen by held-out `stretches` (where there are two) or by the
    `evidence`; noise is that of a fit of the chosen strength. Raises `DataError` where there is
    nothing to fit.
    """
    if not terms:
        raise DataError("no balance of any free sub-model is left to train on")
    normal = Normal.of(terms, Unknowns.of(terms, frames))
    choice = None
    held = WEAK_KAPPA if kappa is None else kappa
    for _ in range(AGREED):
        noise = measured_noise(terms, normal, held)
        if kappa is not None:
            break
        before = held
        if strength == "stretches" and len(stretches_of(terms)) > 1:
            choice = choose_kappa(terms, frames, noise)
            held = choice.chosen
        else:
            held = maximise_evidence(normal, noise)
        if abs(held - before) < 0.1 * before:
            break
    theta, covariance = solve(normal, noise, held)
    return Posterior(normal.unknowns, theta, covariance, held, noise), choice
