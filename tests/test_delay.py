"""The delay between joints and F/T: pretend iCub legs whose delay is known."""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace

import numpy as np
import pytest

from ftcal.contact import ContactSchedule, Interval
from ftcal.delay import REACH, WORST, Delay, estimate_delay
from ftcal.dynamics import expected_wrenches
from ftcal.motion import STANDARD_GRAVITY, FixedContact, Motion
from ftcal.motions import MinimumJerk, Trajectory, balancing, grid
from ftcal.pairing import FtChannel
from ftcal.recording import NANOSECONDS, Recording, Signal
from ftcal.robot import Robot
from ftcal.sensor import AXES
from ftcal.urdf import read_robot
from pretend import FULL_SCALE, bent, workbench

SENSOR = "r_leg_ft_sensor"
LEG = tuple(
    f"r_{joint}"
    for joint in ("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")
)
CHANNEL = FtChannel(SENSOR, "ft", replace(workbench(), logged="channels"))
ALWAYS = ContactSchedule((Interval(0.0, 1e3, "l_sole"),))
ENCODER = 2.0 * np.pi / 4096.0
"""Step of a 12-bit encoder [rad]."""
RATE = 100.0


@functools.cache
def icub() -> Robot:
    icub_models = pytest.importorskip("icub_models", reason="the iCub's models are an extra")
    return read_robot(icub_models.get_model_file("iCubGenova04"))


def swing(seed: int, seconds: float = 40.0) -> MinimumJerk:
    """Return moves of the right leg of a robot on its left."""
    return balancing(icub(), LEG, generator=np.random.default_rng(seed), duration=seconds)


def logged(
    moves: Trajectory, tau: float, seed: int, *, noise: float = 8.0, drift: float = 0.0
) -> Recording:
    """Return a log whose F/T readings were felt `tau` seconds before their stamps.

    An iCub's: both signals on clocks of their own that jitter by 0.2 ms, encoders of 12 bits, a
    sensor bent by 5 % of full scale with an unknown offset, white noise [counts] before rounding;
    the offset may `drift` [share of full scale a minute].
    """
    rng = np.random.default_rng(seed)
    count = int(moves.duration * RATE) - 2

    def clock() -> np.ndarray:
        late = np.clip(2e-4 * rng.normal(size=count), -4e-3, 4e-3)
        when = (rng.uniform(0.4, 1.4) + np.arange(count)) / RATE + late
        return np.asarray(np.rint(when * NANOSECONDS).astype(np.int64))

    joint_clock, ft_clock = clock(), clock()
    seen = moves.at(joint_clock / NANOSECONDS).position
    seen = np.rint(seen / ENCODER + 0.2 * rng.normal(size=seen.shape)) * ENCODER
    then = moves.at(ft_clock / NANOSECONDS - tau)
    wrench = expected_wrenches(icub(), then, FixedContact("l_sole"), [SENSOR])[SENSOR]
    offset = rng.uniform(-0.1, 0.1, 6) * FULL_SCALE
    moved = np.outer(ft_clock / NANOSECONDS / 60.0, drift * FULL_SCALE)
    gain = bent(CHANNEL.workbench, rng, 0.05)
    raw = np.linalg.solve(gain, (wrench - offset - moved).T).T
    raw = np.rint(raw + noise * rng.normal(size=raw.shape))
    start = 1_700_000_000 * NANOSECONDS
    return Recording(
        "swing",
        "pretend",
        start,
        (Signal("leg", moves.joints, joint_clock + start, seen),),
        (Signal("ft", AXES, ft_clock + start, raw),),
    )


def estimate(recording: Recording, schedule: ContactSchedule = ALWAYS) -> Delay:
    return estimate_delay(recording, icub(), CHANNEL, schedule, gravity=STANDARD_GRAVITY)


@pytest.mark.parametrize("milliseconds", [0, 5, -5, 20, -20, 100, -100])
def test_a_delay_is_recovered_within_three_milliseconds(milliseconds: int) -> None:
    tau = milliseconds / 1e3
    found = estimate(logged(swing(milliseconds % 89), tau, seed=1))
    assert found.determined
    assert abs(found.seconds - tau) < 3e-3
    assert abs(found.seconds - tau) < 3.0 * found.sd
    # it says so too: an error bar of 3 ms would make the line above worthless
    assert found.sd < 1e-3


def test_the_standard_deviation_covers_what_it_should() -> None:
    rng = np.random.default_rng(0)
    away = []
    for seed in range(30):
        tau = rng.uniform(-0.1, 0.1)
        found = estimate(logged(swing(100 + seed, seconds=25.0), tau, seed))
        away.append((found.seconds - tau) / found.sd)
    inside = np.mean(np.abs(away) < 1.645)
    # of 30 draws at nominal 90 %, 24 or more are inside in 97 of 100 worlds
    assert inside >= 0.8
    assert 0.5 < np.std(away) < 1.5


def test_slow_noise_widens_the_standard_deviation_as_much_as_the_error() -> None:
    away = []
    for seed in range(8):
        recording = logged(swing(200 + seed), 0.02, seed)
        (signal,) = recording.channels
        rng = np.random.default_rng(seed)
        # 30 times the counts of white noise, remembered for half a second
        kernel = np.exp(-np.arange(300) / (0.5 * RATE))
        kernel /= np.linalg.norm(kernel)
        white = rng.normal(size=(len(signal) + len(kernel) - 1, 6))
        slow = np.stack([np.convolve(column, kernel, "valid") for column in white.T], axis=1)
        noisy = replace(signal, values=signal.values + 30.0 * 8.0 * slow)
        found = estimate(replace(recording, channels=(noisy,)))
        assert found.sd > 1e-3
        away.append((found.seconds - 0.02) / found.sd)
    assert np.abs(away).max() < 3.0


def test_an_offset_that_drifts_costs_nothing() -> None:
    moves = swing(3)
    still, drifting = (estimate(logged(moves, 0.05, seed=3, drift=drift)) for drift in (0.0, 0.01))
    assert drifting.determined
    assert abs(drifting.seconds - 0.05) < 3e-3
    # 1 % of full scale a minute is 20 N: a single offset would leave several of them
    assert drifting.rms.min() < still.rms.min() + 0.5


def test_later_stamps_add_to_the_delay() -> None:
    recording = logged(swing(4), 0.0, seed=4)
    (signal,) = recording.channels
    late = replace(signal, stamps=signal.stamps + 30_000_000)
    before, after = estimate(recording), estimate(replace(recording, channels=(late,)))
    assert after.seconds - before.seconds == pytest.approx(0.03, abs=before.sd)


def test_the_curve_is_lowest_at_the_delay() -> None:
    found = estimate(logged(swing(5), -0.06, seed=5))
    assert found.tried[np.argmin(found.rms)] == pytest.approx(-0.06, abs=0.01)
    assert (found.tried[0], found.tried[-1]) == pytest.approx((-REACH, REACH))
    # at the delay the noise is left [N], away from it the motion
    assert found.rms.min() < 0.2
    assert found.rms.max() > 1.0


@dataclass(frozen=True)
class Circle:
    """Two hip joints a quarter of a turn apart, once in two seconds."""

    joints: tuple[str, ...]
    duration: float = 40.0

    def at(self, time: np.ndarray) -> Motion:
        rate = np.pi
        turn = rate * time[:, None] + np.pi / 2.0 * np.arange(2)
        table = np.zeros((3, len(time), len(self.joints)))
        columns = [self.joints.index(joint) for joint in LEG[:2]]
        table[0][:, columns] = 0.2 * np.sin(turn) + (0.3, -0.3)
        table[1][:, columns] = 0.2 * rate * np.cos(turn)
        table[2][:, columns] = -0.2 * rate**2 * np.sin(turn)
        return Motion(time, self.joints, *table)


@pytest.mark.parametrize("seed", range(3))
def test_a_bent_sensor_is_not_taken_for_a_delay_where_a_motion_repeats(seed: int) -> None:
    # a matrix free to turn the circle explains any delay
    found = estimate(logged(Circle(icub().moving_joints), 0.02, seed))
    assert found.determined
    assert abs(found.seconds - 0.02) < 3e-3


@pytest.mark.parametrize("seed", range(3))
def test_a_motion_too_slow_to_tell_is_not_determined(seed: int) -> None:
    moves = grid(icub(), LEG[:2], points=2, reach=0.05, duration=400.0)
    found = estimate(logged(moves, 0.02, seed))
    assert not found.determined
    assert found.sd > WORST
    assert "not determined" in found.message
    assert "\n" not in found.message


def test_a_slow_motion_is_as_uncertain_as_it_is_wrong() -> None:
    # shifts by parts of a sample once smoothed the noise, and such a minimum looked sharp
    moves = grid(icub(), LEG[:2], points=2, reach=0.1, duration=200.0)
    found = [estimate(logged(moves, 0.02, seed)) for seed in range(8)]
    away = [(delay.seconds - 0.02) / delay.sd for delay in found]
    assert np.sqrt(np.mean(np.square(away))) < 1.5
    assert min(delay.sd for delay in found) > 5e-3


def test_a_delay_beyond_reach_is_not_determined() -> None:
    found = estimate(logged(swing(7), 0.4, seed=7))
    assert not found.determined
    assert "check the clocks" in found.message


def test_a_few_seconds_are_not_enough() -> None:
    short = ContactSchedule((Interval(5.0, 11.0, "l_sole"),))
    found = estimate(logged(swing(8), 0.0, seed=8), short)
    assert not found.determined
    assert np.isnan(found.seconds)
    assert "log longer" in found.message


def test_an_offset_of_its_own_for_each_contact_interval() -> None:
    recording = logged(swing(9), 0.01, seed=9)
    (signal,) = recording.channels
    stepped = signal.values + 2000.0 * (recording.seconds(signal) >= 20.0)[:, None]
    recording = replace(recording, channels=(replace(signal, values=stepped),))
    apart = ContactSchedule((Interval(0.0, 20.0, "l_sole"), Interval(20.0, 40.0, "l_sole")))
    found = estimate(recording, apart)
    assert found.seconds == pytest.approx(0.01, abs=3.0 * found.sd)
    # across the step it is no longer motion that varies most, and the error bar knows
    across = estimate(recording)
    assert across.sd > 5.0 * found.sd
    assert abs(across.seconds - 0.01) < 3.0 * across.sd


def test_a_noiseless_sensor_is_no_division_by_zero() -> None:
    found = estimate(logged(swing(10), 0.02, seed=10, noise=0.0))
    assert found.seconds == pytest.approx(0.02, abs=1e-3)
    assert 0.0 < found.sd < 1e-3
