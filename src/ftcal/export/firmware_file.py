"""`matrix_SN*.txt` of an iCub sensor's board: C in 16-bit words on ADC counts, nothing else.

The file has no place for an offset, a temperature term or a comment: what was left out is printed,
and the provenance stands in a neighbour, `matrix_SN*.txt.json`, with the hash of the matrix file.
"""

from __future__ import annotations

import hashlib
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ftcal import firmware
from ftcal.calibration import to_json
from ftcal.errors import SensorError
from ftcal.export.installed import Installed, Sheet, identifier, with_provenance
from ftcal.sensor import AXES, UNITS

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray as Array

APART = 10.0
"""A full reading of counts and the full scale of an axis lie no further apart than this factor;
a matrix per volt, or on wrenches, misses by hundreds."""

VERY = 1e-6
"""A word this close to whole was that word: float64 keeps them to 1e-11."""


def file_name(law: Installed) -> str:
    """Return `matrix_SN026.txt`, or the sensor's name where no serial number is known."""
    found = None if law.workbench is None else re.search(r"SN\w+", law.workbench.name)
    return f"matrix_{found.group() if found else identifier(law.sensor)}.txt"


def carried(law: Installed) -> Installed:
    """Return what the file holds of a law: the matrix alone, before it is rounded."""
    on_counts(law)
    return replace(law.on("channels"), offset=np.zeros(6), temperature_gain=None)


def encode(sheet: Sheet) -> bytes:
    """Return the matrix file of one sensor; `SensorError` as `firmware.encode` says."""
    (law,) = sheet.sensors
    return firmware.encode(carried(law).matrix, full_scale(law)).encode("ascii")


def full_scale(law: Installed) -> Int[Array, "6"]:
    """Return the full scales of the file: the smallest that no reading overflows.

    A row that stays the Workbench's keeps the full scale it had where its words then are the very
    words of before; recomputed from rounded words it could come out one less.
    """
    C = law.on("channels").matrix
    scale = firmware.smallest_full_scale(C)
    if law.workbench is None:
        return scale
    had = np.rint(law.workbench.full_scale)
    words = C * (firmware.COUNTS * firmware.ONE / had[:, None])
    very = np.abs(words - np.rint(words)).max(axis=1) < VERY
    very &= np.abs(words).max(axis=1) < firmware.ONE - 0.5
    very &= (law.workbench.gain == C).all(axis=1) & (had == law.workbench.full_scale)
    return np.where(very, had, scale).astype(np.int64)


def decode(content: bytes, where: str) -> tuple[Installed, ...]:
    """Return the sensor in a matrix file, called by its serial number."""
    found = re.search(r"SN[0-9A-Za-z]+", Path(where).stem)
    try:
        held = firmware.decode(
            content.decode("ascii"), serial=found.group() if found else Path(where).stem
        )
    except UnicodeDecodeError as error:
        raise SensorError(f"{where}: not a matrix file: {error}") from error
    except SensorError as error:
        raise SensorError(f"{where}: {error}") from error
    return (Installed(held.serial, "channels", held.matrix, np.zeros(6)),)


def beside(sheet: Sheet, content: bytes) -> bytes:
    """Return the neighbour with the provenance of a matrix file."""
    (law,) = sheet.sensors
    digest = hashlib.sha256(content).hexdigest()
    return to_json({"provenance": sheet.origin, "matrix_sha256": digest, "sensor": law.about})


def with_neighbour(law: Installed, content: bytes, neighbour: bytes) -> Installed:
    """Return a decoded sensor with the provenance of its neighbour, where that is of this file."""
    try:
        record = json.loads(neighbour)
        if record["matrix_sha256"] != hashlib.sha256(content).hexdigest():
            return law
        return with_provenance(law, record["sensor"])
    except (ValueError, KeyError, TypeError, RecursionError):
        return law  # a neighbour of another kind, or of nobody


def rounding(law: Installed) -> Float[Array, "6 1"]:
    """Return half a step of the words of each row [N or Nm per count]."""
    return np.asarray(0.5 * full_scale(law) / (firmware.ONE * firmware.COUNTS) * (1 + 1e-9))[
        :, None
    ]


def on_counts(law: Installed) -> None:
    """Raise `SensorError` unless the channels are six ADC counts of the board."""
    if law.matrix.shape[1] != 6 or law.workbench is None:
        raise SensorError(
            f"sensor {law.sensor!r} has {law.matrix.shape[1]} channels; the board's matrix is 6 x 6"
        )
    reach = np.abs(law.workbench.gain).sum(axis=1) * firmware.COUNTS / law.workbench.full_scale
    worst = int(np.argmax(np.abs(np.log(reach))))
    if not 1 / APART <= reach[worst] <= APART:
        raise SensorError(
            f"sensor {law.sensor!r}: {firmware.COUNTS} on every channel would be"
            f" {reach[worst]:.3g} times the full scale of {AXES[worst]}, so its channels are not"
            " ADC counts of the board; calibrate with the board's matrix_SN*.txt as workbench"
        )


def remarks(law: Installed) -> list[str]:
    """Return what the file leaves out, and what its rounding changes at a full reading."""
    C = law.on("channels").matrix
    held = firmware.decode(firmware.encode(C, full_scale(law)), serial=law.sensor)
    change = np.abs(held.matrix - C).sum(axis=1) * firmware.COUNTS
    said = [
        f"{axis} {value:.2g} {unit}" for axis, value, unit in zip(AXES, change, UNITS, strict=True)
    ]
    lines = [
        f"rounding to 16-bit words changes at full reading at most {', '.join(said)}",
        f"full scales of the file: {' '.join(str(value) for value in held.full_scale)}",
    ]
    if law.offset.any():
        lines.append("the board has no offset: o is left out")
    if law.temperature_gain is not None:
        lines.append("the board has no temperature term: k is left out")
    return lines
