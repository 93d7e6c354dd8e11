"""The time column of a table → integer nanoseconds since the Unix epoch."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from pyarrow import compute

from ftcal.errors import LogError
from ftcal.logs.columns import SECONDS, decimal_nanoseconds, matrix, require_finite
from ftcal.logs.layout import TimeUnit
from ftcal.recording import NANOSECONDS

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray as Array

_NANOSECONDS: dict[TimeUnit, int] = {
    "s": NANOSECONDS, "ms": 1_000_000, "us": 1_000, "ns": 1,
}  # fmt: skip
_YEAR_2000, _YEAR_2100 = 946_684_800, 4_102_444_800  # Unix seconds
_LAST = 2**63 - 1  # nanoseconds: the year 2262
_EXACT = 2**53  # nanoseconds; beyond, float64 seconds are good to microseconds


def nanoseconds(
    column: Any, unit: TimeUnit | None, where: str, *, first_row: int
) -> Int[Array, "N"]:
    """Return the stamps of an Arrow `column` in `unit`, or in the unit that it shows itself.

    Raises `LogError` where the unit cannot be told, a stamp is missing, or none is a number.
    """
    if column.null_count:
        row = int(np.flatnonzero(column.is_null().to_numpy())[0]) + first_row
        raise LogError(f"{where}, row {row}: no time stamp; cut the row")
    kind = column.type
    if kind == SECONDS:
        return decimal_nanoseconds(column, where)
    if pa.types.is_timestamp(kind):
        try:
            moments = column.cast(pa.timestamp("ns", kind.tz)).cast(pa.int64())
        except pa.ArrowInvalid as error:
            raise LogError(f"{where}: a time stamp lies beyond the year 2262") from error
        return np.asarray(moments.to_numpy(), dtype=np.int64)
    if pa.types.is_integer(kind):
        return _whole(column, unit, where)
    if pa.types.is_floating(kind) or pa.types.is_decimal(kind):
        return _fractional(column, unit or "s", where, first_row)
    raise LogError(f"{where}: {kind} is no time; give a column of numbers or of dates")


def _whole(column: Any, unit: TimeUnit | None, where: str) -> Int[Array, "N"]:
    low, high = (int(v.as_py()) for v in compute.min_max(column).values())
    if unit is None:
        fits = [u for u, ns in _NANOSECONDS.items()
                if _YEAR_2000 <= low * ns / NANOSECONDS < _YEAR_2100]  # fmt: skip
        if not fits:  # the ranges of two units never meet
            raise LogError(f"{where}: whole numbers from {low} are no Unix time of this century;"
                           " give time_unit in the job")  # fmt: skip
        unit = fits[0]
    if max(-low, high) > _LAST // _NANOSECONDS[unit]:
        raise LogError(f"{where}: {high} {unit} lies beyond the year 2262; correct time_unit")
    return np.asarray(column.cast(pa.int64()).to_numpy(), dtype=np.int64) * _NANOSECONDS[unit]


def _fractional(column: Any, unit: TimeUnit, where: str, first_row: int) -> Int[Array, "N"]:
    values = matrix([column.cast(pa.float64())], scale=_NANOSECONDS[unit])
    require_finite(values, ["time"], where, first_row=first_row)
    moments: Float[Array, "N"] = values[:, 0]
    largest = float(np.abs(moments).max(initial=0.0))
    if largest >= _LAST:
        raise LogError(f"{where}: {largest / NANOSECONDS:.3g} s lies beyond the year 2262;"
                       " give time_unit in the job")  # fmt: skip
    step = 1 if largest < _EXACT else 1000
    stamps: Int[Array, "N"] = np.rint(moments / step).astype(np.int64) * step
    return stamps
