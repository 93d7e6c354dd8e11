"""Breaks found by themselves: pretend robots whose sensors jump, whose feet brush, or neither."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from ftcal.balance_steps import unrest_in_balances
from ftcal.balances import balances, smoothed
from ftcal.config import Job, RecordingSection, read_job
from ftcal.errors import JobError
from ftcal.motion import STANDARD_GRAVITY, FixedContact
from ftcal.motions import extended_balancing
from ftcal.pairing import FtChannel
from ftcal.pipeline import Outcome, calibrate
from ftcal.robot import Robot
from ftcal.sensor import Workbench
from ftcal.steps import Unrest, unrest
from ftcal.support import standing_on
from ftcal.synthetic import (
    Brush,
    Conditions,
    Faults,
    OffsetStep,
    Session,
    Take,
    simulate,
    write_session,
)
from ftcal.terms import Frame, ModelPrior
from ftcal.touches import COMMON, HALF, LOUD, loud_spans, loudness
from ftcal.urdf import parse_robot
from pretend import FULL_SCALE
from study_world import as_urdf, schedule
from test_whole_body import SPANS, WALKER, World, frames_of, world
from walker import SIGNALS, walker

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

LEG = "r_leg_ft_sensor"
FOOT = "r_foot_ft_sensor"
JUMP = OffsetStep(sensor=LEG, take="wide", start=14.0, stop=None, wrench=(15, -12, 9, 0.3, 0, 0))
RIGHT = ("r_hip_roll", "r_hip_pitch", "r_knee", "r_ankle")
URDF = as_urdf(walker())
QUIET = 1e-4
"""White noise of the walk in fractions of full scale; a quarter second of it is averaged."""


# --------------------------------------------------------------------------- all balances at once


def walk(seed: int, jumps: Sequence[tuple[str, float, Float[Array, "6"]]] = ()) -> World:
    """Return a walk whose sensors read more from some times on, by shares of full scale."""
    one = world(seed, kappa=0.03, noise=QUIET)
    signals = {signal.name: signal for signal in one.recording.channels}
    for name, when, size in jumps:
        signal = signals[f"{name}/analog:o"]
        late = one.recording.seconds(signal) >= when
        counts = np.linalg.solve(one.gain[name], size * FULL_SCALE)
        signals[signal.name] = replace(signal, values=signal.values + np.outer(late, counts))
    return replace(one, recording=replace(one.recording, channels=tuple(signals.values())))


def found_in_balances(one: World) -> dict[str, Unrest]:
    parts = balances(
        one.recording, WALKER, one.channels, schedule(*SPANS), gravity=STANDARD_GRAVITY,
        reduced=functools.partial(smoothed, seconds=0.25),
    )  # fmt: skip
    return unrest_in_balances(
        parts, one.channels, frames_of(one), smoothing=0.25, model=ModelPrior(), breaks={}
    )


@pytest.mark.no_cover
def test_a_walk_of_four_sensors_without_steps_has_none() -> None:
    assert set(found_in_balances(walk(2)).values()) == {Unrest()}


@pytest.mark.parametrize(
    ("seed", "sensor", "when"),
    [(0, "l_foot_ft_sensor", 23.0), (1, "r_leg_ft_sensor", 38.0)],
)
@pytest.mark.no_cover
def test_a_step_in_the_balances_is_found_and_given_to_its_sensor(
    seed: int, sensor: str, when: float
) -> None:
    # 5 of what a good fit of a real sensor leaves over (2e-4 and 8e-4 of full scale), signs mixed
    size = 5.0 * np.array([2e-4, -2e-4, 2e-4, 8e-4, 8e-4, -8e-4])
    found = found_in_balances(walk(seed, [(sensor, when, size)]))
    (step,) = found[sensor].steps
    assert step.time == pytest.approx(when, abs=0.3)
    assert step.unsettled[0] < when < step.unsettled[1]
    assert (np.abs(step.size - size * FULL_SCALE) < 5.0 * step.size_sd).all()
    others = [one for name, one in found.items() if name != sensor]
    assert all("or else" in step.message for one in others for step in one.steps)
    assert not any(one.touches for one in others)


@functools.cache
def robot() -> Robot:
    return parse_robot(URDF)


def test_a_step_that_two_sensors_explain_alike_is_given_to_both_and_said() -> None:
    rng = np.random.default_rng(4)
    # the knee and the ankle stand still: seen from the shank, its two sensors never part
    moves = extended_balancing(robot(), RIGHT[:2], generator=rng, duration=30.0, reach=0.6)
    session = simulate(
        robot(), [Take("wide", moves, standing_on(FixedContact("l_sole")))],
        sensors={name: SIGNALS[name] for name in (LEG, FOOT)}, generator=rng,
        conditions=Conditions(kappa=0.03), faults=Faults(steps=(replace(JUMP, start=15.0),)),
    )  # fmt: skip
    channels = [channel(session, name) for name in (LEG, FOOT)]
    parts = balances(
        session.recordings[0], robot(), channels, schedule((0.0, 1e4, "l_sole")),
        gravity=STANDARD_GRAVITY, reduced=functools.partial(smoothed, seconds=0.25),
    )  # fmt: skip
    found = unrest_in_balances(
        [part for part in parts if len(part.inputs) == 2],
        channels,
        {one.sensor: Frame.of(one.workbench, 6) for one in channels},
        smoothing=0.25,
        model=ModelPrior(),
        breaks={},
    )
    for name, other in ((LEG, FOOT), (FOOT, LEG)):
        (step,) = found[name].steps
        assert step.time == pytest.approx(15.0, abs=0.3)
        assert f"or else of {SIGNALS[other]}" in step.message
        assert "\n" not in step.message


# ------------------------------------------------------------------------------- brushing, touching


def channel(session: Session, sensor: str) -> FtChannel:
    board = session.truth[sensor].firmware
    scale = np.asarray(board.full_scale, dtype=np.float64)
    return FtChannel(sensor, SIGNALS[sensor], Workbench(board.serial, board.matrix, scale))


def logged(seed: int, faults: Faults | None = None, seconds: float = 40.0) -> Session:
    """Return a log of a walker on its left that moves its right leg, its sensors bent by 3 %."""
    rng = np.random.default_rng(seed)
    moves = extended_balancing(robot(), RIGHT, generator=rng, duration=seconds, reach=0.6)
    return simulate(
        robot(), [Take("wide", moves, standing_on(FixedContact("l_sole")))],
        sensors={LEG: SIGNALS[LEG]}, generator=rng, conditions=Conditions(kappa=0.03),
        faults=faults,
    )  # fmt: skip


def found_in(session: Session) -> Unrest:
    return unrest(
        session.recordings[0], robot(), channel(session, LEG),
        schedule((0.0, 1e4, "l_sole")), gravity=STANDARD_GRAVITY,
    )  # fmt: skip


@pytest.mark.parametrize(("start", "stop"), [(12.0, 12.7), (20.0, 21.5)])
def test_a_foot_that_brushes_is_a_touch_and_no_step(start: float, stop: float) -> None:
    brush = Brush(take="wide", frame="r_sole", start=start, stop=stop, share=0.1)
    found = found_in(logged(3, Faults(brushing=(brush,))))
    assert found.steps == ()
    assert found.touches
    first = min(touch.start for touch in found.touches)
    last = max(touch.stop for touch in found.touches)
    # the foot takes its weight over some tenths of a second, and blocks are half a second long
    assert first < start + 0.3
    assert last > stop - 0.3
    # what a foot leaves may pass for something that relaxes for seconds
    assert sum(touch.stop - touch.start for touch in found.touches) < stop - start + 6.0
    assert all("touched?" in touch.message and "\n" not in touch.message for touch in found.touches)


def test_logs_that_nothing_touches_have_no_touch() -> None:
    assert [found_in(logged(seed)).touches for seed in range(20, 26)] == [()] * 6


def test_a_balance_that_is_bad_everywhere_has_no_touch() -> None:
    rng = np.random.default_rng(0)
    left = rng.normal(size=(200, 6)) * 100.0
    left[rng.random(200) < 2.0 * COMMON] *= 50.0
    score = loudness(left, np.full(6, 0.3))
    assert (score > LOUD).mean() > COMMON
    assert loud_spans(score) == []


def test_a_lasting_change_is_no_touch_and_a_short_one_is() -> None:
    rng = np.random.default_rng(1)
    left = rng.normal(size=(200, 6))
    left[100:] += 60.0
    assert loud_spans(loudness(left, np.full(6, 0.3))) == []
    left[50:53] += 60.0
    ((first, stop),) = loud_spans(loudness(left, np.full(6, 0.3)))
    assert (first, stop) == (50, 53)


def test_a_log_shorter_than_what_it_is_compared_with_has_no_touch() -> None:
    assert not loudness(np.ones((2 * HALF, 6)), np.full(6, 1e-9)).any()


# ------------------------------------------------------------------------------------- in a job


@functools.cache
def stepping() -> Session:
    return logged(5, Faults(steps=(JUMP,)))


def job_with(folder: Path, **changes: object) -> Job:
    """Return the job of a log that steps at 14 s, its recording changed."""
    urdf = folder / "walker.urdf"
    urdf.write_text(URDF)
    job = read_job(write_session(stepping(), folder / "session", urdf=urdf))
    (section,) = job.recordings
    changed = RecordingSection.model_validate(
        {**section.model_dump(exclude_defaults=True), "test": [[28.0, 40.0]], **changes}
    )
    fixed = job.fit.model_copy(update={"kappa": 0.03})
    return job.model_copy(update={"recordings": (changed,), "fit": fixed})


def percent(outcome: Outcome) -> float:
    (sensor,) = outcome.sensors
    assert sensor.hold_out is not None
    return sensor.hold_out.by_name["force"].percent


def test_auto_breaks_do_as_well_as_breaks_by_hand(tmp_path: Path) -> None:
    window = [[0.0, 26.0]]
    auto = calibrate(job_with(tmp_path, train=window, breaks="auto"))
    by_hand = calibrate(job_with(tmp_path, train=[[0.0, 13.3], [14.7, 26.0]]))
    uncut = calibrate(job_with(tmp_path, train=window))
    assert percent(auto) == pytest.approx(percent(by_hand), abs=2.0)
    assert percent(uncut) > percent(by_hand) + 5.0
    # two offsets, and what the filter smears over 14 s is in neither
    first, second = (segment.samples for segment in auto.sensors[0].training)
    assert first.stop == second.start == pytest.approx(14.0, abs=0.3)
    assert first.time[-1] < 13.7
    assert second.time[0] > 14.3
    ((_, finding),) = [pair for pair in auto.findings if pair[1].kind == "offset step"]
    assert finding.signal == SIGNALS[LEG]
    assert not finding.cut


def test_what_is_held_out_is_the_same_with_auto_breaks(tmp_path: Path) -> None:
    plain = calibrate(job_with(tmp_path, train=[[15.0, 26.0]]))
    auto = calibrate(job_with(tmp_path, train=[[15.0, 26.0]], breaks="auto"))
    for one, other in zip(plain.sensors[0].test, auto.sensors[0].test, strict=True):
        np.testing.assert_array_equal(one.samples.time, other.samples.time)


def test_breaks_by_hand_split_a_window_and_keep_its_samples(tmp_path: Path) -> None:
    given = {LEG: [14.0]}
    cut = calibrate(job_with(tmp_path, train=[[0.0, 26.0]], breaks=given)).sensors[0].training
    whole = calibrate(job_with(tmp_path, train=[[0.0, 26.0]])).sensors[0].training
    assert len(cut) == 2
    assert sum(map(len, cut)) == sum(map(len, whole))


def test_windows_left_out_are_not_trained_on(tmp_path: Path) -> None:
    out = {LEG: [[5.0, 9.0], [27.0, 30.0]]}
    (sensor,) = calibrate(job_with(tmp_path, train=[[0.0, 13.0]], leave_out=out)).sensors
    (trained,) = sensor.training
    segment = trained.samples
    assert not ((segment.time >= 5.0) & (segment.time < 9.0)).any()
    assert (segment.time < 5.0).any()
    assert (segment.time > 9.0).any()
    assert sensor.paired[0].usable == len(sensor.paired[0].samples)
    # held out is held out
    assert sensor.test[0].samples.time[0] == pytest.approx(28.0, abs=0.1)


def job_text(extra: str) -> str:
    return (
        'robot = "r.urdf"\n[[sensors]]\nname = "s"\nsignal = "x"\n'
        f'[[recordings]]\nlog = "l"\ncontact = "c"\n{extra}\n'
    )


@pytest.mark.parametrize(
    ("extra", "words"),
    [
        ("leave_out = {t = [[1.0, 2.0]]}", "leave_out: no sensor 't'"),
        ("leave_out = {s = [[2.0, 1.0]]}", "ends before it starts"),
        ('breaks = "always"', "breaks"),
    ],
)
def test_wrong_breaks_are_refused_in_one_line(tmp_path: Path, extra: str, words: str) -> None:
    path = tmp_path / "job.toml"
    path.write_text(job_text(extra))
    with pytest.raises(JobError, match=words) as caught:
        read_job(path)
    assert "\n" not in str(caught.value)
