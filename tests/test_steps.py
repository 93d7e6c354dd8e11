"""Steps of the offset: pretend legs whose sensor jumps when it is told to, or does not."""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from ftcal.contact import ContactSchedule, Interval
from ftcal.health import examine
from ftcal.motion import STANDARD_GRAVITY, FixedContact
from ftcal.motions import extended_balancing
from ftcal.pairing import FtChannel
from ftcal.recording import Recording, Signal
from ftcal.robot import Robot
from ftcal.sensor import Workbench
from ftcal.steps import Step, unrest
from ftcal.support import standing_on
from ftcal.synthetic import Conditions, Faults, OffsetStep, Session, Take, simulate
from walker import SIGNALS, walker

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

LEG = "r_leg_ft_sensor"
RIGHT = ("r_hip_roll", "r_hip_pitch", "r_knee", "r_ankle")
ON_LEFT = ContactSchedule((Interval(0.0, 1e4, "l_sole"),))


@functools.cache
def robot() -> Robot:
    return walker()


def logged(
    seed: int,
    *steps: OffsetStep,
    seconds: float = 40.0,
    reach: float = 0.6,
    conditions: Conditions | None = None,
) -> Session:
    """Return a log of a walker on its left that moves its right leg, its sensors bent by 5 %."""
    rng = np.random.default_rng(seed)
    moves = extended_balancing(robot(), RIGHT, generator=rng, duration=seconds, reach=reach)
    return simulate(
        robot(),
        [Take("wide", moves, standing_on(FixedContact("l_sole")))],
        sensors={LEG: SIGNALS[LEG]},
        generator=rng,
        conditions=conditions or Conditions(kappa=0.05),
        faults=Faults(steps=steps),
    )


def jump(
    start: float,
    force: tuple[float, float, float] = (10.0, -8.0, 8.0),
    *,
    stop: float | None = None,
) -> OffsetStep:
    return OffsetStep(
        sensor=LEG, take="wide", start=start, stop=stop, wrench=(*force, 0.0, 0.0, 0.0)
    )


def channel(session: Session) -> FtChannel:
    board = session.truth[LEG].firmware
    scale = np.asarray(board.full_scale, dtype=np.float64)
    return FtChannel(LEG, SIGNALS[LEG], Workbench(board.serial, board.matrix, scale))


def found(session: Session, recording: Recording | None = None) -> tuple[Step, ...]:
    recording = recording or session.recordings[0]
    return unrest(
        recording,
        robot(),
        channel(session),
        ON_LEFT,
        gravity=STANDARD_GRAVITY,
        findings=examine(recording),
    ).steps


def with_values(recording: Recording, values: Float[Array, "N 6"]) -> Recording:
    (signal,) = recording.channels
    return replace(recording, channels=(replace(signal, values=values),))


def leg(session: Session) -> tuple[Recording, Signal, Float[Array, "N"]]:
    """Return a recording of one sensor, its signal and its times."""
    (recording,) = session.recordings
    (signal,) = recording.channels
    return recording, signal, recording.seconds(signal)


@pytest.mark.no_cover
def test_planted_steps_are_found_within_a_second() -> None:
    rng = np.random.default_rng(0)
    late, wrong = [], []
    for seed in range(20):
        way = rng.normal(size=3)
        a, b, c = (rng.uniform(5.0, 30.0) * way / np.linalg.norm(way)).tolist()
        when = rng.uniform(3.0, 36.0)
        (step,) = found(logged(seed, jump(when, (a, b, c))))
        assert abs(step.time - when) < 1.0
        assert step.unsettled[0] < when < step.unsettled[1]
        late.append((step.time - when) / step.uncertainty)
        wrong += ((step.size[:3] - [a, b, c]) / step.size_sd[:3]).tolist()
    # twenty and sixty draws: further than four standard deviations once in hundreds of worlds
    assert np.abs(late).max() < 4.0
    assert np.abs(wrong).max() < 4.0


@pytest.mark.no_cover
def test_thirty_healthy_logs_have_one_step_at_most() -> None:
    rng = np.random.default_rng(1)
    alarms = [
        found(
            logged(
                seed,
                seconds=rng.uniform(20.0, 50.0),
                reach=rng.uniform(0.15, 0.8),
                conditions=Conditions(kappa=rng.uniform(0.01, 0.08)),
            )
        )
        for seed in range(100, 130)
    ]
    assert sum(bool(steps) for steps in alarms) <= 1


def test_an_unseen_drift_with_temperature_is_not_cut_into_many_steps() -> None:
    for seed in range(4):
        steps = found(logged(seed, conditions=Conditions(warming=10.0, thermometer=False)))
        assert len(steps) <= 2


@pytest.mark.parametrize("seconds", [15.0, 60.0])
def test_a_sensor_that_warms_up_ever_slower_is_not_cut_into_many_steps(seconds: float) -> None:
    for seed in range(3):
        session = logged(seed)
        recording, signal, time = leg(session)
        drift = np.outer(1.0 - np.exp(-time / seconds), [20.0, -15.0, 10.0, 0.3, 0.2, 0.1])
        assert len(found(session, with_values(recording, signal.values + drift))) <= 2


def test_a_step_on_top_of_a_drift_is_found() -> None:
    session = logged(4, jump(22.0), conditions=Conditions(warming=10.0, thermometer=False))
    (step,) = found(session)
    assert step.time == pytest.approx(22.0, abs=1.0)


@pytest.mark.parametrize(("begin", "length"), [(10.0, 0.6), (17.0, 3.0), (24.0, 6.0)])
def test_a_step_under_a_freeze_is_dated_to_the_freeze(begin: float, length: float) -> None:
    session = logged(5, jump(begin + 0.7 * length))
    recording, signal, time = leg(session)
    frozen = (time >= begin) & (time < begin + length)
    values = signal.values.copy()
    values[frozen] = values[frozen][0]
    (step,) = found(session, with_values(recording, values))
    # nothing is known of it but that it was in the freeze, give or take the half window beside it
    assert begin < step.time < begin + length
    assert step.uncertainty > length / np.sqrt(12.0)
    assert step.unsettled[0] < begin
    assert step.unsettled[1] > begin + length


@pytest.mark.parametrize("apart", [3.0, 9.0, 20.0])
def test_a_step_and_its_reversal_are_both_found(apart: float) -> None:
    up, down = found(logged(6, jump(12.0, stop=12.0 + apart)))
    assert (up.time, down.time) == pytest.approx((12.0, 12.0 + apart), abs=0.2)
    # each is known to some per cent of its size
    np.testing.assert_allclose(up.size[:3], -down.size[:3], atol=1.5)


@pytest.mark.parametrize("tau", [0.7, 1.5, 3.0])
def test_what_relaxes_is_no_second_step_and_is_left_out_until_it_rests(tau: float) -> None:
    session = logged(8)
    recording, signal, time = leg(session)
    since = np.maximum(time - 15.0, 0.0)
    stays, relaxes = np.array([10.0, -8.0, 4.0]), np.array([12.0, -8.0, 4.0])
    values = signal.values.copy()
    values[:, :3] += (time > 15.0)[:, None] * (stays + np.outer(np.exp(-since / tau), relaxes))
    (step,) = found(session, with_values(recording, values))
    assert step.time == pytest.approx(15.0, abs=0.2)
    assert (np.abs(step.size[:3] - stays) < 4.0 * step.size_sd[:3]).all()
    # the time constants tried are a factor of 1.4 apart
    np.testing.assert_allclose(step.relaxing[:3], relaxes, rtol=0.2)
    rests = step.unsettled[1] - 15.0
    # 15 N fall below a newton, and not to a thousandth
    assert tau * np.log(15.0) < rests < 0.5 + tau * np.log(1000.0)


def test_a_step_does_not_depend_on_the_offset_before_it() -> None:
    session = logged(9, jump(20.0))
    recording, signal, _ = leg(session)
    (plain,) = found(session)
    (moved,) = found(session, with_values(recording, signal.values + 100.0))
    assert moved.time == pytest.approx(plain.time, rel=1e-6)
    np.testing.assert_allclose(moved.size, plain.size, rtol=1e-6)


def test_a_log_too_short_for_two_segments_has_no_step() -> None:
    session = logged(10, jump(2.5))
    recording, signal, time = leg(session)
    few = time < 5.0
    short = replace(signal, stamps=signal.stamps[few], values=signal.values[few])
    assert found(session, replace(recording, channels=(short,))) == ()


def test_the_message_is_one_line_with_signal_time_and_size() -> None:
    (step,) = found(logged(11, jump(20.0)))
    assert step.message.startswith("right_leg/analog:o: offset steps at 20.0")
    assert "unsettled 19." in step.message
    assert "\n" not in step.message
