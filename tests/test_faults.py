"""What goes wrong on request is in the log as asked, and nowhere else."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest

from ftcal.errors import DataError
from ftcal.external import external_wrenches
from ftcal.health import examine
from ftcal.kinematics import relative_pose
from ftcal.motion import FixedContact
from ftcal.motions import extended_balancing
from ftcal.recording import Recording, Signal
from ftcal.robot import Robot
from ftcal.support import Support, standing_on
from ftcal.synthetic import (
    Brush,
    Conditions,
    Faults,
    OffsetStep,
    Saturation,
    Session,
    SideBySide,
    Take,
    felt,
    invent_firmware,
    perturbed,
    simulate,
)
from ftcal.trajectory import MinimumJerk
from walker import SENSORS, SIGNALS, WEIGHT, walker

IDEAL = Conditions(noise=0.0, digital=False, encoder=0.0, flicker=0.0)
RIGHT = ("r_hip_roll", "r_hip_pitch", "r_knee", "r_ankle")
G = 9.80665
LEG = "r_leg_ft_sensor"
LONG = 20.0


@functools.cache
def robot() -> Robot:
    return walker()


def on_left() -> Take:
    rng = np.random.default_rng(3)
    move = extended_balancing(robot(), RIGHT, generator=rng, duration=LONG, reach=0.2)
    return Take("wide", move, standing_on(FixedContact("l_sole")))


def still(times: list[float], shares: list[list[float]], frames: tuple[str, ...]) -> Take:
    joints = robot().moving_joints
    rest = MinimumJerk(joints, np.array([0.0, LONG]), np.zeros((2, len(joints))))
    return Take("still", rest, Support(frames, np.array(times), np.array(shares)))


def made(
    faults: Faults | None = None, conditions: Conditions = IDEAL, takes: list[Take] | None = None
) -> Session:
    rng = np.random.default_rng(1)
    scale = [4000, 4000, 4000, 400, 400, 400]
    boards = {
        name: invent_firmware(np.random.default_rng(k), serial=f"SN{k}", full_scale=scale)
        for k, name in enumerate(SENSORS)
    }
    return simulate(
        robot(),
        takes or [on_left()],
        sensors=SIGNALS,
        generator=rng,
        firmware=boards,
        conditions=conditions,
        faults=faults,
    )


@functools.cache
def clean(conditions: Conditions = IDEAL) -> Session:
    return made(None, conditions)


def signals(recording: Recording) -> dict[str, Signal]:
    every = (*recording.joints, *recording.channels, *recording.temperatures)
    return {signal.name: signal for signal in every}


def changed(faults: Faults, conditions: Conditions = IDEAL) -> set[str]:
    """Return the signals whose values differ from those of the same session without faults."""
    (right,), (wrong,) = clean(conditions).recordings, made(faults, conditions).recordings
    ours, theirs = signals(right), signals(wrong)
    assert ours.keys() == theirs.keys()
    return {name for name in ours if not np.array_equal(ours[name].values, theirs[name].values)}


def raw(session: Session, sensor: str) -> np.ndarray:
    """Return what the gauges said in the first take [counts]."""
    values = session.recordings[0].channel(SIGNALS[sensor]).values
    return session.truth[sensor].firmware.counts(values)


def test_no_fault_changes_nothing() -> None:
    assert not changed(Faults())


@pytest.mark.parametrize(
    "faults",
    [
        Faults(saturation=(Saturation(sensor=LEG, share=0.2),)),
        Faults(steps=(OffsetStep(sensor=LEG, take="wide", start=5.0, wrench=(9, 0, 0, 0, 1, 0)),)),
        Faults(delays={LEG: 0.03}),
        Faults(kappa={LEG: 0.1}),
    ],
)
def test_a_fault_of_one_sensor_changes_that_sensor_alone(faults: Faults) -> None:
    assert changed(faults, Conditions()) == {SIGNALS[LEG]}


def test_wrong_zeros_of_joints_change_the_encoders_alone() -> None:
    ports = {signal.name for signal in clean().recordings[0].joints}
    assert changed(Faults(joint_zero=0.01)) == ports


@pytest.mark.parametrize("share", [0.05, 0.21])
def test_a_saturated_sensor_repeats_itself_and_the_data_doctor_sees_it(share: float) -> None:
    session = made(Faults(saturation=(Saturation(sensor=LEG, share=share),)), Conditions())
    (recording,) = session.recordings
    signal = recording.channel(SIGNALS[LEG])
    repeats = np.append(False, (np.diff(signal.values, axis=0) == 0.0).all(axis=1))
    # the noise of 8 counts lets a sample through near the end of the range
    assert repeats.mean() == pytest.approx(share, abs=0.02)
    findings = examine(recording, sensors={signal.name: session.truth[LEG].firmware})
    cut = [finding for finding in findings if finding.cut]
    assert {finding.signal for finding in cut} == {signal.name}
    assert "saturated" in {finding.kind for finding in cut}
    seconds = recording.seconds(signal)
    inside = np.zeros(len(signal), dtype=bool)
    for finding in cut:
        inside |= (seconds >= finding.start) & (seconds < finding.stop)
    assert inside[repeats].all()


def test_saturation_of_one_take_leaves_the_others() -> None:
    takes = [on_left(), dataclasses.replace(on_left(), name="again")]
    one = Faults(saturation=(Saturation(sensor=LEG, share=0.2, take="again"),))
    session = made(one, Conditions(), takes)
    frozen = [
        (np.diff(recording.channel(SIGNALS[LEG]).values, axis=0) == 0.0).all(axis=1).mean()
        for recording in session.recordings
    ]
    assert frozen[0] == 0.0
    assert frozen[1] > 0.1


def test_a_sensor_beyond_its_range_throughout_is_refused() -> None:
    step = OffsetStep(sensor=LEG, take="wide", start=-1.0, wrench=(9e4, 0, 0, 0, 0, 0))
    with pytest.raises(DataError, match="saturates in every sample"):
        made(Faults(steps=(step,)))


def test_an_offset_steps_by_the_wrench_asked_for_and_back() -> None:
    jump = (5.0, -3.0, 0.0, 0.2, 0.0, 0.1)
    step = OffsetStep(sensor=LEG, take="wide", start=5.0, stop=8.0, wrench=jump)
    before, after = clean(), made(Faults(steps=(step,)))
    seconds = after.recordings[0].seconds(after.recordings[0].channel(SIGNALS[LEG]))
    jumped = (raw(after, LEG) - raw(before, LEG)) @ after.truth[LEG].gain.T
    inside = (seconds >= 5.0) & (seconds < 8.0)
    # counts of 1e4 times a matrix of condition 100 leave some 1e-10 N
    np.testing.assert_allclose(jumped[inside], np.tile(jump, (inside.sum(), 1)), atol=1e-9)
    np.testing.assert_allclose(jumped[~inside], 0.0, atol=1e-9)


def test_a_delayed_sensor_says_what_it_felt_before() -> None:
    session = made(Faults(delay=0.01, delays={LEG: 0.05}))
    (take,), (recording,) = session.takes, session.recordings
    for sensor, delay in ((LEG, 0.05), ("l_leg_ft_sensor", 0.01)):
        time = recording.seconds(recording.channel(SIGNALS[sensor])) - delay
        wrench = felt(robot(), take.trajectory, take.support, (), [sensor], time)[sensor]
        said = session.truth[sensor].model("wide").wrench(raw(session, sensor))
        np.testing.assert_allclose(said, wrench, atol=1e-8)


def test_encoders_are_off_by_the_zeros_of_the_truth() -> None:
    right, wrong = clean(), made(Faults(joint_zero=0.01))
    joints = right.recordings[0].joints[0]
    off = wrong.recordings[0].joints[0].values - joints.values
    zeros = [wrong.joint_zeros[name] for name in joints.columns]
    np.testing.assert_allclose(off, np.tile(zeros, (len(off), 1)), atol=1e-12)
    # eight joints: the sample deviation is seldom off by more than a factor of two
    assert 0.005 < np.std(zeros) < 0.02
    assert not right.joint_zeros


def test_a_sensor_may_bend_otherwise_than_the_rest() -> None:
    session = made(Faults(kappa={LEG: 0.0}), Conditions())
    np.testing.assert_array_equal(session.truth[LEG].secondary, np.eye(6))
    assert np.abs(session.truth["l_leg_ft_sensor"].secondary - np.eye(6)).max() > 0.01


def test_perturbed_robots_weigh_otherwise_and_stay_physical() -> None:
    rng = np.random.default_rng(0)
    ratios, moves = [], []
    for _ in range(40):
        other = perturbed(robot(), rng, mass=0.5, com=0.01)
        assert other.joints == robot().joints
        for name, link in robot().links.items():
            if link.mass > 0.0:
                ratio = other.links[name].mass / link.mass
                ratios.append(np.log(ratio))
                moves.append(other.links[name].com - link.com)
                np.testing.assert_allclose(other.links[name].inertia, ratio * link.inertia)
    # 520 masses: a standard deviation known to 3 %
    assert np.std(ratios) == pytest.approx(0.5, rel=0.1)
    assert np.std(moves) == pytest.approx(0.01, rel=0.1)
    assert perturbed(robot(), rng).mass == robot().mass


def test_sensors_feel_the_real_robot_not_the_described_one() -> None:
    session = made(Faults(mass=0.05))
    (take,), (recording,) = session.takes, session.recordings
    time = recording.seconds(recording.channel(SIGNALS[LEG]))
    said = session.truth[LEG].model("wide").wrench(raw(session, LEG))
    for who, same in ((session.real, True), (session.robot, False)):
        wrench = felt(who, take.trajectory, take.support, (), [LEG], time)[LEG]
        assert np.allclose(said, wrench, atol=1e-8) is same


def test_a_drift_without_a_thermometer_goes_unseen() -> None:
    seen, unseen = (made(None, dataclasses.replace(IDEAL, warming=8.0, thermometer=logged))
                    for logged in (True, False))  # fmt: skip
    assert len(seen.recordings[0].temperatures) == len(SENSORS)
    assert not unseen.recordings[0].temperatures
    assert not unseen.thermometers
    np.testing.assert_array_equal(raw(seen, LEG), raw(unseen, LEG))
    gain = unseen.truth[LEG].temperature_gain
    assert gain is not None
    assert np.abs(gain).max() > 0.01


def test_a_take_may_say_how_warm_its_sensors_are() -> None:
    takes = [
        dataclasses.replace(on_left(), name="cold", temperature=25.0, warming=0.0),
        dataclasses.replace(on_left(), name="hot", temperature=31.0, warming=4.0),
    ]
    cold, hot = made(takes=takes).recordings
    assert np.ptp(cold.temperatures[0].values) == 0.0
    assert cold.temperatures[0].values[0, 0] == 25.0
    assert hot.temperatures[0].values[0, 0] == 31.0
    assert hot.temperatures[0].values[-1, 0] == pytest.approx(35.0, abs=1e-9)


def test_two_feet_carry_their_shares_and_what_touches_nothing_balances() -> None:
    take = still([0.0, 10.0], [[0.8, 0.2], [0.3, 0.7]], ("l_sole", "r_sole"))
    time = np.linspace(0.0, LONG, 50)
    wrenches = felt(robot(), take.trajectory, take.support, (), SENSORS, time)
    frames = {"l_foot": "l_sole", "r_foot": "r_sole", "trunk": "trunk", "l_thigh": "l_thigh"}
    motion = take.trajectory.at(time)
    found = external_wrenches(robot(), motion, FixedContact("l_sole"), wrenches, frames)
    shares = take.support.at(time)
    for foot, share in (("l_foot", shares[:, 0]), ("r_foot", shares[:, 1])):
        np.testing.assert_allclose(found.wrench[foot][:, 2], share * WEIGHT * G, rtol=1e-9)
        np.testing.assert_allclose(found.wrench[foot][:, :2], 0.0, atol=1e-9)
    for free in ("trunk", "l_thigh"):
        np.testing.assert_allclose(found.wrench[free], 0.0, atol=1e-9)
    assert np.ptp(shares[:, 0]) == 0.5


def test_a_foot_that_brushes_while_it_moves_takes_its_share_of_all_there_is() -> None:
    """The world pushes the brushing foot with that share of weight and momentum, no other link."""
    take = on_left()
    brush = Brush(take="wide", frame="r_sole", start=6.0, stop=12.0, share=0.04)
    time = np.linspace(0.0, LONG, 400)
    wrenches = felt(robot(), take.trajectory, take.support, [brush], SENSORS, time)
    frames = {"l_foot": "l_sole", "r_foot": "r_sole", "trunk": "trunk", "r_thigh": "r_thigh"}
    motion = take.trajectory.at(time)
    found = external_wrenches(robot(), motion, FixedContact("l_sole"), wrenches, frames)
    pressing = (time >= 6.0) & (time <= 12.0)
    away = (time < 5.8) | (time > 12.2)
    for free in ("trunk", "r_thigh"):
        # the moving foot's acceleration is a difference quotient: 1e-6 of some 300 N
        np.testing.assert_allclose(found.wrench[free], 0.0, atol=1e-3)
    np.testing.assert_allclose(found.wrench["r_foot"][away], 0.0, atol=1e-9)
    l_R_r = relative_pose(robot(), motion, "l_sole", "r_sole")[:, :3, :3]
    pushed = np.einsum("nij,nj->ni", l_R_r, found.wrench["r_foot"][:, :3])
    stands = found.wrench["l_foot"][:, :3]
    np.testing.assert_allclose(pushed[pressing], 0.04 / 0.96 * stands[pressing], atol=1e-3)
    assert pushed[pressing, 2].mean() == pytest.approx(0.04 * WEIGHT * G, rel=0.02)


def test_brushing_is_not_in_the_schedule() -> None:
    brush = Brush(take="wide", frame="r_sole", start=6.0, stop=12.0, share=0.04)
    session = made(Faults(brushing=(brush,)))
    (span,) = session.takes[0].support.schedule().intervals
    assert span.touching == ("l_sole",)
    at_feet = np.abs(raw(session, "r_foot_ft_sensor") - raw(clean(), "r_foot_ft_sensor"))
    assert at_feet.max() > 10.0


def test_feet_brush_after_every_lift_off_and_before_every_touch_down() -> None:
    frames = ("trunk", "l_sole", "r_sole")
    feet = [(0.0, 0.0), (0.0, 0.0), (0.5, 0.5), (0.5, 0.5), (1.0, 0.0), (1.0, 0.0), (0.5, 0.5)]
    shares = [[1.0 - left - right, left, right] for left, right in feet]
    take = still([0, 2, 3, 5, 6, 9, 10], shares, frames)
    brushes = Faults(switch_share=0.03, switch_seconds=0.8).brushes(take)
    spans = sorted((b.frame, b.start, b.stop) for b in brushes)
    assert spans == [
        ("l_sole", 1.2, 2.0),
        ("r_sole", 1.2, 2.0),
        ("r_sole", 6.0, 6.8),
        ("r_sole", 8.2, 9.0),
    ]
    assert not Faults().brushes(take)


def test_every_name_that_is_not_there_is_told_in_one_line() -> None:
    wrong = Faults(
        kappa={"r_leg_ft_senser": 0.1},
        delays={"l_foot": 0.1},
        saturation=(Saturation(sensor=LEG, share=0.1, take="wid"),),
        brushing=(Brush(take="wide", frame="r_soel", start=1.0, stop=2.0, share=0.1),),
    )
    with pytest.raises(DataError) as raised:
        made(wrong)
    message = str(raised.value)
    for words in (
        "kappa: no sensor 'r_leg_ft_senser'; did you mean r_leg_ft_sensor",
        "delays: no sensor 'l_foot'",
        "saturation: no take 'wid'; did you mean wide",
        "brushing: no link 'r_soel'; did you mean r_sole",
    ):
        assert words in message
    assert "\n" not in message


def test_faults_must_make_sense() -> None:
    with pytest.raises(DataError, match=r"mass = -1 .*; switch_share = 1 .*; brushing .* ends"):
        Faults(
            mass=-1.0,
            switch_share=1.0,
            brushing=(Brush(take="a", frame="b", start=2.0, stop=1.0, share=0.1),),
        )


def test_firmware_of_no_sensor_and_ports_used_twice_are_refused() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(DataError, match="no simulated sensor 'l_leg_ft_sensor'"):
        simulate(
            robot(), [on_left()], sensors={LEG: "a"}, generator=rng,
            firmware={"l_leg_ft_sensor": invent_firmware(rng)},
        )  # fmt: skip
    with pytest.raises(DataError, match="'a/analog:o' appears twice"):
        simulate(robot(), [on_left()], sensors={LEG: "a", "l_leg_ft_sensor": "a"}, generator=rng)
    with pytest.raises(DataError, match="sensors: there is none"):
        simulate(robot(), [on_left()], sensors={}, generator=rng)


def test_limbs_side_by_side_move_as_each_alone() -> None:
    make = functools.partial(extended_balancing, robot(), duration=LONG)
    right = make(RIGHT, generator=np.random.default_rng(1))
    left = make(["l_knee"], generator=np.random.default_rng(2))
    both = SideBySide([right, left], [RIGHT, ["l_knee"]])
    time = np.linspace(0.0, LONG, 40)
    moved = both.at(time)
    for joints, alone in ((RIGHT, right), (("l_knee",), left)):
        columns = moved.columns(joints)
        np.testing.assert_array_equal(moved.position[:, columns],
                                      alone.at(time).position[:, columns])  # fmt: skip
        np.testing.assert_array_equal(moved.acceleration[:, columns],
                                      alone.at(time).acceleration[:, columns])  # fmt: skip
    shorter = make(["l_knee"], generator=np.random.default_rng(2), duration=30.0)
    with pytest.raises(DataError, match=r"'r_knee' is in two groups; .* last equally long"):
        SideBySide([right, shorter], [RIGHT, ["r_knee"]])
