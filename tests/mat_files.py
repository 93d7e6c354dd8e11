"""A robot-logger file as MATLAB v7.3 lays it out, written without the library that reads it.

PyTables writes the structs. It cannot write cells of text, which are arrays of HDF5 object
references: those alone are added with h5py.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import h5py
import numpy as np
import tables

ROOT = "robot_logger_device"
HEADER = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, HDF5 schema 1.00 .".ljust(124) + b"\0\x02IM"


def write_mat(
    file: Path,
    leaves: Mapping[str, tuple[np.ndarray, np.ndarray]],
    *,
    names: Mapping[str, Sequence[str]] | None = None,
    units: Mapping[str, Sequence[str]] | None = None,
    described: Sequence[str] = (),
    root: str = ROOT,
) -> Path:
    """Write path → (stamps [s], samples) and the names and units of their columns.

    Samples (T, n) become T x 1 x n, as n x 1 x T of MATLAB does; any other shape stays.
    """
    with tables.open_file(str(file), "w", user_block_size=512) as content:
        content.create_group("/", root)
        for path, (stamps, samples) in leaves.items():
            where = f"/{root}/{path}"
            block = samples[:, None, :] if samples.ndim == 2 else samples
            shape = (max(block.shape[0] // 4, 1), *block.shape[1:])
            content.create_carray(
                where, "data", obj=block, createparents=True, chunkshape=shape,
                filters=tables.Filters(complevel=1, complib="zlib"),
            )  # fmt: skip
            content.create_array(where, "timestamps", stamps[None, :])
    with h5py.File(file, "a") as content:
        for path, texts in (names or {}).items():
            cell(content, f"{root}/{path}/elements_names", texts)
        for path, texts in (units or {}).items():
            cell(content, f"{root}/{path}/units_of_measure", texts)
        if described:
            cell(content, f"{root}/description_list", described)
    with file.open("r+b") as plain:
        plain.write(HEADER)
    return file


def cell(content: h5py.File, path: str, texts: Sequence[str]) -> None:
    """Write texts as MATLAB does: references to columns of UTF-16 codes below `#refs#`."""
    store = content.require_group("#refs#")
    references = []
    for text in texts:
        name = f"t{len(store)}"
        codes = np.array([ord(letter) for letter in text], dtype=np.uint16)
        store.create_dataset(name, data=codes[:, None])
        references.append(store[name].ref)
    content.create_dataset(path, data=np.array([references], dtype=h5py.ref_dtype))
