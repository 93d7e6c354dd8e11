"""One NumPy archive (`.npz`) → an Arrow table with a column for each column of its arrays.

Samples go along the first axis, and all arrays share the clock `time`; sensors with clocks of their
own go into files of their own, and a folder of them is one log. Columns of a two-dimensional array:

| array | its columns |
|---|---|
| `q`, `joints` or `joint_positions` | as the text array `joint_names` says, else `q.0`, … |
| any other, with an array of text `<array>_names` | `<array>.<name>` |
| six columns | `<array>.fx` … `<array>.tz`: an F/T sensor |
| any other number of columns | `<array>.0`, `<array>.1`, … |

What the archive claims of itself is checked before a byte is allocated: a header of 100 bytes can
promise 10^12 samples. Nothing is unpickled.
"""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from ftcal.errors import NO_ARCHIVE, LogError, raise_all, unknown
from ftcal.logs.layout import WRENCH_AXES, Layout

JOINT_ARRAYS = ("q", "joints", "joint_positions")
"""What an array of joint positions is called."""

JOINT_NAMES = "joint_names"
"""Array of text with the names of the joints."""

_DENSEST = 1100  # bytes that one compressed byte can become (deflate: 1032)
_HEADER = 1 << 16  # bytes, more than any header of a plain array
_NUMBERS = "iuf"  # NumPy's kinds of numbers that a sensor logs
_READERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


def load_npz(file: Path, layout: Layout) -> Any:
    """Return the Arrow table of the arrays of numbers, times and names in an `.npz` `file`.

    Arrays of anything else are left alone, and so are single numbers. Raises `LogError` where it is
    no archive, an array holds less than it claims, or arrays differ in their number of samples.
    """
    try:
        with zipfile.ZipFile(file) as archive:
            arrays = _arrays(archive, file)
    except NO_ARCHIVE as error:
        reason = " ".join(str(error).split()) or "it ends early"
        raise LogError(f"{file}: not a readable .npz: {reason}") from error
    time = arrays.get(layout.time)
    if time is None or time.size != time.shape[:1][0]:
        vectors = [name for name, array in arrays.items() if array.ndim == 1]
        what = unknown("time array", layout.time, vectors)
        raise LogError(f"{file}: {what}; say time = ARRAY of N stamps")
    return _table(arrays, time.reshape(-1), file, layout)


def _arrays(archive: zipfile.ZipFile, file: Path) -> dict[str, Any]:
    """Return the arrays by name; `LogError` names those that do not hold what they claim."""
    arrays: dict[str, Any] = {}
    faults = []
    whole = file.stat().st_size
    for member in archive.infolist():
        name = member.filename.removesuffix(".npy")
        if name == member.filename:
            continue
        dense = 1 if member.compress_type == zipfile.ZIP_STORED else _DENSEST
        believable = min(member.compress_size, whole) * dense + _HEADER
        with archive.open(member) as content:
            read_header = _READERS.get(np.lib.format.read_magic(content))
            if read_header is None:
                continue  # later versions serve records of named fields
            shape, _, kind = read_header(content)
            size = int(np.prod([int(n) for n in shape], dtype=object)) * kind.itemsize
            if kind.kind not in _NUMBERS + "MU" or not shape or len(shape) > 2:
                continue
            if size > min(member.file_size - content.tell(), believable):
                shown = " x ".join(map(str, shape))
                faults.append(f"array {name!r} claims {shown} numbers, more than the file holds")
                continue
        with archive.open(member) as content:
            arrays[name] = np.lib.format.read_array(content, allow_pickle=False)
    raise_all(LogError, str(file), faults)
    return arrays


def _table(arrays: Mapping[str, Any], time: Any, file: Path, layout: Layout) -> Any:
    """Return one column for each column of the arrays that run along `time`."""
    names, values, faults = [layout.time], [time], []
    for name, array in arrays.items():
        if name == layout.time or array.dtype.kind not in _NUMBERS:
            continue
        if len(array) != len(time):
            turned = "; transpose it" if array.shape[-1] == len(time) else "; give it its own file"
            shown = " x ".join(map(str, array.shape))
            faults.append(f"array {name!r} is {shown}, {layout.time!r} has {len(time)}{turned}")
            continue
        if array.ndim == 1:
            names.append(name)
            values.append(array)
            continue
        titles = _titles(name, array.shape[1], arrays)
        if len(titles) != array.shape[1]:
            faults.append(f"array {name!r} has {array.shape[1]} columns but {len(titles)} names")
            continue
        names += titles
        values += list(array.T)
    raise_all(LogError, str(file), faults)
    columns = [pa.array(np.ascontiguousarray(v, v.dtype.newbyteorder("="))) for v in values]
    return pa.table(columns, names=names)


def _titles(name: str, width: int, arrays: Mapping[str, Any]) -> list[str]:
    """Return what the `width` columns of the array `name` are called."""
    own = arrays.get(f"{name}_names")
    if name in JOINT_ARRAYS:
        joints = arrays.get(JOINT_NAMES, own)
        if joints is not None:
            return [str(joint) for joint in joints.ravel()]
    elif own is not None:
        return [f"{name}.{title}" for title in own.ravel()]
    elif width == len(WRENCH_AXES):
        return [f"{name}.{axis}" for axis in WRENCH_AXES]
    return [f"{name}.{column}" for column in range(width)]
