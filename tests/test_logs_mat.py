"""Facts about robot-logger's `.mat`: which stream becomes what, and which files are refused."""

from __future__ import annotations

import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
import tables
from hypothesis import given, settings
from hypothesis import strategies as st

from ftcal.errors import FtcalError, LogError
from ftcal.logs import Layout, read
from ftcal.logs.layout import WRENCH_AXES
from mat_files import HEADER, ROOT, write_mat

JOINTS = "joints_state/positions"
STAMPS = 1_700_000_000.0 + np.arange(5) / 100.0
POSITIONS = np.linspace(-1.0, 1.0, 10).reshape(5, 2)
WRENCH = np.arange(30.0).reshape(5, 6)
NAMES = {
    JOINTS: ("l_knee", "l_hip_yaw"),
    "FTs/l_leg_ft": ("f_x", "f_y", "f_z", "mu_x", "mu_y", "mu_z"),
}
LEAVES = {JOINTS: (STAMPS, POSITIONS), "FTs/l_leg_ft": (STAMPS, WRENCH)}


def test_streams_become_signals_called_by_their_path(tmp_path: Path) -> None:
    imu = np.arange(15.0).reshape(5, 3)
    leaves = LEAVES | {
        "joints_state/velocities": (STAMPS, POSITIONS),
        "temperatures/l_leg_ft": (STAMPS, np.full((5, 1), 31.5)),
        "accelerometers/waist": (STAMPS, imu),
        "gyros/waist": (STAMPS, imu + 1),
        "magnetometers/waist": (STAMPS, imu),
    }
    recording = read(write_mat(tmp_path / "walk.mat", leaves, names=NAMES))
    (joints,), (force,) = recording.joints, recording.channels
    assert recording.name == "walk"
    assert (joints.name, joints.columns) == (JOINTS, ("l_knee", "l_hip_yaw"))
    assert joints.values.tolist() == POSITIONS.tolist()
    assert (force.name, force.columns) == ("FTs/l_leg_ft", WRENCH_AXES)
    assert force.values.tolist() == WRENCH.tolist()
    assert force.stamps.tolist() == [1_700_000_000_000_000_000 + k * 10_000_000 for k in range(5)]
    assert recording.temperature("temperatures/l_leg_ft").values.tolist() == [[31.5]] * 5
    assert [s.name for s in recording.imus] == ["accelerometers/waist", "gyros/waist"]


@pytest.mark.parametrize("turn", ["T1n", "Tn1", "Tn", "nT"])
def test_any_order_of_dimensions_is_read(tmp_path: Path, turn: str) -> None:
    block = {
        "T1n": POSITIONS[:, None, :], "Tn1": POSITIONS[:, :, None], "Tn": POSITIONS,
        "nT": POSITIONS.T,
    }[turn]  # fmt: skip
    file = tmp_path / "log.mat"
    with tables.open_file(str(file), "w") as content:
        where = f"/{ROOT}/{JOINTS}"
        content.create_array(where, "data", np.ascontiguousarray(block), createparents=True)
        content.create_array(where, "timestamps", STAMPS[:, None])
    recording = read(file, Layout(joints={JOINTS: ("a", "b")}))
    assert recording.joints[0].values.tolist() == POSITIONS.tolist()


@pytest.mark.parametrize("kind", [">f8", "<f4", ">i2"])
def test_numbers_of_any_kind_are_read(tmp_path: Path, kind: str) -> None:
    file = tmp_path / "log.mat"
    with h5py.File(file, "w") as content:  # PyTables writes the machine's own byte order alone
        group = content.create_group(f"{ROOT}/FTs/a")
        group["data"] = WRENCH.astype(kind)
        group["timestamps"] = np.arange(5).astype(kind if kind != ">i2" else ">f8")
    (force,) = read(file).channels
    assert force.values.tolist() == WRENCH.tolist()
    assert force.values.dtype == np.float64
    assert force.stamps.tolist() == [k * 10**9 for k in range(5)]


def test_thermometer_of_three_columns_is_refused(tmp_path: Path) -> None:
    leaves = {"temperatures/a": (STAMPS, np.ones((5, 3)))}
    with pytest.raises(LogError, match="temperatures/a: 3 columns; a thermometer has one"):
        read(write_mat(tmp_path / "log.mat", leaves))


def test_old_files_name_the_joints_in_the_description_list(tmp_path: Path) -> None:
    file = write_mat(tmp_path / "log.mat", LEAVES, described=("a", "b"))
    assert read(file).joints[0].columns == ("a", "b")


def test_joints_without_names_are_refused_with_the_way_out(tmp_path: Path) -> None:
    file = write_mat(tmp_path / "log.mat", LEAVES)
    with pytest.raises(LogError, match="2 columns but 0 names; say in the job joints"):
        read(file)
    recording = read(file, Layout(joints={JOINTS: ("a", "")}))
    assert recording.joints[0].columns == ("a",)
    assert recording.joints[0].values.shape == (5, 1)


def test_declared_units_are_converted_and_the_job_overrules_them(tmp_path: Path) -> None:
    leaves = LEAVES | {"accelerometers/waist": (STAMPS, np.ones((5, 3)))}
    names = NAMES | {"accelerometers/waist": ("a_x", "a_y", "a_z")}
    units = {JOINTS: ("deg", "degrees"), "accelerometers/waist": ("g",) * 3}
    file = write_mat(tmp_path / "log.mat", leaves, names=names, units=units)
    recording = read(file)
    np.testing.assert_allclose(recording.joints[0].values, np.deg2rad(POSITIONS), rtol=1e-15)
    assert recording.imus[0].values.tolist() == [[9.80665] * 3] * 5
    recording = read(file, Layout(angle="rad", acceleration="m/s^2"))
    assert recording.joints[0].values.tolist() == POSITIONS.tolist()
    assert recording.imus[0].values.tolist() == [[1.0] * 3] * 5


def test_job_overrules_one_unit_and_leaves_the_other(tmp_path: Path) -> None:
    ones = (STAMPS, np.ones((5, 3)))
    units = {"accelerometers/a": ("g",) * 3, "gyros/g": ("deg/s",) * 3}
    file = write_mat(tmp_path / "log.mat", {"accelerometers/a": ones, "gyros/g": ones}, units=units)
    by_name = {s.name: s for s in read(file, Layout(acceleration="m/s^2")).imus}
    assert by_name["accelerometers/a"].columns == ("ax", "ay", "az")
    assert by_name["accelerometers/a"].values.tolist() == [[1.0] * 3] * 5
    assert by_name["gyros/g"].values.tolist() == [[np.pi / 180] * 3] * 5


def test_torque_logged_first_is_put_behind_force(tmp_path: Path) -> None:
    names = NAMES | {"FTs/l_leg_ft": ("mu_x", "mu_y", "mu_z", "f_x", "f_y", "f_z")}
    recording = read(write_mat(tmp_path / "log.mat", LEAVES, names=names))
    assert recording.channels[0].columns == WRENCH_AXES
    assert recording.channels[0].values[0].tolist() == [3, 4, 5, 0, 1, 2]


def test_layout_joins_accelerometer_and_gyro_to_one_imu(tmp_path: Path) -> None:
    a, w = np.full((5, 3), 9.8), np.full((5, 3), 0.1)
    leaves = LEAVES | {"accelerometers/a": (STAMPS, a), "gyros/g": (STAMPS, w)}
    file = write_mat(tmp_path / "log.mat", leaves, names=NAMES)
    recording = read(file, Layout(imus={"waist": ("accelerometers/a", "gyros/g")}))
    (imu,) = recording.imus
    assert imu.name == "waist"
    assert imu.values[0].tolist() == [9.8] * 3 + [0.1] * 3


def test_leaves_of_two_clocks_are_not_joined(tmp_path: Path) -> None:
    leaves = LEAVES | {"gyros/g": (STAMPS + 0.001, np.zeros((5, 3)))}
    file = write_mat(tmp_path / "log.mat", leaves, names=NAMES)
    with pytest.raises(LogError, match="clocks of their own; 'waist' cannot join them"):
        read(file, Layout(imus={"waist": ("FTs/l_leg_ft", "gyros/g")}))


def test_layout_names_leaves_of_any_group(tmp_path: Path) -> None:
    leaves = LEAVES | {"strain/arm": (STAMPS, np.ones((5, 8)))}
    file = write_mat(tmp_path / "log.mat", leaves, names=NAMES)
    recording = read(file, Layout(channels={"arm": ("strain/arm",)}))
    assert recording.channel("arm").columns == tuple(f"ch{k}" for k in range(8))
    with pytest.raises(LogError, match="no leaf 'FTs/l_leg'; did you mean FTs/l_leg_ft"):
        read(file, Layout(channels={"arm": ("FTs/l_leg",)}))


def test_stream_that_never_logged_is_a_finding(tmp_path: Path) -> None:
    file = write_mat(tmp_path / "log.mat", LEAVES, names=NAMES)
    with h5py.File(file, "a") as content:  # MATLAB's empty struct, as h5py shows it
        content[ROOT]["FTs"].create_dataset("r_leg_ft", data=np.zeros(2, dtype=np.uint64))
    (finding,) = read(file).findings
    assert (finding.kind, finding.signal) == ("empty", "FTs/r_leg_ft")


def test_struct_of_another_name_is_found(tmp_path: Path) -> None:
    file = write_mat(tmp_path / "log.mat", LEAVES, names=NAMES, root="my_logger")
    assert read(file).joints[0].name == JOINTS


def test_all_faulty_streams_are_named_at_once(tmp_path: Path) -> None:
    leaves = {
        JOINTS: (STAMPS, POSITIONS[:4]),
        "FTs/a": (STAMPS, WRENCH),
        "FTs/b": (STAMPS, WRENCH[:3]),
    }
    file = write_mat(tmp_path / "log.mat", leaves, names={"FTs/a": ("x",)})
    with pytest.raises(LogError) as caught:
        read(file)
    text = str(caught.value)
    assert "joints_state/positions: data is 4 x 1 x 2, but there are 5 timestamps" in text
    assert "FTs/a: 6 columns but 1 elements_names" in text
    assert "FTs/b: data is 3 x 1 x 6" in text
    assert "\n" not in text


@pytest.mark.parametrize(
    ("stamps", "values", "message"),
    [
        (STAMPS[[0, 1, 3, 2, 4]], POSITIONS, r"row 4: time goes back by 0\.010000 s"),
        (STAMPS, np.where(POSITIONS > 0.9, np.nan, POSITIONS), "row 5: column 'l_hip_yaw' is nan"),
        (np.where(np.arange(5) == 2, np.nan, STAMPS), POSITIONS, "timestamps, row 3"),
        (STAMPS * 1e6, POSITIONS, "give time_unit in the job"),
    ],
)
def test_stream_that_makes_no_sense_is_refused(
    tmp_path: Path, stamps: np.ndarray, values: np.ndarray, message: str
) -> None:
    file = write_mat(
        tmp_path / "log.mat", {JOINTS: (stamps, values)}, names={JOINTS: NAMES[JOINTS]}
    )
    with pytest.raises(LogError, match=message):
        read(file)


def test_matlab_5_is_refused_with_the_way_out(tmp_path: Path) -> None:
    file = tmp_path / "log.mat"
    file.write_bytes(HEADER.replace(b"7.3", b"5.0") + bytes(400))
    with pytest.raises(LogError, match=r"MATLAB v5, not v7\.3; in MATLAB: .*'-v7\.3'"):
        read(file)


def test_file_of_something_else_is_refused(tmp_path: Path) -> None:
    with tables.open_file(str(tmp_path / "log.mat"), "w") as content:
        content.create_array("/x/y", "data", np.zeros(3), createparents=True)
    with pytest.raises(LogError, match="is this a robot-logger file"):
        read(tmp_path / "log.mat")
    with pytest.raises(LogError, match="there is no such file"):
        read(tmp_path / "none.mat")


def test_dataset_that_claims_a_billion_rows_is_refused_unread(tmp_path: Path) -> None:
    file = write_mat(tmp_path / "log.mat", {"FTs/b": (STAMPS, WRENCH)})
    with h5py.File(file, "a") as content:
        group = content.create_group(f"{ROOT}/FTs/a")
        group.create_dataset("timestamps", shape=(1, 10**9), chunks=(1, 1000), dtype="f8")
        group.create_dataset("data", shape=(10**9, 1, 6), chunks=(1000, 1, 6), dtype="f8")
    assert file.stat().st_size < 40_000
    with pytest.raises(LogError, match="claims 1 x 1000000000 numbers, more than the file holds"):
        read(file)


def test_data_in_another_file_are_not_followed(tmp_path: Path) -> None:
    write_mat(tmp_path / "other.mat", LEAVES, names=NAMES)
    with h5py.File(tmp_path / "log.mat", "w") as content:
        group = content.create_group(f"{ROOT}/FTs")
        group["l_leg_ft"] = h5py.ExternalLink("other.mat", f"{ROOT}/FTs/l_leg_ft")
    with pytest.raises(LogError, match="no F/T, joint, temperature or inertial sample"):
        read(tmp_path / "log.mat")


def test_struct_that_contains_itself_ends(tmp_path: Path) -> None:
    file = write_mat(tmp_path / "log.mat", LEAVES, names=NAMES)
    with h5py.File(file, "a") as content:
        content[ROOT]["FTs"]["again"] = content[ROOT]
    assert [s.name for s in read(file).channels] == ["FTs/l_leg_ft"]


def test_missing_h5py_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = write_mat(tmp_path / "log.mat", LEAVES, names=NAMES)
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(LogError, match=r'pip install "ftcal\[hdf5\]"'):
        read(file)


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return write_mat(tmp_path_factory.mktemp("good") / "log.mat", LEAVES, names=NAMES).read_bytes()


@settings(max_examples=150, deadline=None)
@given(places=st.lists(st.tuples(st.floats(0, 1), st.integers(0, 255)), min_size=1, max_size=8),
       length=st.floats(0, 1))  # fmt: skip
def test_spoilt_file_is_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory,
    good: bytes,
    places: list[tuple[float, int]],
    length: float,
) -> None:
    spoilt = bytearray(good)
    for place, value in places:
        spoilt[int(place * (len(good) - 1))] = value
    file = tmp_path_factory.mktemp("fuzz") / "log.mat"
    file.write_bytes(spoilt[: int(len(good) * length)] if length < 0.3 else spoilt)
    try:
        recording = read(file)
    except FtcalError:
        return
    assert all(np.isfinite(signal.values).all() for signal in recording.channels)
