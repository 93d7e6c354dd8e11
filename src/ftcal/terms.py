"""Equation (B) as moments: what a stretch of balances adds to the normal equations of all sensors.

In the coordinates of the prior (method 4) sensor s reads

    w_s = C_w (r - r0) + F E T (r - r0) + F o',

`r0` its mean in the recording, so that a balance is linear in the unknowns of the sensors on its
border: the entries of E, shared by all recordings, and an offset o' for every stretch of constant
offset. The model of the robot is not perfect either: the mass of a sub-model and its centre of mass
are unknowns too, held near the robot description: `h (1 + m)`, its torque turned by `c x force`.

No row of features is kept: per stretch, sub-model and equation the products of features are summed,
and only sensors that share a sub-model ever meet in them.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ftcal.balances import Balance
from ftcal.ridge import scaling_map
from ftcal.sensor import Workbench
from ftcal.spatial import skew

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

CHUNK = 2048
"""Samples whose features are held at once."""

MODEL = 4
"""Unknowns of a sub-model: its mass, and three coordinates of its centre of mass."""

CELL = 1.0
"""Length [s] of the cells whose sums of residuals tell how long they remember."""

MOST_CELLS = 200
"""Cells of a stretch, longer in long ones: means of more than a memory tell it as well."""


@dataclass(frozen=True, slots=True, order=True)
class Segment:
    """A stretch of one recording in which a sensor's offset is constant."""

    recording: str
    start: float
    """Seconds since the start of the recording."""
    stop: float
    """Seconds since the start of the recording, exclusive."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelPrior:
    """How well the robot description is believed to know the inertia of a sub-model."""

    mass: float = 0.005
    """Standard deviation of its mass, as a share: limbs are weighed one by one."""
    com: float = 0.005
    """Standard deviation of each coordinate of its centre of mass [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """The coordinates of one sensor."""

    workbench: Workbench
    basis: Float[Array, "P P"]
    """T, with the temperature's scale last where it has a thermometer."""

    @staticmethod
    def of(workbench: Workbench, inputs: int) -> Frame:
        """Return the coordinates of a sensor with `inputs` columns (channels, temperature)."""
        return Frame(workbench, scaling_map(workbench, inputs)[:inputs, :inputs])

    @property
    def unknowns(self) -> int:
        """Entries of E."""
        return 6 * len(self.basis)

    def coefficients(self, E: Float[Array, "6 P"]) -> Float[Array, "6 P"]:
        """Return `[C, k]` that E stands for."""
        found = self.workbench.full_scale[:, None] * (E @ self.basis)
        channels = self.workbench.gain.shape[1]
        found[:, :channels] += self.workbench.gain
        return np.asarray(found)


Weights = Mapping[tuple[str, Segment], "Float[Array, 'B']"]
"""What the cells of a sub-model in a stretch count."""


@dataclass(frozen=True, slots=True, eq=False)
class Terms:
    """One sub-model over one stretch of one recording, summed."""

    stretch: Segment
    """Where the samples are from."""
    sub_model: str
    sensors: tuple[str, ...]
    segments: tuple[Segment, ...]
    """Offset segment of each sensor."""
    count: float
    """Samples, as often as they count."""
    products: Float[Array, "E D D"]
    """Per equation: sum of products of `[features, target]`; features per sensor: E row by row,
    then its six offsets, in fractions of full scale; then mass and centre of mass of the sub-model
    in standard deviations of their prior, and `model_errors`. The target is in N and Nm."""
    cells: Float[Array, "B E D"]
    """Per cell of about a second and equation: mean of `[features, target]`."""
    weights: Float[Array, "B"]
    """What each sample of a cell counts."""
    model_errors: Mapping[str, float] = field(default_factory=dict)
    """Suspected errors of the model, whose features are the last, and what the balance takes on of
    each already, in standard deviations of their prior."""

    def squares(self, unknowns: Float[Array, "D-1"]) -> Float[Array, "E"]:
        """Return the sum of squared residuals per equation [N^2, Nm^2]."""
        direction = np.append(-unknowns, 1.0)
        return np.asarray(
            np.maximum(np.einsum("d,edf,f->e", direction, self.products, direction), 0)
        )

    def cell_means(self, unknowns: Float[Array, "D-1"]) -> Float[Array, "B E"]:
        """Return the mean residual of every cell per equation [N, Nm]."""
        return np.asarray(self.cells @ np.append(-unknowns, 1.0))


def summed(
    balance: Balance,
    recording: str,
    frames: Mapping[str, Frame],
    references: Mapping[str, Float[Array, "P"]],
    segments: Mapping[str, Sequence[Segment]],
    stretch: tuple[float, float],
    model: ModelPrior,
    *,
    weights: Weights | None = None,
) -> list[Terms]:
    """Return the terms of a balance within `stretch` [s], one for every set of offset segments.

    `references` are r0, `segments` the offset segments of each sensor in the recording; samples in
    none of a sensor's segments are left out. Cells without `weights` count in full.
    """
    edges = {float(e) for name in balance.inputs for s in segments[name] for e in (s.start, s.stop)}
    cuts = sorted({stretch[0], stretch[1], *(e for e in edges if stretch[0] < e < stretch[1])})
    found = []
    for start, stop in itertools.pairwise(cuts):
        mine = []
        for name in balance.inputs:
            inside = [s for s in segments[name] if s.start <= start and stop <= s.stop]
            mine.append(inside[0] if inside else None)
        first, last = np.searchsorted(balance.time, [start, stop])
        held = tuple(segment for segment in mine if segment is not None)
        if first < last and len(held) == len(mine):
            part = balance.rows(slice(int(first), int(last)))
            where = Segment(recording, start, stop)
            told = (weights or {}).get((balance.sub_model, where))
            found.append(_sum(part, where, held, frames, references, model, told))
    return found


def _sum(
    balance: Balance,
    stretch: Segment,
    segments: tuple[Segment, ...],
    frames: Mapping[str, Frame],
    references: Mapping[str, Float[Array, "P"]],
    model: ModelPrior,
    weights: Float[Array, "B"] | None,
) -> Terms:
    sensors = tuple(balance.inputs)
    suspected = {name: balance.taken_on.get(name, 0.0) for name in balance.model_errors}
    width = sum(frames[name].unknowns + 6 for name in sensors) + MODEL + len(suspected) + 1
    equations = balance.equations
    span = balance.time[-1] - balance.time[0]
    cells = min(max(1, round(float(span) / CELL)), MOST_CELLS)
    index = np.minimum(
        ((balance.time - balance.time[0]) / max(span, 1e-9) * cells).astype(int), cells - 1
    )
    # a hole may leave a cell empty: none is kept of it
    found, index = np.unique(index, return_inverse=True)
    cells = len(found)
    weights = np.ones(cells) if weights is None else weights
    root = np.sqrt(weights)[index]
    products = np.zeros((equations, width, width))
    sums = np.zeros((cells, equations, width))
    for start in range(0, len(balance.time), CHUNK):
        rows = slice(start, start + CHUNK)
        table = features(balance.rows(rows), frames, references, model)
        for equation, its_rows in enumerate(table * root[rows, None]):
            products[equation] += its_rows.T @ its_rows
        opens = np.flatnonzero(np.diff(index[rows], prepend=-1))
        sums[index[rows][opens]] += np.add.reduceat(table, opens, axis=1).transpose(1, 0, 2)
    held = np.bincount(index, minlength=cells)
    sums /= held[:, None, None]
    count = float(held @ weights)
    return Terms(
        stretch, balance.sub_model, sensors, segments, count, products, sums, weights, suspected
    )


def features(
    balance: Balance,
    frames: Mapping[str, Frame],
    references: Mapping[str, Float[Array, "P"]],
    model: ModelPrior,
) -> Float[Array, "E N D"]:
    """Return `[features, target]` of every equation and sample of a balance."""
    equations, count = balance.equations, len(balance.time)
    width = sum(frames[name].unknowns + 6 for name in balance.inputs) + MODEL + 1
    width += len(balance.model_errors)
    # equation first: each one's rows are then a matrix of their own for BLAS
    table = np.zeros((equations, count, width))
    table[..., -1] = balance.required[:, :equations].T
    at = 0
    for name, inputs in balance.inputs.items():
        frame = frames[name]
        workbench = frame.workbench
        moved = inputs - references[name]
        X = balance.transforms[name][:, :equations].transpose(1, 0, 2)
        read = moved[:, : workbench.gain.shape[1]] @ workbench.gain.T
        table[..., -1] -= np.einsum("eni,ni->en", X, read)
        lever = X * workbench.full_scale
        y = moved @ frame.basis.T
        bent = lever[..., None] * y[:, None, :]
        table[..., at : at + frame.unknowns] = bent.reshape(equations, count, -1)
        at += frame.unknowns
        table[..., at : at + 6] = lever
        at += 6
    table[..., at] = -model.mass * balance.required[:, :equations].T
    turned = model.com * skew(balance.required[:, :3])
    table[3:, :, at + 1 : at + MODEL] = turned.transpose(1, 0, 2)[: max(equations - 3, 0)]
    for column, change in enumerate(balance.model_errors.values(), at + MODEL):
        table[..., column] = change[:, :equations].T
    return table
