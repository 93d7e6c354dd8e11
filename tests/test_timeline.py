"""Who stood on which foot: a simulated walker whose loads are known."""

from __future__ import annotations

import itertools
import math
import tomllib
from dataclasses import replace

import numpy as np
import pytest

from ftcal.config import RecordingSection
from ftcal.contact import ContactSchedule, Interval
from ftcal.errors import DataError, JobError
from ftcal.plots.contact import contact_timeline
from ftcal.recording import Finding, Recording
from ftcal.robot import Robot
from ftcal.timeline import (
    Timeline,
    matching_signals,
    propose_timeline,
    schedule,
    to_toml,
)
from walker import SIDES, SIGNALS, SWITCH, WEIGHT, Knots, recorded, walker


def spans(timeline: Timeline, kind: str) -> list[tuple[str, float, float]]:
    return [(p.feet[0], p.start, p.stop) for p in timeline.phases if p.kind == kind]


@pytest.fixture(scope="module")
def robot() -> Robot:
    return walker()


@pytest.fixture(scope="module")
def switching(robot: Robot) -> Recording:
    return recorded(robot, SWITCH, {"r": [(12, 25)], "l": [(33, 45)]})


def only(place: str) -> dict[str, str]:
    return {sensor: signal for sensor, signal in SIGNALS.items() if place in sensor}


@pytest.mark.parametrize("place", ["foot", "leg"])
@pytest.mark.parametrize("seed", range(3))
def test_both_feet_are_found_in_turn_whatever_the_offsets(
    robot: Robot, place: str, seed: int
) -> None:
    log = recorded(robot, SWITCH, {"r": [(12, 25)], "l": [(33, 45)]}, seed=seed)
    timeline = propose_timeline(log, robot, signals=only(place))
    assert [foot.place.sensor[2:6].strip("_") for foot in timeline.feet] == [place[:4]] * 2
    (left, a, b), (right, c, d) = spans(timeline, "support")
    assert (left, right) == ("l_sole", "r_sole")
    # half the averaging window and a step, and the ramp through the light range of the last foot
    assert [a, b] == pytest.approx([12, 25], abs=0.15)
    assert [c, d] == pytest.approx([33, 45], abs=0.5)


def test_a_light_touch_is_brushing(robot: Robot, switching: Recording) -> None:
    first, second = spans(propose_timeline(switching, robot), "brushing")[:2]
    assert first == pytest.approx(("l_sole", 10.05, 12), abs=0.15)
    assert second == pytest.approx(("l_sole", 25, 26.05), abs=0.15)


def test_phases_leave_no_hole(robot: Robot, switching: Recording) -> None:
    phases = propose_timeline(switching, robot).phases
    assert all(a.stop == b.start for a, b in itertools.pairwise(phases))


def test_load_of_a_foot_is_its_share_of_the_weight(robot: Robot, switching: Recording) -> None:
    timeline = propose_timeline(switching, robot)
    newton = WEIGHT * 9.80665
    for foot, share in zip(timeline.feet, (0.5, 0.5), strict=True):
        standing = foot.load[(timeline.time > 2) & (timeline.time < 7)]
        # the level of the free foot is known to its dynamics, a newton or two of 294
        assert np.median(standing) == pytest.approx(share * newton, rel=0.02)


def test_the_direction_a_sensor_measures_in_is_its_description_s(switching: Recording) -> None:
    turned = walker("parent_to_child")
    log = recorded(turned, SWITCH, {"r": [(12, 25)], "l": [(33, 45)]})
    ours, theirs = (propose_timeline(r, m) for r, m in ((switching, walker()), (log, turned)))
    assert [p.kind for p in ours.phases] == [p.kind for p in theirs.phases]


def test_steps_of_a_walk_are_found_each(robot: Robot) -> None:
    knots: Knots = [(0, 0.5), (4, 0.5)]
    swings: dict[str, list[tuple[float, ...]]] = {"l": [], "r": []}
    for step in range(6):
        start, foot = 4.3 + 1.3 * step, SIDES[step % 2]
        share = 1.0 if foot == "l" else 0.0
        knots += [(start, share), (start + 0.9, share)]
        swings[foot].append((start, start + 0.9))
    knots += [(11.75, 0.5), (16, 0.5)]
    timeline = propose_timeline(recorded(robot, knots, swings), robot)
    steps = schedule(timeline.phases, shortest=0.5).intervals
    assert [i.link for i in steps] == ["r_sole", "l_sole"] * 3
    assert [i.start for i in steps] == pytest.approx([4.3 + 1.3 * i for i in range(6)], abs=0.1)


def test_a_robot_that_sways_on_two_feet_lifts_none(robot: Robot) -> None:
    knots = [(2.0 * i, 0.5 + 0.45 * (-1) ** i) for i in range(10)]
    timeline = propose_timeline(recorded(robot, knots, {}), robot)
    assert {p.kind for p in timeline.phases} == {"double", "unknown"}
    assert not any(foot.free for foot in timeline.feet)
    assert schedule(timeline.phases).intervals == ()
    assert all(p.stop - p.start < 0.5 for p in timeline.phases if p.kind == "unknown")


def test_a_robot_on_a_crane_stands_on_nothing(robot: Robot) -> None:
    log = recorded(
        robot, SWITCH, {"r": [(12, 25), (46, 49)], "l": [(33, 45), (46, 49)]}, lifted=(46, 49)
    )
    hung = [p for p in propose_timeline(log, robot).phases if p.start < 47.5 < p.stop]
    assert [p.kind for p in hung] == ["unknown"]


def test_an_offset_that_jumps_in_the_air_is_no_touch(robot: Robot, switching: Recording) -> None:
    name = SIGNALS["r_foot_ft_sensor"]
    jumped = switching.channel(name).values.copy()
    jumped[1820:2000] -= [5, 5, 15, 0, 0, 0]  # the foot is 7 to 10 cm above the floor
    channels = tuple(replace(s, values=jumped) if s.name == name else s for s in switching.channels)
    timeline = propose_timeline(replace(switching, channels=channels), robot)
    assert spans(timeline, "support")[0][1:] == pytest.approx((12, 25), abs=0.15)


@pytest.mark.parametrize("place", ["foot", "leg"])
def test_a_kick_above_the_level_leaves_the_other_foot_standing(robot: Robot, place: str) -> None:
    log = recorded(robot, SWITCH, {"r": [(12, 25, 1.9)], "l": [(33, 45, 1.9)]})
    timeline = propose_timeline(log, robot, signals=only(place))
    (left, a, b), (right, c, d) = spans(timeline, "support")
    assert (left, right) == ("l_sole", "r_sole")
    assert [a, b] == pytest.approx([12, 25], abs=0.15)
    assert [c, d] == pytest.approx([33, 45], abs=0.5)


def test_what_is_cut_is_unknown_unless_the_other_foot_is_free(
    robot: Robot, switching: Recording
) -> None:
    name = SIGNALS["l_foot_ft_sensor"]
    cuts = tuple(Finding("frozen", name, a, b, True, "") for a, b in ((38.0, 40.0), (15.0, 17.0)))
    timeline = propose_timeline(switching, robot, findings=cuts)
    assert [p.kind for p in timeline.phases if p.start < 39 < p.stop] == ["unknown"]
    # something carries the robot while the right foot hangs
    assert [p.feet for p in timeline.phases if p.start < 16 < p.stop] == [("l_sole",)]


def test_a_foot_that_did_not_move_while_it_was_not_seen_stood(
    robot: Robot, switching: Recording
) -> None:
    cut = Finding("frozen", SIGNALS["l_foot_ft_sensor"], 4.0, 6.0, True, "")
    timeline = propose_timeline(switching, robot, findings=[cut])
    assert [p.kind for p in timeline.phases if p.start < 5 < p.stop] == ["double"]


def test_the_hip_is_asked_where_the_foot_is_frozen(robot: Robot, switching: Recording) -> None:
    name = SIGNALS["r_foot_ft_sensor"]
    cut = Finding("frozen", name, 0.0, 40.0, True, "")
    timeline = propose_timeline(switching, robot, findings=[cut])
    assert timeline.feet[1].place.signal == "right_leg/analog:o"


def test_signals_are_matched_by_the_place_they_name(robot: Robot, switching: Recording) -> None:
    assert matching_signals(switching, robot) == SIGNALS
    twice = replace(switching, channels=(*switching.channels, *switching.channels[:1]))
    assert "l_leg_ft_sensor" not in matching_signals(twice, robot)


def test_feet_without_a_sensor_between_them_are_refused(robot: Robot, switching: Recording) -> None:
    with pytest.raises(DataError, match="between 'r_sole' and 'l_sole'"):
        propose_timeline(switching, robot, signals={"l_foot_ft_sensor": "left_foot/analog:o"})
    with pytest.raises(JobError, match="two feet, not l_sole"):
        propose_timeline(switching, robot, ["l_sole"])


def test_logs_without_common_time_are_refused(robot: Robot, switching: Recording) -> None:
    late = tuple(
        replace(s, stamps=s.stamps + 10**12) if s.name == "left_foot/analog:o" else s
        for s in switching.channels
    )
    with pytest.raises(DataError, match="no time in common"):
        propose_timeline(replace(switching, channels=late), robot)


def test_toml_reads_back_as_the_schedule(robot: Robot, switching: Recording) -> None:
    found = schedule(propose_timeline(switching, robot).phases)
    section = RecordingSection.model_validate({"log": "x", **tomllib.loads(to_toml(found))})
    assert len(found.intervals) == 2
    for ours, theirs in zip(found.intervals, section.schedule().intervals, strict=True):
        assert ours.link == theirs.link
        # rounded inwards, by 10 ms at most
        assert ours.start - 1e-9 <= theirs.start <= ours.start + 0.01 + 1e-9
        assert ours.stop - 0.01 - 1e-9 <= theirs.stop <= ours.stop + 1e-9


def test_toml_of_one_interval() -> None:
    contacts = ContactSchedule((Interval(math.pi, 9.999, "l_sole"),))
    text = 'contacts = [\n  { start = 3.15, stop = 9.99, link = "l_sole" },\n]'
    assert to_toml(contacts) == text


def test_toml_names_all_that_touch_and_one_contact_throughout_alone() -> None:
    both = Interval(-math.inf, 80.0, "l_sole", ("r_sole",))
    assert to_toml(ContactSchedule((both,)), duration=80.0) == 'contact = ["l_sole", "r_sole"]'
    text = 'contacts = [\n  { start = 0.10, stop = 80.00, link = ["l_sole", "r_sole"] },\n]'
    assert to_toml(ContactSchedule((replace(both, start=0.1),)), duration=80.0) == text


def test_the_plot_has_a_band_a_phase_and_a_curve_a_foot(robot: Robot, switching: Recording) -> None:
    timeline = propose_timeline(switching, robot)
    figure = contact_timeline(timeline, switching.name)
    bands = [(shape["x0"], shape["x1"]) for shape in figure["layout"]["shapes"]]
    assert bands == [(p.start, p.stop) for p in timeline.phases]
    assert [t["name"].split()[0] for t in figure["data"]] == ["l_sole", "r_sole"]
    written = [note["text"] for note in figure["layout"]["annotations"]]
    assert "support<br>l_sole" in written


def test_the_order_of_the_feet_changes_nothing(robot: Robot, switching: Recording) -> None:
    ours, theirs = (
        propose_timeline(switching, robot, feet)
        for feet in (("l_sole", "r_sole"), ("r_sole", "l_sole"))
    )
    assert schedule(ours.phases) == schedule(theirs.phases)
    assert [(p.start, p.kind, set(p.feet)) for p in ours.phases] == [
        (p.start, p.kind, set(p.feet)) for p in theirs.phases
    ]
