"""Units of inertial signals: what a log declares, or a job says of it, turned to m/s^2 and rad/s.

An inertial signal of six columns is proper acceleration, then angular velocity. Any other is known
by the names of its columns: `ax`, `acc_x`, … and `gx`, `gyro_x`, `omega_x`, `wx`, ….
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import get_args

import numpy as np

from ftcal.errors import LogError, raise_all
from ftcal.logs.layout import Acceleration, AngularVelocity, Layout
from ftcal.recording import Recording, Signal

STANDARD_G = 9.80665
"""One g [m/s^2], by definition (CGPM 1901)."""

SI: Mapping[str, float] = MappingProxyType({
    "rad": 1.0, "deg": np.pi / 180, "rad/s": 1.0, "deg/s": np.pi / 180, "m/s^2": 1.0,
    "g": STANDARD_G, "N": 1.0, "Nm": 1.0, "mN": 1e-3, "mNm": 1e-3, "kN": 1e3,
})  # fmt: skip
"""What a number in a unit is times to be SI."""

_SPELLINGS = {
    "radian": "rad", "radians": "rad", "degree": "deg", "degrees": "deg", "radian/s": "rad/s",
    "radians/s": "rad/s", "degree/s": "deg/s", "degrees/s": "deg/s", "dps": "deg/s",
    "m/s2": "m/s^2", "m/s**2": "m/s^2", "m/s/s": "m/s^2", "newton": "N", "n": "N", "nm": "Nm",
    "n*m": "Nm", "n.m": "Nm", "n m": "Nm",
}  # fmt: skip
_ACCELERATION = re.compile(r"(a|acc|accel|acceleration|linearacceleration)[xyz]")
_ANGULAR_VELOCITY = re.compile(r"(g|gyr|gyro|w|omega|angularvelocity)[xyz]")


ACCELERATIONS: frozenset[str] = frozenset(get_args(Acceleration))
ANGULAR_VELOCITIES: frozenset[str] = frozenset(get_args(AngularVelocity))


def spelt(unit: str) -> str:
    """Return `unit`, in any usual spelling, as `SI` spells it; "" where nobody knows it."""
    plain = unit.strip()
    return plain if plain in SI else _SPELLINGS.get(plain.lower(), "")


def factor(unit: str) -> float | None:
    """Return what a number in `unit` is times to be SI, in any usual spelling; None: unknown."""
    return SI.get(spelt(unit))


def inertial_columns(signal: Signal) -> tuple[list[int], list[int]]:
    """Return the columns of `signal` that are acceleration, and those that are angular velocity.

    Three each, or none.
    """
    if len(signal.columns) == 6:
        return [0, 1, 2], [3, 4, 5]
    return _called(signal.columns, _ACCELERATION), _called(signal.columns, _ANGULAR_VELOCITY)


def _called(columns: Sequence[str], pattern: re.Pattern[str]) -> list[int]:
    plain = [re.sub(r"[^a-z]", "", name.rpartition("/")[2].lower()) for name in columns]
    found = [column for column, name in enumerate(plain) if pattern.fullmatch(name)]
    return found if len(found) == 3 else []


def in_si(recording: Recording, layout: Layout) -> Recording:
    """Return `recording` with its inertial signals turned from the units that `layout` names.

    Raises `LogError` where a unit is given and no signal has columns that it could be of.
    """
    given = (layout.acceleration, layout.angular_velocity)
    if given == (None, None):
        return recording
    imus, found = [], [False, False]
    for signal in recording.imus:
        scale = np.ones(len(signal.columns))
        for kind, (unit, columns) in enumerate(zip(given, inertial_columns(signal), strict=True)):
            scale[columns] = 1.0 if unit is None else SI[unit]
            found[kind] |= bool(columns)
        imus.append(replace(signal, values=signal.values * scale))
    raise_all(
        LogError,
        recording.source,
        [
            f"{key} = {unit!r}, but no imu has columns called {axes}; name them so under imus"
            for key, axes, unit, some in zip(
                ("acceleration", "angular_velocity"), ("ax, ay, az", "gx, gy, gz"), given, found,
                strict=True,
            )
            if unit is not None and not some
        ],
    )  # fmt: skip
    return replace(recording, imus=tuple(imus))
