"""Facts about the readers and writers of CSV and Parquet tables."""

from __future__ import annotations

import csv
import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyarrow import parquet

from ftcal.errors import FtcalError, LogError, OutputError
from ftcal.logs import Layout, read, tables
from ftcal.logs.layout import WRENCH_AXES, TimeUnit
from ftcal.recording import Recording, Signal

ATI = Path(__file__).resolve().parents[2] / "shared" / "data" / "ati-gamma-lbrmed"
START = 1_457_614_036_921_366_123


def write(file: Path, header: Sequence[str], rows: Sequence[Sequence[object]], **form: str) -> Path:
    """Write a CSV with the standard library, not with the writer under test."""
    with file.open("w", newline="") as stream:
        out = csv.writer(stream, delimiter=form.get("delimiter", ","))
        out.writerow(header)
        out.writerows(rows)
    return file


def test_one_csv_gives_joints_and_named_forces(tmp_path: Path) -> None:
    header = ["time", "knee", *(f"l_leg.{axis}" for axis in WRENCH_AXES), "note"]
    rows = [[0.0, 0.1, 1, 2, 3, 4, 5, 6, "a"], [0.01, 0.2, 1.5, 2, 3, 4, 5, 6, "b"]]
    recording = read(write(tmp_path / "walk.csv", header, rows))
    (joints,), (force,) = recording.joints, recording.channels
    assert (recording.name, joints.name, joints.columns) == ("walk", "walk", ("knee",))
    assert (force.name, force.columns) == ("l_leg", WRENCH_AXES)
    assert force.values.tolist() == [[1, 2, 3, 4, 5, 6], [1.5, 2, 3, 4, 5, 6]]
    assert force.stamps.tolist() == [0, 10_000_000]
    assert recording.digest == hashlib.sha256(
        hashlib.sha256((tmp_path / "walk.csv").read_bytes()).digest()
    ).hexdigest()  # fmt: skip


@pytest.mark.parametrize(
    ("columns", "signal"),
    [
        (["a.fx", "a.fy", "a.fz", "a.mx", "a.my", "a.mz"], "a"),
        (["a/FX", "a/FY", "a/FZ", "a/TX", "a/TY", "a/TZ"], "a"),
        (["l_leg_tx", "l_leg_ty", "l_leg_tz", "l_leg_fx", "l_leg_fy", "l_leg_fz"], "l_leg"),
        (list(WRENCH_AXES), "log"),
    ],
)
def test_forces_are_found_by_their_columns(tmp_path: Path, columns: list[str], signal: str) -> None:
    recording = read(write(tmp_path / "log.csv", ["time", *columns], [[0.5, *range(6)]]))
    (force,) = recording.channels
    assert force.name == signal
    order = [c[-2:].lower().replace("m", "t") for c in columns]
    assert force.values.tolist() == [[order.index(axis) for axis in WRENCH_AXES]]


def test_magnetometer_alone_is_no_force(tmp_path: Path) -> None:
    recording = read(write(tmp_path / "log.csv", ["time", "mx", "my", "mz"], [[0.5, 1, 2, 3]]))
    assert not recording.channels
    assert recording.joints[0].columns == ("mx", "my", "mz")


def test_layout_claims_renames_and_leaves_out(tmp_path: Path) -> None:
    header = ["t", "q1", "q2", "battery", "raw1", "raw2", "heat", "ax"]
    file = write(tmp_path / "log.csv", header, [[1, 90, 180, "nan", 7, 8, 40, 9.8]])
    layout = Layout(
        time="t", time_unit="ms", angle="deg",
        joints={"q2": ("knee",), "battery": ()},
        channels={"leg": ("raw1", "raw2")},
        temperatures={"leg": "heat"},
        imus={"waist": ("ax",)},
    )  # fmt: skip
    recording = read(file, layout, name="run 7")
    (joints,) = recording.joints
    assert joints.columns == ("q1", "knee")
    np.testing.assert_allclose(joints.values, [[np.pi / 2, np.pi]], rtol=1e-15)
    assert recording.channels[0].values.tolist() == [[7, 8]]
    assert recording.temperature("leg").values.tolist() == [[40]]
    assert recording.imus[0].columns == ("ax",)
    assert (recording.start, recording.name) == (1_000_000, "run 7")


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_delimiter_is_the_one_the_header_uses(tmp_path: Path, delimiter: str) -> None:
    file = write(tmp_path / "log.csv", ["time", "knee"], [[0.5, 1.25]], delimiter=delimiter)
    assert read(file).joints[0].values.tolist() == [[1.25]]


@pytest.mark.parametrize(
    ("stamp", "nanoseconds"),
    [
        ("1457614036", 1_457_614_036_000_000_000),
        ("1457614036921", 1_457_614_036_921_000_000),
        ("1457614036921366", 1_457_614_036_921_366_000),
        ("1457614036921366123", START),
        ("1457614036.921366", 1_457_614_036_921_366_000),
        ("1457614036.921366123", START),
        ("1.457614036921366e9", 1_457_614_036_921_366_000),
        ("0.25", 250_000_000),
        ("2016-03-10 12:47:16.921366123", START),
    ],
)
def test_stamps_are_read_to_the_last_digit(tmp_path: Path, stamp: str, nanoseconds: int) -> None:
    file = write(tmp_path / "log.csv", ["time", "knee"], [[stamp, 1]])
    assert read(file).joints[0].stamps.tolist() == [nanoseconds]


@pytest.mark.parametrize(("unit", "scale"), [("s", 10**9), ("ms", 10**6), ("us", 1000), ("ns", 1)])
def test_whole_numbers_from_boot_need_a_unit(tmp_path: Path, unit: TimeUnit, scale: int) -> None:
    file = write(tmp_path / "log.csv", ["time", "knee"], [[5, 1], [6, 1]])
    with pytest.raises(LogError, match="give time_unit in the job"):
        read(file)
    stamps = read(file, Layout(time_unit=unit)).joints[0].stamps
    assert stamps.tolist() == [5 * scale, 6 * scale]


@pytest.mark.parametrize("stamp", ["99999999999.5", "1e300", "nan", "", "noon"])
def test_stamp_that_is_no_time_is_refused(tmp_path: Path, stamp: str) -> None:
    file = write(tmp_path / "log.csv", ["time", "knee"], [["0.5", 1], [stamp, 1]])
    with pytest.raises(LogError, match=r"log\.csv"):
        read(file)


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
def test_parquet_timestamps_need_no_unit(tmp_path: Path, unit: str) -> None:
    moments = pa.array([1_700_000_000 * 1000], pa.int64()).cast(pa.timestamp("ms"))
    table = pa.table({"time": moments.cast(pa.timestamp(unit)), "knee": pa.array([1], pa.int16())})
    parquet.write_table(table, tmp_path / "log.parquet")
    assert read(tmp_path / "log.parquet").start == 1_700_000_000 * 10**9


def test_counts_that_turn_fractional_late_are_numbers(tmp_path: Path) -> None:
    rows = [[f"{n / 1000:.3f}", 0] for n in range(60_000)]
    rows[-1][1] = 0.5
    file = write(tmp_path / "log.csv", ["time", "knee"], rows)
    assert read(file).joints[0].values[-1, 0] == 0.5


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the file is empty"),
        ("time,knee\n", "a header but no rows"),
        ("clock,knee\n1.5,2\n", "no time column 'time'; did you mean clock, knee"),
        ("time,knee,knee\n1.5,2,3\n", "column 'knee' appears 2 times"),
        ("time,knee\n1.5,2\n1.6,nan\n", "row 3: column 'knee' is nan"),
        ("time,knee\n1.5,2\n1.6,inf\n", "row 3: column 'knee' is inf"),
        ("time,knee\n1.5,2\n1.6,\n", "row 3: column 'knee' is nan"),
        ("time,knee\n1.5,2\n1.4,3\n", r"row 3: time goes back by 0\.100000 s"),
        ("time,knee\n1.5,2\n1.6\n", "not a readable table"),
        ("time,note\n1.5,a\n", "no F/T, joint, temperature or inertial sample"),
        ("time,knee\n,2\n", "no time stamp|is no time"),
    ],
)
def test_broken_table_is_refused_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "log.csv"
    file.write_text(text)
    with pytest.raises(LogError, match=message) as caught:
        read(file)
    assert "log.csv" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("suffix", [".parquet", ".csv", ".tsv"])
@settings(max_examples=60, deadline=None)
@given(
    content=st.binary(max_size=60) | st.text("time,\nknee0123.-\"'e", max_size=60).map(str.encode)
)
def test_any_bytes_are_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, suffix: str, content: bytes
) -> None:
    file = tmp_path_factory.mktemp("fuzz") / f"log{suffix}"
    file.write_bytes((b"" if suffix == ".parquet" else b"time,knee\n") + content)
    try:
        recording = read(file)
    except FtcalError:
        return
    assert all(np.isfinite(signal.values).all() for signal in recording.joints)


def test_repeated_stamps_are_dropped_and_told(tmp_path: Path) -> None:
    file = write(tmp_path / "log.csv", ["time", "knee"], [[0.1, 1], [0.1, 2], [0.2, 3]])
    recording = read(file)
    assert recording.joints[0].values.tolist() == [[1], [3]]
    assert [f.kind for f in recording.findings] == ["duplicate stamps"]


def test_folder_is_one_recording_of_several_clocks(tmp_path: Path) -> None:
    write(tmp_path / "legs.csv", ["time", "knee"], [[0.5, 1], [0.7, 2]])
    write(tmp_path / "force.csv", ["time", *WRENCH_AXES], [[0.25, 1, 2, 3, 4, 5, 6]])
    recording = read(tmp_path)
    assert [s.name for s in (*recording.joints, *recording.channels)] == ["legs", "force"]
    assert recording.start == 250_000_000
    assert read(tmp_path, Layout(zero="legs")).start == 500_000_000


@pytest.mark.parametrize(
    ("layout", "message"),
    [
        (Layout(channels={"leg": ("fx", "knei")}), "no column 'knei'; did you mean"),
        (Layout(channels={"leg": ("fx", "knee")}), "no single table holds"),
        (Layout(temperatures={"leg": "note"}), "column 'note' of 'leg' is string"),
        (Layout(joints={"kne": ("l_knee",)}), "no column 'kne'; did you mean knee"),
    ],
)
def test_column_that_the_layout_names_must_be_there(
    tmp_path: Path, layout: Layout, message: str
) -> None:
    write(tmp_path / "legs.csv", ["time", "knee", "note"], [[0.5, 1, "a"]])
    write(tmp_path / "force.csv", ["time", *WRENCH_AXES], [[0.25, 1, 2, 3, 4, 5, 6]])
    with pytest.raises(LogError, match=message):
        read(tmp_path, layout)


def test_two_tables_with_one_signal_are_refused(tmp_path: Path) -> None:
    for name in ("a", "b"):
        header = ["time", *(f"leg.{axis}" for axis in WRENCH_AXES)]
        write(tmp_path / f"{name}.csv", header, [[0.25, 1, 2, 3, 4, 5, 6]])
    with pytest.raises(LogError, match="2 signals share the name 'leg'"):
        read(tmp_path)


def test_file_of_another_kind_is_refused(tmp_path: Path) -> None:
    (tmp_path / "log.xlsx").touch()
    with pytest.raises(LogError, match=r"no reader for '\.xlsx'"):
        read(tmp_path / "log.xlsx")


numbers = st.floats(allow_nan=False, allow_infinity=False)


@st.composite
def signals(draw: st.DrawFn, name: str, columns: tuple[str, ...], stamps: list[int]) -> Signal:
    size = len(stamps) * len(columns)
    values = np.array(draw(st.lists(numbers, min_size=size, max_size=size)))
    return Signal(name, columns, np.array(stamps), values.reshape(len(stamps), -1))


clocks = st.lists(st.integers(0, 2**62), min_size=1, max_size=5, unique=True).map(sorted)


@st.composite
def recordings(draw: st.DrawFn, *, shared: bool) -> Recording:
    clock = draw(clocks)

    def signal(name: str, columns: tuple[str, ...]) -> Signal:
        return draw(signals(name, columns, clock if shared else draw(clocks)))

    joints = (signal("take", ("l_knee", "torso_yaw")),)
    channels = (signal("left_leg/analog:o", WRENCH_AXES), signal("arm", ("ch0", "ch1", "ch2")))
    warmth = (signal("arm board", ("temperature",)),)
    imus = (signal("waist", ("ax", "roll")),)
    start = min(int(s.stamps[0]) for s in (*joints, *channels, *warmth, *imus))
    return Recording("take", "", start, joints, channels, warmth, imus)


def require_equal(read_back: Recording, written: Recording) -> None:
    assert read_back.start == written.start
    assert not read_back.findings
    for role in ("joints", "channels", "temperatures", "imus"):
        found = {signal.name: signal for signal in getattr(read_back, role)}
        assert len(found) == len(getattr(written, role))
        for wanted in getattr(written, role):
            signal = found[wanted.name]
            assert signal.columns == wanted.columns
            assert signal.stamps.tolist() == wanted.stamps.tolist()
            assert signal.values.tolist() == wanted.values.tolist()


@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
@settings(max_examples=25, deadline=None)
@given(recording=recordings(shared=True))
def test_one_table_gives_back_every_bit(
    tmp_path_factory: pytest.TempPathFactory, suffix: str, recording: Recording
) -> None:
    file = tmp_path_factory.mktemp("one") / f"take{suffix}"
    layout = tables.write(recording, file)
    require_equal(read(file, layout), recording)


@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
@settings(max_examples=25, deadline=None)
@given(recording=recordings(shared=False))
def test_folder_of_tables_gives_back_every_bit(
    tmp_path_factory: pytest.TempPathFactory, suffix: str, recording: Recording
) -> None:
    folder = tmp_path_factory.mktemp("many") / "take"
    layout = tables.write(recording, folder, suffix=suffix)  # type: ignore[arg-type]
    require_equal(read(folder, layout), recording)


def two_clocks() -> Recording:
    knee = Signal("legs", ("l_knee",), np.array([0]), np.zeros((1, 1)))
    force = Signal("leg", WRENCH_AXES, np.array([1]), np.zeros((1, 6)))
    return Recording("take", "", 0, (knee,), (force,))


def test_two_clocks_do_not_fit_one_table(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="clocks of their own; give a folder"):
        tables.write(two_clocks(), tmp_path / "take.csv")


def test_parquet_is_stored_by_significance(tmp_path: Path) -> None:
    tables.write(two_clocks(), tmp_path / "take")
    column = parquet.ParquetFile(tmp_path / "take" / "leg.parquet").metadata.row_group(0).column(1)
    assert column.compression == "ZSTD"
    assert "BYTE_STREAM_SPLIT" in column.encodings
    assert not column.has_dictionary_page


@pytest.mark.skipif(not ATI.is_dir(), reason="the ATI recordings are not here")
def test_microseconds_of_the_ati_files_are_told_by_their_size() -> None:
    recording = read(ATI / "1-baseline_wrench.csv", Layout(time="t"))
    (force,) = recording.channels
    assert (force.name, force.columns, len(force)) == ("1-baseline_wrench", WRENCH_AXES, 4376)
    assert recording.start == 1_708_857_503_929_545_000
    assert force.values[0].tolist() == [-0.190451, -0.899815, 10.1437, 0.425679, -1.0967, -0.148439]
    assert force.period == pytest.approx(1 / 698, rel=0.01)
    imu = Layout(time="t", imus={"imu": ("ax", "ay", "az")})
    assert read(ATI / "1-baseline_accel.csv", imu).imus[0].values.shape == (1593, 3)


def test_whole_numbers_beyond_a_double_are_rounded_not_refused(tmp_path: Path) -> None:
    file = tmp_path / "log.csv"
    file.write_text("time,q,nanoseconds\n0.0,1.5,1700000000123456789\n0.1,2,1700000000223456789\n")
    (joints,) = tables.read(file, Layout()).joints
    assert joints.columns == ("q", "nanoseconds")
    assert joints.values[1, 1] == float(1700000000223456789)


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"time,q\xff\n0.0,1\n", "not a readable table"),
        (b"time," + b"q" * 140_000 + b"\n0.0,1\n", "its header is none"),
    ],
)
def test_a_header_that_is_none_is_told_in_one_line(
    content: bytes, told: str, tmp_path: Path
) -> None:
    file = tmp_path / "log.csv"
    file.write_bytes(content)
    with pytest.raises(LogError, match=told) as error:
        tables.read(file, Layout())
    assert "\n" not in str(error.value)
