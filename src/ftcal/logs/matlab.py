"""MATLAB v7.3 files of robometry: HDF5 with a group for every struct.

A leaf is a group with `data` and `timestamps`; text in a cell is an array of references to arrays
of UTF-16 codes. MATLAB's last dimension is HDF5's first: a vector logged as n x 1 at T times comes
as T x 1 x n (robometry, `BufferManager::createElementStruct`). What a file claims of its sizes is
compared with what it holds before anything is read, and no link out of the file is followed.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ftcal.errors import LogError, raise_all

if TYPE_CHECKING:
    from jaxtyping import Float, Num
    from numpy import ndarray as Array

ROOT = "robot_logger_device"
"""The struct that a robot-logger writes, where its configuration says nothing else."""

_OLD = b"MATLAB 5.0 MAT-file"
_DENSEST = 1100  # bytes that one compressed byte can become (deflate: 1032)
_SMALL = 1 << 16  # bytes that are always believed
_DEPTH = 12  # groups in groups; robot-logger has five


@dataclass(frozen=True, slots=True)
class Leaf:
    """One stream as the file holds it."""

    stamps: Num[Array, "N"]
    """Time of each sample [s]."""
    values: Float[Array, "N K"]
    """As logged."""
    names: tuple[str, ...]
    """Of each column; empty where the file has none."""
    units: tuple[str, ...]
    """Of each column; empty where the file has none."""


@dataclass(frozen=True, slots=True)
class Contents:
    """What of a file matters."""

    leaves: dict[str, Leaf]
    """By path below the root, such as `FTs/l_leg_ft`."""
    empty: tuple[str, ...]
    """Paths of those that were set up but never logged."""
    described: tuple[str, ...]
    """`description_list`: the joints, in older files the only place that names them."""


def load(file: Path, matters: Callable[[str], bool], known: Collection[str]) -> Contents:
    """Return the leaves of `file` whose paths matter.

    The root is the struct `robot_logger_device`, else the first with an entry called as one of
    `known`. Raises `LogError` where the file is no MATLAB v7.3, or all that is wrong with a leaf.
    """
    try:
        import h5py
    except ImportError as error:
        raise LogError(f'{file}: .mat needs HDF5; pip install "ftcal[hdf5]"') from error
    with file.open("rb") as head:
        if head.read(len(_OLD)) == _OLD:
            raise LogError(
                f"{file}: MATLAB v5, not v7.3; in MATLAB: s = load(FILE); save(FILE, '-struct',"
                " 's', '-v7.3')"
            )
    leaves: dict[str, Leaf] = {}
    empty, faults = [], []
    try:
        with h5py.File(file, "r") as content:
            root = _root(content, known)
            if root is None:
                raise LogError(
                    f"{file}: no {ROOT} in it, nor {', '.join(known)} in any struct; is this a"
                    " robot-logger file?"
                )
            for path, node in _streams(root, "", set()):
                if not matters(path):
                    continue
                if not {"data", "timestamps"} <= set(_children(node)):
                    empty.append(path)
                    continue
                try:
                    leaves[path] = _leaf(content, node)
                except ValueError as fault:
                    faults.append(f"{path}: {fault}")
            described = _texts(content, _children(root).get("description_list"))
    except (OSError, KeyError, RuntimeError, ValueError, TypeError, AttributeError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0][:200]
        raise LogError(f"{file}: not a readable MATLAB v7.3 file: {reason}") from error
    raise_all(LogError, str(file), faults)
    return Contents(leaves, tuple(empty), described)


def _children(node: Any) -> dict[str, Any]:
    """Return what lies in a group of this very file; nothing in an array."""
    import h5py

    if not isinstance(node, h5py.Group):
        return {}
    inside = (name for name in node if isinstance(node.get(name, getlink=True), h5py.HardLink))
    return {name: node[name] for name in inside if not name.startswith("#")}


def _root(content: Any, known: Collection[str]) -> Any:
    structs = _children(content)
    candidates = [structs[ROOT]] if ROOT in structs else [*structs.values(), content]
    return next((node for node in candidates if set(known) & set(_children(node))), None)


def _streams(group: Any, path: str, seen: set[Any]) -> Iterator[tuple[str, Any]]:
    """Yield path and node of every leaf, and of what could have been one but is empty."""
    import h5py

    place = h5py.h5o.get_info(group.id).addr
    if place in seen or path.count("/") > _DEPTH:
        return  # a struct that contains itself
    seen.add(place)
    children = _children(group)
    if "data" in children or (not children and path):
        yield path, group
        return
    for name, child in children.items():
        yield from _streams(child, f"{path}/{name}" if path else name, seen)


def _leaf(content: Any, group: Any) -> Leaf:
    """Return one stream; `ValueError` says what is wrong with it."""
    children = _children(group)
    stamps = _numbers(children["timestamps"], "timestamps").ravel()
    block = _numbers(children["data"], "data")
    count, shape = len(stamps), block.shape
    if not count or not shape or count not in {shape[0], shape[-1]}:
        shown = " x ".join(map(str, shape)) or "one number"
        raise ValueError(f"data is {shown}, but there are {count} timestamps; log it anew")
    rows = block if shape[0] == count else np.moveaxis(block, -1, 0)
    values = np.asarray(rows, dtype=np.float64).reshape(count, -1)
    names = _texts(content, children.get("elements_names"))
    if names and len(names) != values.shape[1]:
        raise ValueError(f"{values.shape[1]} columns but {len(names)} elements_names")
    return Leaf(stamps, values, names, _texts(content, children.get("units_of_measure")))


def _numbers(dataset: Any, what: str) -> Num[Array, "..."]:
    """Return the numbers of a dataset that holds what it claims, else `ValueError`."""
    import h5py

    if not isinstance(dataset, h5py.Dataset) or dataset.dtype.kind not in "iuf":
        raise ValueError(f"{what} is no array of numbers")
    shown = " x ".join(map(str, dataset.shape))
    if dataset.is_virtual or dataset.external:
        raise ValueError(f"{what} lies in another file; save it whole")
    held = dataset.id.get_storage_size() * _DENSEST + _SMALL
    largest = max(dataset.size, int(np.prod(dataset.chunks or (0,), dtype=object)))
    if largest * dataset.dtype.itemsize > held:
        raise ValueError(f"{what} claims {shown} numbers, more than the file holds")
    kind = np.float64 if dataset.dtype.kind == "f" else dataset.dtype.newbyteorder("=")
    return np.asarray(dataset[()], dtype=kind)


def _texts(content: Any, dataset: Any) -> tuple[str, ...]:
    """Return the texts of a cell array, of one array of text, or nothing where there is none."""
    import h5py

    if not isinstance(dataset, h5py.Dataset) or "MATLAB_empty" in dataset.attrs:
        return ()
    if h5py.check_ref_dtype(dataset.dtype) is None:
        return (_text(dataset),)
    if dataset.size * dataset.dtype.itemsize > dataset.id.get_storage_size() + _SMALL:
        raise ValueError("a list of names claims more than the file holds")
    return tuple(_text(content[reference]) for reference in dataset[()].ravel())


def _text(dataset: Any) -> str:
    return "".join(map(chr, _numbers(dataset, "a name").ravel()))
