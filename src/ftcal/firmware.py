"""The calibration inside a sensor: the words of `matrix_SN*.txt`, and their trace in a log.

A file holds 36 hex words (row major, 16-bit two's complement, Q1.15), the constant 1 and six
decimal full scales. The board computes `w = C r` in these words, so whatever it sends is an integer
multiple of full scale / 32768: a log says which file was in the sensor.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from ftcal.errors import SensorError, raise_all

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray as Array

COUNTS = 32767
"""Largest raw reading; a full row of words at full reading gives the full scale."""

ONE = 32768
"""The word of 1.0 in Q1.15, the first that does not fit."""

WORST_CONDITION = 1e8
"""A matrix beyond it maps some wrench to less than a count (that of SN026 is 90)."""

TEXT_ROUNDING = 5e-7
"""Logs print six decimals [N, Nm]."""

ON_LATTICE = 0.02
"""Mean distance to the lattice, in steps, that still counts as on it (chance gives 0.25)."""

ENOUGH = 10
"""Distinct values an axis must show: ten chance ones lie on a lattice once in a million cases."""

Fit = Literal["fits", "off", "undecided"]
"""Whether values lie on a lattice; undecided where they are too few or the lattice too fine."""


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

    Near 0 on the lattice, 0.25 by chance. Each distinct value counts once: a frozen sensor
    repeats one; zero lies on every lattice and does not count. NaN where no value is left.
    """
    return _distance(_distinct(values), full_scale)


def lattice_fit(values: Float[Array, "N 6"], full_scale: Float[Array, "6"]) -> Fit:
    """Return whether all six axes lie on the lattice of `full_scale`.

    Undecided where an axis shows fewer than ten distinct values, or text of six decimals cannot
    show its lattice.
    """
    return _fit(_distinct(values), full_scale)


def identify(
    values: Float[Array, "N 6"], matrices: Mapping[str, FirmwareMatrix]
) -> tuple[str, ...]:
    """Return the names of those `matrices` whose full scales fit all six axes of a log."""
    found = _distinct(values)
    return tuple(
        name for name, matrix in matrices.items() if _fit(found, matrix.full_scale) == "fits"
    )


def estimate_full_scale(values: Float[Array, "N 6"], *, largest: int = 5000) -> Int[Array, "6"]:
    """Return the whole full scale whose lattice each axis shows, 0 where none does.

    Every divisor of it fits as well, so the largest that fits is meant. An axis whose readings
    are all even (fy of the iCubGenova02 left arm) shows twice its full scale.
    """
    found = np.zeros(6, dtype=np.int64)
    smallest = int(TEXT_ROUNDING / ON_LATTICE * ONE) + 1
    candidates = np.arange(smallest, largest + 1)
    for axis, distinct in enumerate(_distinct(values)):
        if distinct.size < 3 * ENOUGH:  # thousands of candidates: chance needs more to be ruled out
            continue
        spread = distinct[:: max(1, distinct.size // 200)]
        steps = spread[:, None] * (ONE / candidates)
        error = np.mean(np.abs(steps - np.rint(steps)), axis=0)
        fits = candidates[error < ON_LATTICE]
        found[axis] = fits.max(initial=0)
    return found


def _distinct(values: Float[Array, "N 6"]) -> list[Float[Array, "D"]]:
    columns = np.asarray(values, dtype=np.float64).T
    found = [np.unique(column[np.isfinite(column)]) for column in columns]
    return [distinct[distinct != 0.0] for distinct in found]


def _distance(
    found: Sequence[Float[Array, "D"]], full_scale: Float[Array, "6"]
) -> Float[Array, "6"]:
    """Return `lattice_error` of the distinct values of each axis."""
    step = np.asarray(full_scale, dtype=np.float64) / ONE
    error = np.full(6, np.nan)
    for axis, distinct in enumerate(found):
        if distinct.size:
            steps = distinct / step[axis]
            error[axis] = np.mean(np.abs(steps - np.rint(steps)))
    return error


def _fit(found: Sequence[Float[Array, "D"]], full_scale: Float[Array, "6"]) -> Fit:
    """Return `lattice_fit` of the distinct values of each axis."""
    enough = np.array([distinct.size >= ENOUGH for distinct in found])
    enough &= np.asarray(full_scale, dtype=np.float64) / ONE * ON_LATTICE > TEXT_ROUNDING
    error = _distance(found, full_scale)
    if (error[enough] > ON_LATTICE).any():
        return "off"
    return "fits" if enough.all() else "undecided"
