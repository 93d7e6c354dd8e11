"""The job file: ten lines of TOML that name a robot, its sensors and the recordings.

Paths are relative to the file. Unknown keys are refused with the near name; all faults of a file
are reported at once. Seconds count from the start of each recording (see `zero`).
"""

from __future__ import annotations

import difflib
import hashlib
import itertools
import tomllib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import ErrorDetails

from ftcal.compute import HERE
from ftcal.contact import ContactSchedule, Interval
from ftcal.errors import JobError, raise_all, unknown
from ftcal.fit import FitOptions
from ftcal.logs import Layout
from ftcal.motion import STANDARD_GRAVITY
from ftcal.pairing import SignalOptions
from ftcal.signals import JOINT_ORDER, JOINT_WINDOW, SMOOTHING_ORDER, SMOOTHING_WINDOW

if TYPE_CHECKING:
    from jaxtyping import Bool, Float
    from numpy import ndarray as Array

Window = Annotated[tuple[float, float], Field(description="[start, stop) in seconds")]
Six = Annotated[tuple[float, float, float, float, float, float], Field()]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Links = str | Annotated[tuple[str, ...], Field(min_length=1)]
Three = tuple[float, float, float]

PAPER_LAMBDAS = (0.0, 0.5, 1.0, 1.5, 2.0, 4.0, 6.0, 8.0, 10.0)
"""Penalties of the paper's second validation (section IV-C), and none."""


class Section(BaseModel):
    """A table of the job file; keys that it does not know are an error."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=False, populate_by_name=True)


class SensorSection(Section):
    """One F/T sensor: where it is in the robot, in the log, and what its maker says of it."""

    name: str
    """Sensor of the URDF, or the fixed joint it sits in."""
    signal: str
    """Signal of the log that carries its channels, such as `right_leg/analog:o`."""
    workbench: Path | None = None
    """Firmware matrix file (`matrix_SN*.txt`) or a CSV of six rows; none: the log is believed."""
    full_scale: Six | None = None
    """Largest wrench per axis [N, Nm]; taken from the firmware file where it has one."""
    logged: Literal["wrench", "channels"] = "wrench"
    """Whether the log carries N and Nm (calibrated by the Workbench matrix) or raw channels."""
    temperature: str | None = None
    """Signal of the log with its temperature [degree Celsius]."""
    wrench_frame: str | None = None
    """Link in whose axes the log gives its wrench, about its origin; default: its own frame."""

    @model_validator(mode="after")
    def _turned_wrenches(self) -> SensorSection:
        if self.wrench_frame is not None and self.logged == "channels":
            raise ValueError(
                f"sensor {self.name!r}: wrench_frame = {self.wrench_frame!r} is of a wrench in N"
                ' and Nm, and raw channels have no axes; say logged = "wrench", or leave it out'
            )
        return self


class ContactSection(Section):
    """An interval during which one link alone touches the world."""

    start: float
    stop: float
    link: Links


class RecordingSection(Section):
    """One take: where it is, who touched the world, and which seconds train and test."""

    log: Path
    """File or folder."""
    name: str | None = None
    """Name in tables; default: that of the file or folder."""
    contact: Links | None = None
    """Link or frame that touches the world throughout; of several the first stands still."""
    contacts: tuple[ContactSection, ...] = ()
    """Or: intervals with one contact each."""
    gravity: Three = STANDARD_GRAVITY
    """Gravity acceleration in the contact frame [m/s^2]; default: a level sole, z up."""
    imu: str | None = None
    """Signal with the contact's own motion (see `ftcal.pairing`); none: it stands still."""
    train: tuple[Window, ...] | None = None
    """Windows to train on, an offset each; default: all of it, unless `test` is given alone."""
    test: tuple[Window, ...] = ()
    """Windows held out for validation."""
    breaks: dict[str, tuple[float, ...]] | Literal["auto"] = {}
    """Seconds at which the offset of a sensor steps, its name to them; or to be searched for."""
    leave_out: dict[str, tuple[Window, ...]] = {}
    """Windows in which a sensor is not trained on, its name to them."""
    zero: str | None = None
    """Signal whose first sample is second 0; default: the earliest of all."""
    angle: Literal["deg", "rad"] | None = None
    """Unit of the joints; default: the format's own (YARP deg, tables rad)."""
    acceleration: Literal["m/s^2", "g"] | None = None
    """Unit of the accelerations of the imus; default: m/s^2, or what the log declares."""
    angular_velocity: Literal["rad/s", "deg/s"] | None = None
    """Unit of the angular velocities of the imus; default: as logged, or as the log declares."""
    time: str = "time"
    """Tables: column with the stamps."""
    time_unit: Literal["s", "ms", "us", "ns"] | None = None
    """Tables: unit of that column."""
    joints: dict[str, str | tuple[str, ...]] = {}
    """YARP: port to joint names; tables: column to joint name."""
    channels: dict[str, tuple[str, ...]] = {}
    """Tables: signal to its columns."""
    temperatures: dict[str, str] = {}
    """Tables: signal to its column."""
    imus: dict[str, tuple[str, ...]] = {}
    """Tables: signal to its columns."""

    @model_validator(mode="after")
    def _consistent(self) -> RecordingSection:
        faults = [
            f"window [{a:g}, {b:g}] ends before it starts"
            for a, b in (*(self.train or ()), *self.test, *sum(self.leave_out.values(), ()))
            if not b > a
        ]
        if (self.contact is None) == (not self.contacts):
            faults.append("give either contact = LINK or contacts = [{start, stop, link}]")
        size = float(np.linalg.norm(self.gravity))
        if not 9.7 < size < 9.9:
            faults.append(
                f"gravity has length {size:.3g}; it is in m/s^2 and about 9.81 long on Earth"
            )
        windows = sorted((*(self.train or ()), *self.test))
        faults += [
            f"windows [{a[0]:g}, {a[1]:g}] and [{b[0]:g}, {b[1]:g}] overlap"
            for a, b in itertools.pairwise(windows)
            if b[0] < a[1]
        ]
        if faults:
            raise ValueError("; ".join(faults))
        return self

    @property
    def label(self) -> str:
        """Name in tables and in the calibration."""
        return self.name or self.log.stem or str(self.log)

    @property
    def known_breaks(self) -> dict[str, tuple[float, ...]]:
        """The breaks that are given; none while they are to be searched for."""
        return self.breaks if self.breaks != "auto" else {}

    def trained_on(self, sensor: str, time: Float[Array, "N"]) -> Bool[Array, "N"]:
        """Return which times [s] are not left out; what is held out stays, however it is."""
        windows = self.leave_out.get(sensor, ())
        out = np.zeros(len(time), dtype=bool)
        for start, stop in windows:
            out |= (time >= start) & (time < stop)
        for start, stop in self.test if windows else ():
            out &= (time < start) | (time >= stop)
        return ~out

    @property
    def trains(self) -> bool:
        """Whether any of it is trained on."""
        return bool(self.train) or (self.train is None and not self.test)

    def schedule(self) -> ContactSchedule:
        """Return who touches the world when; `JobError` where intervals overlap or end early."""
        if self.contact is not None:
            return ContactSchedule((interval(-np.inf, np.inf, self.contact),))
        try:
            return ContactSchedule(tuple(interval(c.start, c.stop, c.link) for c in self.contacts))
        except JobError as error:
            raise JobError(f"recording {self.label!r}: {error}") from error

    def layout(self) -> Layout:
        """Return what the reader is told about the log."""
        return Layout(
            joints={k: (v,) if isinstance(v, str) else v for k, v in self.joints.items()},
            angle=self.angle,
            acceleration=self.acceleration,
            angular_velocity=self.angular_velocity,
            time=self.time,
            time_unit=self.time_unit,
            channels=self.channels,
            temperatures=self.temperatures,
            imus=self.imus,
            zero=self.zero,
        )


def interval(start: float, stop: float, links: str | tuple[str, ...]) -> Interval:
    """Return the interval during which `links` touch, the first of them standing still."""
    first, *others = (links,) if isinstance(links, str) else links
    return Interval(start, stop, first, tuple(others))


class SignalsSection(Section):
    """Smoothing; the defaults suit walking-pace motions logged at 50 Hz or more."""

    joint_window: Positive = JOINT_WINDOW
    """Savitzky-Golay window of the joint positions [s]."""
    joint_order: Annotated[int, Field(ge=2)] = JOINT_ORDER
    """Its polynomial order."""
    smoothing: Positive = SMOOTHING_WINDOW
    """Window of the filter that channels and model wrench share [s]."""
    smoothing_order: Annotated[int, Field(ge=0)] = SMOOTHING_ORDER
    """Its polynomial order."""
    max_gap: Positive | None = None
    """Longest time between two samples that is not a hole [s]; default: five periods."""

    def options(self) -> SignalOptions:
        """Return the options of the pairing step."""
        return SignalOptions(**self.model_dump())


class FitSection(Section):
    """How strongly the Workbench matrix is believed."""

    scope: Literal["each sensor", "whole body"] = "each sensor"
    """Each sensor from its own free limb, or all at once from every free sub-model."""
    kappa: Positive | Literal["auto"] | None = None
    """Scaled prior: expected bend of the secondary matrix, fraction of full scale."""
    penalty: NotNegative | None = Field(default=None, alias="lambda")
    """The paper's lambda instead (0 is plain least squares)."""
    offset: Literal["centred", "in situ"] = "centred"
    """How the offset leaves the regression."""
    noise: Six | None = None
    """Residual standard deviation per axis [N, Nm]; default: measured."""
    samples_per_independent: Annotated[float, Field(ge=1)] | None = None
    """Samples that count as one; default: measured."""
    folds: Annotated[int, Field(ge=2, le=100)] = 5
    """Blocks of every cross-validation."""
    robust: bool = False
    """Whether seconds that do not fit count less; not with `lambda`."""

    @model_validator(mode="after")
    def _one_prior(self) -> FitSection:
        if self.kappa is not None and self.penalty is not None:
            raise ValueError("give kappa or lambda, not both")
        if self.robust and self.penalty is not None:
            raise ValueError("robust weights need kappa: lambda is the paper's fit, all alike")
        if self.noise is not None and not min(self.noise) > 0:
            raise ValueError("noise must be positive on every axis")
        return self

    @property
    def strength(self) -> float | None:
        """Kappa, or None where it is to be chosen."""
        return None if self.kappa == "auto" else self.kappa

    def options(self) -> FitOptions:
        """Return the options of the fit."""
        return FitOptions(
            kappa=self.strength,
            penalty=self.penalty,
            noise=self.noise,
            samples_per_independent=self.samples_per_independent,
            folds=self.folds,
            robust=self.robust,
        )


class PayloadSection(Section):
    """A body on a link that the robot description may lack."""

    link: str
    """Link, or frame, on which it is suspected."""
    mass: Positive = 1.0
    """Standard deviation of its mass [kg]."""
    com: Positive = 0.1
    """Standard deviation of each coordinate of its centre of mass in the link's frame [m]."""


class WholeBodySection(Section):
    """The fit of all sensors at once, with `[fit] scope = "whole body"`."""

    strength: Literal["stretches", "evidence"] = "stretches"
    """How kappa is chosen: by holding out stretches in turn, or by the evidence."""
    smoothing: Positive = 0.25
    """Window of the filter that channels and h of a balance share [s]."""
    by_mass: bool = False
    """Whether sub-models with joints that are not logged enter by their mass (forces alone)."""
    mass: NotNegative = 0.005
    """Standard deviation of the mass of a sub-model, as a share of it."""
    com: NotNegative = 0.005
    """Standard deviation of each coordinate of its centre of mass [m]."""
    diagnose: bool = True
    """Whether logs are searched for wrong frames, signs and robots where the fit looks odd."""
    joint_zeros: Positive | None = None
    """Standard deviation of the zero of every encoder [rad]; none: not suspected."""
    zeros_of: tuple[str, ...] = ()
    """Joints whose zeros are suspected; default: all revolute ones that are logged."""
    floor_tilt: Positive | None = None
    """Standard deviation of the tilt of what a link stands on [rad]; none: not suspected."""
    payloads: tuple[PayloadSection, ...] = ()
    """Bodies suspected."""

    @model_validator(mode="after")
    def _zeros_have_a_size(self) -> WholeBodySection:
        if self.zeros_of and self.joint_zeros is None:
            raise ValueError("zeros_of needs joint_zeros, their standard deviation in rad")
        return self


class StudySection(Section):
    """The paper's two validations: which data sets train, and which run switches contacts."""

    training: tuple[str, ...] = ()
    """Recordings to train on, one at a time; default: all but `switching`."""
    switching: str | None = None
    """Recording of the second validation; none: the first validation alone."""
    align: Window | None = None
    """Seconds of it that give each sensor its offset; default: the first interval that can."""
    lambdas: Annotated[tuple[NotNegative, ...], Field(min_length=1)] = PAPER_LAMBDAS
    """Penalties tried in the second validation."""
    truth: Path | None = None
    """`truth.json` of a simulation: the report then shows the distance to it."""

    @model_validator(mode="after")
    def _consistent(self) -> StudySection:
        if self.align is not None and self.switching is None:
            raise ValueError("align is a window of the switching recording; name it")
        if self.align is not None and not self.align[1] > self.align[0]:
            raise ValueError(f"align {list(self.align)} ends before it starts")
        if self.switching in self.training:
            raise ValueError(f"{self.switching!r} cannot both train and switch contacts")
        return self


class ComputeSection(Section):
    """Where the recordings are read and paired."""

    scheduler: str = HERE
    """`here`, `local` (the cores of this machine), or the address of a Dask scheduler."""
    workers: Annotated[int, Field(ge=1)] | None = None
    """Processes of `local`; default: one a core."""


class Job(Section):
    """A whole job file."""

    robot: Path
    """URDF or xacro."""
    sensors: Annotated[tuple[SensorSection, ...], Field(min_length=1)]
    recordings: Annotated[tuple[RecordingSection, ...], Field(min_length=1)]
    signals: SignalsSection = SignalsSection()
    fit: FitSection = FitSection()
    whole_body: WholeBodySection = WholeBodySection()
    study: StudySection = StudySection()
    compute: ComputeSection = ComputeSection()
    output: Path | None = None
    """Folder of the results; default: `ftcal-out` beside the job file."""
    file: Annotated[Path, Field(exclude=True)] = Path("job.toml")
    """The job file itself (set by `read_job`)."""

    @model_validator(mode="after")
    def _names_once(self) -> Job:
        for kind, names in (
            ("sensor", [s.name for s in self.sensors]),
            ("recording", [r.label for r in self.recordings]),
        ):
            if twice := sorted({name for name in names if names.count(name) > 1}):
                raise ValueError(f"{kind} {', '.join(map(repr, twice))} appears twice; give names")
        labels = [r.label for r in self.recordings]
        sensors = [s.name for s in self.sensors]
        for section in self.recordings:
            timed = [("breaks", name) for name in section.known_breaks]
            for key, name in (*timed, *(("leave_out", name) for name in section.leave_out)):
                if name not in sensors:
                    where = f"recording {section.label!r}: {key}"
                    raise ValueError(f"{where}: {unknown('sensor', name, sensors)}")
            for name, times in section.known_breaks.items():
                if list(times) != sorted(set(times)):
                    raise ValueError(
                        f"recording {section.label!r}: breaks of {name!r} must increase, got"
                        f" {list(times)}"
                    )
        if "Workbench" in labels:
            raise ValueError("a recording cannot be called 'Workbench'; give it another name")
        named = (*self.study.training, *filter(None, (self.study.switching,)))
        if strangers := [unknown("recording", n, labels) for n in named if n not in labels]:
            raise ValueError(f"study: {'; '.join(strangers)}")
        return self

    def path(self, path: Path) -> Path:
        """Return a path of the job file as one that can be opened."""
        return self.file.parent / path

    @property
    def digest(self) -> str:
        """SHA-256 of the job file's text, empty where the job was made in memory."""
        return hashlib.sha256(self.file.read_bytes()).hexdigest() if self.file.is_file() else ""


def read_job(path: Path) -> Job:
    """Return the job that a TOML file describes.

    Raises `JobError`, one line that names every fault with the near key where one is misspelt.
    """
    table = read_toml(path)
    if "file" in table:
        raise JobError(f"{path}: unknown key 'file'")
    try:
        return Job.model_validate({**table, "file": path})
    except ValidationError as error:
        raise_all(JobError, str(path), in_words(error.errors(), table))
        raise


def read_toml(path: Path) -> dict[str, Any]:
    """Return the tables of a TOML file; `JobError` where it is none."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise JobError(f"{path}: cannot be read ({error.strerror})") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise JobError(f"{path}: not TOML: {error}") from error


def in_words(
    errors: Iterable[ErrorDetails],
    table: Mapping[str, Any],
    keys_at: Callable[[Iterable[Any]], list[str]] | None = None,
) -> list[str]:
    """Return what pydantic found as phrases with the key, the value and a remedy.

    A value that fits none of several types is one fault, not one a type. `keys_at` tells the keys
    that the section at some place of the file knows (default: of a job file).
    """
    keys_at = keys_at or keys_beside
    alternatives: dict[str, list[str]] = {}
    for error in errors:
        *parents, key = where = place(error, table)
        name = ".".join(map(str, where))
        message = str(error["msg"]).removeprefix("Value error, ")
        match error["type"]:
            case "extra_forbidden":
                near = difflib.get_close_matches(str(key), keys_at(parents), n=1, cutoff=0.5)
                hint = f"; did you mean {near[0]!r}?" if near else ""
                alternatives[f"unknown key {name!r}{hint}"] = []
            case "missing":
                alternatives[f"{name!r} is missing"] = []
            case "value_error":
                alternatives[f"{name}: {message}" if key else message] = []
            case _:
                shown = repr(error["input"])
                shown = shown if len(shown) <= 40 else f"{shown[:37]}..."
                message = message[0].lower() + message[1:]
                alternatives.setdefault(f"{name} = {shown}", []).append(message)
    return [f"{name}: {' or '.join(m)}" if m else name for name, m in alternatives.items()]


def place(error: ErrorDetails, table: Mapping[str, Any]) -> list[str | int]:
    """Return the keys that lead to a fault, without pydantic's names of types tried."""
    node: Any = table
    keys: list[str | int] = []
    last = len(error["loc"]) - 1
    for depth, part in enumerate(error["loc"]):
        node = dict(enumerate(node)) if isinstance(node, list) else node
        inside = isinstance(node, dict) and part in node
        if inside:
            node = node[part]
        if inside or (error["type"] == "missing" and depth == last):
            keys.append(part)
    return keys or [""]


def keys_beside(parents: Iterable[Any]) -> list[str]:
    """Return the keys that the section at `parents` of a job file knows."""
    section: type[BaseModel] = Job
    sections: dict[str, type[BaseModel]] = {
        "sensors": SensorSection,
        "recordings": RecordingSection,
        "contacts": ContactSection,
        "signals": SignalsSection,
        "fit": FitSection,
        "whole_body": WholeBodySection,
        "payloads": PayloadSection,
        "study": StudySection,
        "compute": ComputeSection,
    }
    for part in parents:
        section = sections.get(str(part), section)
    return [field.alias or name for name, field in section.model_fields.items() if name != "file"]
