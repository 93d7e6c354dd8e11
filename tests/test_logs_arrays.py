"""Facts about `.npz` archives: which array becomes what, and which archives are refused.

The archives are written by NumPy; the reader takes the zip apart itself and asks NumPy for headers
only, but no other library writes the format.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from pyarrow import parquet

from ftcal.calibration import read_calibration
from ftcal.cli import main
from ftcal.errors import FtcalError, LogError
from ftcal.logs import Layout, read
from ftcal.logs.layout import WRENCH_AXES
from mat_files import write_mat
from pretend import FULL_SCALE
from small_world import JOB, JOINTS, PRIOR, robot_text, take, truth

TIME = 1_700_000_000.0 + np.arange(4) / 100.0
Q = np.linspace(0.0, 0.7, 8).reshape(4, 2)
LEFT = np.arange(24.0).reshape(4, 6)


def save(file: Path, **arrays: np.ndarray) -> Path:
    np.savez(file, **{"time": TIME, **arrays})  # type: ignore[arg-type]
    return file


def test_arrays_become_joints_and_forces(tmp_path: Path) -> None:
    names = np.array(["knee", "hip"])
    recording = read(save(tmp_path / "walk.npz", q=Q, joint_names=names, left=LEFT, arm_fx=Q[:, 0]))
    (joints,), (force,) = recording.joints, recording.channels
    assert joints.columns == ("knee", "hip", "arm_fx")
    assert joints.values[:, :2].tolist() == Q.tolist()
    assert (force.name, force.columns) == ("left", WRENCH_AXES)
    assert force.values.tolist() == LEFT.tolist()
    assert force.stamps.tolist() == [1_700_000_000_000_000_000 + k * 10_000_000 for k in range(4)]
    assert recording.start == 1_700_000_000_000_000_000


def test_arrays_name_their_own_columns(tmp_path: Path) -> None:
    names = np.array(["tx", "ty", "tz", "fx", "fy", "fz"])
    recording = read(save(tmp_path / "log.npz", left=LEFT, left_names=names, joints=Q))
    assert recording.channel("left").values[0].tolist() == [3, 4, 5, 0, 1, 2]
    assert recording.joints[0].columns == ("joints.0", "joints.1")


def test_one_dimensional_arrays_are_columns(tmp_path: Path) -> None:
    forces = {f"left_{axis}": LEFT[:, k] for k, axis in enumerate(WRENCH_AXES)}
    recording = read(save(tmp_path / "log.npz", knee=Q[:, 0].astype(np.float32), **forces))
    assert recording.joints[0].columns == ("knee",)
    assert recording.channel("left").values.tolist() == LEFT.tolist()


def test_layout_claims_whole_arrays(tmp_path: Path) -> None:
    gauges = np.arange(32, dtype=np.int16).reshape(4, 8)
    heat = np.full(4, 30.0)
    imu = np.hstack([np.full((4, 3), 1.0), np.full((4, 3), 180.0)])
    file = save(tmp_path / "log.npz", q=Q, gauges=gauges, heat=heat, imu=imu, t=TIME + 1)
    layout = Layout(
        time="t", angle="deg", channels={"ft": ("gauges",)}, temperatures={"ft": "heat"},
        imus={"waist": ("imu",)}, joints={"q.0": ("knee",), "q.1": ("hip",), "time": ()},
        acceleration="g", angular_velocity="deg/s",
    )  # fmt: skip
    recording = read(file, layout)
    assert recording.channel("ft").values.tolist() == gauges.tolist()
    assert recording.temperature("ft").values[0, 0] == 30.0
    assert recording.joints[0].columns == ("knee", "hip")
    np.testing.assert_allclose(recording.joints[0].values, np.deg2rad(Q), rtol=1e-15)
    np.testing.assert_allclose(recording.imus[0].values[0], [9.80665] * 3 + [np.pi] * 3, rtol=1e-15)


def test_dates_need_no_unit(tmp_path: Path) -> None:
    moments = np.datetime64("2023-11-14T22:13:20", "ns") + np.arange(4).astype("m8[ms]")
    recording = read(save(tmp_path / "log.npz", time=moments, knee=Q[:, 0]))
    assert recording.start == 1_700_000_000_000_000_000


def test_what_no_sensor_logs_is_left_alone(tmp_path: Path) -> None:
    other = {"rate": np.array(100.0), "operator": np.array(["Ann"]), "film": np.zeros((4, 3, 3)),
             "meta": np.array([{"a": 1}], dtype=object), "ok": np.ones(4, dtype=bool)}  # fmt: skip
    recording = read(save(tmp_path / "log.npz", knee=Q[:, 0], **other))
    assert recording.joints[0].columns == ("knee",)
    assert not recording.channels


def test_clocks_of_their_own_are_files_of_one_folder(tmp_path: Path) -> None:
    save(tmp_path / "legs.npz", knee=Q[:, 0])
    save(tmp_path / "left.npz", time=TIME[:3] - 0.25, left=LEFT[:3])
    recording = read(tmp_path)
    assert [len(s) for s in (*recording.joints, *recording.channels)] == [4, 3]
    assert recording.start == 1_699_999_999_750_000_000


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"left": LEFT[:3]}, "array 'left' is 3 x 6, 'time' has 4; give it its own file"),
        ({"left": LEFT.T.copy()}, "array 'left' is 6 x 4, 'time' has 4; transpose it"),
        ({"q": Q, "joint_names": np.array(["knee"])}, "array 'q' has 2 columns but 1 names"),
        ({"time": np.zeros((4, 2)), "knee": TIME}, "no time array 'time'"),
        ({"time": np.array(0.0), "clock": TIME}, "no time array 'time'"),
        ({"knee": np.array([0.0, np.nan, 0.0, 0.0])}, "row 2: column 'knee' is nan"),
        ({"q": Q, "joint_names": np.array(["a", "a"])}, "column 'a' appears 2 times"),
        ({"time": TIME * 1e6, "knee": TIME}, "give time_unit in the job"),
        ({"time": TIME[::-1].copy(), "knee": TIME}, "row 2: time goes back"),
        ({"knee": TIME[:0], "time": TIME[:0]}, "a header but no rows"),
    ],
)
def test_broken_archive_is_refused_in_one_line(
    tmp_path: Path, arrays: Mapping[str, np.ndarray], message: str
) -> None:
    file = save(tmp_path / "log.npz", **arrays)
    with pytest.raises(LogError, match=message) as caught:
        read(file)
    assert "\n" not in str(caught.value)


def header(shape: tuple[int, ...], dtype: str = "<f8") -> bytes:
    """Return the beginning of a `.npy` file of that shape."""
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        stream, {"descr": dtype, "fortran_order": False, "shape": shape}
    )
    return stream.getvalue()


@pytest.mark.parametrize("compression", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
@pytest.mark.parametrize("shape", [(10**9, 6), (10**9,), (2**62, 2**62), (5,)])
def test_header_that_claims_more_than_it_holds_is_refused_unread(
    tmp_path: Path, shape: tuple[int, ...], compression: int
) -> None:
    file = tmp_path / "log.npz"
    with zipfile.ZipFile(file, "w", compression) as archive:
        archive.writestr("time.npy", header(shape) + bytes(32))
    assert file.stat().st_size < 1000
    with pytest.raises(LogError, match=r"array 'time' claims [\dx ]+ numbers, more than the file"):
        read(file)


def test_directory_that_claims_a_terabyte_is_refused_unread(tmp_path: Path) -> None:
    file = tmp_path / "log.npz"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("time.npy", header((500_000_000,)) + bytes(32))
    content = file.read_bytes()
    place = content.index(b"PK\x01\x02") + 24  # the size unpacked, in the central directory
    file.write_bytes(content[:place] + (4_000_000_200).to_bytes(4, "little") + content[place + 4 :])
    with pytest.raises(LogError, match="claims 500000000 numbers"):
        read(file)


def plain(shape: tuple[int, ...]) -> bytes:
    return header(shape) + bytes(8 * int(np.prod(shape)))


@settings(max_examples=150, deadline=None)
@given(
    head=st.binary(max_size=40) | st.sampled_from([plain((2,)), plain((2, 6)), header((3,), "|O")]),
    place=st.integers(0, 400),
    value=st.integers(0, 255),
)
def test_spoilt_archive_is_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, head: bytes, place: int, value: int
) -> None:
    file = tmp_path_factory.mktemp("fuzz") / "log.npz"
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("time.npy", header((2,)) + np.array([1.5, 2.5]).tobytes())
        archive.writestr("left.npy", head)
    content = bytearray(file.read_bytes())
    content[place % len(content)] = value
    file.write_bytes(content)
    try:
        recording = read(file)
    except FtcalError:
        return
    assert all(np.isfinite(signal.values).all() for signal in recording.channels)


# ---- from the log to the coefficients

MAT_JOINTS = "joints_state/positions"
FORMS = {
    "parquet": "",
    "npz": "",
    "mat": 'channels = { ft = ["FTs/arm"] }\n',
}


def write_form(folder: Path, form: str) -> Path:
    """Write the two takes of the small world in one format, with a job; return the job."""
    folder.mkdir()
    (folder / "arm.urdf").write_text(robot_text())
    np.savetxt(folder / "workbench.csv", PRIOR.gain, delimiter=",")
    for name, seed in (("one", 1), ("two", 2)):
        time, joints, channels = take(seed)
        stamps = 1.7e9 + time
        file = folder / f"{name}.{form}"
        if form == "npz":
            np.savez(file, time=stamps, q=joints, joint_names=np.array(JOINTS), ft=channels)
        elif form == "mat":
            write_mat(
                file, {MAT_JOINTS: (stamps, joints), "FTs/arm": (stamps, channels)},
                names={MAT_JOINTS: JOINTS},
            )  # fmt: skip
        else:
            columns = dict(zip(JOINTS, joints.T, strict=True))
            columns |= {f"ft.{axis}": channels[:, k] for k, axis in enumerate(WRENCH_AXES)}
            parquet.write_table(pa.table({"time": stamps, **columns}), file)
    text = JOB.format(full_scale=", ".join(map(str, FULL_SCALE)))
    text = text.replace(".csv", f".{form}").replace(f"workbench.{form}", "workbench.csv")
    (folder / "job.toml").write_text(
        text.replace('contact = "base"\n', f'contact = "base"\n{FORMS[form]}')
    )
    return folder / "job.toml"


def gain(job: Path) -> np.ndarray:
    result = CliRunner().invoke(main, ["calibrate", str(job)])
    assert result.exit_code == 0, result.stderr
    assert ": degrees?" not in result.output
    (sensor,) = read_calibration(job.parent / "ftcal-out" / "calibration.json").sensors
    return np.array(sensor.gain)


def test_every_format_of_a_session_gives_the_same_coefficients(tmp_path: Path) -> None:
    # the numbers are equal bit by bit, and so are the stamps after rounding to microseconds
    expected = gain(write_form(tmp_path / "parquet", "parquet"))
    for form in ("npz", "mat"):
        np.testing.assert_allclose(
            gain(write_form(tmp_path / form, form)), expected, rtol=1e-12, atol=0
        )


@pytest.mark.parametrize("form", ["npz", "mat"])
def test_eight_raw_channels_are_calibrated(tmp_path: Path, form: str) -> None:
    rng = np.random.default_rng(0)
    mixing = rng.normal(size=(8, 6)) * 2000.0  # counts per full scale
    true = np.linalg.pinv(mixing / FULL_SCALE)
    job = write_form(tmp_path / form, form)
    bend = 1.0 + 0.03 * rng.normal(size=true.shape)
    np.savetxt(job.with_name("workbench.csv"), true * bend, delimiter=",")
    for name, seed in (("one", 1), ("two", 2)):
        time, joints, six = take(seed)
        wrench = six @ truth().T
        eight = wrench @ (mixing / FULL_SCALE).T + rng.normal(size=(len(time), 8))
        file, stamps = job.with_name(f"{name}.{form}"), 1.7e9 + time
        if form == "npz":
            np.savez(file, time=stamps, q=joints, joint_names=np.array(JOINTS), gauges=eight)
        else:
            write_mat(
                file, {MAT_JOINTS: (stamps, joints), "FTs/arm": (stamps, eight)},
                names={MAT_JOINTS: JOINTS},
            )  # fmt: skip
    if form == "npz":
        said = job.read_text().replace(
            'contact = "base"\n', 'contact = "base"\nchannels = { ft = ["gauges"] }\n'
        )
        job.write_text(said)
    found = gain(job)
    assert found.shape == (6, 8)
    # nearer to the truth than the Workbench, on what six axes can drive of eight gauges
    there = mixing / FULL_SCALE
    before = np.abs((true * bend - true) @ there).max()
    assert np.abs((found - true) @ there).max() < 0.5 * before
