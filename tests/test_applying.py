"""A log read again with its calibration."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from ftcal import logs
from ftcal.applying import ZERO, chosen_offset, corrected, refused, wrench_sd
from ftcal.calibration import Calibration, Offset, SensorCalibration
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


def with_verdicts(calibration: Calibration, *words: str) -> Calibration:
    """Return the calibration with other verdicts on its axes."""
    (sensor,) = calibration.sensors
    verdicts = [
        verdict.model_copy(update={"verdict": word})
        for verdict, word in zip(sensor.verdicts, words, strict=True)
    ]
    return calibration.model_copy(
        update={"sensors": [sensor.model_copy(update={"verdicts": verdicts})]}
    )


def segment_of(calibration: Calibration) -> tuple[SensorCalibration, Offset, np.ndarray]:
    """Return the sensor, the offset of `two`, and the channels about which it was found."""
    (sensor,) = calibration.sensors
    segment, _ = chosen_offset(sensor, "two", "two")
    assert segment.centre is not None
    return sensor, segment, np.array(segment.centre.inputs)


def test_at_the_mean_of_the_segment_the_gain_does_no_harm(calibration: Calibration) -> None:
    sensor, segment, mean = segment_of(calibration)
    assert segment.centre is not None
    (sd,) = wrench_sd(sensor, mean[None], segment)
    np.testing.assert_allclose(sd, segment.centre.sd, rtol=1e-12)
    independent = 3820 / np.array(sensor.inefficiency)  # samples of `two` in its segment
    np.testing.assert_allclose(sd, sensor.noise_sd / np.sqrt(independent), rtol=1e-6)


def test_at_zero_counts_it_is_the_standard_deviation_of_the_offset(
    calibration: Calibration,
) -> None:
    sensor, segment, mean = segment_of(calibration)
    (sd,) = wrench_sd(sensor, np.zeros((1, len(mean))), segment)
    # the quadratic form of an offset of thousands of counts keeps about ten digits
    np.testing.assert_allclose(sd, segment.sd, rtol=1e-9)


def test_away_from_the_mean_it_is_the_quadratic_form_of_the_covariance(
    calibration: Calibration,
) -> None:
    sensor, segment, mean = segment_of(calibration)
    assert segment.centre is not None
    away = np.random.default_rng(0).normal(size=(50, 6)) * 3000.0
    squared = np.einsum("np,ipq,nq->ni", away, np.array(sensor.covariance), away)
    expected = np.sqrt(squared + np.array(segment.centre.sd) ** 2)
    np.testing.assert_allclose(wrench_sd(sensor, mean + away, segment), expected, rtol=1e-9)


def test_warming_counts_from_the_mean_temperature(calibration: Calibration) -> None:
    """A seventh column, T - T_ref: k is known to 0.02 N/K, the segment was 3 K warm."""
    sensor, segment, mean = segment_of(calibration)
    assert segment.centre is not None
    covariance = np.zeros((6, 7, 7))
    covariance[:, 6, 6] = 0.02**2
    inputs = [*mean, 3.0]
    warm = segment.model_copy(
        update={"centre": segment.centre.model_copy(update={"inputs": inputs, "sd": [0.0] * 6})}
    )
    known = sensor.model_copy(update={"covariance": covariance.tolist()})
    sd = wrench_sd(known, np.array([inputs, [*mean, 8.0]]), warm)
    np.testing.assert_allclose(sd, [[0.0] * 6, [0.1] * 6], rtol=1e-12)


def test_without_an_offset_zero_counts_are_exact(calibration: Calibration) -> None:
    (sensor,) = calibration.sensors
    segment, _ = chosen_offset(sensor, "two", ZERO)
    assert (wrench_sd(sensor, np.zeros((1, 6)), segment) == 0.0).all()
    assert (wrench_sd(sensor, np.full((1, 6), 1000.0), segment) > 0.0).all()


def test_a_refused_axis_has_no_standard_deviation(world: Path, calibration: Calibration) -> None:
    half = with_verdicts(calibration, "ACCEPT", "REFUSE", "PARTIAL", "REFUSE", "ACCEPT", "ACCEPT")
    (sensor,) = half.sensors
    assert refused(sensor) == ("fy", "tx")
    segment, _ = chosen_offset(sensor, "two", "two")
    sd = wrench_sd(sensor, np.zeros((2, 6)), segment)
    assert np.isnan(sd).all(axis=0).tolist() == [False, True, False, True, False, False]
    (signal,) = corrected(half, logs.read(world.parent / "two.csv"), sd=True)[0].channels
    assert signal.columns[6:] == ("fx_sd", "fz_sd", "ty_sd", "tz_sd")
    assert np.isfinite(signal.values).all()


def test_an_offset_without_its_mean_has_no_standard_deviation(
    world: Path, calibration: Calibration
) -> None:
    (sensor,) = calibration.sensors
    old = [offset.model_copy(update={"centre": None}) for offset in sensor.offsets]
    aged = calibration.model_copy(update={"sensors": [sensor.model_copy(update={"offsets": old})]})
    recording = logs.read(world.parent / "two.csv")
    corrected(aged, recording)
    with pytest.raises(DataError, match=r"'ft_sensor' for 'two' has no `centre`"):
        corrected(aged, recording, sd=True)


def test_a_calibration_of_before_still_reads(calibration: Calibration, tmp_path: Path) -> None:
    from ftcal.calibration import read_calibration

    plain = calibration.model_dump(mode="json")
    for offset in plain["sensors"][0]["offsets"]:
        del offset["centre"]
    file = tmp_path / "calibration.json"
    file.write_text(json.dumps(plain))
    assert read_calibration(file).sensors[0].offsets[0].centre is None


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ""])
def test_the_command_writes_standard_deviations_beside_the_wrench(
    world: Path, calibration: Calibration, tmp_path: Path, suffix: str
) -> None:
    """The table still reads as the sensor's six columns; the rest does no harm there."""
    from ftcal.calibration import to_json

    known, out = tmp_path / "calibration.json", tmp_path / f"out{suffix}"
    known.write_bytes(to_json(with_verdicts(calibration, "ACCEPT", "REFUSE", *["ACCEPT"] * 4)))
    log = world.parent / "two.csv"
    result = CliRunner().invoke(main, ["apply", str(known), str(log), "-o", str(out), "--sd"])
    assert result.exit_code == 0, result.output
    assert "ft_sensor: no standard deviation of fy: Workbench kept" in result.stdout
    back = logs.read(out)
    assert [signal.name for signal in back.channels] == ["ft_sensor"]
    assert len(back.channels[0].columns) == 6
    names = [f"ft_sensor.{axis}_sd" for axis in ("fx", "fz", "tx", "ty", "tz")]
    assert list(back.joints[0].columns) == names
    assert (back.joints[0].values > 0).all()
