"""A session → a folder with all that `ftcal calibrate` needs, and the truth beside it."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ftcal.contact import Interval
from ftcal.errors import JobError, OutputError, RobotError
from ftcal.firmware import encode
from ftcal.logs import tables, yarp
from ftcal.logs.layout import Layout
from ftcal.motion import STANDARD_GRAVITY
from ftcal.recording import Recording
from ftcal.support import Support
from ftcal.synthetic.faults import Faults
from ftcal.synthetic.session import SensorTruth, Session
from ftcal.synthetic.take import Take

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

ROBOT, JOB, TRUTH = "robot.urdf", "job.toml", "truth.json"
"""Files of a session besides its recordings and its matrices."""

Form = Literal["yarp", "parquet", "csv"]
"""How recordings are written."""

ROUNDING = 0.01
"""Contact intervals are written in whole steps of this [s]."""


def write_session(session: Session, folder: Path, *, urdf: Path, form: Form = "yarp") -> Path:
    """Write a session into `folder` and return its job file.

    Next to `job.toml`: each recording as a YARP tree or a folder of tables, the firmware matrices,
    `robot.urdf` (a copy of `urdf`, from which the robot was read) and `truth.json`. A folder that
    already holds a session is replaced entry by entry. Raises `OutputError` where the folder holds
    anything else or cannot be written, `RobotError` where `urdf` is not the robot's.
    """
    robot = _description(session, urdf)
    if folder.is_dir() and any(folder.iterdir()) and not (folder / TRUTH).is_file():
        raise OutputError(f"{folder}: holds other files; give a new or an empty folder")
    staged = folder.with_name(f".{folder.name}.part")
    try:
        shutil.rmtree(staged, ignore_errors=True)
        staged.mkdir(parents=True)
        _fill(session, staged, robot, form)
        folder.mkdir(exist_ok=True)
        # the job comes last: where it is, all that it names is
        for entry in sorted(staged.iterdir(), key=lambda path: (path.name == JOB, path.name)):
            target = folder / entry.name
            if target.is_dir():
                shutil.rmtree(target)
            entry.replace(target)
        staged.rmdir()
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written ({error.strerror or error})") from error
    finally:
        shutil.rmtree(staged, ignore_errors=True)
    return folder / JOB


def read_truth(file: Path) -> dict[str, Float[Array, "6 6"]]:
    """Return the true gain C of each sensor from the truth that `write_session` wrote.

    Raises `JobError` where the file is none.
    """
    try:
        sensors = json.loads(file.read_text(encoding="utf-8"))["sensors"]
        return {
            name: np.array(sensor["gain"], dtype=np.float64) for name, sensor in sensors.items()
        }
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise JobError(f"{file}: not the truth of a simulation ({error})") from error


def _description(session: Session, urdf: Path) -> bytes:
    """Return the text of the URDF, which must be that of the robot simulated."""
    try:
        text = urdf.read_bytes()
    except OSError as error:
        raise RobotError(f"{urdf}: {error.strerror or error}") from error
    if hashlib.sha256(text).hexdigest() != session.robot.digest:
        raise RobotError(
            f"{urdf}: not the file from which robot {session.robot.name!r} was read; give that one"
            " (a xacro expanded to a URDF)"
        )
    return text


def _fill(session: Session, folder: Path, robot: bytes, form: Form) -> None:
    (folder / ROBOT).write_bytes(robot)
    job = [
        "# A simulated robot: what a calibration should find is in truth.json.",
        f"robot = {_toml(ROBOT)}",
    ]
    for name, signal in session.sensors.items():
        firmware = session.truth[name].firmware
        matrix = f"matrix_{firmware.serial}.txt"
        _write_text(folder / matrix, encode(firmware.matrix, firmware.full_scale))
        job += ["", "[[sensors]]", f"name = {_toml(name)}", f"signal = {_toml(signal)}"]
        job.append(f"workbench = {_toml(matrix)}")
        if name in session.thermometers:
            job.append(f"temperature = {_toml(session.thermometers[name])}")
    for take, recording in zip(session.takes, session.recordings, strict=True):
        said = FORMS[form](recording, folder / take.name)
        job += ["", "[[recordings]]", *_recording(take, recording.duration), *said]
    _write_text(folder / TRUTH, json.dumps(_truth(session), indent=1) + "\n")
    _write_text(folder / JOB, "\n".join(job) + "\n")


def _recording(take: Take, duration: float) -> list[str]:
    """Return what the job file says of one take but for its format."""
    lines = [f"log = {_toml(take.name)}", *_contacts(take.support, duration)]
    if tuple(take.support.gravity) != STANDARD_GRAVITY:
        lines.append(f"gravity = {_toml(take.support.gravity)}")
    if take.held_out:
        lines += ["train = []", f"test = [[0.0, {_end(duration)}]]"]
    return lines


def _contacts(support: Support, duration: float) -> list[str]:
    """Return who touches, and when, as the job file says it.

    Spans are rounded inwards: nothing is said of the moment of a switch.
    """
    spans = support.schedule().intervals
    if len(spans) == 1:
        return [f"contact = {_toml(_links(spans[0]))}"]
    lines = []
    for span in spans:
        start = np.ceil(span.start / ROUNDING) * ROUNDING
        stop = np.floor(min(span.stop, _end(duration)) / ROUNDING) * ROUNDING
        if stop > start:
            links = _toml(_links(span))
            lines.append(f"    {{ start = {start:.2f}, stop = {stop:.2f}, link = {links} }},")
    return ["contacts = [", *lines, "]"]


def _links(span: Interval) -> str | tuple[str, ...]:
    return span.touching if span.others else span.link


def _end(duration: float) -> float:
    """Return a whole second after the last sample."""
    return float(np.ceil(duration + 1e-3))


def _yarp(recording: Recording, folder: Path) -> list[str]:
    """Write a YARP tree; return what the job file says of it."""
    return _tables_of(joints=yarp.write(recording, folder).joints)


def _parquet(recording: Recording, folder: Path) -> list[str]:
    """Write a folder of Parquet tables; return what the job file says of it."""
    return _columns(tables.write(recording, folder, suffix=".parquet"))


def _csv(recording: Recording, folder: Path) -> list[str]:
    """Write a folder of CSV tables; return what the job file says of it."""
    return _columns(tables.write(recording, folder, suffix=".csv"))


FORMS: Mapping[Form, Callable[[Recording, Path], list[str]]] = {
    "yarp": _yarp,
    "parquet": _parquet,
    "csv": _csv,
}
"""How a recording may be written."""


def _columns(layout: Layout) -> list[str]:
    zero = [f"zero = {_toml(layout.zero)}"]
    return zero + _tables_of(channels=layout.channels, temperatures=layout.temperatures)


def _tables_of(**tables: Mapping[str, object]) -> list[str]:
    """Return inline tables of the job file, those left out that are empty."""
    lines = []
    for key, table in tables.items():
        named = [f"{_toml(name)} = {_toml(value)}" for name, value in table.items()]
        if named:
            lines.append(f"{key} = {{ {', '.join(named)} }}")
    return lines


def _truth(session: Session) -> Mapping[str, Any]:
    truth: dict[str, Any] = {
        "sensors": {name: _sensor_truth(known) for name, known in session.truth.items()}
    }
    if session.faults != Faults():
        truth["faults"] = asdict(session.faults)
        truth["joint_zeros"] = session.joint_zeros
        truth["links"] = {
            name: {"mass": link.mass, "com": link.com.tolist()}
            for name, link in session.real.links.items()
            if link.mass > 0.0
        }
    return truth


def _sensor_truth(truth: SensorTruth) -> Mapping[str, Any]:
    return {
        "law": "w = C r + o + k (T - T_ref); r in counts, w in N and Nm",
        "gain": truth.gain.tolist(),
        "secondary": truth.secondary.tolist(),
        "offsets": {name: offset.tolist() for name, offset in truth.offsets.items()},
        "temperature_gain": None
        if truth.temperature_gain is None
        else truth.temperature_gain.tolist(),
        "reference_temperature": truth.reference_temperature,
        "workbench": truth.firmware.matrix.tolist(),
        "full_scale": truth.firmware.full_scale.tolist(),
    }


def _toml(value: object) -> str:
    """Return a text, a number or a row of them as TOML, which writes them as JSON does."""
    return json.dumps(value, ensure_ascii=False)


def _write_text(file: Path, text: str) -> None:
    file.write_text(text, encoding="utf-8", newline="\n")
