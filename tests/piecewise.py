"""The pieces of a log put together again, and compared with the log."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from ftcal.logs.pieces import ROLES, Piece, cut, joined
from ftcal.recording import Recording


def put_together(pieces: Sequence[Piece]) -> Recording:
    def all_of(role: str) -> tuple[object, ...]:
        parts = [getattr(piece.own, role) for piece in pieces]
        return tuple(joined(same) for same in zip(*parts, strict=True))

    first = pieces[0].recording
    roles = {role: all_of(role) for role in ROLES}
    return Recording(
        first.name, first.source, first.start, findings=first.findings, digest=first.digest,
        **roles,  # type: ignore[arg-type]
    )  # fmt: skip


def assert_same(found: Recording, expected: Recording) -> None:
    for field in ("name", "source", "start", "findings", "digest"):
        assert getattr(found, field) == getattr(expected, field)
    for role in ROLES:
        pairs = zip(getattr(found, role), getattr(expected, role), strict=True)
        for ours, theirs in pairs:
            assert (ours.name, ours.columns, ours.breaks) == (
                theirs.name, theirs.columns, theirs.breaks,
            )  # fmt: skip
            np.testing.assert_array_equal(ours.stamps, theirs.stamps)
            assert ours.values.tobytes() == theirs.values.tobytes()


def assert_are_pieces(pieces: Sequence[Piece], whole: Recording, *, rows: int, margin: int) -> None:
    """Check pieces of at most `rows` own samples a signal that reach `margin` [ns] beyond."""
    assert_same(put_together(pieces), whole)
    assert all(before.stop == after.start for before, after in pairwise(pieces))
    for piece in pieces:
        assert all(len(s) <= rows for role in ROLES for s in getattr(piece.own, role))
        assert_same(piece.recording, cut(whole, piece.start - margin, piece.stop + margin))
