"""Recordings that do not fit into memory are read again, and nothing else changes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ftcal import takes
from ftcal.config import read_job
from ftcal.pipeline import calibrate, ft_channel, score_calibration
from ftcal.progress import Steps, silent
from ftcal.takes import Takes
from ftcal.urdf import read_robot
from small_world import write_world


def some(folder: Path, most: int) -> Takes:
    folder.mkdir(exist_ok=True)
    job = read_job(write_world(folder))
    robot = read_robot(job.path(job.robot))
    channels = [ft_channel(job, robot, section) for section in job.sensors]
    return Takes.read(job, robot, channels, Steps(silent, 9), most)


@pytest.mark.parametrize("most", [0, 200_000, 1 << 30])
def test_recordings_are_the_same_whether_kept_or_read_again(tmp_path: Path, most: int) -> None:
    kept, found = some(tmp_path / "a", 1 << 30), some(tmp_path / "b", most)
    assert len(found) == len(found.job.recordings) == len(list(found))
    for one, other in zip(kept, found, strict=True):
        assert one.digest == other.digest
        for mine, theirs in zip(one.signals, other.signals, strict=True):
            assert np.array_equal(mine.values, theirs.values)
    assert found.findings == kept.findings


def test_only_so_many_bytes_are_kept(tmp_path: Path) -> None:
    sizes = [recording.size for recording in some(tmp_path, 1 << 30)]
    assert list(some(tmp_path / "first", sizes[0]).kept) == [0]
    assert not some(tmp_path / "none", sizes[0] - 1).kept


def test_outlines_say_when_signals_begin_and_end_and_hold_no_more(tmp_path: Path) -> None:
    found = some(tmp_path, 0)
    for recording, outline in zip(found, found.outlines, strict=True):
        assert outline.duration == recording.duration
        assert outline.digest == recording.digest
        for whole, ends in zip(recording.signals, outline.signals, strict=True):
            assert list(ends.stamps) == [whole.stamps[0], whole.stamps[-1]]
            assert ends.columns == whole.columns


def test_scores_are_the_same_bit_for_bit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    job = read_job(write_world(tmp_path))
    known = calibrate(job).calibration
    kept = score_calibration(known, job)["ft_sensor"].by_name
    monkeypatch.setattr(takes, "KEPT", 0)
    assert score_calibration(known, job)["ft_sensor"].by_name == kept
