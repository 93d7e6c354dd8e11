"""Records of numbers → one file that is read back without running anything, and a shelf of them.

A file is a NumPy archive (`.npz`) of plain arrays and the tree that holds them, as JSON; nothing is
pickled. On the shelf a file is named by what it was made from, so that a result is found again as
long as nothing that went into it has changed, and only then.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ftcal.calibration import write_whole
from ftcal.errors import NO_ARCHIVE

TREE = "tree"
"""Name of the JSON text among the arrays."""


def packed(record: Any) -> bytes:
    """Return a record of dataclasses, rows, tables by name, arrays, texts and numbers as a file.

    Raises `TypeError` for arrays of objects.
    """
    arrays: dict[str, Any] = {}

    def flat(node: Any) -> Any:
        if isinstance(node, np.ndarray):
            if node.dtype.hasobject:
                raise TypeError("an array of objects cannot be kept: it would have to be pickled")
            name = f"a{len(arrays)}"
            arrays[name] = node
            return {"array": name}
        if is_dataclass(node):
            held = {f.name: flat(getattr(node, f.name)) for f in fields(node)}
            return {"record": type(node).__name__, "fields": held}
        if isinstance(node, Mapping):
            return {"table": [[key, flat(value)] for key, value in node.items()]}
        if isinstance(node, (tuple, list)):
            return {"row": [flat(value) for value in node]}
        return node

    text = json.dumps(flat(record))
    arrays[TREE] = np.frombuffer(text.encode(), dtype=np.uint8)
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def unpacked(content: bytes, kinds: Mapping[str, Callable[..., Any]]) -> Any:
    """Return the record in a file; rows come back as tuples.

    `kinds` are the classes it may hold, by name. Raises `ValueError` or `KeyError` where the file
    holds anything else.
    """
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:

        def grown(node: Any) -> Any:
            match node:
                case {"array": name}:
                    return arrays[name]
                case {"record": kind, "fields": held}:
                    return kinds[kind](**{name: grown(value) for name, value in held.items()})
                case {"table": pairs}:
                    return {key: grown(value) for key, value in pairs}
                case {"row": values}:
                    return tuple(grown(value) for value in values)
            return node

        return grown(json.loads(bytes(arrays[TREE])))


@dataclass(frozen=True, slots=True)
class Shelf:
    """A folder of results, each named by the hash of what it was made from.

    Several processes may use it at once: a file appears whole or not at all, and who makes the same
    result twice writes the same file twice.
    """

    folder: Path
    kinds: Mapping[str, Callable[..., Any]]
    """Classes that its files may hold, by name."""

    def place(self, made_from: Mapping[str, Any]) -> Path:
        """Return where the result of `made_from` (plain JSON) lies or will lie."""
        text = json.dumps(made_from, sort_keys=True, default=str)
        return self.folder / f"{hashlib.sha256(text.encode()).hexdigest()[:32]}.npz"

    def find(self, place: Path) -> Any | None:
        """Return the result at `place`, or None where there is none that can be read."""
        try:
            return unpacked(place.read_bytes(), self.kinds)
        except NO_ARCHIVE:
            return None

    def put(self, place: Path, record: Any) -> None:
        """Write a result; raises `OutputError` where the folder cannot be written."""
        write_whole(place, packed(record))
