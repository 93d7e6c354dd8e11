from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ftcal.errors import DataError
from ftcal.filters import smooth_and_derive
from ftcal.recording import Finding, Recording, Signal
from ftcal.run_filter import odd_window
from ftcal.signals import default_gap, interpolate, joint_motion, runs, smooth_runs, usable

ROBOT = Path(__file__).resolve().parents[2] / "shared" / "data" / "icub-genova02"
EPOCH = 1_457_614_036_659_765_000
SECOND = 1_000_000_000


def stamps_at(seconds: np.ndarray) -> np.ndarray:
    return np.asarray(EPOCH + np.rint(np.asarray(seconds) * SECOND).astype(np.int64))


def signal(
    name: str, seconds: np.ndarray, columns: dict[str, np.ndarray], **more: object
) -> Signal:
    values = np.column_stack(list(columns.values()))
    return Signal(name, tuple(columns), stamps_at(seconds), values, **more)  # type: ignore[arg-type]


def recording(*joints: Signal, channels: tuple[Signal, ...] = ()) -> Recording:
    return Recording("take", "here", EPOCH, joints, channels)


def cut(name: str, start: float, stop: float, *, keep: bool = False) -> Finding:
    return Finding("frozen", name, start, stop, not keep, "for the test")


@pytest.mark.parametrize(
    ("seconds", "period", "count"),
    [(0.81, 0.01, 81), (1.01, 0.01, 101), (0.81, 0.01003, 81), (0.81, 0.001, 811), (0.01, 0.01, 3)],
)
def test_window_is_the_nearest_odd_count(seconds: float, period: float, count: int) -> None:
    assert odd_window(seconds, period) == count


@given(seconds=st.floats(0.1, 5.0), period=st.floats(1e-3, 0.03))
def test_window_is_odd_and_within_a_sample(seconds: float, period: float) -> None:
    count = odd_window(seconds, period)
    assert count % 2 == 1
    assert abs(count - seconds / period) <= 1 + 1e-9 or count == 3


@pytest.mark.parametrize(("seconds", "period"), [(0.0, 0.01), (0.8, 0.0), (0.8, float("nan"))])
def test_window_without_length_is_refused(seconds: float, period: float) -> None:
    with pytest.raises(DataError, match="both must be positive"):
        odd_window(seconds, period)


def test_runs_end_at_holes_sessions_and_cuts() -> None:
    t = np.arange(100) * 0.01
    t[40:] += 0.3
    s = signal("leg", t, {"knee": t}, breaks=(70,))
    assert runs(s) == [slice(0, 40), slice(40, 70), slice(70, 100)]
    assert runs(s, max_gap=1.0) == [slice(0, 70), slice(70, 100)]
    keep = np.ones(100, dtype=bool)
    keep[[0, 50, 51, 99]] = False
    assert runs(s, usable=keep) == [
        slice(1, 40), slice(40, 50), slice(52, 70), slice(70, 99)
    ]  # fmt: skip
    assert runs(s, usable=np.zeros(100, dtype=bool)) == []


def test_runs_of_nothing_and_of_one_sample() -> None:
    empty = Signal("a", ("x",), np.empty(0, dtype=np.int64), np.empty((0, 1)))
    single = Signal("a", ("x",), np.array([EPOCH]), np.zeros((1, 1)))
    assert runs(empty) == []
    assert runs(single) == [slice(0, 1)]


def test_slow_signals_have_long_gaps() -> None:
    slow = signal("t", np.arange(20.0), {"t": np.zeros(20)})
    assert default_gap(slow) == pytest.approx(5.0)
    fast = signal("t", np.arange(20) * 0.001, {"t": np.zeros(20)})
    assert default_gap(fast) == 0.05


@given(gaps=st.lists(st.integers(1, 30), min_size=1, max_size=60))
def test_runs_cover_every_sample_once(gaps: list[int]) -> None:
    t = np.cumsum(gaps) * 0.01
    s = signal("leg", t, {"knee": t})
    rows = [row for run in runs(s, max_gap=0.1) for row in range(run.start, run.stop)]
    assert rows == list(range(len(t)))


def test_usable_leaves_out_what_findings_cut() -> None:
    t = np.arange(100) * 0.01
    s = signal("ft", t, {"fx": t})
    r = recording(channels=(s,))
    mask = usable(r, s, [cut("ft", 0.2, 0.3), cut("ft", 0.6, 0.7, keep=True), cut("other", 0, 1)])
    assert np.flatnonzero(~mask).tolist() == list(range(20, 30))
    wide = usable(r, s, [cut("ft", 0.205, 0.295)], halo=0.05)
    assert np.flatnonzero(~wide).tolist() == list(range(16, 35))


def test_interpolation_never_crosses_a_hole_nor_leaves_the_signal() -> None:
    t = np.r_[0:1:0.1, 3:4:0.1]
    s = signal("temperature", t, {"t": 20 + 2 * t})
    clock = stamps_at(np.arange(-50, 500) / 100)
    at = (clock - EPOCH) / SECOND
    values = interpolate(s, clock)[:, 0]
    inside = ((at >= 0) & (at <= 0.9 + 1e-9)) | ((at >= 3 - 1e-9) & (at <= 3.9 + 1e-9))
    np.testing.assert_array_equal(np.isfinite(values), inside)
    np.testing.assert_allclose(values[inside], 20 + 2 * at[inside], rtol=1e-12)


def test_interpolation_on_its_own_clock_is_identity() -> None:
    t = np.cumsum(np.random.default_rng(0).uniform(0.005, 0.015, 300))
    s = signal("a", t, {"x": np.sin(t), "y": np.cos(t)})
    # one ulp: left + share * (right - left) with share 0 or, on the last row, 1
    np.testing.assert_allclose(interpolate(s, s.stamps), s.values, rtol=1e-15, atol=1e-15)


def test_smooth_runs_equals_the_filter_inside_each_run() -> None:
    x = np.random.default_rng(0).standard_normal((300, 6))
    y = smooth_runs(x, [slice(0, 120), slice(130, 150), slice(160, 300)], 21, 2)
    valid = np.flatnonzero(np.isfinite(y).all(axis=1))
    assert valid.tolist() == [*range(10, 110), *range(170, 290)]
    expected = smooth_and_derive(x[160:300], 21, 2, 0.01)[0]
    np.testing.assert_allclose(y[170:290], expected, rtol=1e-13, atol=1e-13)


def moving(seconds: np.ndarray) -> dict[str, np.ndarray]:
    return {"hip": 0.5 * np.sin(2 * seconds), "knee": 0.3 * np.cos(3 * seconds) - 0.7}


def test_motion_of_a_smooth_trajectory_is_its_derivatives() -> None:
    rng = np.random.default_rng(0)
    t = np.arange(3000) * 0.01 + rng.uniform(-0.001, 0.001, 3000)
    clock = stamps_at(np.arange(0, 3000) * 0.01 + 0.004)
    motion, valid = joint_motion(recording(signal("leg", t, moving(t))), ["knee", "hip"], clock)
    at = motion.time[valid]
    np.testing.assert_allclose(motion.time, (clock - EPOCH) / SECOND, atol=1e-12)
    assert motion.joints == ("knee", "hip")
    hip, knee = motion.columns(["hip", "knee"])
    position, velocity, acceleration = (
        table[valid] for table in (motion.position, motion.velocity, motion.acceleration)
    )
    # truncation of the polynomial: at most (w/2)^5 f^(5) for the value, less for slow joints;
    # linear interpolation onto the grid adds h^2 f''/8 = 4e-5 and its noise over the window
    np.testing.assert_allclose(position[:, hip], 0.5 * np.sin(2 * at), atol=5e-5)
    np.testing.assert_allclose(position[:, knee], 0.3 * np.cos(3 * at) - 0.7, atol=1e-4)
    np.testing.assert_allclose(velocity[:, hip], np.cos(2 * at), atol=3e-3)
    np.testing.assert_allclose(velocity[:, knee], -0.9 * np.sin(3 * at), atol=1e-2)
    np.testing.assert_allclose(acceleration[:, hip], -2 * np.sin(2 * at), atol=2e-2)
    assert np.isnan(motion.position[~valid]).all()
    # half a window and less than a sample on each side
    assert at[0] == pytest.approx(0.404, abs=0.012)
    assert at[-1] == pytest.approx(29.59, abs=0.012)


def test_regular_clock_gives_the_plain_filter() -> None:
    t = np.arange(5000) * 0.01  # several chunks
    s = signal("leg", t, moving(t))
    motion, valid = joint_motion(recording(s), ["hip", "knee"], s.stamps)
    assert np.flatnonzero(valid).tolist() == list(range(40, 4960))
    value, first, second = smooth_and_derive(s.values, 81, 4, 0.01)
    for ours, plain in zip(
        (motion.position, motion.velocity, motion.acceleration), (value, first, second), strict=True
    ):
        # rounding of the stamps: the grid is off by up to 1e-12 s, in a second derivative by 1e-9
        np.testing.assert_allclose(ours[valid], plain, rtol=0, atol=1e-8)


def test_holes_are_never_bridged() -> None:
    t = np.arange(1000) * 0.01
    t[500:] += 2.0
    s = signal("leg", t, moving(t))
    clock = stamps_at(np.arange(0, 12, 0.01))
    motion, valid = joint_motion(recording(s), ["hip"], clock)
    at = motion.time[valid]
    assert not ((at > 4.99 - 0.4 + 0.001) & (at < 7.0 + 0.4 - 0.001)).any()
    assert valid.sum() == pytest.approx(2 * 420, abs=4)
    np.testing.assert_allclose(motion.position[valid, 0], 0.5 * np.sin(2 * at), atol=5e-5)


def test_cut_spans_are_holes_and_every_joint_must_be_there() -> None:
    t = np.arange(1000) * 0.01
    leg, torso = signal("leg", t, moving(t)), signal("torso", t[:600], {"yaw": t[:600]})
    motion, valid = joint_motion(
        recording(leg, torso), ["hip", "yaw"], leg.stamps, findings=[cut("leg", 2.0, 2.1)]
    )
    expected = [*range(40, 160), *range(250, 560)]
    assert np.flatnonzero(valid).tolist() == expected
    assert np.isfinite(motion.position[800, 0])
    assert np.isnan(motion.position[800, 1])


def test_run_exactly_as_long_as_the_filter_supports_one_instant() -> None:
    t = np.arange(81) * 0.01
    s = signal("leg", t, moving(t))
    motion, valid = joint_motion(recording(s), ["hip"], s.stamps)
    assert np.flatnonzero(valid).tolist() == [40]
    np.testing.assert_allclose(motion.position[40, 0], 0.5 * np.sin(0.8), atol=5e-6)


def test_clock_elsewhere_is_invalid_not_an_error() -> None:
    t = np.arange(200) * 0.01
    _, valid = joint_motion(recording(signal("leg", t, moving(t))), ["hip"], stamps_at(t + 99))
    assert not valid.any()


def test_what_is_not_logged_is_named() -> None:
    t = np.arange(200) * 0.01
    r = recording(signal("leg", t, moving(t)))
    with pytest.raises(DataError, match="joints not logged but needed: yaw, roll"):
        joint_motion(r, ["hip", "yaw", "roll"], r.joints[0].stamps)
    with pytest.raises(DataError, match="did you mean knee"):
        joint_motion(r, ["kneee"], r.joints[0].stamps)


def test_joint_logged_twice_is_refused() -> None:
    t = np.arange(200) * 0.01
    r = recording(signal("leg", t, moving(t)), signal("leg2", t, {"knee": t}))
    with pytest.raises(DataError, match="joint 'knee' is logged twice, in 'leg' and 'leg2'"):
        joint_motion(r, ["hip"], r.joints[0].stamps)


def test_log_shorter_than_the_filter_is_refused() -> None:
    t = np.arange(50) * 0.01
    r = recording(signal("leg", t, moving(t)))
    with pytest.raises(DataError, match=r"longest stretch of 'leg' .* lasts 0.49 s, less than the"):
        joint_motion(r, ["hip"], r.joints[0].stamps)


@pytest.mark.skipif(not ROBOT.is_dir(), reason="the recordings of iCubGenova02 are not here")
def test_real_knee_follows_its_encoder() -> None:
    folder = ROBOT / "left_leg_support" / "icub" / "right_leg"
    lines = (folder / "stateExt:o" / "data.log").read_text().splitlines()
    stamps = np.array([round(float(line.split()[1]) * 1e9) for line in lines])
    angles = np.array(
        [[float(v) for v in line[line.index("(") + 1 : line.index(")")].split()] for line in lines]
    )
    names = tuple(f"joint{i}" for i in range(6))
    leg = Signal("right_leg/stateExt:o", names, stamps, np.radians(angles))
    clock = np.array(
        [
            round(float(line.split()[1]) * 1e9)
            for line in (folder / "analog:o" / "data.log").read_text().splitlines()
        ]
    )
    take = Recording("real", "here", int(clock[0]), (leg,), ())
    motion, valid = joint_motion(take, names, clock)
    assert valid.mean() > 0.98
    error = motion.position[valid] - interpolate(leg, clock)[valid]
    # encoder steps are 0.0879 deg; fast moves lose a little to the filter
    assert np.degrees(np.sqrt((error**2).mean(axis=0))).max() < 0.3
