"""The everyday case on a real wrist: KUKA LBR Med with an ATI Gamma (shared/data, known answer)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from ftcal.cli import main
from ftcal.payload import estimate
from ftcal.pose_tables import PoseLayout, read_poses
from real import DATA

GAMMA = DATA / "ati-gamma-lbrmed"
POSES = GAMMA / "0-calibration_fts-accel.csv"
MOVING = [GAMMA / "1-baseline_wrench.csv", GAMMA / "1-baseline_orientations.csv"]

pytestmark = pytest.mark.skipif(not GAMMA.is_dir(), reason="shared/data/ati-gamma-lbrmed is absent")


@pytest.mark.parametrize("attitude", ["gravity", "rotation"])
def test_known_payload_is_weighed(attitude: str) -> None:
    found = estimate(read_poses([POSES], PoseLayout(attitude=attitude)))  # type: ignore[arg-type]
    assert found.mass == pytest.approx(0.932, rel=0.005)
    assert found.centre[2] == pytest.approx(0.044, abs=0.001)
    np.testing.assert_allclose(found.offset[:3], [9.08, -1.02, 9.99], atol=0.05)
    force, _ = found.rms(found.residual)
    assert force == pytest.approx(0.086, abs=0.001)
    assert found.refused == ()
    assert found.outliers == ()
    assert found.sign == 1


def test_transposed_rotation_is_named() -> None:
    by_columns = tuple(f"r{row}{column}" for column in (1, 2, 3) for row in (1, 2, 3))
    found = estimate(read_poses([POSES], PoseLayout(attitude="rotation", columns=by_columns)))
    assert "read as rotation transposed" in found.refused[0]


def test_accelerometer_in_its_own_frame_is_named() -> None:
    """The IMU sits turned on the tool: its x, y, z are the sensor's -z, -x, y."""
    found = estimate(read_poses([POSES], PoseLayout(attitude="acceleration")))
    assert "the wrench's x, y, z being the attitude's -y, z, -x" in found.refused[0]


def test_moving_run_is_refused_as_it_stands() -> None:
    found = estimate(read_poses(MOVING, PoseLayout(time="t")))
    assert "inertia is not in the model" in found.refused[0]
    # right all the same to a few percent: the run goes both ways
    assert found.mass == pytest.approx(0.932, rel=0.03)
    assert found.centre[2] == pytest.approx(0.044, abs=0.003)


def test_rests_of_the_moving_run_are_too_few_attitudes(tmp_path: Path) -> None:
    words = ["payload", *map(str, MOVING), "--time", "t", "--steady", "5"]
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 1
    assert "2 attitudes, at least 4 are needed" in result.stderr
