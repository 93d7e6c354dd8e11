"""The calibration inside a sensor: the words of `matrix_SN*.txt`, and their trace in a log.

A file holds 36 hex words (row major, 16-bit two's complement, Q1.15), the constant 1 and six
decimal full scales. The board computes `w = C r` in these words, so whatever it sends is an integer
multiple of full scale / 32768: a log says which file was in the sensor.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ftcal.errors import SensorError, raise_all
from ftcal.lattice import LARGEST, STEPS, Fit, Readings

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray as Array

COUNTS = 32767
"""Largest raw reading; a full row of words at full reading gives the full scale."""

ONE = STEPS
"""The word of 1.0 in Q1.15, the first that does not fit."""

WORST_CONDITION = 1e8
"""A matrix beyond it maps some wrench to less than a count (that of SN026 is 90)."""


@dataclass(frozen=True, slots=True)
class FirmwareMatrix:
    """The content of one `matrix_SN*.txt`."""

    serial: str
    """Serial number of the sensor, such as `SN026`."""
    words: Int[Array, "6 6"]
    """Q1.15 words as the board holds them, int16."""
    full_scale: Int[Array, "6"]
    """Wrench at full output, whole N and Nm."""

    @property
    def matrix(self) -> Float[Array, "6 6"]:
        """Return `C` of `w = C r`, N or Nm per count."""
        return np.asarray(self.full_scale[:, None] * (self.words / ONE) / COUNTS)

    def counts(self, wrench: Float[Array, "N 6"]) -> Float[Array, "N 6"]:
        """Return the raw readings `r = C^-1 w` [counts] behind logged wrenches [N, Nm]."""
        return np.asarray(np.linalg.solve(self.matrix, np.asarray(wrench).T).T)


def read_matrix(path: Path) -> FirmwareMatrix:
    """Return the matrix in the file `path`; the serial number is taken from its name.

    `SensorError`: file not readable, or anything `decode` refuses.
    """
    try:
        text = path.read_text(encoding="ascii")
    except (OSError, UnicodeDecodeError) as error:
        raise SensorError(f"{path}: cannot be read as a matrix file: {error}") from error
    found = re.search(r"SN\w+", path.stem)
    try:
        return decode(text, serial=found.group() if found else path.stem)
    except SensorError as error:
        raise SensorError(f"{path}: {error}") from error


def decode(text: str, *, serial: str) -> FirmwareMatrix:
    """Return the matrix that `text` holds.

    `SensorError` lists all faults: not 43 entries, words that are not 16-bit hex, a constant that
    is not 1, full scales that are not positive whole numbers, a singular matrix.
    """
    entries = text.split()
    if len(entries) != 43:
        raise SensorError(
            f"matrix {serial}: {len(entries)} entries instead of 43 ({len(entries) - 7} hex words"
            " where 36 belong, before the constant 1 and 6 full scales); take the file as the"
            " manufacturer wrote it"
        )
    faults = [
        f"word {i + 1} is {word!r}, not 1 to 4 hex digits"
        for i, word in enumerate(entries[:36])
        if not re.fullmatch(r"[0-9A-Fa-f]{1,4}", word)
    ]
    if entries[36] != "1":
        faults.append(
            f"entry 37 is {entries[36]!r}, not the constant 1; a word is missing or extra"
        )
    faults += [
        f"full scale {i + 1} is {scale!r}, not a positive whole number"
        for i, scale in enumerate(entries[37:])
        if not (re.fullmatch(r"[0-9]{1,9}", scale) and int(scale) > 0)
    ]
    raise_all(SensorError, f"matrix {serial}", faults)
    unsigned = np.array([int(word, 16) for word in entries[:36]], dtype=np.uint16)
    words = unsigned.view(np.int16).reshape(6, 6)
    _refuse_singular(words, f"matrix {serial}")
    return FirmwareMatrix(serial, words, np.array([int(scale) for scale in entries[37:]]))


def encode(matrix: Float[Array, "6 6"], full_scale: Int[Array, "6"] | None = None) -> str:
    """Return the file of the matrix `C` [N, Nm per count], the inverse of `decode`.

    Words are scaled with the *printed* whole full scale; scaling with an unrounded one, as the
    published writer does, inflates rows by up to 4 %. The default is `smallest_full_scale`.
    `SensorError`: entries not finite, words outside [-1, 1), full scales not positive whole
    numbers, a singular matrix.
    """
    C = np.asarray(matrix, dtype=np.float64)
    if C.shape != (6, 6) or not np.isfinite(C).all():
        raise SensorError(f"firmware matrix: needs 6 x 6 finite numbers, has shape {C.shape}")
    scale = np.asarray(smallest_full_scale(C) if full_scale is None else full_scale, np.float64)
    faults = [
        f"full scale {i + 1} is {value:g}, not a positive whole number"
        for i, value in enumerate(scale)
        if not (value > 0 and value == np.rint(value))
    ]
    raise_all(SensorError, "firmware matrix", faults)
    exact = np.rint(C * COUNTS / scale[:, None] * ONE)
    faults = [
        f"row {i + 1} needs a word of {row[np.abs(row).argmax()] / ONE:.4f}, outside [-1, 1);"
        f" raise full scale {i + 1} from {scale[i]:g} to {smallest_full_scale(C)[i]} or more"
        for i, row in enumerate(exact)
        if row.min() < -ONE or row.max() >= ONE
    ]
    raise_all(SensorError, "firmware matrix", faults)
    words = exact.astype(np.int16)
    _refuse_singular(words, "firmware matrix")
    lines = [f"{word:X}" for word in words.view(np.uint16).ravel()]
    return "\n".join([*lines, "1", *(f"{value:.0f}" for value in scale)]) + "\n"


def smallest_full_scale(matrix: Float[Array, "6 6"]) -> Int[Array, "6"]:
    """Return `ceil(32767 sum_j |C_ij|)`: no raw reading can overflow an output; not a rating."""
    C = np.abs(np.asarray(matrix, dtype=np.float64))
    # a row of one entry would need the word 1.0, which does not exist; a zero row some scale
    largest_word = np.floor(C.max(axis=1) * COUNTS * ONE / (ONE - 0.5)) + 1
    # a full scale that is whole but for rounding stays what it is
    total = np.ceil(C.sum(axis=1) * COUNTS * (1.0 - 1e-12))
    return np.asarray(np.maximum(total, largest_word), dtype=np.int64)


def _refuse_singular(words: Int[Array, "6 6"], where: str) -> None:
    # in words: the choice of N or Nm and of full scale must not count
    condition = np.linalg.cond(words / ONE)
    if not condition < WORST_CONDITION:
        raise SensorError(
            f"{where}: singular, condition number {condition:.1e} exceeds {WORST_CONDITION:.0e};"
            " two channels carry the same reading, check the file"
        )


def lattice_error(values: Float[Array, "N 6"], full_scale: Float[Array, "6"]) -> Float[Array, "6"]:
    """Return the mean distance of each axis to multiples of full scale / 32768, in such steps.

    Near 0 on the lattice, 0.25 by chance, NaN where no value but zero is left.
    """
    return _readings(values).error(full_scale)


def lattice_fit(values: Float[Array, "N 6"], full_scale: Float[Array, "6"]) -> Fit:
    """Return whether all six axes lie on the lattice of `full_scale`, as `Readings.fit` tells."""
    return _readings(values).fit(full_scale)


def identify(
    values: Float[Array, "N 6"], matrices: Mapping[str, FirmwareMatrix]
) -> tuple[str, ...]:
    """Return the names of those `matrices` whose full scales fit all six axes of a log."""
    return _readings(values).fitting({name: m.full_scale for name, m in matrices.items()})


def estimate_full_scale(values: Float[Array, "N 6"], *, largest: int = LARGEST) -> Int[Array, "6"]:
    """Return the whole full scale whose lattice each axis shows, 0 where none does.

    Of those that fit the largest, as `Readings.full_scale` has it.
    """
    return _readings(values).full_scale(largest=largest)


def _readings(values: Float[Array, "N 6"]) -> Readings:
    return Readings.of(np.asarray(values, dtype=np.float64).T)
