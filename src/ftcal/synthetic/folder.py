"""A session → a folder with all that `ftcal calibrate` needs, and the truth beside it."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ftcal.errors import JobError, OutputError, RobotError
from ftcal.firmware import encode
from ftcal.logs import yarp
from ftcal.logs.layout import Layout
from ftcal.motion import STANDARD_GRAVITY
from ftcal.synthetic.logger import Take
from ftcal.synthetic.session import Session

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

ROBOT, JOB, TRUTH = "robot.urdf", "job.toml", "truth.json"
"""Files of a session besides its recordings and its matrix."""


def write_session(session: Session, folder: Path, *, urdf: Path) -> Path:
    """Write a session into `folder` and return its job file.

    Next to `job.toml`: a YARP tree for each recording, the firmware matrix, `robot.urdf` (a copy of
    `urdf`, from which the robot was read) and `truth.json`. A folder that already holds a session
    is replaced entry by entry. Raises `OutputError` where the folder holds anything else or cannot
    be written, `RobotError` where `urdf` is not the robot's.
    """
    robot = _description(session, urdf)
    if folder.is_dir() and any(folder.iterdir()) and not (folder / TRUTH).is_file():
        raise OutputError(f"{folder}: holds other files; give a new or an empty folder")
    staged = folder.with_name(f".{folder.name}.part")
    try:
        shutil.rmtree(staged, ignore_errors=True)
        staged.mkdir(parents=True)
        _fill(session, staged, robot)
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


def read_truth(job: Path) -> dict[str, Float[Array, "6 6"]]:
    """Return the true gain C of each sensor of a job that `write_session` wrote.

    Raises `JobError` where there is no truth beside the job.
    """
    file = job.with_name(TRUTH)
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


def _fill(session: Session, folder: Path, robot: bytes) -> None:
    (folder / ROBOT).write_bytes(robot)
    firmware = session.truth.firmware
    matrix = f"matrix_{firmware.serial}.txt"
    _write_text(folder / matrix, encode(firmware.matrix, firmware.full_scale))
    job = [
        "# A simulated robot: what a calibration should find is in truth.json.",
        f"robot = {_toml(ROBOT)}",
        *("", "[[sensors]]"),
        f"name = {_toml(session.sensor)}",
        f"signal = {_toml(session.signal)}",
        f"workbench = {_toml(matrix)}",
    ]
    if warm := session.recordings[0].temperatures:
        job.append(f"temperature = {_toml(warm[0].name)}")
    for take, recording in zip(session.takes, session.recordings, strict=True):
        layout = yarp.write(recording, folder / take.name)
        job += ["", "[[recordings]]", *_recording(take, layout, recording.duration)]
    _write_text(folder / TRUTH, json.dumps(_truth(session), indent=1) + "\n")
    _write_text(folder / JOB, "\n".join(job) + "\n")


def _recording(take: Take, layout: Layout, duration: float) -> list[str]:
    """Return the lines of one take in the job file."""
    lines = [f"log = {_toml(take.name)}", f"contact = {_toml(take.contact.link)}"]
    if tuple(take.contact.gravity) != STANDARD_GRAVITY:
        lines.append(f"gravity = {_toml(take.contact.gravity)}")
    if take.held_out:
        lines += ["train = []", f"test = [[0.0, {np.ceil(duration + 1e-3)}]]"]
    if layout.joints:
        named = [f"{_toml(port)} = {_toml(names)}" for port, names in layout.joints.items()]
        lines.append(f"joints = {{ {', '.join(named)} }}")
    return lines


def _truth(session: Session) -> Mapping[str, Any]:
    truth = session.truth
    return {
        "sensors": {
            session.sensor: {
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
        }
    }


def _toml(value: object) -> str:
    """Return a text, a number or a row of them as TOML, which writes them as JSON does."""
    return json.dumps(value, ensure_ascii=False)


def _write_text(file: Path, text: str) -> None:
    file.write_text(text, encoding="utf-8", newline="\n")
