"""A research sensor of eight raw channels goes the whole way: fit, verdict, report, apply."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from ftcal.calibration import read_calibration
from ftcal.cli import main
from pretend import FULL_SCALE
from small_world import JOB, JOINTS, robot_text, take, truth

NAMES = [f"gauge{i}" for i in range(1, 9)]


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("eight")
    rng = np.random.default_rng(0)
    mixing = rng.normal(size=(8, 6)) * 2000.0  # counts per full scale
    true = np.linalg.pinv(mixing / FULL_SCALE)
    (folder / "arm.urdf").write_text(robot_text())
    bend = 1.0 + 0.03 * rng.normal(size=true.shape)
    np.savetxt(folder / "workbench.csv", true * bend, delimiter=",")
    for name, seed in (("one", 1), ("two", 2)):
        time, joints, six = take(seed)
        wrench = six @ truth().T
        eight = wrench @ (mixing / FULL_SCALE).T + rng.normal(size=(len(time), 8))
        with (folder / f"{name}.csv").open("w", newline="") as stream:
            writer = csv.writer(stream)
            writer.writerow(["time", *JOINTS, *NAMES])
            for t, row in zip(time, np.column_stack([joints, eight]), strict=True):
                writer.writerow([f"{1.7e9 + t:.6f}", *map(repr, row.tolist())])
    text = JOB.format(full_scale=", ".join(map(str, FULL_SCALE)))
    columns = ", ".join(f'"{name}"' for name in NAMES)
    with_columns = f'contact = "base"\nchannels = {{ft = [{columns}]}}'
    (folder / "job.toml").write_text(text.replace('contact = "base"', with_columns))
    return folder


def test_eight_channels_are_calibrated_and_reported(world: Path) -> None:
    result = CliRunner().invoke(main, ["calibrate", str(world / "job.toml")])
    assert result.exit_code == 0, result.stderr
    (sensor,) = read_calibration(world / "ftcal-out" / "calibration.json").sensors
    assert np.array(sensor.gain).shape == (6, 8)
    assert sensor.secondary is None
    # six wrench axes drive eight gauges: two combinations never move and stay at the Workbench
    assert all(v.verdict in {"PARTIAL", "REFUSE"} for v in sensor.verdicts)
    assert "2 directions not excited: channel" in sensor.verdicts[0].reason
    metrics = json.loads((world / "ftcal-out" / "metrics.json").read_text())
    score = metrics["sensors"]["ft_sensor"]["hold_out"]["scores"]
    assert score["force"]["percent"] < 30
    assert "channel" in (world / "ftcal-out" / "report.html").read_text()
