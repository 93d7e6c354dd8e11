"""`calibration.json`: what a calibration found, with its evidence and provenance.

The JSON Schema is generated from these models (`schema()`, committed as
`docs/calibration.schema.json`). Law and sign: `w = C r + o + k (T - T_ref)`, force first, acting
on the link that `acts_on` names, expressed in `frame`.
"""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from pydantic import (
    BaseModel,
    ConfigDict,
    SerializerFunctionWrapHandler,
    ValidationError,
    model_serializer,
)

from ftcal.errors import OutputError, SensorError, unknown
from ftcal.sensor import SensorModel, Workbench

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

ChosenBy = Literal[
    "job", "blocked cross-validation", "second validation", "held-out stretches", "evidence"
]
"""What chose the strength of a prior."""

Row = list[float]
Matrix = list[Row]


class Record(BaseModel):
    """A table of the file; unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)


class Input(Record):
    """A file or folder that was read."""

    role: Literal["job", "robot", "recording", "workbench"]
    path: str
    """As the job names it."""
    sha256: str


class Provenance(Record):
    """What made the calibration."""

    ftcal: str
    python: str
    numpy: str
    created: str
    """UTC, ISO 8601."""
    inputs: list[Input]


class Centre(Record):
    """Where a stretch of a recording knows its wrench best: at its mean."""

    inputs: Row
    """Mean of the channels [channel unit], then of T - T_ref [K] where a temperature is logged."""
    sd: Row
    """Standard deviation of the wrench at `inputs`, whatever the gain [N, Nm]."""


class Offset(Record):
    """The offset of one stretch of one recording."""

    recording: str
    start: float
    """Seconds since the start of the recording."""
    stop: float
    """Seconds since the start of the recording, exclusive."""
    offset: Row
    """o of `w = C r + o` with the deployed `gain` [N, Nm]."""
    sd: Row
    """Posterior standard deviation [N, Nm]."""
    centre: Centre | None = None
    """About which the error of the gain turns; null where it is not known."""


class Prior(Record):
    """What was believed before, and how strongly."""

    name: str
    """Serial number or source of the Workbench matrix."""
    gain: Matrix
    """C_w, six rows of K [N or Nm per channel unit]."""
    full_scale: Row
    """Largest wrench per axis [N, Nm]."""
    form: Literal["kappa", "lambda"]
    """Scaled prior of secondary-matrix entries, or the paper's penalty."""
    strength: float | Row
    """kappa (fraction of full scale), or lambda; six where axes differ."""
    chosen_by: ChosenBy


class AxisVerdict(Record):
    """Whether the new row of this axis may be trusted, and why."""

    axis: str
    verdict: Literal["ACCEPT", "PARTIAL", "REFUSE"]
    reason: str


class HealthFinding(Record):
    """What the data doctor found in this sensor's signals."""

    recording: str
    kind: str
    signal: str
    start: float
    """Seconds since the start of the recording."""
    stop: float
    """Seconds since the start of the recording, exclusive."""
    cut: bool
    """Whether those samples were left out."""
    message: str


class SensorCalibration(Record):
    """One sensor."""

    sensor: str
    """Name in the robot description."""
    signal: str
    """Signal of the logs it was fitted to."""
    logged: Literal["wrench", "channels"]
    """Whether logs carry the Workbench's wrench or raw channels."""
    frame: str
    """Frame that expresses the wrench: a link, or `SENSOR (origin)` of the URDF's sensor tag."""
    acts_on: str
    """Link on which the measured wrench acts."""
    wrench_frame: str | None = None
    """Link in whose axes logs carry the wrench, about the sensor's origin; left out: `frame`."""
    temperature_signal: str | None
    """Signal with the sensor's temperature, if any."""
    gain: Matrix
    """C to deploy, six rows of K; refused axes keep the Workbench row."""
    fitted_gain: Matrix
    """C as fitted, all rows."""
    secondary: Matrix | None
    """S = C C_w^-1 of the deployed gain; null unless K is 6."""
    temperature_gain: Row | None
    """k [N/K, Nm/K]; null where no temperature was logged."""
    reference_temperature: float
    """T_ref [degree Celsius]."""
    offsets: list[Offset]
    covariance: list[Matrix]
    """Posterior covariance of each row of the fitted `[C, k]`."""
    envelope: dict[str, tuple[float, float]]
    """Smallest and largest load that training saw, per axis and of force and torque [N, Nm]."""
    noise_sd: Row
    """Residual standard deviation [N, Nm]."""
    inefficiency: Row
    """Samples that count as one independent sample."""
    prior: Prior
    verdicts: list[AxisVerdict]
    health: list[HealthFinding]

    @model_serializer(mode="wrap")
    def _as_short_as_can_be(self, plain: SerializerFunctionWrapHandler) -> dict[str, Any]:
        fields: dict[str, Any] = plain(self)
        if self.wrench_frame is None:
            del fields["wrench_frame"]
        return fields

    @property
    def coefficients(self) -> Float[Array, "6 P"]:
        """`[C, k]` as deployed."""
        gain = np.array(self.gain)
        if self.temperature_gain is None:
            return gain
        return np.column_stack([gain, self.temperature_gain])

    def in_own_frame(self) -> SensorCalibration:
        """Return the calibration as one of readings that are in the sensor's frame already."""
        return self.model_copy(update={"wrench_frame": None})

    def workbench(self) -> Workbench:
        """Return the prior as a Workbench."""
        return Workbench(
            self.prior.name,
            np.array(self.prior.gain),
            np.array(self.prior.full_scale),
            self.logged,
        )

    def model(self, offset: Row | None = None) -> SensorModel:
        """Return the deployed sensor law with `offset`, or that of the last segment."""
        return SensorModel(
            np.array(self.gain),
            np.array(self.offsets[-1].offset if offset is None else offset),
            None if self.temperature_gain is None else np.array(self.temperature_gain),
            self.reference_temperature,
        )


class Calibration(Record):
    """The whole file."""

    format: Literal["ftcal-calibration"] = "ftcal-calibration"
    version: Literal[1] = 1
    robot: str
    sensors: list[SensorCalibration]
    provenance: Provenance

    def sensor(self, name: str) -> SensorCalibration:
        """Return the calibration of one sensor; `SensorError` offers near names."""
        by_name = {sensor.sensor: sensor for sensor in self.sensors}
        if name not in by_name:
            raise SensorError(unknown("calibrated sensor", name, by_name))
        return by_name[name]


def schema() -> dict[str, Any]:
    """Return the JSON Schema of `calibration.json` (draft 2020-12)."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **Calibration.model_json_schema(),
    }


def read_calibration(path: Path) -> Calibration:
    """Return the calibration in a file; `SensorError` says in one line what is wrong with it."""
    try:
        return Calibration.model_validate_json(path.read_bytes())
    except OSError as error:
        raise SensorError(f"{path}: cannot be read ({error.strerror})") from error
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise SensorError(
            f"{path}: not a calibration of ftcal: {where or 'file'}: {first['msg']}"
        ) from error


def write_whole(path: Path, content: bytes) -> None:
    """Write a file whole or not at all: into a neighbour first, then renamed over.

    Raises `OutputError` where the folder cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(content)
            Path(name).chmod(0o644)
            Path(name).replace(path)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise
    except OSError as error:
        raise OutputError(
            f"{path}: cannot be written ({error.strerror}); name another folder with -o"
        ) from error


def to_json(record: BaseModel | dict[str, Any]) -> bytes:
    """Return a record as indented JSON text."""
    plain = record.model_dump(mode="json") if isinstance(record, BaseModel) else record
    return (json.dumps(plain, indent=1, allow_nan=False) + "\n").encode()
