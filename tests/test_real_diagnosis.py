"""The diagnosis on two real robots: rightly read, with signs reversed, with each other's URDF.

The legs of the two descriptions are the same to 2 g and 1 mm, only the trunks differ (chest 5.6
against 7.6 kg), and no arm is logged: what an URDF says of the arms and where they hung adds to
what no log can tell. On the log of iCubGenova01 the weight that its feet share changes by 17 N
while the torso sweeps, which no hypothesis about sensors or masses explains.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from ftcal.contact import ContactSchedule
from ftcal.diagnosis import Diagnosis, diagnose, throughout, touching
from ftcal.health import examine
from ftcal.logs import read
from ftcal.recording import Recording
from ftcal.robot import Robot
from ftcal.timeline import propose_timeline
from ftcal.urdf import read_robot
from real import DATA, GENOVA02, needs_genova02

GENOVA01 = DATA / "icub-genova01"
needs_genova01 = pytest.mark.skipif(
    not GENOVA01.is_dir(), reason="shared/data/icub-genova01 is not here"
)
PLACES = ("left_leg", "right_leg", "left_foot", "right_foot")


@cache
def of_model(name: str) -> Robot:
    return read_robot(Path(pytest.importorskip("icub_models").get_model_file(name)))


@cache
def genova02() -> Robot:
    return read_robot(GENOVA02 / "iCubGenova02.urdf")


@cache
def sweep() -> tuple[Recording, ContactSchedule]:
    recording = read(GENOVA01 / "torso_sweep")
    return recording, throughout(recording, ("l_sole", "r_sole"))


@cache
def support() -> tuple[Recording, ContactSchedule]:
    recording = read(GENOVA02 / "left_leg_support")
    timeline = propose_timeline(recording, genova02(), findings=examine(recording))
    return recording, touching(timeline.phases)


def judged(
    log: tuple[Recording, ContactSchedule],
    robot: Robot,
    reverse: tuple[str, ...] = (),
    rivals: dict[str, Robot] | None = None,
) -> Diagnosis:
    """Return the diagnosis of a log with some signals negated."""
    recording, schedule = log
    names = {f"{place}/analog:o" for place in reverse}
    channels = tuple(
        replace(s, values=-s.values) if s.name in names else s for s in recording.channels
    )
    wrong = replace(recording, channels=channels)
    return diagnose(wrong, robot, schedule, rivals=rivals, findings=examine(recording))


def reversed_places(found: Diagnosis) -> set[str]:
    """Return where a sign is believed to be reversed."""
    words = "of the opposite sign"
    return {s.signal.split("/")[0] for s in found.sensors if s.words == words}


@needs_genova01
def test_genova01_is_as_described() -> None:
    found = judged(sweep(), of_model("iCubGenova01"))
    assert found.word == "as described", found.sentence


@needs_genova02
def test_genova02_is_as_described() -> None:
    found = judged(support(), genova02())
    assert found.word == "as described", found.sentence


@needs_genova02
@pytest.mark.parametrize("place", ["left_leg", "right_foot"])
def test_a_reversed_sign_is_named_on_genova02(place: str) -> None:
    found = judged(support(), genova02(), (place,))
    assert found.word == "wrong reading"
    assert reversed_places(found) == {place}


@needs_genova02
def test_signs_all_reversed_are_named_on_genova02() -> None:
    found = judged(support(), genova02(), PLACES)
    assert reversed_places(found) == set(PLACES)


@needs_genova01
@pytest.mark.parametrize("place", ["left_leg", "right_foot"])
def test_a_reversed_sign_on_genova01_is_that_of_one_end_of_the_shank(place: str) -> None:
    found = judged(sweep(), of_model("iCubGenova01"), (place,))
    assert found.word == "wrong reading"
    # the shank hardly tilts: whether hip or foot is reversed, its balance cannot tell
    (named,) = reversed_places(found)
    side, _, part = place.partition("_")
    assert named.startswith(side)
    truth = f"{side[0]}_{part}_ft of the opposite sign"
    assert named == place or truth in found.sentence
    assert "does not tell which" in found.sentence


@needs_genova01
def test_signs_all_reversed_on_genova01_are_named_as_most_likely() -> None:
    found = judged(sweep(), of_model("iCubGenova01"), PLACES)
    assert found.word == "cannot tell"
    assert "most likely, though not clearly: all sensors of the opposite sign" in found.sentence


@needs_genova01
@needs_genova02
@pytest.mark.no_cover
def test_the_log_of_genova02_prefers_its_own_urdf() -> None:
    first = of_model("iCubGenova01")
    alone = judged(support(), first)
    assert alone.word == "as described"  # the legs are the same: nothing speaks against it
    found = judged(support(), first, rivals={"iCubGenova02": genova02()})
    assert found.word == "wrong robot"
    assert found.sentence.startswith("iCubGenova02 fits better")


@needs_genova01
@needs_genova02
def test_the_log_of_genova01_cannot_tell_the_two_urdfs_apart() -> None:
    found = judged(sweep(), genova02(), rivals={"iCubGenova01": of_model("iCubGenova01")})
    assert found.word == "as described"
    assert found.rivals[0].words == "cannot be told from iCubGenova02 by this log"


@needs_genova01
def test_a_urdf_with_other_feet_is_told_on_genova01() -> None:
    other = of_model("iCubGenova02")  # that of 2018
    found = judged(sweep(), other, rivals={"iCubGenova01": of_model("iCubGenova01")})
    assert found.word == "wrong robot"
    assert found.rivals[0].better
