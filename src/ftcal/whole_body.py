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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from ftcal.errors import DataError
from ftcal.robust import huber_weights
from ftcal.terms import MODEL, Frame, Terms, Weights
from ftcal.unknowns import (
    Group,
    GroupNoise,
    Normal,
    Posterior,
    Unknowns,
    groups,
    offsets_alone,
    path,
    solve,
)

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

KAPPAS = np.geomspace(1e-3, 0.2, 24)
"""Prior strengths tried, in fractions of full scale."""

WEAK_KAPPA = 0.1
"""Prior held while the noise is measured, as for one sensor."""

FIRST_SD = (1.0, 0.1)
"""Noise of forces [N] and torques [Nm] from which its estimate starts."""

FIRST_MEMORY = 100.0
"""Samples that count as one, from which its estimate starts."""

ROUNDS = 6
"""Rounds of fit and noise; it moves by less than a percent after the fifth."""

LEAST_SHARE = 0.1
"""Independent samples less parameters spent are at least this share of the former."""

FEWEST_TOLD = 4
"""Stretches whose errors have a standard error."""

TIE = 0.01
"""Strengths whose held-out errors differ by less (relative) are equally good."""

AGREED = 4
"""Rounds at most until the strength of the prior and the noise agree."""

Strength = Literal["stretches", "evidence"]
"""How the strength of the prior is chosen."""


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
    """The strongest prior that is as good as the best, and no weaker than the evidence wants."""


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
    """Return the prior strength that predicts stretches which it did not see as well as the best.

    Every stretch is left out in turn. Offsets that the others know are kept; where one is not
    known, the balance is scored about its mean. Of strengths whose errors differ from the least by
    no more than one standard error over the stretches, the strongest prior is taken (L. Breiman et
    al., "Classification and Regression Trees", 1984, section 3.4.3): what stretches do not tell is
    better left to the Workbench. Fewer than four have no standard error to speak of: of equals the
    weakest then. Raises `DataError` with fewer than two.
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
    score = np.log(np.maximum(error, np.finfo(float).tiny))
    best = int(score.mean(axis=1).argmin())
    worse = score - score[best]
    spread = worse.std(axis=1, ddof=1) / np.sqrt(len(folds))
    tolerated = spread if len(folds) >= FEWEST_TOLD else TIE
    as_good = np.flatnonzero(worse.mean(axis=1) <= tolerated)
    at = as_good[0] if len(folds) >= FEWEST_TOLD else as_good[-1]
    names = tuple(f"{recording} {start:g} s" for recording, start in folds)
    return Choice(np.asarray(kappas), error, names, float(kappas[at]))


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
            # evidence takes all that is wrong for bend or noise: no bend is larger than that
            held = min(choice.chosen, maximise_evidence(normal, noise))
            choice = replace(choice, chosen=held)
        else:
            held = maximise_evidence(normal, noise)
        if abs(held - before) < 0.1 * before:
            break
    return Posterior.of(normal, noise, held, maximise_evidence(normal, noise)), choice
