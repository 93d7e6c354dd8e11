"""A calibration as the file a robot's software reads: encoded, read back, compared, written.

| `--to` | for | reads | file |
|---|---|---|---|
| `yarp` | wholeBodyDynamics | the board's wrench | one XML |
| `firmware` | the iCub sensor's board | ADC counts | `matrix_SN*.txt` a sensor |
| `ros` | force_torque_sensor_broadcaster | the driver's wrench | one YAML |
| `ati` | readers of ATI's `.cal` | raw channels | one XML a sensor |
| `c` | control loops | what the log carried | one header |
| `json`, `npz` | anything else | raw channels | one file |
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ftcal import __version__
from ftcal.calibration import Calibration, read_calibration, write_whole
from ftcal.errors import OutputError, SensorError, raise_all
from ftcal.export import ati, c_header, firmware_file, plain, ros, yarp
from ftcal.export.installed import Installed, Sheet, installed, sheet

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

__all__ = ["FORMATS", "Exported", "Installed", "export", "origin", "pieces", "read"]


def nothing(_: Installed) -> Float[Array, "6 1"]:
    """Return the rounding of a format that has none."""
    return np.zeros((6, 1))


@dataclass(frozen=True, slots=True)
class Format:
    """One kind of file."""

    encode: Callable[[Sheet], bytes]
    decode: Callable[[bytes, str], tuple[Installed, ...]]
    carried: Callable[[Installed], Installed]
    """What of a law the file holds, and on which x."""
    remarks: Callable[[Installed], list[str]]
    """What a person is told of a sensor: what was left out, and what that costs."""
    file: str | Callable[[Installed], str]
    """Name of the one file, or of that of each sensor."""
    rounding: Callable[[Installed], Float[Array, "6 1"]] = nothing
    """How far an entry of the matrix may be off after reading back."""
    beside: Callable[[Sheet, bytes], bytes] | None = None
    """Neighbour with the provenance, where the file has no place for it."""


FORMATS = {
    "yarp": Format(yarp.encode, yarp.decode, yarp.carried, yarp.remarks, "ft_calibration.xml"),
    "firmware": Format(
        firmware_file.encode, firmware_file.decode, firmware_file.carried, firmware_file.remarks,
        firmware_file.file_name, firmware_file.rounding, firmware_file.beside,
    ),
    "ros": Format(ros.encode, ros.decode, ros.carried, ros.remarks, "ft_broadcasters.yaml"),
    "ati": Format(ati.encode, ati.decode, ati.carried, ati.remarks, ati.file_name),
    "c": Format(
        c_header.encode, c_header.decode, c_header.carried, c_header.remarks, "ft_calibration.h"
    ),
    "json": Format(
        plain.encode_json, plain.decode_json, plain.carried, plain.remarks, "ft_calibration.json"
    ),
    "npz": Format(
        plain.encode_npz, plain.decode_npz, plain.carried, plain.remarks, "ft_calibration.npz"
    ),
}  # fmt: skip

BY_SUFFIX = {
    ".xml": "yarp", ".txt": "firmware", ".yaml": "ros", ".yml": "ros", ".cal": "ati", ".h": "c",
    ".json": "json", ".npz": "npz",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Exported:
    """What was written."""

    files: tuple[Path, ...]
    remarks: dict[str, list[str]]
    """By sensor: what the files leave out or ask for."""


def origin(path: Path, calibration: Calibration) -> dict[str, Any]:
    """Return where a file comes from: the same calibration makes the same file, byte for byte."""
    return {
        "ftcal": __version__,
        "calibration": path.name,
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        "created": calibration.provenance.created,
        "calibrated_with": calibration.provenance.ftcal,
    }


def pieces(kind: str, whole: Sheet) -> dict[str, bytes]:
    """Return the files of a format by name, each read back and found to say the same.

    Raises `SensorError` for what the format cannot hold.
    """
    chosen = FORMATS[kind]
    name = chosen.file
    parts = (
        {name: whole}
        if isinstance(name, str)
        else {name(law): Sheet(whole.origin, (law,)) for law in whole.sensors}
    )
    if not isinstance(name, str) and len(parts) < len(whole.sensors):
        raise SensorError(
            f"two sensors make the same file ({', '.join(parts)}); export by --sensor"
        )
    made: dict[str, bytes] = {}
    for file, part in parts.items():
        content = chosen.encode(part)
        check(chosen, part, chosen.decode(content, file), file)
        if chosen.beside is not None:
            made[f"{file}.json"] = chosen.beside(part, content)
        made[file] = content
    return made


def check(chosen: Format, part: Sheet, found: tuple[Installed, ...], file: str) -> None:
    """Raise `OutputError` unless what was read back is what went in."""
    if len(found) != len(part.sensors):
        raise OutputError(f"{file}: {len(found)} sensors read back, {len(part.sensors)} written")
    faults = []
    for law, back in zip(part.sensors, found, strict=True):
        told = chosen.carried(law)
        zero = np.zeros(6)
        warm = told.temperature_gain if told.temperature_gain is not None else zero
        same = (
            back.matrix.shape == told.matrix.shape
            and bool((np.abs(back.matrix - told.matrix) <= chosen.rounding(law)).all())
            and np.array_equal(back.offset, told.offset)
            and np.array_equal(
                warm, zero if back.temperature_gain is None else back.temperature_gain
            )
            and (told.temperature_gain is None
                 or back.reference_temperature == told.reference_temperature)
        )  # fmt: skip
        if not same:
            faults.append(f"sensor {law.sensor!r} reads back otherwise than it was written")
    raise_all(OutputError, file, faults)


def export(
    source: Path,
    kind: str,
    output: Path,
    *,
    sensors: tuple[str, ...] = (),
    offset: str,
    undo: bool = False,
    into_folder: bool = False,
) -> Exported:
    """Write the calibration in the file `source` as `kind` (a key of `FORMATS`) to `output`.

    `output` is the folder where it is one, has no suffix or is said to be (`into_folder`), else the
    one file. Every file is made, read back and compared before the first is written. Raises
    `FtcalError`.
    """
    calibration = read_calibration(source)
    whole = sheet(
        calibration, origin(source, calibration), sensors=sensors, offset=offset, undo=undo
    )
    made = pieces(kind, whole)
    main = [name for name in made if not (FORMATS[kind].beside and name.endswith(".json"))]
    if output.suffix and not into_folder and not output.is_dir():
        if len(main) > 1:
            raise OutputError(
                f"{output}: {kind} makes {len(main)} files here; name a folder, or --sensor"
            )
        placed = {output.with_name(output.name + name.removeprefix(main[0])): name for name in made}
    else:
        placed = {output / name: name for name in made}
    if source.resolve() in {path.resolve() for path in placed}:
        raise OutputError(f"{source}: would be overwritten by its own export; name another file")
    for path, name in placed.items():
        write_whole(path, made[name])
        if path.read_bytes() != made[name]:
            raise OutputError(f"{path}: does not read back as written; look at the disk")
    remarks = {
        law.sensor: [summary(law), *turned(law), *FORMATS[kind].remarks(law)]
        for law in whole.sensors
    }
    return Exported(tuple(placed), remarks)


def summary(law: Installed) -> str:
    """Return which rows keep the Workbench, and whose offset it is."""
    about = law.about or {}
    kept = ", ".join(about["keeps_workbench"]) or "none"
    return f"rows of the Workbench: {kept}; offset of {about['offset_of']}"


def turned(law: Installed) -> list[str]:
    """Return what a driver must heed that turns the wrench into the axes of another link."""
    about = law.about or {}
    if "wrench_frame" not in about:
        return []
    return [
        f"gives the wrench in the sensor's frame ({about['frame']}): what turns it into the axes"
        f" of {about['wrench_frame']} comes after it, not before"
    ]


def read(path: Path) -> tuple[Installed, ...]:
    """Return the sensors of `calibration.json` or of a file of any format, by its suffix.

    Of a calibration, the deployed gain and the latest offset. Raises `SensorError`.
    """
    try:
        content = path.read_bytes()
        kind = BY_SUFFIX.get(path.suffix.lower())
        if kind is None:
            known = ", ".join(BY_SUFFIX)
            raise SensorError(
                f"{path}: no calibration ends in {path.suffix!r}; give calibration.json, or a file"
                f" that ftcal export wrote ({known})"
            )
        if kind == "json" and b'"ftcal-calibration"' in content[:200]:
            known_sensors = read_calibration(path).sensors
            return tuple(installed(s, "auto" if s.offsets else "zero") for s in known_sensors)
        laws = FORMATS[kind].decode(content, str(path))
        beside = path.with_name(path.name + ".json")
        if kind == "firmware" and beside.is_file():
            return (firmware_file.with_neighbour(laws[0], content, beside.read_bytes()),)
        return laws
    except OSError as error:
        raise SensorError(f"{path}: cannot be read ({error.strerror})") from error
