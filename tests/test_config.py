"""The job file: what a person may write, and one line for everything wrong with it."""

from __future__ import annotations

from pathlib import Path

import pytest

from ftcal.config import Job, read_job
from ftcal.errors import JobError

GOOD = """
robot = "robot.urdf"
[[sensors]]
name = "r_leg_ft_sensor"
signal = "right_leg/analog:o"
workbench = "matrix_SN026.txt"
[[recordings]]
log = "take"
contact = "l_sole"
"""


def job(folder: Path, text: str) -> Job:
    file = folder / "job.toml"
    file.write_text(text)
    return read_job(file)


def test_ten_lines_are_enough(tmp_path: Path) -> None:
    read = job(tmp_path, GOOD)
    assert read.path(read.robot) == tmp_path / "robot.urdf"
    assert read.fit.options().kappa is None
    (recording,) = read.recordings
    assert recording.label == "take"
    assert recording.train is None
    assert recording.schedule().intervals[0].link == "l_sole"


def test_lambda_is_the_papers_penalty(tmp_path: Path) -> None:
    assert job(tmp_path, GOOD + "[fit]\nlambda = 10\n").fit.options().penalty == 10.0


def test_kappa_may_be_left_to_cross_validation_by_name(tmp_path: Path) -> None:
    assert job(tmp_path, GOOD + '[fit]\nkappa = "auto"\n').fit.options().kappa is None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("contact =", "contcat ="), ["unknown key 'recordings.0.contcat'", "'contact'"]),
        (("robot =", "robto ="), ["unknown key 'robto'", "'robot'", "'robot' is missing"]),
        (('"l_sole"', '"l_sole"\nangle = "degrees"'), ["angle = 'degrees'", "'deg' or 'rad'"]),
        (('"l_sole"', '"l_sole"\ntime_unit = "sec"'), ["time_unit = 'sec'"]),
        (('"l_sole"', '"l_sole"\ngravity = [0, 0, -1]'), ["gravity has length 1", "m/s^2"]),
        (('"l_sole"', '"l_sole"\ntrain = [[5, 2]]'), ["[5, 2] ends before it starts"]),
        (
            ('"l_sole"', '"l_sole"\ntrain = [[1, 5]]\ntest = [[4, 9]]'),
            ["[1, 5] and [4, 9] overlap"],
        ),
        (('contact = "l_sole"', ""), ["give either contact = LINK or contacts"]),
        (('"take"', "7"), ["recordings.0.log = 7"]),
        (("[[sensors]]", "[[sensors]]\nfull_scale = [1, 2]"), ["sensors.0.full_scale"]),
        (("[[sensors]]", '[[sensors]]\nlogged = "volts"'), ["logged = 'volts'"]),
    ],
)
def test_a_mistake_is_named_with_its_remedy(
    tmp_path: Path, change: tuple[str, str], words: list[str]
) -> None:
    with pytest.raises(JobError) as caught:
        job(tmp_path, GOOD.replace(*change))
    assert all(word in str(caught.value) for word in words), str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("fit", "words"),
    [
        ("kapa = 0.1", "did you mean 'kappa'"),
        ("kappa = -1", "kappa = -1"),
        ("kappa = nan", "kappa"),
        ("lambda = 1\nkappa = 0.1", "kappa or lambda, not both"),
        ("folds = 1", "folds = 1"),
        ("noise = [1, 1, 1, 1, 1, 0]", "noise must be positive"),
        ('offset = "insitu"', "offset = 'insitu'"),
    ],
)
def test_a_mistake_in_the_fit_is_named(tmp_path: Path, fit: str, words: str) -> None:
    with pytest.raises(JobError, match=words):
        job(tmp_path, f"{GOOD}[fit]\n{fit}\n")


def test_all_faults_come_at_once(tmp_path: Path) -> None:
    with pytest.raises(JobError) as caught:
        job(tmp_path, GOOD.replace("signal", "singal") + "[fit]\nkappa = 0\n")
    text = str(caught.value)
    assert "singal" in text
    assert "fit.kappa = 0" in text


def test_text_that_is_no_toml_is_refused(tmp_path: Path) -> None:
    with pytest.raises(JobError, match="not TOML"):
        job(tmp_path, "robot = ")


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(JobError, match=r"absent\.toml: cannot be read"):
        read_job(tmp_path / "absent.toml")


def test_two_recordings_of_one_name_are_refused(tmp_path: Path) -> None:
    twice = GOOD + '[[recordings]]\nlog = "take"\ncontact = "l_sole"\n'
    with pytest.raises(JobError, match="recording 'take' appears twice"):
        job(tmp_path, twice)
