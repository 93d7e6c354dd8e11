"""The paper's second validation: what is left over where nothing touches, across contact switches.

Between two sensors of a limb nothing touches, so the external wrench there should be zero (section
IV-C: "the section between the ankle and the hip"). Every surviving training set at every penalty is
tried in place of the Workbench matrix, one sensor at a time, the others as they are; the offset of
each is taken anew from the seconds of the run in which its limb is known to be free. As sensor and
sub-chain are compared in the sensor's own frame, a row of the matrix touches one axis alone: the
best row of every axis makes the *mixed* matrix.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal.balances import Balance, Leftover
from ftcal.errors import DataError
from ftcal.first_validation import FirstValidation
from ftcal.law import Law, aligned
from ftcal.samples import Samples
from ftcal.sensor import AXES, Workbench

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

WORKBENCH = "Workbench"
"""Name of the matrix that all others are compared with."""
BEST, MIXED, TRUTH = "best", "mixed", "truth"
"""Names of the matrices found, and of the true one of a simulation."""

BLOCK = 10.0
"""Length [s] of the pieces of the run on which matrices are chosen and scored in turn: a few
steps of a leg."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One matrix that was tried."""

    training: str
    """Training set, or `Workbench`."""
    penalty: float
    """The paper's lambda; 0 for the Workbench."""
    law: Law
    covariance: Float[Array, "6 P P"]
    """Of each row of the coefficients; zero for the Workbench."""

    @property
    def name(self) -> str:
        """Name in tables."""
        return self.training if self.training == WORKBENCH else f"{self.training}, {self.penalty:g}"


@dataclass(frozen=True, slots=True, eq=False)
class SecondValidation:
    """What every candidate for one sensor leaves over in one sub-chain, in the sensor's frame."""

    sub_chain: str
    """Sub-model that nothing touches, named by its first link."""
    neighbours: tuple[str, ...]
    """Other sensors on its border, which read with their Workbench matrices."""
    seconds: float
    """How long it was free."""
    candidates: tuple[Candidate, ...]
    """The Workbench, then every surviving set at every penalty."""
    left: tuple[Leftover, ...]
    """Of each candidate."""
    mixed: Law
    """Best row of every axis, its offset taken anew."""
    mixed_left: Leftover
    unseen: dict[str, Leftover]
    """`Workbench`, `best` and `mixed` on every other `BLOCK` seconds, both chosen on the rest."""
    time: Float[Array, "N"]
    """Seconds since the start of the switching run."""
    error: dict[str, Float[Array, "N 6"]]
    """Leftover wrench [N, Nm] in time: `Workbench`, `best`, `mixed`."""

    @property
    def best(self) -> int:
        """Index of the candidate that leaves the least mean force, as in the paper."""
        return int(np.argmin([left.force for left in self.left]))

    @property
    def best_per_axis(self) -> tuple[int, ...]:
        """Index of the candidate that leaves least on each axis."""
        return tuple(int(k) for k in np.argmin([left.axes for left in self.left], axis=0))

    @property
    def best_axes(self) -> list[tuple[str, str, float]]:
        """Axis, name and mean size [N, Nm] of the best candidate of every axis (Table III)."""
        return [
            (axis, self.candidates[k].name, self.left[k].axes[i])
            for i, (axis, k) in enumerate(zip(AXES, self.best_per_axis, strict=True))
        ]

    @property
    def by_set(self) -> dict[str, dict[float, Leftover]]:
        """What is left over by training set and penalty, the Workbench first (Table II)."""
        rows: dict[str, dict[float, Leftover]] = {}
        for candidate, left in zip(self.candidates, self.left, strict=True):
            rows.setdefault(candidate.training, {})[candidate.penalty] = left
        return rows


def second_validation(
    sensor: str,
    first: FirstValidation,
    balance: Balance,
    laws: Mapping[str, Law],
    aligning: Samples,
    workbench: Workbench,
    lambdas: Sequence[float],
) -> SecondValidation:
    """Return what every surviving set at every penalty leaves over for one sensor.

    `laws` are those of all sensors on the border with their Workbench matrices, offsets included;
    `aligning` are samples of the switching run that tell the sensor's own offset.
    """
    readings = {name: laws[name].read(inputs) for name, inputs in balance.inputs.items()}
    implied = balance.implied(sensor, readings)
    inputs = balance.inputs[sensor]
    own = laws[sensor]
    width = own.coefficients.shape[1]
    candidates = [Candidate(WORKBENCH, 0.0, own, np.zeros((6, width, width)))]
    for k in first.surviving:
        one = first.sets[k]
        for penalty, estimate in zip(lambdas, one.estimates(workbench, lambdas), strict=True):
            law = aligned(estimate.coefficients, aligning)
            candidates.append(Candidate(one.name, penalty, law, estimate.covariance))
    errors = [candidate.law.read(inputs) - implied for candidate in candidates]
    left = [Leftover.of(error) for error in errors]
    chosen = choice(candidates, left, aligning)
    error = {name: law.read(inputs) - implied for name, law in chosen.items()}
    choosing = (balance.time // BLOCK) % 2 == 0
    unseen = {}
    if choosing.any() and not choosing.all():
        fair = choice(candidates, [Leftover.of(error[choosing]) for error in errors], aligning)
        for name, law in fair.items():
            unseen[name] = Leftover.of(law.read(inputs[~choosing]) - implied[~choosing])
    return SecondValidation(
        balance.sub_model,
        tuple(name for name in balance.inputs if name != sensor),
        seconds_of(balance.time),
        tuple(candidates),
        tuple(left),
        chosen[MIXED],
        Leftover.of(error[MIXED]),
        unseen,
        balance.time,
        error,
    )


def choice(
    candidates: Sequence[Candidate], left: Sequence[Leftover], aligning: Samples
) -> dict[str, Law]:
    """Return the laws of the Workbench, of the best candidate by force, and of the best rows."""
    best = candidates[int(np.argmin([one.force for one in left]))]
    mixed = aligned(mixed_rows(candidates, left), aligning)
    return {WORKBENCH: candidates[0].law, BEST: best.law, MIXED: mixed}


def mixed_rows(candidates: Sequence[Candidate], left: Sequence[Leftover]) -> Float[Array, "6 P"]:
    """Return the row of the best candidate for every axis; a row without k has k = 0."""
    width = max(one.law.coefficients.shape[1] for one in candidates)
    mixed = np.zeros((6, width))
    for axis, k in enumerate(np.argmin([one.axes for one in left], axis=0)):
        row = candidates[k].law.coefficients[axis]
        mixed[axis, : len(row)] = row
    return mixed


def judging_balance(sensor: str, found: Sequence[Balance]) -> Balance:
    """Return the sub-chain that says most of a sensor: free longest, then of fewest sensors.

    Raises `DataError` where the sensor is on the border of none.
    """
    mine = [balance for balance in found if sensor in balance.inputs]
    if not mine:
        raise DataError(
            f"sensor {sensor!r}: no sub-chain beside it is ever free in the switching run; name"
            " the sensors on its other side, or other contacts"
        )
    return max(mine, key=lambda b: (round(seconds_of(b.time), 1), -len(b.inputs)))


def seconds_of(time: Float[Array, "N"]) -> float:
    """Return how long samples last together [s], holes left out."""
    return float(len(time) * np.median(np.diff(time))) if len(time) > 1 else 0.0


@dataclass(frozen=True, slots=True)
class SubChain:
    """One contact-free sub-model with all its sensors read alike."""

    name: str
    """Its first link."""
    sensors: tuple[str, ...]
    seconds: float
    left: dict[str, Leftover]
    """By matrix: `Workbench`, `best`, `mixed`, and `truth` where it is known; in its own frame."""


def sub_chains(
    found: Sequence[Balance], laws: Mapping[str, Mapping[str, Law]]
) -> tuple[SubChain, ...]:
    """Return what is left over in each sub-chain when all its sensors change at once.

    `laws` are by matrix, then by sensor.
    """
    chains = []
    for balance in found:
        readings = {
            matrix: {name: mine[name].read(inputs) for name, inputs in balance.inputs.items()}
            for matrix, mine in laws.items()
        }
        left = {matrix: Leftover.of(balance.residual(w)) for matrix, w in readings.items()}
        names = tuple(balance.inputs)
        chains.append(SubChain(balance.sub_model, names, seconds_of(balance.time), left))
    return tuple(chains)
