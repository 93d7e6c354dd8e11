"""A pretend six-axis sensor: invented by its maker, bent by its mounting, digitised by its board.

The Workbench has the layout of a real one: three spokes 120 degrees apart, on each a gauge across
and a gauge upright, and some cross-talk. Mounting bends it as the scaled prior says (method 4):
`C = S C_w`, `S = I + F E F^-1`, `E_ij ~ N(0, kappa^2)`, `F` the full scale.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal.errors import DataError, SensorError
from ftcal.firmware import COUNTS, ONE, FirmwareMatrix, decode, encode
from ftcal.health import NEAR_CEILING

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

CROSS_TALK = 0.02
"""Standard deviation of the entries that an ideal sensor would not have, share of a row."""

LEAST_FORCE, MOST_FORCE = 1500, 2100
"""Full scale of the forces of invented sensors [N]."""

LEAST_TORQUE, MOST_TORQUE = 25, 40
"""Full scale of the torques of invented sensors [Nm]."""

WARMTH = 5e-4
"""Standard deviation of the temperature gain of pretend sensors, share of full scale per kelvin."""


@dataclass(frozen=True, slots=True, eq=False)
class PretendSensor:
    """One mounted sensor with its board."""

    firmware: FirmwareMatrix
    """What its maker wrote into the board: C_w and the full scale."""
    secondary: Float[Array, "6 6"]
    """S: what the mounting did."""
    temperature_gain: Float[Array, "6"]
    """k [N/K, Nm/K]."""

    @property
    def gain(self) -> Float[Array, "6 6"]:
        """True matrix `C = S C_w` [N, Nm per count]."""
        return np.asarray(self.secondary @ self.firmware.matrix)

    def response(
        self, wrench: Float[Array, "N 6"], warmth: Float[Array, "N"]
    ) -> Float[Array, "N 6"]:
        """Return `C^-1 (w - k (T - T_ref))` [counts]: what the gauges say, but for their zero.

        `warmth` is T - T_ref [K].
        """
        cold = wrench - np.outer(warmth, self.temperature_gain)
        return np.asarray(np.linalg.solve(self.gain, cold.T).T)

    def zero(
        self,
        response: Float[Array, "N 6"],
        generator: np.random.Generator,
        *,
        largest: float,
        spare: float,
    ) -> Float[Array, "6"]:
        """Return a random raw offset [counts] that keeps every channel in range.

        Each channel takes up to `largest` either way, as far as `spare` counts are left for noise.
        Raises `DataError` where the response alone is wider than the range.
        """
        ceiling = NEAR_CEILING - spare
        low, high = response.min(axis=0), response.max(axis=0)
        if (high - low > 2.0 * ceiling).any():
            wide = int(np.argmax(high - low))
            raise DataError(
                f"sensor {self.firmware.serial!r} saturates: channel {wide + 1} would span"
                f" {high[wide] - low[wide]:.0f} counts, {2 * ceiling:.0f} are there; use a"
                " sensor of larger full scale, or a slower or smaller motion"
            )
        wanted = generator.uniform(-largest, largest, size=6)
        return np.asarray(np.clip(wanted, -ceiling - low, ceiling - high))

    def saturating(
        self, response: Float[Array, "N 6"], raw: Float[Array, "6"], share: float
    ) -> Float[Array, "6"]:
        """Return the raw offset `raw` [counts] but for the widest channel, which gets too little.

        It leaves the range in about the given share of the samples.
        """
        widest = int(np.argmax(np.ptp(response, axis=0)))
        return np.where(
            np.arange(6) == widest,
            COUNTS - np.quantile(response[:, widest], 1.0 - share),
            raw,
        )

    def sent(self, counts: Float[Array, "N 6"], *, digital: bool) -> Float[Array, "N 6"]:
        """Return what the board sends [N, Nm] of raw readings, in steps of full scale / 32768.

        While a channel is beyond its range all six outputs stay those of the last good sample (seen
        on iCubGenova02). A board that is not `digital` rounds nothing.
        """
        good = (np.abs(np.rint(counts)) <= COUNTS).all(axis=1)
        if not good.any():
            raise DataError(
                f"sensor {self.firmware.serial!r} saturates in every sample; ask for a smaller"
                " share or a smaller offset step, or use a sensor of larger full scale"
            )
        last = np.maximum.accumulate(np.where(good, np.arange(len(counts)), np.argmax(good)))
        if not digital:
            return np.asarray((counts @ self.firmware.matrix.T)[last])
        step = self.firmware.full_scale / ONE
        wrench = np.rint(counts) @ self.firmware.matrix.T
        return np.asarray((np.rint(wrench / step) * step)[last])


def invent_firmware(
    generator: np.random.Generator,
    *,
    serial: str = "SN900",
    full_scale: Sequence[int] | None = None,
) -> FirmwareMatrix:
    """Return the Workbench matrix of a sensor that does not exist, of the size of an iCub's.

    `full_scale` [N, Nm] are whole numbers, for robots of other sizes. Raises `SensorError` where
    they are not.
    """
    drawn = np.concatenate(
        [
            generator.integers(LEAST_FORCE, MOST_FORCE + 1, size=3),
            generator.integers(LEAST_TORQUE, MOST_TORQUE + 1, size=3),
        ]
    )
    scale = drawn if full_scale is None else np.asarray(full_scale)
    if scale.shape != (6,):
        raise SensorError(f"full scale has {scale.size} entries; give fx fy fz tx ty tz")
    angle = np.deg2rad([0.0, 120.0, 240.0])
    none = np.zeros(3)
    across = [-np.sin(angle), np.cos(angle), none, none, none, np.ones(3)]
    upright = [none, none, np.ones(3), np.sin(angle), -np.cos(angle), none]
    ideal = np.stack([across, upright], axis=-1).reshape(6, 6)
    rows = ideal / np.abs(ideal).sum(axis=1, keepdims=True)
    rows = rows + generator.normal(scale=CROSS_TALK, size=(6, 6))
    # a hair less than full scale: rounded words must not add up to more
    share = rows / np.abs(rows).sum(axis=1, keepdims=True) * (1.0 - 4.0 / ONE)
    return decode(encode(scale[:, None] * share / COUNTS, scale), serial=serial)


def mount(
    firmware: FirmwareMatrix, generator: np.random.Generator, *, kappa: float = 0.03
) -> PretendSensor:
    """Return the sensor bent by its mounting; `kappa` as in the scaled prior."""
    F = np.asarray(firmware.full_scale, dtype=np.float64)
    E = generator.normal(size=(6, 6)) * kappa
    secondary = np.eye(6) + F[:, None] * E / F
    return PretendSensor(firmware, secondary, WARMTH * F * generator.normal(size=6))
