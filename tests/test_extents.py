"""A log of any length can be inspected: what is said does not depend on how it was read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ftcal import inspection, logs
from ftcal.extents import Extents
from ftcal.logs.pieces import WholeLog
from small_world import write_world


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_world(tmp_path_factory.mktemp("world")).parent


def test_a_log_in_pieces_is_inspected_as_in_memory(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = folder / "arm.urdf"
    whole = inspection.inspected(folder / "one.csv", logs.Layout(), robot=robot)
    monkeypatch.setattr(logs, "IN_MEMORY", 0)
    streamed = inspection.inspected(folder / "one.csv", logs.Layout(), robot=robot)
    assert inspection.as_record(streamed) == inspection.as_record(whole)
    assert len(whole.recording.channels[0]) == 4000
    assert len(streamed.recording.channels[0]) == 2


def test_what_needs_the_whole_log_reads_it(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(logs, "IN_MEMORY", 0)
    seen = inspection.inspected(folder / "one.csv", logs.Layout(), whole=True)
    assert len(seen.recording.channels[0]) == 4000


@pytest.mark.parametrize("rows", [1000, 4000])
def test_extents_are_those_of_the_signals(folder: Path, rows: int) -> None:
    recording = logs.read(folder / "two.csv")
    log = WholeLog(recording)
    extents = Extents.of(log)
    for piece in log.pieces(rows=rows):
        extents.see(piece.own)
    signals = (*recording.joints, *recording.channels)
    for signal, extent in zip(signals, extents.of_each.values(), strict=True):
        assert extent.name == signal.name
        seconds = recording.seconds(signal)
        assert (extent.samples, extent.columns) == (len(signal), signal.columns)
        assert (extent.start, extent.stop) == (seconds[0], seconds[-1])
        assert extent.rate == 1.0 / signal.period
        assert extent.least is not None
        np.testing.assert_array_equal(extent.least, signal.values.min(axis=0))
        np.testing.assert_array_equal(extent.greatest, signal.values.max(axis=0))
