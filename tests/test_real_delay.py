"""The delay of the hip sensor in the one public log of the paper's robot: none to speak of."""

from __future__ import annotations

import functools

from ftcal.config import read_job
from ftcal.contact import ContactSchedule, Interval
from ftcal.delay import Delay, estimate_delay
from ftcal.health import examine
from ftcal.logs import Layout, read
from ftcal.motion import STANDARD_GRAVITY
from ftcal.pairing import FtChannel
from ftcal.urdf import read_robot
from ftcal.workbench import read_workbench
from real import GENOVA02, REAL_JOB, needs_genova02

pytestmark = needs_genova02


@functools.cache
def found(windows: tuple[tuple[float, float], ...]) -> Delay:
    recording = read(GENOVA02 / "left_leg_support", Layout(zero="right_leg/analog:o"))
    prior = read_workbench(GENOVA02 / "matrices/matrix_SN026.txt")
    return estimate_delay(
        recording,
        read_robot(GENOVA02 / "iCubGenova02.urdf"),
        FtChannel("r_leg_ft_sensor", "right_leg/analog:o", prior),
        ContactSchedule(tuple(Interval(start, stop, "l_sole") for start, stop in windows)),
        gravity=STANDARD_GRAVITY,
        findings=examine(recording),
    )


def hand_cut() -> tuple[tuple[float, float], ...]:
    """Return the windows of the example in which the right leg is free and its offset holds."""
    (section,) = read_job(REAL_JOB).recordings
    return tuple(sorted((*(section.train or ()), *section.test)))


def test_the_hip_sensor_is_not_delayed_within_ten_milliseconds() -> None:
    delay = found(hand_cut())
    assert delay.determined
    assert delay.sd < 0.01
    # +7.1 ms, standard deviation 5.4 ms
    assert abs(delay.seconds) < 0.01


def test_with_the_offset_step_left_in_it_says_that_it_does_not_know() -> None:
    delay = found(((16.8, 61.5),))
    assert not delay.determined
    assert "steps of the offset" in delay.message
