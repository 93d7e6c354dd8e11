"""A log read again with its calibration."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from ftcal import logs
from ftcal.applying import ZERO, corrected
from ftcal.calibration import Calibration
from ftcal.cli import main
from ftcal.config import read_job
from ftcal.errors import DataError
from ftcal.pipeline import calibrate
from pretend import FULL_SCALE
from small_world import take, truth, write_world


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_world(tmp_path_factory.mktemp("world"))


@pytest.fixture(scope="module")
def calibration(world: Path) -> Calibration:
    return calibrate(read_job(world)).calibration


def test_corrected_wrenches_are_the_true_ones(world: Path, calibration: Calibration) -> None:
    recording, used = corrected(calibration, logs.read(world.parent / "two.csv"))
    (signal,) = recording.channels
    channels = take(2)[2]
    true = channels @ truth().T
    difference = signal.values - true
    assert used == {"ft_sensor": "two 0.9-39.1 s"}
    spread = (difference - difference.mean(axis=0)).std(axis=0)
    assert (spread < 1e-3 * FULL_SCALE).all()


def test_without_an_offset_it_is_the_gain_alone(world: Path, calibration: Calibration) -> None:
    recording = logs.read(world.parent / "two.csv")
    only, _ = corrected(calibration, recording, ZERO)
    expected = recording.channels[0].values @ np.array(calibration.sensors[0].gain).T
    np.testing.assert_allclose(only.channels[0].values, expected, rtol=1e-12)


def test_an_unknown_offset_comes_with_the_known_ones(world: Path, calibration: Calibration) -> None:
    with pytest.raises(DataError, match=r"'tow'; did you mean two"):
        corrected(calibration, logs.read(world.parent / "two.csv"), "tow")


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_the_command_writes_a_table_that_reads_back(
    world: Path, calibration: Calibration, tmp_path: Path, suffix: str
) -> None:
    from ftcal.calibration import to_json

    known = tmp_path / "calibration.json"
    known.write_bytes(to_json(calibration))
    out = tmp_path / f"out{suffix}"
    log = world.parent / "two.csv"
    result = CliRunner().invoke(main, ["apply", str(known), str(log), "-o", str(out)])
    assert result.exit_code == 0, result.output
    assert "ft_sensor: offset of two" in result.stdout
    back = logs.read(out).channels[0]
    expected = corrected(calibration, logs.read(log))[0].channels[0]
    assert back.name == "ft_sensor"
    np.testing.assert_array_equal(back.stamps, expected.stamps)
    np.testing.assert_allclose(back.values, expected.values, rtol=1e-12)


def test_an_output_that_is_no_table_is_refused(
    world: Path, calibration: Calibration, tmp_path: Path
) -> None:
    from ftcal.calibration import to_json

    known = tmp_path / "calibration.json"
    known.write_bytes(to_json(calibration))
    command = ["apply", str(known), str(world.parent / "two.csv"), "-o", str(tmp_path / "out.xls")]
    result = CliRunner().invoke(main, command)
    assert result.exit_code == 1
    assert "out.xls" in result.stderr
    assert not (tmp_path / "out.xls").exists()
