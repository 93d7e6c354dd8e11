"""An unknown tool on a wrist sensor: recovered, refused where not seen, wrong conventions named."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from click.testing import CliRunner, Result
from hypothesis import given, settings
from hypothesis import strategies as st
from pyarrow import csv, parquet

from ftcal.cli import main
from ftcal.cli.frame import NOT_BETTER
from ftcal.errors import DataError, LogError
from ftcal.payload import Payload, estimate
from ftcal.pose_tables import HABITS, PoseLayout, read_poses
from ftcal.poses import STANDARD_GRAVITY, Poses
from ftcal.spatial import rotation_about, rotation_from_rpy

Table = dict[str, np.ndarray]

WRENCH = ("fx", "fy", "fz", "tx", "ty", "tz")
ROTATION = HABITS["rotation"]
MASS, CENTRE = 0.932, np.array([0.012, -0.021, 0.044])
OFFSET = np.array([9.08, -1.02, 9.99, 0.43, -0.69, -0.16])
NOISE = np.array([0.13, 0.05, 0.06, 0.003, 0.005, 0.0015])
TRUTH = np.array([MASS, *CENTRE, *OFFSET])


def figures(found: Payload) -> np.ndarray:
    return np.array([found.mass, *found.centre, *found.offset])


def errors(found: Payload) -> np.ndarray:
    return np.array([found.mass_error, *found.centre_error, *found.offset_error])


def rotations(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return random orientations of the sensor in the base."""
    return rotation_from_rpy(rng.uniform(-np.pi, np.pi, size=(count, 3)))


def felt(gravity: np.ndarray, *, mass: float = MASS, centre: np.ndarray = CENTRE) -> np.ndarray:
    """Return the weight of the tool and its torque, without an offset."""
    return np.concatenate([mass * gravity, np.cross(centre, mass * gravity)], axis=1)


def held(gravity: np.ndarray, wrench: np.ndarray) -> Poses:
    return Poses("poses", "gravity", "", np.arange(len(wrench)) + 2, wrench, gravity)


def pretend(seed: int, *, count: int = 24, noise: float = 1.0) -> Poses:
    rng = np.random.default_rng(seed)
    gravity = -STANDARD_GRAVITY * rotations(rng, count)[:, 2]
    wrench = felt(gravity) + OFFSET + noise * NOISE * rng.normal(size=(count, 6))
    return held(gravity, wrench)


def columns(rng: np.random.Generator, *, count: int = 24, noise: float = 1.0) -> Table:
    """Return a table of poses as a lab logs it: wrench, rotation, gravity, accelerometer."""
    R = rotations(rng, count)
    gravity = -STANDARD_GRAVITY * R[:, 2]
    wrench = felt(gravity) + OFFSET + noise * NOISE * rng.normal(size=(count, 6))
    named = dict(zip(WRENCH, wrench.T, strict=True))
    named |= dict(zip(ROTATION, R.reshape(-1, 9).T, strict=True))
    named |= dict(zip(HABITS["gravity"], gravity.T, strict=True))
    named |= dict(zip(HABITS["acceleration"], -gravity.T / STANDARD_GRAVITY, strict=True))
    return {name: np.ascontiguousarray(values) for name, values in named.items()}


def write(file: Path, table: Table) -> Path:
    csv.write_csv(pa.table(table), str(file))
    return file


def run(*words: str | Path) -> Result:
    return CliRunner().invoke(main, ["payload", *(str(word) for word in words)])


# ----------------------------------------------------------------- the estimate


@pytest.mark.parametrize("seed", range(20))
def test_truth_lies_within_three_standard_errors(seed: int) -> None:
    found = estimate(pretend(seed))
    z = (figures(found) - TRUTH) / errors(found)
    # 200 figures in all: Gaussian errors of the right size leave one beyond 3 in every other run
    # of this suite, so the bound is 3.5 for the worst and 3 for all but one of the ten
    assert np.sort(np.abs(z))[-2] < 3.0
    assert np.abs(z).max() < 3.5
    assert found.refused == ()
    assert found.sign == 1


def test_standard_errors_are_as_large_as_the_errors() -> None:
    z = np.array([(figures(f) - TRUTH) / errors(f) for f in map(estimate, map(pretend, range(80)))])
    # 80 draws: the sd of a unit Gaussian is seen to 8 %, three of them are 25 %
    np.testing.assert_allclose(z.std(axis=0), 1.0, rtol=0.3)


def test_without_noise_the_truth_is_found_to_rounding() -> None:
    found = estimate(pretend(0, noise=0.0))
    np.testing.assert_allclose(figures(found), TRUTH, rtol=1e-9)
    assert found.refused == ()
    assert found.outliers == ()


@given(
    mass=st.floats(0.05, 50.0),
    centre=st.tuples(*[st.floats(-0.5, 0.5)] * 3),
    offset=st.tuples(*[st.floats(-500.0, 500.0)] * 6),
    seed=st.integers(0, 2**16),
    sign=st.sampled_from([1, -1]),
)
@settings(max_examples=60, deadline=None)
def test_any_tool_is_recovered(
    mass: float,
    centre: tuple[float, ...],
    offset: tuple[float, ...],
    seed: int,
    sign: int,
) -> None:
    gravity = -STANDARD_GRAVITY * rotations(np.random.default_rng(seed), 12)[:, 2]
    wrench = sign * felt(gravity, mass=mass, centre=np.array(centre)) + np.array(offset)
    found = estimate(held(gravity, wrench))
    # offsets of 500 N over weights of 0.5 N: four digits of the sixteen are lost
    assert found.mass == pytest.approx(mass, rel=1e-9)
    np.testing.assert_allclose(found.centre, centre, atol=1e-9)
    np.testing.assert_allclose(found.offset, offset, atol=1e-9 * 500)
    assert found.sign == sign


def test_estimate_is_that_of_lstsq_where_all_axes_are_equally_noisy() -> None:
    rng = np.random.default_rng(5)
    gravity = -STANDARD_GRAVITY * rotations(rng, 5000)[:, 2]
    wrench = felt(gravity) + OFFSET + 0.1 * rng.normal(size=(5000, 6))
    A = np.zeros((5000, 6, 10))
    A[:, :3, 0] = gravity
    for k, e in enumerate(np.eye(3)):
        A[:, 3:, 1 + k] = np.cross(e, gravity)
    A[:, :, 4:] = np.eye(6)
    m, *rest = np.linalg.lstsq(A.reshape(-1, 10), wrench.ravel())[0]
    found = estimate(held(gravity, wrench))
    expected = np.array([m, *(np.array(rest[:3]) / m), *rest[3:]])
    # weights of six axes estimated from 5000 rows differ by 2 %: errors move by far less
    assert np.abs((figures(found) - expected) / errors(found)).max() < 0.1


def test_rows_that_repeat_an_attitude_are_one_attitude() -> None:
    once = pretend(3)
    rng = np.random.default_rng(0)
    rows = np.repeat(np.arange(24), 50)
    wrench = once.wrench[rows] + 0.01 * NOISE * rng.normal(size=(1200, 6))
    many = estimate(held(once.gravity[rows], wrench))
    single = estimate(once)
    assert many.poses == 24
    # fifty repetitions of one error are no fifty errors
    np.testing.assert_allclose(errors(many), errors(single), rtol=0.3)


def test_rest_of_an_attitude_left_out_is_larger_than_that_of_the_fit() -> None:
    found = estimate(pretend(1))
    assert found.rms(found.held_out) > found.rms(found.residual)


def test_outlier_is_named_by_row_and_axis() -> None:
    poses = pretend(2)
    poses.wrench[7, 1] += 3.0
    (outlier,) = estimate(poses).outliers
    assert outlier.rows == (9, 9)
    assert outlier.axis == "fy"
    assert outlier.residual == pytest.approx(3.0, abs=0.5)  # ten times the noise of fy


# ------------------------------------------------------- what cannot be known


def test_gravity_that_never_turns_is_refused() -> None:
    gravity = np.tile([0.0, 0.0, -STANDARD_GRAVITY], (50, 1))
    with pytest.raises(DataError, match="50 rows hold 1 attitudes, at least 4"):
        estimate(held(gravity, felt(gravity) + OFFSET))


def test_gravity_that_hardly_turns_is_refused() -> None:
    angle = np.radians(1.2) * (np.arange(40) % 2)
    gravity = -STANDARD_GRAVITY * np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=1)
    with pytest.raises(DataError, match=r"0\.6 deg .* mass and offset are one sum"):
        estimate(held(gravity, felt(gravity) + OFFSET))


def test_fewer_than_four_attitudes_are_refused() -> None:
    with pytest.raises(DataError, match="3 rows hold 3 attitudes"):
        estimate(pretend(0, count=3))


def test_gravity_in_a_plane_is_enough() -> None:
    angle = np.linspace(0, 5, 12)
    gravity = STANDARD_GRAVITY * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    found = estimate(held(gravity, felt(gravity) + OFFSET))
    np.testing.assert_allclose(figures(found), TRUTH, rtol=1e-9)
    assert found.refused == ()


def test_gravity_along_a_line_leaves_the_centre_on_it_open() -> None:
    """Up and down along y with a tilt in z: only what the line cannot see is withheld."""
    side = np.where(np.arange(12) % 2, 1.0, -1.0)
    gravity = STANDARD_GRAVITY * np.stack([0 * side, 0.8 * side, 0.6 + 0 * side], axis=1)
    rng = np.random.default_rng(0)
    wrench = felt(gravity) + OFFSET + 0.01 * NOISE * rng.normal(size=(12, 6))
    found = estimate(held(gravity, wrench))
    assert len(found.refused) == 1
    assert "along (+0.00, +1.00, +0.00) alone" in found.refused[0].replace("-", "+")
    assert "(cy, offset tx)" in found.refused[0]
    known = np.isfinite(figures(found))
    np.testing.assert_array_equal(np.flatnonzero(~known), [2, 7])
    np.testing.assert_allclose(figures(found)[known], TRUTH[known], rtol=0.02)


def test_no_tool_has_no_centre() -> None:
    poses = pretend(0)
    rng = np.random.default_rng(1)
    bare = held(poses.gravity, OFFSET + NOISE * rng.normal(size=(24, 6)))
    found = estimate(bare)
    assert "is not seen" in found.refused[0]
    assert np.isnan(found.centre).all()
    assert np.abs(found.offset - OFFSET).max() < 0.2


def test_a_dead_sensor_weighs_nothing() -> None:
    poses = pretend(0)
    found = estimate(held(poses.gravity, np.zeros((24, 6))))
    assert found.mass == 0.0
    assert "is not seen" in found.refused[0]


# -------------------------------------------------------------- conventions


def named(tmp_path: Path, table: Table, layout: PoseLayout) -> str:
    (reason,) = estimate(read_poses([write(tmp_path / "poses.csv", table)], layout)).refused
    return reason


@pytest.fixture
def table() -> Table:
    return columns(np.random.default_rng(4))


TOLD = PoseLayout(attitude="rotation")


@pytest.mark.parametrize("layout", [TOLD, PoseLayout(), PoseLayout(attitude="acceleration")])
def test_right_conventions_are_believed(tmp_path: Path, table: Table, layout: PoseLayout) -> None:
    found = estimate(read_poses([write(tmp_path / "poses.csv", table)], layout))
    assert found.refused == ()
    assert found.notes == ()
    assert np.abs((figures(found) - TRUTH) / errors(found)).max() < 3.5


def test_transposed_rotation_is_named(tmp_path: Path, table: Table) -> None:
    by_columns = tuple(np.reshape(ROTATION, (3, 3)).T.ravel())
    layout = PoseLayout(attitude="rotation", columns=by_columns)
    assert "read as rotation transposed; name the columns" in named(tmp_path, table, layout)


@pytest.mark.parametrize("seed", range(10))
def test_six_poses_are_enough_to_name_a_transposed_rotation(tmp_path: Path, seed: int) -> None:
    by_columns = tuple(np.reshape(ROTATION, (3, 3)).T.ravel())
    layout = PoseLayout(attitude="rotation", columns=by_columns)
    few = columns(np.random.default_rng(seed), count=6)
    assert "read as rotation transposed;" in named(tmp_path, few, layout)


def test_torque_first_is_named(tmp_path: Path, table: Table) -> None:
    layout = PoseLayout(wrench=(*WRENCH[3:], *WRENCH[:3]), attitude="rotation")
    assert "read as torque first; name the torque's columns last" in named(tmp_path, table, layout)


def test_torque_first_and_transposed_are_named_together(tmp_path: Path, table: Table) -> None:
    by_columns = tuple(np.reshape(ROTATION, (3, 3)).T.ravel())
    layout = PoseLayout(wrench=(*WRENCH[3:], *WRENCH[:3]), attitude="rotation", columns=by_columns)
    assert "read as rotation transposed, torque first;" in named(tmp_path, table, layout)


def test_base_on_its_side_is_named(tmp_path: Path, table: Table) -> None:
    on_its_side = (*ROTATION[6:], *ROTATION[:6])  # z of the base becomes x
    layout = PoseLayout(attitude="rotation", columns=on_its_side)
    assert "read as base x vertical; turn the base" in named(tmp_path, table, layout)


def test_wrench_in_the_base_frame_is_named(tmp_path: Path, table: Table) -> None:
    R = np.stack([table[name] for name in ROTATION], axis=1).reshape(-1, 3, 3)
    wrench = np.stack([table[name] for name in WRENCH], axis=1).reshape(-1, 2, 3)
    in_base = np.einsum("nij,nkj->nki", R, wrench).reshape(-1, 6)
    moved = table | dict(zip(WRENCH, np.ascontiguousarray(in_base.T), strict=True))
    assert "read as wrench in the base frame;" in named(tmp_path, moved, TOLD)


def test_swapped_axes_are_named(tmp_path: Path, table: Table) -> None:
    layout = PoseLayout(attitude="gravity", columns=("gy", "gz", "gx"))
    reason = named(tmp_path, table, layout)
    assert "read as the wrench's x, y, z being the attitude's z, x, y; give both" in reason


def test_sensor_turned_on_its_flange_is_named_with_its_angle(tmp_path: Path, table: Table) -> None:
    g = np.stack([table[name] for name in HABITS["gravity"]], axis=1)
    turned = g @ rotation_about(np.array([0.0, 0.0, 1.0]), np.asarray(np.radians(30.0)))
    moved = table | dict(zip(HABITS["gravity"], np.ascontiguousarray(turned.T), strict=True))
    reason = named(tmp_path, moved, PoseLayout())
    # noise of 0.1 N in 9 N is about a degree
    assert "frame of the attitude turned by 30." in reason or "turned by 29." in reason


def test_reaction_is_told_and_the_mass_stays_positive(tmp_path: Path, table: Table) -> None:
    flipped = table | {name: -np.asarray(table[name]) for name in WRENCH}
    found = estimate(read_poses([write(tmp_path / "poses.csv", flipped)]))
    assert found.sign == -1
    assert found.refused == ()
    assert found.mass == pytest.approx(MASS, abs=4 * found.mass_error)
    np.testing.assert_allclose(found.offset, -OFFSET, atol=4 * found.offset_error.max())


def test_poses_that_cannot_tell_say_so() -> None:
    """In a plane, half a turn about its normal reverses gravity: a sign, or another frame."""
    angle = np.linspace(0, 5, 12)
    gravity = STANDARD_GRAVITY * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    found = estimate(held(gravity, felt(gravity) + OFFSET))
    assert any("being the attitude's -x, -y, z" in note for note in found.notes)


def test_wrong_unit_is_named(tmp_path: Path, table: Table) -> None:
    file = write(tmp_path / "poses.csv", table)
    with pytest.raises(DataError, match=r"is not gravity in m/s\^2 but in g; say --unit g"):
        read_poses([file], PoseLayout(attitude="acceleration", unit="m/s^2"))


def test_gyroscope_is_no_gravity(tmp_path: Path, table: Table) -> None:
    rates = {name: 0.01 * np.asarray(table[name]) for name in HABITS["gravity"]}
    with pytest.raises(DataError, match=r"neither 1 g nor 9.81 m/s.2; .* gyroscope"):
        read_poses([write(tmp_path / "poses.csv", table | rates)])


def test_gravity_that_was_not_logged_is_named_by_row(tmp_path: Path, table: Table) -> None:
    gone = {name: np.where(np.arange(24) == 4, 0.0, table[name]) for name in HABITS["gravity"]}
    with pytest.raises(DataError, match=r"row 6: norm 0, the median is 9\.807"):
        read_poses([write(tmp_path / "poses.csv", table | gone)])


@pytest.mark.parametrize("column", ["fx", "r22", "gz"])
def test_absurd_numbers_are_named_by_row(tmp_path: Path, table: Table, column: str) -> None:
    absurd = table | {column: np.where(np.arange(24) == 4, 1e300, table[column])}
    file = write(tmp_path / "poses.csv", absurd)
    layout = PoseLayout() if column == "gz" else TOLD
    with pytest.raises(LogError, match=rf"row 6: column '{column}' is 1e\+300, .*; cut the row"):
        read_poses([file], layout)


def test_biased_accelerometer_is_told(tmp_path: Path, table: Table) -> None:
    biased = table | {"az": np.asarray(table["az"]) + 0.08}
    file = write(tmp_path / "poses.csv", biased)
    found = estimate(read_poses([file], PoseLayout(attitude="acceleration")))
    assert "biased" in found.notes[0]
    # the bias goes into the offset, the tool is right
    assert found.mass == pytest.approx(MASS, abs=4 * found.mass_error)
    moved = found.offset[2] - OFFSET[2]
    expected = MASS * 0.08 * STANDARD_GRAVITY
    assert moved == pytest.approx(expected, abs=4 * found.offset_error[2])


def test_what_is_no_rotation_is_named_by_row(tmp_path: Path, table: Table) -> None:
    broken = np.asarray(table["r11"]).copy()
    broken[5] += 0.5
    file = write(tmp_path / "poses.csv", table | {"r11": broken})
    with pytest.raises(DataError, match="row 7: no rotation"):
        read_poses([file], TOLD)


# -------------------------------------------------------------- two tables


def slow_log(tmp_path: Path, *, rate: float = 6.0, seconds: float = 60.0) -> list[Path]:
    """Write wrench at 200 Hz and attitude at 50 Hz of a wrist that turns at `rate` deg/s."""
    rng = np.random.default_rng(8)

    def R(t: np.ndarray) -> np.ndarray:
        angle = np.radians(rate) * t
        rolling = rotation_about(np.array([1.0, 0.0, 0.0]), angle)
        return np.asarray(rolling @ rotation_about(np.array([0.0, 1.0, 0.0]), 0.7 * angle))

    t, at = np.arange(0.0, seconds, 1 / 200), np.arange(0.5, seconds, 1 / 50)
    wrench = felt(-STANDARD_GRAVITY * R(t)[:, 2]) + OFFSET + NOISE * rng.normal(size=(len(t), 6))
    logged = R(at).reshape(-1, 9)
    one = {"time": t} | dict(zip(WRENCH, np.ascontiguousarray(wrench.T), strict=True))
    two = {"time": at} | dict(zip(ROTATION, np.ascontiguousarray(logged.T), strict=True))
    return [write(tmp_path / "wrench.csv", one), write(tmp_path / "attitude.csv", two)]


def test_wrench_and_attitude_on_two_clocks_are_joined(tmp_path: Path) -> None:
    poses = read_poses(slow_log(tmp_path))
    assert "rows have no attitude" in poses.notes[0]
    found = estimate(poses)
    assert found.refused == ()
    assert np.abs((figures(found) - TRUTH) / errors(found)).max() < 4.0


def test_tool_that_is_thrown_about_is_refused(tmp_path: Path) -> None:
    found = estimate(read_poses(slow_log(tmp_path, rate=40.0, seconds=20.0)))
    assert "inertia is not in the model; say --steady" in found.refused[0]


def test_moving_rows_are_left_out(tmp_path: Path) -> None:
    files = slow_log(tmp_path)
    with pytest.raises(DataError, match=r"never turns slower than .* deg/s; raise --steady"):
        read_poses(files, PoseLayout(steady=np.radians(0.5)))
    kept = read_poses(files, PoseLayout(steady=np.radians(20.0)))
    assert len(kept.rows) == len(read_poses(files).rows)


def test_rests_of_one_table_are_found_by_its_clock(tmp_path: Path) -> None:
    """Six attitudes held for two seconds; in between the wrist swings and the tool with it."""
    rng = np.random.default_rng(2)
    t = np.arange(0.0, 18.0, 0.01)
    moving = t % 3.0 > 2.0
    corners = rng.uniform(-1.5, 1.5, size=(7, 3))
    part = np.where(moving, t % 3.0 - 2.0, 0.0)[:, None]
    turn = (t // 3.0).astype(int)
    R = rotation_from_rpy(corners[turn] * (1 - part) + corners[turn + 1] * part)
    wrench = felt(-STANDARD_GRAVITY * R[:, 2]) + OFFSET + NOISE * rng.normal(size=(len(t), 6))
    wrench[moving] += rng.normal(size=(moving.sum(), 6))
    values = np.ascontiguousarray(np.column_stack([t, wrench, R.reshape(-1, 9)]).T)
    file = write(tmp_path / "log.csv", dict(zip(("time", *WRENCH, *ROTATION), values, strict=True)))
    found = estimate(read_poses([file], PoseLayout(steady=np.radians(2.0))))
    assert found.poses == 6
    assert found.refused == ()
    assert np.abs((figures(found) - TRUTH) / errors(found)).max() < 4.0
    assert found.rms(found.residual)[0] < 0.1  # noise, nothing of the swings


def test_clocks_that_never_meet_are_refused(tmp_path: Path) -> None:
    files = slow_log(tmp_path, seconds=5.0)
    table = csv.read_csv(files[1])
    later = table.set_column(0, "time", pa.array(table["time"].to_numpy() + 1000.0))
    csv.write_csv(later, files[1])
    with pytest.raises(DataError, match="no wrench within the time of the attitude"):
        read_poses(files)


# ---------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: {{"fx": "f_x"}.get(k, k): v for k, v in t.items()}, "'fx'; did you mean f_x?"),
        (lambda t: {k: v for k, v in t.items() if k in WRENCH}, "no attitude: none of gx … gz"),
        (lambda t: t | {"tz": np.where(np.arange(24) == 3, np.nan, 1.0)}, "row 5: column 'tz' is"),
        (lambda t: t | {"fy": np.array(["one"] * 24)}, "column 'fy' is string, not numbers"),
    ],
    ids=["missing column", "no attitude", "NaN", "text"],
)
def test_a_bad_table_is_one_line(
    tmp_path: Path, table: Table, change: Callable[[Table], Table], message: str
) -> None:
    changed = change(table)
    result = run(write(tmp_path / "poses.csv", changed))
    assert result.exit_code == 1
    assert message in result.stderr
    assert result.stderr.count("\n") == 1


def test_all_missing_columns_are_told_at_once(tmp_path: Path, table: Table) -> None:
    file = write(tmp_path / "poses.csv", table)
    layout = PoseLayout(
        wrench=("f_x", *WRENCH[1:5], "t_z"), attitude="gravity", columns=("gx", "gy")
    )
    with pytest.raises(
        LogError, match=r"'f_x'; did you mean fx.*'t_z'; did you mean tz.*2 are named"
    ):
        read_poses([file], layout)


@pytest.mark.parametrize(
    ("text", "message"),
    [("", "the file is empty"), (",".join(WRENCH) + "\n", "a header but no rows")],
)
def test_an_empty_file_is_one_line(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "poses.csv"
    file.write_text(text)
    result = run(file)
    assert result.exit_code == 1
    assert message in result.stderr


def test_a_missing_file_is_one_line(tmp_path: Path) -> None:
    result = run(tmp_path / "none.csv")
    assert result.exit_code == 1
    assert "not a readable table" in result.stderr


def test_two_attitudes_are_a_usage_error(tmp_path: Path) -> None:
    words = ["--gravity", "a", "b", "c", "--acceleration", "d", "e", "f"]
    assert run(tmp_path / "poses.csv", *words).exit_code == 2


# ------------------------------------------------------------- the command


def test_command_prints_the_tool_within_100_columns(
    tmp_path: Path, table: Table, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "poses.csv", table)
    result = run("poses.csv")
    assert result.exit_code == 0, result.output
    assert "ACCEPT" in result.stdout
    assert (
        "gravity from gx … gz [m/s^2]; the sensor reads what the tool does to it" in result.stdout
    )
    assert all(len(line) <= 100 for line in result.stdout.splitlines())


def test_refusal_has_its_own_exit_code(tmp_path: Path, table: Table) -> None:
    result = run(write(tmp_path / "poses.csv", table), "--gravity", "gy", "gz", "gx")
    assert result.exit_code == NOT_BETTER
    assert "REFUSE: read as told the fit leaves" in result.stdout


def test_json_says_what_the_table_says(tmp_path: Path, table: Table) -> None:
    file = tmp_path / "poses.parquet"
    parquet.write_table(pa.table(table), str(file))
    record = json.loads(run(file, "--acceleration", "ax", "ay", "az", "--json").stdout)
    found = estimate(read_poses([file], PoseLayout(attitude="acceleration")))
    assert record["verdict"] == "ACCEPT"
    assert record["mass"] == found.mass
    assert record["centre_of_mass"] == found.centre.tolist()
    assert record["readings"][0]["read_as"] == "as told"


def test_json_has_null_for_what_is_not_determined(tmp_path: Path) -> None:
    side = np.where(np.arange(12) % 2, 1.0, -1.0)
    gravity = STANDARD_GRAVITY * np.stack([0 * side, side, 0 * side], axis=1)
    wrench = felt(gravity) + OFFSET
    names = (*HABITS["gravity"], *WRENCH)
    both = np.ascontiguousarray(np.concatenate([gravity, wrench], axis=1).T)
    result = run(write(tmp_path / "p.csv", dict(zip(names, both, strict=True))), "--json")
    record = json.loads(result.stdout)
    assert result.exit_code == NOT_BETTER
    assert record["centre_of_mass"][1] is None
    assert record["centre_of_mass"][0] == pytest.approx(CENTRE[0])
