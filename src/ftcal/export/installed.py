"""What a robot computes from one sensor, as its files say it: `w = M x + o + k (T - T_ref)`.

A file either maps raw channels, x = r and M = C, or the wrench that the sensor's board already
sends, x = C_w r and M = S = C C_w^-1 (the secondary matrix). With the Workbench both say the same.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ftcal.applying import ZERO, chosen_offset, refused
from ftcal.calibration import Calibration, SensorCalibration
from ftcal.errors import SensorError, raise_all
from ftcal.sensor import AXES, Workbench

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

Reads = Literal["channels", "wrench"]
"""What a matrix is applied to: raw channels r, or the Workbench's wrench C_w r."""


@dataclass(frozen=True, slots=True, eq=False)
class Installed:
    """One sensor as a robot reads it."""

    sensor: str
    """Name in the robot description; the serial number where a file knows no other."""
    reads: Reads
    """What x is."""
    matrix: Float[Array, "6 K"]
    """M [N or Nm per unit of x]."""
    offset: Float[Array, "6"]
    """o, added [N, Nm]."""
    temperature_gain: Float[Array, "6"] | None = None
    """k [N/K, Nm/K], or None."""
    reference_temperature: float = 0.0
    """T_ref [degree Celsius]."""
    workbench: Workbench | None = None
    """The prior, where it is known: what turns C into S and back."""
    about: Mapping[str, Any] | None = None
    """Provenance: what a person asks of the file later; plain JSON."""

    def __post_init__(self) -> None:
        warm = np.zeros(6) if self.temperature_gain is None else self.temperature_gain
        shapes = self.matrix.ndim == 2 and self.matrix.shape[0] == len(self.offset) == len(warm)
        finite = all(np.isfinite(part).all() for part in (self.matrix, self.offset, warm))
        if not (shapes and len(warm) == 6 and finite and np.isfinite(self.reference_temperature)):
            raise SensorError(
                f"sensor {self.sensor!r}: matrix {self.matrix.shape} and offset"
                f" {self.offset.shape} must be 6 x K and 6 finite numbers"
            )

    def on(self, reads: Reads) -> Installed:
        """Return the same law on x = `reads`.

        Raises `SensorError` where the Workbench is not known, or K is not 6 and S does not exist.
        """
        if reads == self.reads:
            return self
        if self.workbench is None:
            raise SensorError(
                f"sensor {self.sensor!r}: its file says what to do with its {self.reads} alone;"
                " compare with calibration.json, which knows the Workbench"
            )
        if reads == "channels":
            return replace(self, reads=reads, matrix=self.matrix @ self.workbench.gain)
        secondary = self.workbench.secondary(self.matrix)
        if secondary is None:
            raise SensorError(
                f"sensor {self.sensor!r} has {self.matrix.shape[1]} channels, so no matrix"
                " S = C C_w^-1; export --to c, json, npz or ati"
            )
        # a row that is the Workbench's own is exactly that of the identity, not nearly
        kept = (self.matrix == self.workbench.gain).all(axis=1)
        return replace(self, reads=reads, matrix=np.where(kept[:, None], np.eye(6), secondary))

    @property
    def full_scale(self) -> Float[Array, "6"] | None:
        """Largest wrench of each axis [N, Nm], where it is known."""
        return None if self.workbench is None else self.workbench.full_scale

    @property
    def signal(self) -> str | None:
        """Name of the sensor's signal in logs, where it is known."""
        return None if self.about is None else str(self.about["signal"])


@dataclass(frozen=True, slots=True, eq=False)
class Sheet:
    """The sensors that go into one file, and where they come from."""

    origin: Mapping[str, Any]
    """ftcal, created, calibration, sha256, robot, undo: plain JSON."""
    sensors: tuple[Installed, ...]


def installed(sensor: SensorCalibration, offset: str, *, undo: bool = False) -> Installed:
    """Return the law to install, on raw channels: the deployed gain, or with `undo` the prior.

    `offset` as in `applying.chosen_offset`; `undo` has none. Raises `DataError` for an unknown one.
    """
    prior = sensor.workbench()
    found, source = chosen_offset(sensor, "", ZERO if undo else offset)
    warm = None if undo or sensor.temperature_gain is None else np.array(sensor.temperature_gain)
    about = {
        "sensor": sensor.sensor,
        "signal": sensor.signal,
        "frame": sensor.frame,
        "acts_on": sensor.acts_on,
        "verdicts": {verdict.axis: verdict.verdict for verdict in sensor.verdicts},
        "keeps_workbench": list(AXES if undo else refused(sensor)),
        "offset_of": source,
        "temperature_signal": sensor.temperature_signal,
        "envelope": {name: list(span) for name, span in sensor.envelope.items()},
        "workbench": sensor.prior.name,
        "logged": sensor.logged,
        "workbench_gain": sensor.prior.gain,
        "full_scale": sensor.prior.full_scale,
    }
    if sensor.wrench_frame is not None:
        about["wrench_frame"] = sensor.wrench_frame
    return Installed(
        sensor.sensor, "channels", prior.gain if undo else np.array(sensor.gain),
        np.array(found.offset), warm, sensor.reference_temperature if warm is not None else 0.0,
        prior, about,
    )  # fmt: skip


def remembered(about: Mapping[str, Any]) -> Workbench:
    """Return the Workbench that the provenance of a sensor holds.

    Raises `SensorError` where the provenance was edited beyond use.
    """
    try:
        str(about["sensor"]), str(about["signal"])
        if about["logged"] not in ("wrench", "channels"):
            raise ValueError(f"logged {about['logged']!r}")
        return Workbench(
            str(about["workbench"]),
            np.array(about["workbench_gain"], dtype=np.float64),
            np.array(about["full_scale"], dtype=np.float64).reshape(6),
            about["logged"],
        )
    except (KeyError, TypeError, ValueError) as error:
        raise SensorError(f"provenance of a sensor: {error!r}; export the file again") from error


def with_provenance(law: Installed, about: Mapping[str, Any] | None) -> Installed:
    """Return a law with what its file says of it beside the numbers; as it is, where that is None.

    Raises `SensorError` as `remembered` does.
    """
    if about is None:
        return law
    return replace(law, sensor=str(about["sensor"]), workbench=remembered(about), about=about)


def sheet(
    calibration: Calibration,
    origin: Mapping[str, Any],
    *,
    sensors: tuple[str, ...] = (),
    offset: str,
    undo: bool = False,
) -> Sheet:
    """Return what goes into the files: the named sensors, or all. Raises `SensorError`."""
    chosen = [calibration.sensor(name) for name in sensors] or calibration.sensors
    bare = [sensor.sensor for sensor in chosen if not sensor.offsets]
    if not undo and offset != ZERO:
        remedy = "has no offset; give --offset zero"
        raise_all(SensorError, "calibration", [f"sensor {name!r} {remedy}" for name in bare])
    laws = tuple(installed(sensor, offset, undo=undo) for sensor in chosen)
    names = [identifier(law.sensor) for law in laws]
    twice = sorted({law.sensor for law in laws if names.count(identifier(law.sensor)) > 1})
    if twice:
        raise SensorError(
            f"sensors {', '.join(twice)} cannot be told apart in a file; export them by --sensor"
        )
    return Sheet({**origin, "robot": calibration.robot, "undo": undo}, laws)


def identifier(name: str) -> str:
    """Return a name that a file, a C program and a parameter tree may bear."""
    plain = re.sub(r"\W", "_", name, flags=re.ASCII)
    return plain if not plain[:1].isdigit() else f"_{plain}"
