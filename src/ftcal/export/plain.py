"""Plain JSON and NumPy archives: the law of each sensor on raw channels, and S where K is 6."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from typing import Any

import numpy as np

from ftcal.calibration import to_json
from ftcal.errors import NO_ARCHIVE, SensorError
from ftcal.export.installed import Installed, Sheet, with_provenance

FORMAT = "ftcal-export"


def carried(law: Installed) -> Installed:
    """Return what the file holds of a law: all of it, on raw channels."""
    return law.on("channels")


def arrays(law: Installed) -> dict[str, Any]:
    """Return the law as arrays by name; k and T_ref only where they are."""
    held = carried(law)
    found: dict[str, Any] = {"gain": held.matrix, "offset": held.offset}
    if held.matrix.shape[1] == 6:
        found["secondary"] = held.on("wrench").matrix
    if held.temperature_gain is not None:
        found["temperature_gain"] = held.temperature_gain
        found["reference_temperature"] = held.reference_temperature
    return found


def law_of(found: dict[str, Any], about: dict[str, Any]) -> Installed:
    """Return the law that `arrays` and provenance say."""
    law = Installed(
        str(about["sensor"]),
        "channels",
        np.array(found["gain"], dtype=np.float64),
        np.array(found["offset"], dtype=np.float64).reshape(6),
    )
    if "temperature_gain" in found:
        law = replace(
            law,
            temperature_gain=np.array(found["temperature_gain"], dtype=np.float64).reshape(6),
            reference_temperature=float(found["reference_temperature"]),
        )
    return with_provenance(law, about)


def encode_json(sheet: Sheet) -> bytes:
    """Return the JSON file."""
    sensors = [
        {
            "about": law.about,
            **{name: np.asarray(value).tolist() for name, value in arrays(law).items()},
        }
        for law in sheet.sensors
    ]
    law = "w = gain r + offset + temperature_gain (T - reference_temperature)"
    return to_json(
        {"format": FORMAT, "version": 1, "law": law, "provenance": sheet.origin, "sensors": sensors}
    )


def decode_json(content: bytes, where: str) -> tuple[Installed, ...]:
    """Return the sensors of a JSON file of ours; `SensorError` where it is none."""
    try:
        record = json.loads(content)
        if record["format"] != FORMAT:
            raise KeyError(f"format {record['format']!r}")
        return tuple(law_of(found, found["about"]) for found in record["sensors"])
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise SensorError(f"{where}: not a JSON export of ftcal: {error}") from error


def encode_npz(sheet: Sheet) -> bytes:
    """Return the NumPy archive: `SENSOR/gain` …, and `provenance`, a JSON text."""
    held = {
        f"{law.sensor}/{name}": value
        for law in sheet.sensors
        for name, value in arrays(law).items()
    }
    text = json.dumps({**sheet.origin, "sensors": [law.about for law in sheet.sensors]})
    file = io.BytesIO()
    np.savez(file, **held, provenance=np.array(text))
    return file.getvalue()


def decode_npz(content: bytes, where: str) -> tuple[Installed, ...]:
    """Return the sensors of an archive of ours; `SensorError` where it is none."""
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as held:
            record = json.loads(str(held["provenance"]))
            return tuple(
                law_of(
                    {
                        name.removeprefix(f"{about['sensor']}/"): held[name]
                        for name in held.files
                        if name.startswith(f"{about['sensor']}/")
                    },
                    about,
                )
                for about in record["sensors"]
            )
    except NO_ARCHIVE as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise SensorError(f"{where}: not an archive of ftcal: {reason}") from error


def remarks(law: Installed) -> list[str]:
    """Return nothing: the files hold all of the law."""
    return []
