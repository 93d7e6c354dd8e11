"""The shelf gives back what was put on it, and believes nothing else."""

from __future__ import annotations

import io
import pickle
import subprocess
import sys
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from ftcal.archive import Shelf, packed, unpacked
from ftcal.errors import OutputError


@dataclass(frozen=True, slots=True, eq=False)
class Leaf:
    """A record of plain things."""

    values: Any
    note: str | None


@dataclass(frozen=True, slots=True, eq=False)
class Branch:
    """A record of records."""

    leaves: tuple[Leaf, ...]
    table: dict[str, Any]
    size: float


KINDS = {"Leaf": Leaf, "Branch": Branch}

arrays = hnp.arrays(
    dtype=st.one_of(
        hnp.floating_dtypes(),
        hnp.integer_dtypes(),
        hnp.boolean_dtypes(),
        hnp.complex_number_dtypes(),
        hnp.unicode_string_dtypes(),
    ),
    shape=hnp.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=4),
)
plain = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(allow_nan=True, allow_infinity=True),
    st.text(st.characters(), max_size=8),
    st.sampled_from(["", "\x00", "\ud800", "a\nb", '"', "array", "record", "Leaf", "μ→ñ"]),
)
leaves = st.builds(Leaf, st.one_of(plain, arrays), st.one_of(st.none(), st.text(max_size=5)))
names = st.one_of(st.text(max_size=5), st.sampled_from(["array", "record", "fields", "row"]))
nodes = st.recursive(
    st.one_of(plain, arrays, leaves),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3).map(tuple), st.dictionaries(names, inner, max_size=3)
    ),
    max_leaves=8,
)
branches = st.builds(
    Branch,
    st.lists(leaves, max_size=3).map(tuple),
    st.dictionaries(names, nodes, max_size=3),
    st.floats(),
)


def same(one: Any, other: Any) -> bool:
    """Return whether two records are alike to the bit, and of the same types."""
    if type(one) is not type(other):
        return False
    if isinstance(one, np.ndarray):
        alike = one.dtype == other.dtype and one.shape == other.shape
        return bool(alike and one.tobytes() == other.tobytes())
    if is_dataclass(one):
        return all(same(getattr(one, f.name), getattr(other, f.name)) for f in fields(one))
    if isinstance(one, dict):
        return list(one) == list(other) and all(same(one[key], other[key]) for key in one)
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    return repr(one) == repr(other)  # nan is nan, -0.0 is not 0.0


@given(st.one_of(branches, nodes))
@settings(max_examples=60, deadline=None)
def test_unpacking_gives_back_what_was_packed(record: Any) -> None:
    assert same(unpacked(packed(record), KINDS), record)


def test_not_a_number_and_infinity_survive_in_arrays_and_alone() -> None:
    odd = np.array([np.nan, np.inf, -np.inf, -0.0])
    record = Leaf((odd, *map(float, odd)), None)
    assert same(unpacked(packed(record), KINDS), record)


def test_rows_come_back_as_tuples() -> None:
    assert unpacked(packed([1, [2.5, "x"]]), {}) == (1, (2.5, "x"))


def test_the_same_record_is_the_same_file() -> None:
    record = Branch((Leaf(np.arange(5.0), None),), {"a": 1}, 2.0)
    assert packed(record) == packed(record)


@pytest.fixture
def shelf(tmp_path: Path) -> Shelf:
    return Shelf(tmp_path / "shelf", KINDS)


RECORD = Branch((Leaf(np.linspace(0.0, 1.0, 50), "n"),), {"a": np.arange(4)}, 1.0)


def test_what_was_put_is_found_and_nothing_else_is(shelf: Shelf) -> None:
    place = shelf.place({"log": "abc", "window": 0.81})
    assert shelf.find(place) is None
    shelf.put(place, RECORD)
    assert same(shelf.find(place), RECORD)
    assert shelf.find(shelf.place({"log": "abc", "window": 0.82})) is None
    assert [file.name for file in shelf.folder.iterdir()] == [place.name]


def test_a_place_is_named_by_what_not_by_the_order(shelf: Shelf) -> None:
    assert shelf.place({"a": 1, "b": [2]}) == shelf.place({"b": [2], "a": 1})
    assert shelf.place({"a": 1, "b": [2]}) != shelf.place({"a": 1, "b": [3]})


WHOLE = packed(RECORD)


@pytest.mark.parametrize("share", [0.02, 0.2, 0.4, 0.6, 0.8, 0.98])
def test_a_truncated_file_is_not_believed(shelf: Shelf, share: float) -> None:
    place = shelf.place({})
    shelf.folder.mkdir()
    place.write_bytes(WHOLE[: round(share * len(WHOLE))])
    assert shelf.find(place) is None


def npz(**content: Any) -> bytes:
    file = io.BytesIO()
    np.savez(file, **content)
    return file.getvalue()


def npy(array: Any) -> bytes:
    file = io.BytesIO()
    np.save(file, array, allow_pickle=True)
    return file.getvalue()


FOREIGN = {
    "text": b"not an archive",
    "one byte": b"P",
    "an archive without a tree": npz(a0=np.arange(3)),
    "a tree that is not JSON": npz(tree=np.frombuffer(b"{", dtype=np.uint8)),
    "a tree that is not text": npz(tree=np.array([255, 254], dtype=np.uint8)),
    "a tree that is one number": npz(tree=np.array(3)),
    "an array that is not there": npz(tree=np.frombuffer(b'{"array": "a0"}', dtype=np.uint8)),
    "an unknown class": npz(tree=np.frombuffer(b'{"record": "X", "fields": {}}', dtype=np.uint8)),
    "a class without its fields": npz(
        tree=np.frombuffer(b'{"record": "Leaf", "fields": {}}', dtype=np.uint8)
    ),
    "fields of another class": npz(
        tree=np.frombuffer(b'{"record": "Leaf", "fields": {"x": 1}}', dtype=np.uint8)
    ),
    "one bare array": npy(np.arange(3)),
    "a pickle": pickle.dumps({"a": 1}),
    "a pickled array": npy(np.array([{"a": 1}], dtype=object)),
}


@pytest.mark.parametrize("kind", FOREIGN)
def test_a_foreign_file_is_not_believed(shelf: Shelf, kind: str) -> None:
    place = shelf.place({})
    shelf.folder.mkdir()
    place.write_bytes(FOREIGN[kind])
    assert shelf.find(place) is None


def test_an_empty_file_is_not_believed(shelf: Shelf) -> None:
    place = shelf.place({})
    shelf.folder.mkdir()
    place.write_bytes(b"")
    assert shelf.find(place) is None


@pytest.mark.parametrize("change", [1, 32])
def test_a_file_with_a_wrong_byte_is_refused_or_whole(shelf: Shelf, change: int) -> None:
    shelf.folder.mkdir()
    place = shelf.place({})
    for where in range(0, len(WHOLE), 3):
        broken = bytearray(WHOLE)
        broken[where] ^= change
        place.write_bytes(broken)
        found = shelf.find(place)
        # archives hold bytes that nobody reads: dates, the attributes of files
        assert found is None or same(found, RECORD), where


class Trap:
    """Its pickle, where loaded, writes a file."""

    def __init__(self, file: Path) -> None:
        self.file = file

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.file,)


def test_nothing_pickled_is_ever_loaded(shelf: Shelf, tmp_path: Path) -> None:
    trap = Trap(tmp_path / "sprung")
    pickle.loads(pickle.dumps(trap))
    assert trap.file.exists()  # it works where it is loaded
    trap.file.unlink()
    inside = np.array([trap], dtype=object)
    place = shelf.place({})
    shelf.folder.mkdir()
    tree = np.frombuffer(b'{"array": "a0"}', dtype=np.uint8)
    for content in (pickle.dumps(trap), npy(inside), npz(a0=inside, tree=tree), npz(tree=inside)):
        place.write_bytes(content)
        assert shelf.find(place) is None
    assert not trap.file.exists()


WRITER = """
import sys
from pathlib import Path
import numpy as np
from ftcal.archive import Shelf
shelf = Shelf(Path(sys.argv[1]), {})
for _ in range(20):
    shelf.put(shelf.place({}), np.full(20_000, float(sys.argv[2])))
"""


def test_two_processes_that_write_one_place_leave_a_whole_file(shelf: Shelf) -> None:
    place = shelf.place({})
    writers = [
        subprocess.Popen([sys.executable, "-c", WRITER, str(shelf.folder), word])
        for word in ("1", "2")
    ]
    seen = set()
    while any(writer.poll() is None for writer in writers):
        there = place.exists()
        found = shelf.find(place)
        if there:
            # once there, always whole, of one writer alone
            assert found is not None
            assert found.shape == (20_000,)
            assert (found == found[0]).all()
            seen.add(found[0])
    assert [writer.wait() for writer in writers] == [0, 0]
    assert seen
    assert [file.name for file in shelf.folder.iterdir()] == [place.name]


def test_an_array_of_objects_is_not_packed() -> None:
    with pytest.raises((TypeError, ValueError)):
        packed(Leaf(np.array([{"a": 1}], dtype=object), None))


def test_a_shelf_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "shelf").write_text("a file where the folder should be")
    shelf = Shelf(tmp_path / "shelf", KINDS)
    assert shelf.find(shelf.place({})) is None
    with pytest.raises(OutputError, match="cannot be written"):
        shelf.put(shelf.place({}), RECORD)
