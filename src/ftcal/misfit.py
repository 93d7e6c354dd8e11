"""How badly sensors and description contradict each other, whatever is done to the readings.

A free part of the robot is in balance: what the sensors on its border read adds up to what its
motion and weight ask for (`ftcal.balances`). Here each balance becomes a quadratic form in the 6x6
maps that a hypothesis puts on the readings and in what it adds to the masses of the links, so a
thousand hypotheses cost no second pass over the log.

Misfits are measured against what sensors rightly described but *uncalibrated* leave over
(`ftcal.bins`), so that 1 is usual and no cause for alarm.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

INDEPENDENT = 1.0
"""Seconds after which a misfit says something new: robots move slowly."""

LINK_SIZE = 0.1
"""How far the centre of mass of a link may lie from where the URDF says [m]."""

Maps = Mapping[str, "Float[Array, '6 6']"]
"""What a hypothesis does to the readings of each sensor."""


@dataclass(frozen=True, slots=True, eq=False)
class Misfit:
    """The balance of one free part as a quadratic form."""

    frame: str
    """First link of the part; its frame expresses the wrench left over."""
    sensors: tuple[str, ...]
    """Sensors on the border of the part."""
    links: dict[str, float]
    """Links of the part and their masses [kg]; their inertial columns follow the sensors'."""
    resting: tuple[str, ...]
    """Joints not logged that move mass of the part, held at zero."""
    seconds: float
    """Time of the samples."""
    rows: Float[Array, "R C"]
    """Whitened equations without offsets: the columns are what is required, 36 a sensor (what each
    entry of its map makes of the readings), 4 a link."""
    grams: dict[int, Float[Array, "C C"]]
    """Products of the columns by block of time, scaled so that their sum is a mean over rows."""
    whitening: Float[Array, "6 6"]
    """Wrench [N, Nm] to multiples of the usual misfit."""
    load: tuple[float, float]
    """RMS variation of what the sensors carry: force [N], torque [Nm]."""

    def coefficients(
        self, maps: Maps, masses: Mapping[str, Float[Array, "4"]] | None = None
    ) -> Float[Array, "C"]:
        """Return the weights of the columns: readings less what is required."""
        parts: list[Float[Array, "K"]] = [np.array([-1.0])]
        parts += [np.asarray(maps[name]).ravel() for name in self.sensors]
        parts += [-(masses or {}).get(name, np.zeros(4)) for name in self.links]
        return np.concatenate(parts)

    def entries(self, sensor: str) -> slice:
        """Return the columns of a sensor."""
        first = 1 + 36 * self.sensors.index(sensor)
        return slice(first, first + 36)

    @property
    def inertial(self) -> slice:
        """The columns of the links."""
        return slice(1 + 36 * len(self.sensors), None)

    def without(self, held: int | None) -> Float[Array, "C C"]:
        """Return the products of the columns over all blocks but one."""
        kept = [gram for block, gram in self.grams.items() if block != held]
        return np.asarray(sum(kept, np.zeros_like(self.grams[next(iter(self.grams))])))

    def unlike(self, masses: Mapping[str, Float[Array, "4"]]) -> float:
        """Return the RMS of what `masses` add to the links, as a share of what is required."""
        v = self.coefficients(dict.fromkeys(self.sensors, np.zeros((6, 6))), masses)
        gram, own = self.without(None), self.inertial
        return float(np.sqrt(v[own] @ gram[own, own] @ v[own] / gram[0, 0]))

    def square(
        self,
        maps: Maps,
        masses: Mapping[str, Float[Array, "4"]] | None = None,
        *,
        blocks: Iterable[int] | None = None,
    ) -> float:
        """Return the mean square misfit over the balance's rows that lie in `blocks` (all)."""
        v = self.coefficients(maps, masses)
        chosen = self.grams if blocks is None else set(blocks) & set(self.grams)
        return float(sum(v @ self.grams[block] @ v for block in chosen))

    def left_over(
        self, maps: Maps, masses: Mapping[str, Float[Array, "4"]] | None = None
    ) -> tuple[float, float]:
        """Return the RMS length of force [N] and torque [Nm] that are left over."""
        white = (self.rows @ self.coefficients(maps, masses)).reshape(-1, 6)
        return lengths(np.linalg.solve(self.whitening, white.T).T)


def lengths(wrench: Float[Array, "N 6"]) -> tuple[float, float]:
    """Return the RMS length of force and torque."""
    force, torque = np.sqrt((wrench**2).reshape(-1, 2, 3).sum(axis=2).mean(axis=0))
    return float(force), float(torque)


def without(
    table: Float[Array, "N 6 C"], freedom: Float[Array, "N 6 K"], strength: float
) -> tuple[Float[Array, "R C"], Float[Array, "K C"]]:
    """Return the rows of a table without what offsets explain, and the price of the offsets.

    What is constant is free. What the turning of the frames makes of an offset is found by least
    squares, each offset of unit prior variance where `strength` squared rows count as one.
    """
    table, freedom = (values - values.mean(axis=0) for values in (table, freedom))
    width = freedom.shape[2]
    A = np.vstack([freedom.reshape(-1, width), strength * np.eye(width)])
    B = np.vstack([table.reshape(-1, table.shape[2]), np.zeros((width, table.shape[2]))])
    Q = np.linalg.qr(A)[0]
    left = B - Q @ (Q.T @ B)
    return left[:-width], left[-width:]
