"""A recording that passes by in pieces is paired as it is in one: cuts leave no trace."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from ftcal import takes
from ftcal.clocks import clocks_of
from ftcal.config import Job, read_job
from ftcal.contact import ContactSchedule, Interval
from ftcal.errors import DataError
from ftcal.gathering import PairedSensor
from ftcal.logs.pieces import WholeLog
from ftcal.paired_takes import paired_take, work_of
from ftcal.pairing import FtChannel, SignalOptions
from ftcal.piece_pairing import Pairing
from ftcal.pipeline import calibrate, described
from ftcal.recording import Finding, Recording, Signal
from ftcal.robot import Robot
from ftcal.smoothing import Rows
from ftcal.urdf import parse_robot
from small_world import JOINTS, PRIOR, robot_text, take, write_world

SECOND = 1_000_000_000


@lru_cache(maxsize=1)
def arm() -> Robot:
    return parse_robot(robot_text(), name="arm")


@lru_cache(maxsize=1)
def unruly() -> Recording:
    """Return a log on four clocks with holes, a session break, and stamps that tremble."""
    rng = np.random.default_rng(3)
    time, q, channels = take(5, seconds=30.0)

    def stamped(every: int, shift: float) -> np.ndarray:
        trembling = time[::every] + shift + rng.uniform(0.0, 2e-3, size=len(time[::every]))
        return np.asarray((trembling * SECOND).astype(np.int64) + 10**18)

    def signal(name: str, columns: tuple[str, ...], stamps: np.ndarray, values: np.ndarray,
               out: tuple[float, float]) -> Signal:  # fmt: skip
        seconds = (stamps - 10**18) / SECOND
        kept = (seconds < out[0]) | (seconds >= out[1])
        return Signal(name, columns, stamps[kept], values[kept])

    motion = np.column_stack([q, np.gradient(q, time, axis=0)])
    joints = signal("state", JOINTS, stamped(1, 0.0), q, (11.0, 11.4))
    felt = signal("leg", tuple("abcdef"), stamped(1, 1e-3), channels, (17.0, 17.2))
    warm = signal("heat", ("T",), stamped(50, 0.01), 30.0 + time[::50, None] / 10, (20.0, 24.0))
    base = signal("unit", tuple("ABCDEF"), stamped(2, 4e-3), motion[::2], (25.0, 25.1))
    return Recording(
        "unruly",
        "",
        10**18,
        (joints,),
        (replace(felt, breaks=(500,)),),
        (warm,),
        (base,),
        (Finding("frozen", "leg", 6.0, 6.3, True, "leg: frozen"),
         Finding("lost packets", "state", 27.0, 27.05, True, "state: lost")),
    )  # fmt: skip


SCHEDULE = ContactSchedule((Interval(0.0, 14.0, "base"), Interval(15.0, 40.0, "base")))
CHANNEL = FtChannel("ft_sensor", "leg", PRIOR, "heat")


def passed(rows: int | None, *, imu: str | None = None, max_gap: float | None = None) -> Rows:
    """Return all that comes out of the log in pieces of so many samples of a signal."""
    log = WholeLog(unruly())
    pairing = Pairing.of(
        log,
        arm(),
        [CHANNEL],
        SCHEDULE,
        gravity=(0.0, 0.0, -9.80665),
        imu=imu,
        findings=log.recording.findings,
        clocks=clocks_of(log, log.recording.findings, max_gap),
        options=SignalOptions(smoothing=0.5, max_gap=max_gap),
        with_attitude=True,
    )
    found = [out for piece in log.pieces(rows=rows, overlap=pairing.overlap)
             for _, out in pairing.rows(piece)]  # fmt: skip
    pairing.check()
    assert pairing.logged["ft_sensor"] == len(unruly().channels[0])
    return Rows(*(np.concatenate([getattr(one, name) for one in found])
                  for name in ("stamps", "values", "beside")))  # fmt: skip


WHOLE = {imu: passed(None, imu=imu) for imu in (None, "unit")}


@example(7, "unit")
@settings(deadline=None, max_examples=30)
@given(st.integers(30, 3000), st.sampled_from([None, "unit"]))
def test_it_makes_no_difference_where_a_log_is_cut(rows: int, imu: str | None) -> None:
    found, whole = passed(rows, imu=imu), WHOLE[imu]
    np.testing.assert_array_equal(found.stamps, whole.stamps)
    # the vector code takes another path at the ends of a table: sums round differently
    scale = np.abs(whole.values).max(axis=0)
    np.testing.assert_allclose(found.values / scale, whole.values / scale, rtol=0, atol=1e-13)
    np.testing.assert_allclose(found.beside, whole.beside, rtol=1e-11, atol=1e-11)


def test_a_short_pause_allowed_to_joints_is_not_asked_of_a_slow_thermometer() -> None:
    found = passed(None, max_gap=0.06)
    # two readings a second: each is longer away from the next than joints may be
    np.testing.assert_array_equal(found.stamps, WHOLE[None].stamps)
    np.testing.assert_array_equal(found.beside[:, 0], WHOLE[None].beside[:, 0])


def test_nothing_is_paired_across_a_hole_a_session_a_cut_or_a_change_of_contact() -> None:
    seconds = (WHOLE[None].stamps - 10**18) / SECOND
    lost = np.flatnonzero(np.diff(seconds) > 0.1)
    begin, end = seconds[lost], seconds[lost + 1]
    broken = (unruly().channels[0].stamps[500] - 10**18) / SECOND
    for event in (broken, 6.1, 11.2, 14.5, 17.1, 22.0, 27.02):
        assert ((begin < event) & (event < end)).any(), event
    # every smoothed sample keeps half a window (0.25 s) from the end of its stretch
    assert np.abs(seconds - broken).min() > 0.2


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Job:
    return read_job(write_world(tmp_path_factory.mktemp("world")))


def same(one: PairedSensor, other: PairedSensor) -> None:
    assert (one.usable, one.logged) == (other.usable, other.logged)
    for a, b in zip((*one.training, *one.test), (*other.training, *other.test), strict=True):
        assert a.label == b.label
        np.testing.assert_array_equal(a.cells.count, b.cells.count)
        np.testing.assert_allclose(a.cells.mean, b.cells.mean, rtol=1e-12)
        scale = np.sqrt(np.diagonal(b.moments().scatter))
        scatter = np.outer(scale, scale)
        np.testing.assert_allclose(
            a.cells.scatter / scatter, b.cells.scatter / scatter, rtol=0, atol=1e-12
        )
        np.testing.assert_allclose(a.envelope, b.envelope, rtol=1e-12)


def test_a_log_that_is_read_in_pieces_gives_what_one_in_memory_gives(
    world: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, channels = described(world)
    work = work_of(world, robot, channels)
    in_memory = [paired_take(one) for one in work.values()]
    monkeypatch.setattr(takes, "IN_MEMORY", 0)
    for one, whole in zip(work.values(), in_memory, strict=True):
        streamed = paired_take(one)
        assert streamed.findings == whole.findings
        assert streamed.outline.duration == whole.outline.duration
        assert streamed.outline.digest == whole.outline.digest
        same(streamed.sensors["ft_sensor"], whole.sensors["ft_sensor"])


def test_a_calibration_in_pieces_is_that_in_memory(
    world: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    (whole,) = calibrate(world).sensors
    monkeypatch.setattr(takes, "IN_MEMORY", 0)
    (streamed,) = calibrate(world).sensors
    for name in ("gain", "covariance"):
        one, other = getattr(streamed.estimate, name), getattr(whole.estimate, name)
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-10 * np.abs(other).max())
    assert streamed.verdicts == whole.verdicts
    assert streamed.hold_out is not None
    assert whole.hold_out is not None
    for axis, score in whole.hold_out.by_name.items():
        assert streamed.hold_out.by_name[axis].rms == pytest.approx(score.rms, rel=1e-10)


def test_a_stretch_shorter_than_the_filter_is_told_with_its_length() -> None:
    log = WholeLog(unruly())
    pairing = Pairing.of(
        log,
        arm(),
        [CHANNEL],
        ContactSchedule((Interval(2.0, 2.4, "base"),)),
        gravity=(0.0, 0.0, -9.80665),
        clocks=clocks_of(log, ()),
        options=SignalOptions(smoothing=0.5),
    )
    for piece in log.pieces(rows=10, overlap=pairing.overlap):
        assert not list(pairing.rows(piece))
    with pytest.raises(DataError, match=r"longest 0\.39 s\); log longer or smooth less"):
        pairing.check()
