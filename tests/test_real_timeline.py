"""The timeline of the one public log of the paper's robot, against that of its README."""

from __future__ import annotations

import functools
from dataclasses import replace
from pathlib import Path

import pytest

from ftcal.config import read_job
from ftcal.health import examine
from ftcal.logs import Layout, read
from ftcal.recording import Finding, Recording, Signal
from ftcal.robot import Robot
from ftcal.timeline import matching_signals, propose_timeline, schedule
from ftcal.urdf import read_robot
from real import DATA, GENOVA02, REAL_JOB, needs_genova02

SWEEP = DATA / "icub-genova01" / "torso_sweep"


@functools.cache
def log() -> tuple[Recording, Robot, tuple[Finding, ...]]:
    layout = Layout(zero="right_leg/analog:o")
    recording = read(GENOVA02 / "left_leg_support", layout)
    return recording, read_robot(GENOVA02 / "iCubGenova02.urdf"), examine(recording)


def found(places: tuple[str, ...]) -> list[tuple[str, float, float]]:
    """Return kind, start and stop of what the sensors at `places` propose."""
    recording, robot, findings = log()
    signals = {
        sensor: signal
        for sensor, signal in matching_signals(recording, robot).items()
        if sensor.removesuffix("_ft_sensor") in places
    }
    timeline = propose_timeline(recording, robot, signals=signals, findings=findings)
    return [(p.kind, p.start, p.stop) for p in timeline.phases]


SENSORS = [("l_foot", "r_foot"), ("l_foot", "r_leg"), ("l_leg", "r_foot"), ("l_leg", "r_leg")]


@needs_genova02
@pytest.mark.parametrize("places", SENSORS, ids=" ".join)
def test_the_hand_timeline_is_found_with_whichever_sensors(places: tuple[str, ...]) -> None:
    phases = found(places)
    kinds = [kind for kind, _, _ in phases if kind != "unknown"]
    # the offset step at 22.4 s and its reversal at 58.7 s split nothing
    assert kinds == ["double", "brushing", "support", "brushing", "double"]
    standing, toe, free, touching, again = (p for p in phases if p[0] != "unknown")
    assert standing[1] < 0.5
    assert toe[1] == pytest.approx(13.0, abs=0.5)
    assert free[1] == pytest.approx(16.8, abs=0.5)
    assert touching[1] == pytest.approx(62.0, abs=0.5)
    assert again[1] == pytest.approx(65.6, abs=0.5)


@needs_genova02
def test_the_proposal_stands_on_the_left_foot_inside_the_authors_interval() -> None:
    recording, robot, findings = log()
    timeline = propose_timeline(recording, robot, findings=findings)
    (only,) = schedule(timeline.phases).intervals
    assert only.link == "l_sole"
    assert only.start > 13.07
    assert only.stop < 65.64
    windows = read_job(REAL_JOB).recordings[0]
    assert all(a > only.start and b < only.stop for a, b in (*(windows.train or ()), *windows.test))


@needs_genova02
def test_the_right_foot_bears_half_the_robot_before_it_lifts() -> None:
    recording, robot, findings = log()
    timeline = propose_timeline(recording, robot, findings=findings)
    right = timeline.feet[1]
    standing = right.load[(timeline.time > 1) & (timeline.time < 9)].mean()
    # 166 of 324 N; nothing makes the shares equal but the posture
    assert standing == pytest.approx(robot.mass * 9.80665 / 2, rel=0.15)


@needs_genova02
def test_a_log_that_ends_in_the_air_needs_only_one_touch() -> None:
    recording, robot, _ = log()
    kept = between(recording, 0.0, 50.0)
    (only,) = schedule(propose_timeline(kept, robot, findings=examine(kept)).phases).intervals
    assert (only.start, only.stop) == pytest.approx((16.8, 50.0), abs=0.5)


@needs_genova02
def test_a_log_that_touches_longer_than_it_is_free_keeps_them_apart() -> None:
    recording, robot, _ = log()
    kept = between(recording, 60.0, 75.0)
    phases = propose_timeline(kept, robot, findings=examine(kept)).phases
    assert [p.kind for p in phases if p.kind != "unknown"] == ["support", "brushing", "double"]
    (only,) = schedule(phases).intervals
    assert (only.start, only.stop) == pytest.approx((60.0, 62.0), abs=0.5)


@needs_genova02
def test_a_log_of_one_swing_alone_says_nothing() -> None:
    recording, robot, _ = log()
    kept = between(recording, 31.0, 58.0)
    phases = propose_timeline(kept, robot, findings=examine(kept)).phases
    assert {p.kind for p in phases} == {"unknown"}


def between(recording: Recording, start: float, stop: float) -> Recording:
    """Return the samples in [start, stop) seconds."""

    def cut(signal: Signal) -> Signal:
        seconds = recording.seconds(signal)
        rows = (seconds >= start) & (seconds < stop)
        return replace(signal, stamps=signal.stamps[rows], values=signal.values[rows])

    return replace(
        recording,
        joints=tuple(map(cut, recording.joints)),
        channels=tuple(map(cut, recording.channels)),
    )


@pytest.mark.skipif(not SWEEP.is_dir(), reason="shared/data/icub-genova01 is not here")
def test_a_sweep_of_the_torso_lifts_no_foot() -> None:
    models = pytest.importorskip("icub_models")
    robot = read_robot(Path(models.get_model_file("iCubGenova01")))
    recording = read(SWEEP)
    for place in ("foot", "leg"):
        known = matching_signals(recording, robot)
        signals = {sensor: name for sensor, name in known.items() if place in sensor}
        timeline = propose_timeline(recording, robot, signals=signals, findings=examine(recording))
        assert {p.kind for p in timeline.phases} <= {"double", "unknown"}
        assert schedule(timeline.phases).intervals == ()
