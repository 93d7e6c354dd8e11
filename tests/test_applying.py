"""A log read again with its calibration."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from ftcal import logs
from ftcal.applying import (
    ZERO,
    apply,
    by_rows,
    chosen_offset,
    corrected,
    refused,
    wrench_sd,
    writer,
)
from ftcal.calibration import Calibration, Offset, SensorCalibration
from ftcal.cli import main
from ftcal.config import read_job
from ftcal.errors import DataError, LogError, OutputError
from ftcal.logs import tables
from ftcal.pipeline import calibrate
from ftcal.recording import NANOSECONDS, Recording, Signal
from ftcal.signals import default_gap, interpolate, longest_pause, temperature_at
from pretend import FULL_SCALE
from small_world import take, truth, write_world

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array


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


def warm(calibration: Calibration, thermometer: str) -> Calibration:
    """Return the calibration with a temperature term, of about the size that real sensors have."""
    (sensor,) = calibration.sensors
    covariance = np.zeros((6, 7, 7))
    covariance[:, :6, :6] = sensor.covariance
    covariance[:, 6, 6] = 0.02**2
    offsets = [
        segment.model_copy(update={
            "centre": segment.centre.model_copy(update={"inputs": [*segment.centre.inputs, 3.0]})
        })
        for segment in sensor.offsets
        if segment.centre is not None
    ]  # fmt: skip
    known = sensor.model_copy(
        update={
            "temperature_signal": thermometer,
            "temperature_gain": [0.5, -0.3, 1.0, 0.01, -0.02, 0.005],
            "reference_temperature": 30.0,
            "covariance": covariance.tolist(),
            "offsets": offsets,
        }
    )
    return calibration.model_copy(update={"sensors": [known]})


def session(folder: Path, world: Path) -> logs.Layout:
    """Write `two` with a slow thermometer that pauses, as a folder; return its layout."""
    recording = logs.read(world.parent / "two.csv")
    signal = recording.channels[0]
    rng = np.random.default_rng(3)
    kept = rng.random(len(signal)) > 0.1
    channels = Signal(signal.name, signal.columns, signal.stamps[kept], signal.values[kept])
    steps = rng.integers(90_000_000, 110_000_000, 500)
    steps[[40, 41, 100, 300]] += 3 * NANOSECONDS  # a lone sample between the first two
    stamps = int(signal.stamps[0]) + NANOSECONDS + np.cumsum(steps)
    degrees = 30.0 + 3.0 * np.sin(np.arange(500) / 40.0)[:, None]
    board = Signal("board", ("temperature",), stamps, degrees)
    taken = Recording("two", "", recording.start, (), (channels,), (board,))
    return tables.write(taken, folder)


def assert_written_alike(made: Path, expected: Recording) -> None:
    """Assert that `made` holds what `tables.write` writes of the whole, to the last bit."""
    whole = made.with_name(f"whole{made.suffix}")
    tables.write(expected, whole)
    if made.suffix == ".csv":
        assert made.read_bytes() == whole.read_bytes()
    ours, theirs = logs.read(made), logs.read(whole)
    pairs = zip((*ours.channels, *ours.joints), (*theirs.channels, *theirs.joints), strict=True)
    for found, wanted in pairs:
        assert found.columns == wanted.columns
        np.testing.assert_array_equal(found.stamps, wanted.stamps)
        assert found.values.tobytes() == wanted.values.tobytes()
    np.testing.assert_array_equal(ours.channels[0].values, expected.channels[0].values[:, :6])


@pytest.mark.parametrize("rows", [37, 1000, 10**6])
@pytest.mark.parametrize("name", ["out.csv", "out.parquet", "out"])
@pytest.mark.parametrize("sd", [False, True])
def test_pieces_give_the_bits_of_the_whole(
    world: Path, calibration: Calibration, tmp_path: Path, rows: int, name: str, sd: bool
) -> None:
    log, made, known = tmp_path / "two", tmp_path / name, warm(calibration, "board")
    layout = session(log, world)
    expected, _ = corrected(known, logs.read(log, layout), sd=sd)
    used = apply(known, logs.in_pieces(log, layout), made, sd=sd, rows=rows)
    assert used == {"ft_sensor": "two 0.9-39.1 s"}
    # of about 3600 samples, those before the thermometer's first and in its pauses are out
    assert 1000 < len(expected.channels[0]) < 3500
    assert_written_alike(made, expected)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_pieces_of_a_single_row_do_too(
    world: Path, calibration: Calibration, tmp_path: Path, suffix: str
) -> None:
    log = tmp_path / "two.csv"
    log.write_text("\n".join((world.parent / "two.csv").read_text().splitlines()[:61]) + "\n")
    apply(calibration, logs.in_pieces(log), tmp_path / f"out{suffix}", sd=True, rows=1)
    assert_written_alike(
        tmp_path / f"out{suffix}", corrected(calibration, logs.read(log), sd=True)[0]
    )


def test_ros_messages_hold_the_corrected_wrenches(
    world: Path, calibration: Calibration, tmp_path: Path
) -> None:
    log, out = world.parent / "two.csv", tmp_path / "out.mcap"
    apply(calibration, logs.in_pieces(log), out, sd=True, rows=1000)
    expected = corrected(calibration, logs.read(log), sd=True)[0].channels[0]
    back = {signal.name: signal for signal in logs.read(out).channels}
    assert sorted(back) == ["ft_sensor", "ft_sensor/sd"]
    for name, columns in (("ft_sensor", slice(0, 6)), ("ft_sensor/sd", slice(6, 12))):
        np.testing.assert_array_equal(back[name].stamps, expected.stamps)
        np.testing.assert_array_equal(back[name].values, expected.values[:, columns])


@pytest.mark.parametrize("name", ["out.csv", "out.parquet", "out", "out.mcap"])
def test_a_fault_late_in_the_log_leaves_nothing_behind(
    world: Path, calibration: Calibration, tmp_path: Path, name: str
) -> None:
    lines = (world.parent / "two.csv").read_text().splitlines()
    lines[3000] = lines[3000].rpartition(",")[0] + ",nan"
    log = tmp_path / "two.csv"
    log.write_text("\n".join(lines) + "\n")
    with pytest.raises(LogError, match="row 3001: column"):
        apply(calibration, logs.in_pieces(log), tmp_path / name, rows=100)
    assert [file.name for file in tmp_path.iterdir()] == ["two.csv"]


@pytest.mark.parametrize("name", ["out.csv", "out.parquet"])
def test_sensors_with_clocks_of_their_own_want_a_folder(
    calibration: Calibration, tmp_path: Path, name: str
) -> None:
    (sensor,) = calibration.sensors
    other = sensor.model_copy(update={"sensor": "other", "signal": "other"})
    known = calibration.model_copy(update={"sensors": [sensor, other]})
    ours = np.arange(100) * 1_000_000
    theirs = ours.copy()
    theirs[80:] += 5
    columns = ("fx", "fy", "fz", "tx", "ty", "tz")
    names = ((sensor.signal, ours), ("other", theirs))
    signals = tuple(Signal(name, columns, stamps, np.ones((100, 6))) for name, stamps in names)
    layout = tables.write(Recording("two", "", 0, (), signals), tmp_path / "log")
    log = logs.in_pieces(tmp_path / "log", layout)
    with pytest.raises(OutputError, match=r"have clocks of their own; give a folder"):
        apply(known, log, tmp_path / name, rows=10)
    assert [file.name for file in tmp_path.iterdir()] == ["log"]
    apply(known, log, tmp_path / "out", rows=10)
    assert sorted(f.name for f in (tmp_path / "out").iterdir()) == [
        "ft_sensor.parquet", "other.parquet",
    ]  # fmt: skip


def wrenches(*names: str, rows: int = 3, start: int = 0) -> Recording:
    """Return signals of ones on a clock that they share."""
    stamps = start + np.arange(rows)
    columns = ("fx", "fy", "fz", "tx", "ty", "tz")
    return Recording(
        "take",
        "",
        0,
        (),
        tuple(Signal(name, columns, stamps, np.ones((rows, 6))) for name in names),
    )


@pytest.mark.parametrize("pieces", [(("a", "b"), ("b",)), (("b",), ("a", "b")), (("a",), ("b",))])
def test_a_signal_that_pauses_has_a_clock_of_its_own(
    tmp_path: Path, pieces: tuple[tuple[str, ...], tuple[str, ...]]
) -> None:
    def write(path: Path) -> None:
        with writer(path) as file:
            file.add(wrenches(*pieces[0]))
            file.add(wrenches(*pieces[1], start=10))

    with pytest.raises(OutputError, match=r"'a' and 'b' have clocks of their own; give a folder"):
        write(tmp_path / "t.csv")
    write(tmp_path / "t")
    rows = {signal.name: len(signal) for signal in logs.read(tmp_path / "t").channels}
    assert rows == {name: 3 * sum(name in piece for piece in pieces) for name in ("a", "b")}


def test_names_that_would_meet_in_a_table_are_refused(tmp_path: Path) -> None:
    with (
        pytest.raises(OutputError, match="two columns would have one name"),
        writer(tmp_path / "t.csv") as file,
    ):
        file.add(wrenches("a", "a"))
    with (
        pytest.raises(OutputError, match="two signals are called 'a'"),
        writer(tmp_path / "t") as file,
    ):
        file.add(wrenches("a", "a"))
    assert not list(tmp_path.iterdir())


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match=r"t\.csv: cannot be written"):
        writer(tmp_path / "file" / "t.csv")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "precious").touch()
    with (
        pytest.raises(OutputError, match="full: cannot be written"),
        writer(tmp_path / "full") as file,
    ):
        file.add(wrenches("a"))
    assert sorted(place.name for place in tmp_path.iterdir()) == ["file", "full"]
    assert (tmp_path / "full" / "precious").exists()


def test_a_log_without_a_temperature_where_it_matters_has_nothing_to_write(
    world: Path, calibration: Calibration, tmp_path: Path
) -> None:
    recording = logs.read(world.parent / "two.csv")
    early = recording.channels[0].stamps[:1] - 5 * NANOSECONDS
    board = Signal("board", ("temperature",), early, np.array([[30.0]]))
    taken = Recording("two", "", recording.start, (), recording.channels, (board,))
    layout = tables.write(taken, tmp_path / "log")
    with pytest.raises(OutputError, match="'log' has no sample to write"):
        apply(warm(calibration, "board"), logs.in_pieces(tmp_path / "log", layout), tmp_path / "o")
    assert [file.name for file in tmp_path.iterdir()] == ["log"]


def test_a_row_is_rounded_alike_wherever_it_stands() -> None:
    rng = np.random.default_rng(0)
    x, matrix, offset = rng.normal(size=(9000, 7)), rng.normal(size=(6, 7)), rng.normal(size=6)
    whole = by_rows(x, matrix, offset)
    np.testing.assert_allclose(whole, x @ matrix.T + offset, rtol=1e-12, atol=1e-13)
    for start, stop in ((0, 1), (1, 3), (4095, 4098), (17, 8999)):
        assert by_rows(x[start:stop], matrix, offset).tobytes() == whole[start:stop].tobytes()


@settings(deadline=None)
@given(
    steps=st.lists(st.integers(1, 30), max_size=12), at=st.lists(st.integers(-5, 200), max_size=20)
)
def test_a_temperature_is_the_interpolated_one(steps: list[int], at: list[int]) -> None:
    stamps = np.cumsum([0, *steps]) * 10_000_000
    board = Signal("board", ("temperature",), stamps, np.cos(stamps / 1e9)[:, None])
    clock = np.sort(np.array(at, dtype=np.int64)) * 5_000_000
    gap = 0.1
    found = temperature_at(board, clock, gap)
    # seconds since the first sample of a run round at 1e-16 of them
    np.testing.assert_allclose(found, interpolate(board, clock, max_gap=gap)[:, 0], rtol=1e-12)


def test_without_a_sample_of_it_there_is_no_temperature() -> None:
    board = Signal("board", ("temperature",), np.empty(0, np.int64), np.empty((0, 1)))
    assert np.isnan(temperature_at(board, np.arange(3), 1.0)).all()


def test_nothing_is_interpolated_across_a_break() -> None:
    degrees: Float[Array, "4 1"] = np.arange(4.0)[:, None]
    board = Signal("board", ("temperature",), np.arange(4) * 10, degrees, breaks=(2,))
    found = temperature_at(board, np.array([5, 10, 15, 20, 30]), 1.0)
    np.testing.assert_array_equal(found, [0.5, 1.0, np.nan, 2.0, 3.0])


@pytest.mark.parametrize("samples", [1, 2, 30])
def test_a_pause_is_as_long_as_it_is_for_the_calibration(samples: int) -> None:
    stamps = np.cumsum(np.random.default_rng(samples).integers(1, 10**9, samples))
    board = Signal("board", ("temperature",), stamps, np.zeros((samples, 1)))
    assert longest_pause(board.period) == default_gap(board)


def test_the_examples_of_the_documentation_run(
    world: Path, calibration: Calibration, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from ftcal.calibration import to_json

    monkeypatch.chdir(tmp_path)
    Path("calibration.json").write_bytes(to_json(calibration))
    Path("two.csv").write_bytes((world.parent / "two.csv").read_bytes())
    page = (Path(__file__).parents[1] / "docs" / "apply.md").read_text(encoding="utf-8")
    made: dict[str, Any] = {}
    for example in page.split("```python\n")[1:]:
        exec(example.partition("```")[0], made)
    assert Path("corrected.parquet").exists()
    assert made["wrench"].shape == made["doubt"].shape == (6,)
