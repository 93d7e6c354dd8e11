"""What `ftcal inspect --diagnose` says of mistakes whose truth is known.

The arm of `small_world` moves on one sensor; the walker of `walker` stands, and lifts one foot
after the other, on four.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from click.testing import CliRunner, Result
from hypothesis import given, settings
from hypothesis import strategies as st

from ftcal.cli import main
from ftcal.contact import ContactSchedule, Interval
from ftcal.diagnosis import Diagnosis, diagnose
from ftcal.errors import DataError
from ftcal.hypotheses import angle_and_axis, fixed_hypotheses, nearest_turn, signed_axes, turned
from ftcal.recording import Recording, Signal
from ftcal.robot import Robot
from ftcal.spatial import inverse, pose, rotation_about, wrench_transform
from ftcal.urdf import parse_robot
from small_world import JOINTS, robot_text, take, truth, write_log
from walker import SWITCH, recorded, walker

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

BASE = ContactSchedule((Interval(0.0, 1e9, "base"),))
FULL_SCALE = np.array([1500.0, 1500.0, 2000.0, 35.0, 35.0, 25.0])


@cache
def arm(mass: float = 8.0) -> Robot:
    return parse_robot(robot_text(mass), name="arm")


@cache
def arm_wrenches(seed: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return time, joints and ideal readings with an offset and noise of 0.3 N, 6 mNm."""
    time, joints, channels = take(seed)
    return time, joints, channels @ truth().T


def arm_log(
    made: Callable[[Float[Array, "N 6"]], Float[Array, "N 6"]] = lambda w: w, seed: int = 1
) -> Recording:
    """Return the log of an arm whose sensor makes something of its readings."""
    time, joints, wrench = arm_wrenches(seed)
    stamps = np.round(time * 1e9).astype(np.int64) + 1_700_000_000_000_000_000
    return Recording(
        "take",
        "memory",
        int(stamps[0]),
        (Signal("joints", JOINTS, stamps, joints),),
        (Signal("ft", ("fx", "fy", "fz", "tx", "ty", "tz"), stamps, made(wrench)),),
    )


def mapped(matrix: Float[Array, "6 6"]) -> Callable[[Float[Array, "N 6"]], Float[Array, "N 6"]]:
    return lambda wrench: np.asarray(wrench @ matrix.T)


def of_arm(log: Recording, robot: Robot | None = None) -> Diagnosis:
    return diagnose(log, robot or arm(), BASE, signals={"ft_sensor": "ft"})


def bend(seed: int, kappa: float) -> Float[Array, "6 6"]:
    """Return S of a sensor bent by its mounting, as method 4 believes it."""
    E = np.random.default_rng(seed).normal(scale=kappa, size=(6, 6))
    return np.asarray(np.eye(6) + FULL_SCALE[:, None] * E / FULL_SCALE)


@pytest.mark.parametrize("seed", range(8))
def test_nothing_is_found_on_a_bent_sensor(seed: int) -> None:
    kappa = 0.03 + 0.02 * (seed % 2)
    found = of_arm(arm_log(mapped(bend(seed, kappa)), seed))
    assert found.word == "as described", found.sentence
    assert found.sensors[0].cure == ""


@pytest.mark.parametrize("kappa", [0.0, 0.04])
def test_a_reversed_sign_is_found(kappa: float) -> None:
    found = of_arm(arm_log(mapped(-bend(3, kappa))))
    assert found.word == "wrong reading"
    assert found.sentence.startswith("reverse the sign of ft_sensor")
    assert found.sensors[0].as_good == ()
    assert found.parts[0].misfit[1] < 2.0 < found.parts[0].misfit[0]


ARM_WAYS = {h.words: h for h in fixed_hypotheses(arm(), "ft_sensor")}


@pytest.mark.parametrize("words", [w for w in ARM_WAYS if w != "as described"][::7])
def test_axes_read_another_way_are_found(words: str) -> None:
    log = arm_log(mapped(np.linalg.inv(ARM_WAYS[words].map) @ bend(5, 0.03)))
    found = of_arm(log)
    assert found.word == "wrong reading"
    assert found.sensors[0].words == words


def test_torque_first_is_found_in_words() -> None:
    found = of_arm(arm_log(lambda wrench: wrench[:, [3, 4, 5, 0, 1, 2]]))
    assert found.sensors[0].words == "torque first"
    assert "read the columns of ft_sensor as tx, ty, tz, fx, fy, fz" in found.sentence


def test_the_frame_of_the_other_link_is_found() -> None:
    parent_H_child = arm().joints["ft"].parent_H_child
    found = of_arm(arm_log(mapped(wrench_transform(parent_H_child) @ bend(6, 0.03))))
    assert found.sensors[0].words == "in the frame of the parent link"
    assert "<frame>parent</frame>" in found.sentence


angles = st.floats(np.radians(35.0), np.radians(150.0))
directions = st.tuples(*3 * [st.floats(-1.0, 1.0)]).filter(lambda v: np.linalg.norm(v) > 0.3)


@settings(max_examples=8, deadline=None)
@given(angles, directions)
def test_a_turned_mounting_is_found(angle: float, direction: tuple[float, ...]) -> None:
    axis = np.array(direction) / np.linalg.norm(direction)
    R = np.asarray(rotation_about(axis, np.asarray(angle)))
    found = of_arm(arm_log(mapped(np.kron(np.eye(2), R.T) @ bend(7, 0.03))))
    believed = found.sensors[0].words
    quarter = [Q for Q in signed_axes().values() if np.linalg.det(Q) > 0]
    nearest = min(angle_and_axis(Q.T @ R)[0] for Q in quarter)
    # within a few degrees of a quarter turn, that one is the simpler word for it
    assert believed == turned(R).words or believed.startswith("turned") or nearest < np.radians(12)
    if believed.startswith("turned"):
        assert abs(float(believed.split()[2]) - np.degrees(angle)) < 5.0


@pytest.mark.parametrize("mass", [4.0, 13.0])
def test_another_robot_is_found_by_its_masses(mass: float) -> None:
    found = of_arm(arm_log(mapped(bend(8, 0.03))), arm(mass))
    assert found.word == "wrong robot", found.sentence
    assert found.sentence.startswith("arm is not the robot of the log")


def test_a_still_arm_tells_no_sign() -> None:
    log = arm_log()
    joints, ft = log.joints[0], log.channels[0]
    rng = np.random.default_rng(0)
    still = replace(
        log,
        joints=(replace(joints, values=np.zeros_like(joints.values)),),
        channels=(replace(ft, values=rng.normal(scale=0.3, size=ft.values.shape)),),
    )
    found = of_arm(still)
    assert found.word == "cannot tell"
    assert "does not tell the sign of ft_sensor" in found.sentence


def test_rivals_are_compared() -> None:
    rivals = {
        "light": arm(4.0),
        "twin": parse_robot(robot_text(), name="twin"),
        "stranger": replace(arm(), sensors={}),
    }
    log = arm_log(mapped(bend(9, 0.03)))
    log = replace(log, channels=(replace(log.channels[0], name="ft_sensor"),))
    found = diagnose(log, arm(), BASE, rivals=rivals)
    words = {rival.robot: rival.words for rival in found.rivals}
    assert words == {
        "light": "fits worse than arm",
        "twin": "cannot be told from arm by this log",
        "stranger": "has no sensors in common with arm",
    }
    other = diagnose(log, arm(9.5), BASE, rivals={"true": arm()})
    assert other.rivals[0].words == "fits better than arm"
    assert other.word == "wrong robot"


def test_a_log_without_a_known_sensor_is_refused() -> None:
    with pytest.raises(DataError, match=r"no F/T signal \(ft\) bears the name .* of another robot"):
        diagnose(arm_log(), replace(arm(), sensors={}), BASE)


@cache
def walk() -> tuple[Robot, Recording]:
    robot = walker()
    swings = {"r": [(12.5, 24.5)], "l": [(33.5, 44.5)]}
    return robot, recorded(robot, SWITCH, swings)  # type: ignore[arg-type]


STANDING = ContactSchedule(
    (
        Interval(0.0, 12.0, "l_sole", ("r_sole",)),
        Interval(12.5, 24.5, "l_sole"),
        Interval(25.2, 32.5, "l_sole", ("r_sole",)),
        Interval(33.5, 44.5, "r_sole"),
        Interval(45.5, 50.0, "l_sole", ("r_sole",)),
    )
)


def reread(log: Recording, ways: dict[str, Float[Array, "6 6"]]) -> Recording:
    """Return a log with the readings of some signals mapped."""
    return replace(
        log,
        channels=tuple(
            replace(s, values=s.values @ ways[s.name].T) if s.name in ways else s
            for s in log.channels
        ),
    )


def test_a_healthy_walker_is_as_described() -> None:
    robot, log = walk()
    ways = {s.name: bend(k, 0.04) for k, s in enumerate(log.channels)}
    found = diagnose(reread(log, ways), robot, STANDING)
    assert found.word == "as described", found.sentence


def test_all_signs_reversed_are_one_mistake() -> None:
    robot, log = walk()
    found = diagnose(reread(log, {s.name: -np.eye(6) for s in log.channels}), robot, STANDING)
    assert {sensor.words for sensor in found.sensors} == {"of the opposite sign"}
    assert found.sentence.count("reverse the sign") == 1


def test_two_sensors_wrong_in_ways_of_their_own_are_both_found() -> None:
    robot, log = walk()
    swap = np.kron(np.eye(2), signed_axes()["x and y swapped, z reversed"])
    hip, foot = "left_leg/analog:o", "right_foot/analog:o"
    found = diagnose(reread(log, {hip: -np.eye(6), foot: swap}), robot, STANDING)
    words = {sensor.signal: sensor.words for sensor in found.sensors if sensor.cure}
    assert words[hip] == "of the opposite sign"
    # the foot of half a kilogram hangs; which of the axes that its load leaves alone is reversed,
    # its hip must tell
    assert words[foot] == "x and y swapped, z reversed"
    assert len(words) == 2


def test_a_wrench_reduced_elsewhere_is_found_where_force_comes_and_goes() -> None:
    robot, log = walk()
    elsewhere = pose(np.eye(3), np.array([0.0, 0.08, -0.15]))
    far = reread(log, {"left_leg/analog:o": wrench_transform(inverse(elsewhere))})
    found = diagnose(far, robot, STANDING)
    (wrong,) = [sensor for sensor in found.sensors if sensor.cure]
    assert wrong.sensor == "l_leg_ft_sensor"
    assert wrong.words.startswith("reduced at (")
    found_at = [float(x) for x in wrong.words.split("(")[1].split(")")[0].split(",")]
    np.testing.assert_allclose(found_at, elsewhere[:3, 3], atol=0.005)  # noise of 0.3 N on 150 N


def test_a_wrench_reduced_elsewhere_is_only_an_offset_where_force_is_constant() -> None:
    elsewhere = pose(np.eye(3), np.array([0.0, 0.08, -0.15]))
    found = of_arm(arm_log(mapped(wrench_transform(inverse(elsewhere)))))
    assert found.word == "as described"


def test_inspect_tells_what_is_wrong(tmp_path: Path) -> None:
    time, joints, wrench = arm_wrenches()
    write_log(tmp_path / "log.csv", time, joints, -wrench)
    (tmp_path / "arm.urdf").write_text(robot_text())
    (tmp_path / "light.urdf").write_text(robot_text(4))
    words = ("inspect", tmp_path / "log.csv", "--robot", tmp_path / "arm.urdf", "--diagnose")
    result = run(*words, "--contact", "base", "--rival", tmp_path / "light.urdf")
    assert result.exit_code == 0, result.output
    assert "ft_sensor  ft: of the opposite sign" in result.stdout
    assert "wrong reading: reverse the sign of ft_sensor" in result.stdout
    record = json.loads(run(*words, "--contact", "base", "--json").stdout)["diagnosis"]
    assert record["word"] == "wrong reading"
    assert record["sensors"][0]["cure"].startswith("reverse the sign")


def test_inspect_without_contacts_cannot_diagnose() -> None:
    assert run("inspect", "log.csv", "--diagnose", "--robot", "arm.urdf").exit_code == 2
    assert run("inspect", "log.csv", "--diagnose", "--contact", "base").exit_code == 2
    assert run("inspect", "log.csv", "--contact", "base").exit_code == 2


def run(*words: str | Path) -> Result:
    return CliRunner().invoke(main, [str(word) for word in words], prog_name="ftcal")


def test_signed_axes_are_all_of_them_with_names_of_their_own() -> None:
    ways = signed_axes()
    assert len(ways) == 48
    assert len({tuple(Q.ravel()) for Q in ways.values()}) == 48
    moved = ways["x and y swapped, z reversed"] @ [1.0, 2.0, 3.0]
    assert moved.tolist() == [2.0, 1.0, -3.0]


@given(angles, directions)
def test_angle_and_axis_give_the_rotation_back(angle: float, direction: tuple[float, ...]) -> None:
    axis = np.array(direction) / np.linalg.norm(direction)
    found, about = angle_and_axis(np.asarray(rotation_about(axis, np.asarray(angle))))
    assert found == pytest.approx(angle, rel=1e-9)
    np.testing.assert_allclose(about, axis, atol=1e-9)


@given(st.integers(0, 1000))
def test_the_nearest_turn_is_the_one_that_was_done(seed: int) -> None:
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    R = np.asarray(rotation_about(axis, np.asarray(rng.uniform(0.0, 0.7))))
    loads = rng.normal(size=(50, 6))
    rows = np.einsum("ij,nk->nijk", np.eye(6), loads).reshape(-1, 36)
    target = (loads @ np.kron(np.eye(2), R).T).ravel()
    found = nearest_turn(rows.T @ rows, -rows.T @ target, np.eye(3))
    np.testing.assert_allclose(found, R, atol=1e-5)  # the search stops at a millionth
