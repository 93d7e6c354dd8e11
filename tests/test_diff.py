"""What changes on a robot when one calibration file takes the place of another."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from ftcal import export as exports
from ftcal.calibration import SensorCalibration, to_json
from ftcal.cli import main
from ftcal.comparison import change, compare, pairs
from ftcal.errors import DataError, SensorError
from ftcal.export import FORMATS, Installed
from ftcal.export.installed import installed
from ftcal.firmware import COUNTS
from ftcal.recording import Recording, Signal
from golden import check
from pretend_calibration import (
    FULL_SCALE,
    calibration,
    exact,
    exact_prior,
    exact_secondary,
    random_gains,
    sensor,
)
from real import GENOVA02, needs_genova02

SIGNAL = "right_leg/analog:o"
GAIN, PRIOR = random_gains(1, 6)
OTHER = random_gains(2, 6)[0]
R = np.random.default_rng(3).uniform(-20000, 20000, (200, 6))


def of(known: SensorCalibration) -> Installed:
    return installed(known, "auto")


def recording(values: np.ndarray, *names: str) -> Recording:
    columns = tuple(f"c{i}" for i in range(values.shape[1]))
    stamps = np.arange(len(values), dtype=np.int64) * 10_000_000
    signals = tuple(Signal(name, columns, stamps, values) for name in names or (SIGNAL,))
    return Recording("log", "log", 0, (), signals)


def corners(width: int) -> np.ndarray:
    return np.array(np.meshgrid(*[[-1.0, 1.0]] * width)).reshape(width, -1).T


def written(known: SensorCalibration, path: Path) -> Path:
    path.write_bytes(to_json(calibration(known)))
    return path


def exported(source: Path, kind: str, folder: Path, *options: str) -> Path:
    result = run("export", source, "--to", kind, "-o", folder, *options)
    assert result.exit_code == 0, result.output
    return Path(result.stdout.split()[-1])


def run(*command: str | Path) -> Any:
    return CliRunner().invoke(main, [str(word) for word in command])


def test_a_file_and_itself_differ_in_nothing() -> None:
    same = change(of(sensor(GAIN, PRIOR)), of(sensor(GAIN, PRIOR)), recording(R @ PRIOR.T))
    assert same.full_scale is not None
    assert same.at_log is not None
    for values in (same.full_scale, same.offset, same.per_kelvin, same.at_log.rms):
        assert not values.any()


def test_full_scale_is_the_worst_corner_of_the_workbench_wrench() -> None:
    found = change(of(sensor(GAIN, PRIOR)), of(sensor(OTHER, PRIOR)))
    f = corners(6) * FULL_SCALE
    worst = np.abs(np.linalg.solve(PRIOR, f.T).T @ (OTHER - GAIN).T).max(axis=0)
    assert found.full_scale is not None
    np.testing.assert_allclose(found.full_scale, worst, rtol=1e-9)


def test_eight_channels_go_each_to_where_it_alone_makes_a_full_scale() -> None:
    (a, prior), (b, _) = random_gains(1, 8), random_gains(2, 8)
    found = change(of(sensor(a, prior, logged="channels")), of(sensor(b, prior, logged="channels")))
    r = corners(8) / (np.abs(prior) / np.array(FULL_SCALE)[:, None]).max(axis=0)
    assert found.full_scale is not None
    np.testing.assert_allclose(found.full_scale, np.abs(r @ (b - a).T).max(axis=0), rtol=1e-9)
    assert "channel" in found.box


def test_two_bare_matrix_files_are_compared_at_full_counts(tmp_path: Path) -> None:
    for name, gain in (("a", GAIN), ("b", OTHER)):
        source = written(sensor(gain, PRIOR), tmp_path / f"{name}.json")
        exported(source, "firmware", tmp_path / name)
        (tmp_path / name / "matrix_SN900.txt.json").unlink()
    a, b = (exports.read(tmp_path / name / "matrix_SN900.txt") for name in ("a", "b"))
    (found,) = compare(a, b)
    worst = np.abs(corners(6) * COUNTS @ (b[0].matrix - a[0].matrix).T).max(axis=0)
    assert found.full_scale is not None
    np.testing.assert_allclose(found.full_scale, worst, rtol=1e-9)
    assert "32767 counts" in found.box


@pytest.mark.parametrize("kind", [kind for kind in FORMATS if kind != "firmware"])
def test_a_calibration_and_its_export_do_the_same(kind: str, tmp_path: Path) -> None:
    source = written(sensor(GAIN, PRIOR), tmp_path / "calibration.json")
    path = exported(source, kind, tmp_path / "out")
    (found,) = compare(exports.read(source), exports.read(path), recording(R @ PRIOR.T))
    assert found.full_scale is not None
    assert found.at_log is not None
    # S and back in float64, against thousands of newtons
    np.testing.assert_allclose(found.full_scale, 0, atol=1e-9)
    np.testing.assert_allclose(found.at_log.largest, 0, atol=1e-9)
    expected = -np.array(of(sensor(GAIN, PRIOR)).offset) if kind == "ati" else np.zeros(6)
    np.testing.assert_allclose(found.offset, expected, atol=1e-12)


@pytest.mark.parametrize("logged", ["wrench", "channels"])
@pytest.mark.parametrize("kind", ["json", "yarp"])
def test_the_loads_of_a_log_are_those_of_both_laws(kind: str, logged: Any, tmp_path: Path) -> None:
    """Change = law B - law A on the same readings; its mean is the shift, the rest RMS and max."""
    offset = (1.0, 2.0, 3.0, 0.1, 0.2, 0.3)
    known = [sensor(GAIN, PRIOR, logged=logged), sensor(OTHER, PRIOR, logged=logged, offset=offset)]
    laws = []
    for name, one in zip("ab", known, strict=True):
        source = written(one, tmp_path / f"{name}.json")
        laws.append(exports.read(exported(source, kind, tmp_path / name)))
    values = R @ PRIOR.T if logged == "wrench" else R
    holes = np.vstack([values, np.full((3, 6), np.nan)])
    (found,) = compare(laws[0], laws[1], recording(holes))
    moved = known[1].model().wrench(R) - known[0].model().wrench(R)
    swing = moved - moved.mean(axis=0)
    assert found.at_log is not None
    assert found.at_log.samples == len(R)
    np.testing.assert_allclose(found.at_log.shift, moved.mean(axis=0), rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(found.at_log.rms, swing.std(axis=0), rtol=1e-8)
    np.testing.assert_allclose(found.at_log.largest, np.abs(swing).max(axis=0), rtol=1e-8)


def test_another_reference_temperature_is_an_offset() -> None:
    k = (0.5, -0.25, 2.0, 0.0, 0.125, -0.5)
    a = sensor(GAIN, PRIOR, temperature_gain=k, reference_temperature=30.0)
    b = sensor(GAIN, PRIOR, temperature_gain=k, reference_temperature=20.0)
    found = change(of(a), of(b))
    T = np.full(1, 55.0)
    moved = b.model().wrench(R[:1], T) - a.model().wrench(R[:1], T)
    np.testing.assert_allclose(found.offset, moved[0], atol=1e-9)
    assert not found.per_kelvin.any()


def test_a_foreign_file_is_compared_with_a_calibration_and_with_its_like(tmp_path: Path) -> None:
    numbers = ",".join(str(x) for x in (np.eye(6) * 1.5).ravel())
    path = tmp_path / "wbd.xml"
    path.write_text(
        '<!DOCTYPE devices PUBLIC "-//YARP//DTD yarprobotinterface 3.0//EN" "x.dtd">'
        '<devices robot="r" build="1"><device name="wbd" type="wholebodydynamics">'
        '<group name="FT_SECONDARY_CALIBRATION"><param name="r_leg_ft_sensor">'
        f"({numbers})</param></group></device></devices>"
    )
    foreign = exports.read(path)
    (found,) = compare(foreign, [of(sensor(PRIOR, PRIOR, offset=[0.0] * 6))])
    assert found.full_scale is not None
    np.testing.assert_allclose(found.full_scale, 0.5 * np.array(FULL_SCALE), rtol=1e-9)
    (alone,) = compare(foreign, foreign)
    assert alone.full_scale is None
    result = run("diff", path, path)
    assert result.exit_code == 0, result.output
    assert "full scale: not known" in result.stdout
    with pytest.raises(DataError, match="neither file names its signal"):
        compare(foreign, foreign, recording(R, "one", "two"))
    (only,) = compare(foreign, foreign, recording(R, "one"))
    assert only.at_log is not None
    assert only.at_log.samples == len(R)
    with pytest.raises(DataError, match="5 columns; sensor 'r_leg_ft_sensor' has 6"):
        compare(foreign, foreign, recording(R[:, :5], "one"))


def test_a_matrix_on_counts_and_one_on_wrenches_need_a_workbench(tmp_path: Path) -> None:
    law = of(sensor(GAIN, PRIOR))
    bare = [Installed("x", reads, law.matrix, law.offset) for reads in ("channels", "wrench")]
    with pytest.raises(SensorError, match=r"compare with calibration\.json"):
        change(bare[0], bare[1])


def test_files_without_a_common_sensor_are_named() -> None:
    a = [of(sensor(GAIN, PRIOR, name=name, serial=name)) for name in ("left", "right")]
    b = [of(sensor(GAIN, PRIOR, name="head", serial="head"))]
    with pytest.raises(SensorError, match="left, right in A, head in B"):
        compare(a, b)


def test_sensors_are_paired_by_name_then_by_serial_number() -> None:
    """Workbenches of one name (`as logged`) pair nothing across."""
    a = [of(sensor(GAIN, PRIOR, name=name, serial="as logged")) for name in ("left", "right")]
    assert [(old.sensor, new.sensor) for old, new in pairs(a, a[::-1])] == [
        ("left", "left"),
        ("right", "right"),
    ]
    board = [Installed("SN901", "channels", GAIN, np.zeros(6))]
    b = [of(sensor(GAIN, PRIOR, name=f"s{n}", serial=f"SN90{n}")) for n in range(3)]
    assert [(old.sensor, new.sensor) for old, new in pairs(board, b)] == [("SN901", "s1")]


def test_the_command_prints_a_table_and_json(tmp_path: Path) -> None:
    b = written(exact(offset=(16.0, 0.0, 0.0, 1.0, 0.0, 0.0)), tmp_path / "b.json")
    other = sensor(exact_secondary() @ exact_prior(), exact_prior(), name="wrist", serial="SN901")
    a = tmp_path / "a.json"
    a.write_bytes(to_json(calibration(exact(refused=("fx", "fy", "fz", "tx", "ty", "tz")), other)))
    table = tmp_path / "log.csv"
    f = np.array([[64.0, 32.0, 16.0, 2.0, 4.0, 8.0], [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]])
    head = ",".join(f"{SIGNAL}.{axis}" for axis in ("fx", "fy", "fz", "tx", "ty", "tz"))
    lines = [f"{i / 100}," + ",".join(map(str, f[i % 2])) for i in range(100)]
    table.write_text("\n".join([f"time,{head}", *lines]) + "\n")
    result = run("diff", a, b, "--log", table)
    assert result.exit_code == 0, result.output
    check("export/diff.txt", result.stdout)
    assert max(map(len, result.stdout.splitlines())) <= 100
    record = json.loads(run("diff", a, b, "--log", table, "--json").stdout)
    found = record["sensors"]["r_leg_ft_sensor"]
    # S - I: fz doubles and takes four of ty, whose full scale is 64
    assert found["full_scale"]["fz"] == pytest.approx(2048 + 4 * 64)
    assert found["log"]["samples"] == 100
    assert found["log"]["rms"]["fz"] == pytest.approx((16 + 4 * 4) / 2)
    assert record["alone"] == ["wrist is in A alone"]


@needs_genova02
def test_undo_is_what_the_board_of_the_real_robot_holds(tmp_path: Path) -> None:
    """SN026 as the manufacturer wrote it, exported again as the prior of a calibration."""
    from ftcal.firmware import read_matrix

    original = read_matrix(GENOVA02 / "matrices" / "matrix_SN026.txt")
    scale = [float(value) for value in original.full_scale]
    known = sensor(
        original.matrix * 1.01, original.matrix, serial=original.serial, full_scale=scale
    )
    source = written(known, tmp_path / "calibration.json")
    path = exported(source, "firmware", tmp_path / "out", "--undo")
    assert path.name == "matrix_SN026.txt"
    np.testing.assert_array_equal(read_matrix(path).words, original.words)
    np.testing.assert_array_equal(read_matrix(path).full_scale, original.full_scale)
