"""Everything a user can get wrong: one line with culprit and remedy, exit 1, nothing written."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from ftcal.cli import main
from ftcal.firmware import encode
from small_world import PRIOR, robot_text, take, write_log, write_world

FIRMWARE = encode(PRIOR.gain, np.ceil(32767 * np.abs(PRIOR.gain).sum(axis=1)))


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("world")
    write_world(folder)
    return folder


@pytest.fixture
def world(good: Path, tmp_path: Path) -> Path:
    shutil.copytree(good, tmp_path / "world")
    return tmp_path / "world"


def edit(file: str, old: str, new: str) -> Callable[[Path], None]:
    def change(world: Path) -> None:
        text = (world / file).read_text()
        assert old in text
        (world / file).write_text(text.replace(old, new))

    return change


def write(file: str, text: str) -> Callable[[Path], None]:
    def change(world: Path) -> None:
        (world / file).write_text(text)

    return change


def log(change: Callable[[np.ndarray, np.ndarray, np.ndarray], object]) -> Callable[[Path], None]:
    """Change the arrays of the first log in place."""

    def rewrite(world: Path) -> None:
        time, joints, channels = take(1)
        change(time, joints, channels)
        write_log(world / "one.csv", time, joints, channels)

    return rewrite


def short(world: Path) -> None:
    write_log(world / "one.csv", *(part[:60] for part in take(1)))


def firmware_with(text: str) -> Callable[[Path], None]:
    def change(world: Path) -> None:
        (world / "matrix_SN001.txt").write_text(text)
        edit("job.toml", '"workbench.csv"', '"matrix_SN001.txt"')(world)

    return change


def singular(world: Path) -> None:
    np.savetxt(world / "workbench.csv", np.outer(np.arange(1.0, 7), np.ones(6)), delimiter=",")


CASES: dict[str, tuple[Callable[[Path], None], list[str]]] = {
    "missing log": (lambda w: (w / "one.csv").unlink(), ["no log at one.csv", "relative"]),
    "unknown sensor": (
        edit("job.toml", '"ft_sensor"', '"ft_sensr"'),
        ["no F/T sensor 'ft_sensr'", "did you mean ft_sensor"],
    ),
    "unknown signal": (
        edit("job.toml", 'signal = "ft"', 'signal = "tf"'),
        ["no F/T signal", "'tf'", "ft?"],
    ),
    "unknown contact": (
        edit("job.toml", 'log = "one.csv"\ncontact = "base"', 'log = "one.csv"\ncontact = "bse"'),
        ["no link 'bse'", "did you mean base"],
    ),
    "unlogged joint": (
        edit("one.csv", "elbow", "ellbow"),
        ["joints not logged but needed: elbow", "ellbow"],
    ),
    "not XML": (write("arm.urdf", "robot:\n  links: []\n"), ["arm.urdf", "XML"]),
    "entity bomb": (
        write(
            "arm.urdf",
            '<!DOCTYPE r [<!ENTITY a "aa"><!ENTITY b "&a;&a;">]><robot name="x">&b;</robot>',
        ),
        ["arm.urdf"],
    ),
    "massless half": (write("arm.urdf", robot_text(mass=0)), ["has no mass", "ft_sensor"]),
    "negative mass": (
        write("arm.urdf", robot_text(mass=-1)),
        ["mass of link 'shoulder_link' is -1", "mass of link 'wrist_link'"],
    ),
    "mass not a number": (write("arm.urdf", robot_text(mass="nan")), ["shoulder_link", "nan"]),
    "inertia not finite": (
        edit("arm.urdf", 'ixx="0.1"', 'ixx="inf"'),
        ["inertia of link 'shoulder_link'", "finite"],
    ),
    "NaN in channels": (
        log(lambda t, q, r: r.__setitem__((70, 2), np.nan)),
        ["one.csv", "ft/fz"],
    ),
    "time runs back": (
        log(lambda t, q, r: t.__setitem__(slice(500, None), t[500:] - 2.0)),
        ["one.csv", "back"],
    ),
    "log shorter than the filter": (short, ["one", "0.81 s"]),
    "all samples frozen": (
        log(lambda t, q, r: r.__setitem__(slice(None), r[0])),
        ["all 4000 samples of 'ft' are cut", "frozen"],
    ),
    "contact on both halves": (
        edit(
            "job.toml",
            'log = "one.csv"\ncontact = "base"',
            'log = "one.csv"\ncontact = ["base", "wrist_link"]',
        ),
        ["both halves at sensor 'ft_sensor'", "base", "wrist_link"],
    ),
    "35 words": (
        firmware_with("\n".join(FIRMWARE.split()[1:])),
        ["matrix_SN001.txt", "35"],
    ),
    "misspelt key": (edit("job.toml", "contact =", "contakt ="), ["'contact'", "contakt"]),
    "wrong unit": (
        edit("job.toml", 'log = "one.csv"', 'log = "one.csv"\nangle = "radians"'),
        ["angle = 'radians'", "'deg' or 'rad'"],
    ),
    "singular Workbench": (singular, ["'workbench' is singular", "condition"]),
    "no full scale": (
        edit("job.toml", "full_scale", "# full_scale"),
        ["has no full scale", "full_scale = "],
    ),
    "nothing to train on": (
        edit("job.toml", 'log = "one.csv"', 'log = "one.csv"\ntrain = [[900, 950]]'),
        ["no usable sample in any training window"],
    ),
    "nothing to test on": (
        edit("job.toml", "test = [[0, 40]]", "test = [[900, 950]]"),
        ["no usable sample in any test window"],
    ),
    "empty log": (write("one.csv", ""), ["one.csv"]),
}


@pytest.mark.parametrize("case", CASES)
def test_bad_input_is_one_line_and_writes_nothing(world: Path, case: str) -> None:
    change, words = CASES[case]
    change(world)
    before = sorted(world.rglob("*"))
    result = CliRunner().invoke(main, ["calibrate", str(world / "job.toml")])
    assert result.exit_code == 1, result.output
    assert result.stdout == ""
    (line,) = result.stderr.splitlines()
    assert line.startswith("ftcal: ")
    missing = [word for word in words if word not in line]
    assert not missing, line
    assert sorted(world.rglob("*")) == before


def test_an_output_that_cannot_be_written_is_named(world: Path) -> None:
    (world / "out").write_text("a file where the folder should be")
    result = CliRunner().invoke(
        main, ["calibrate", str(world / "job.toml"), "-o", str(world / "out")]
    )
    assert result.exit_code == 1
    assert "cannot be written" in result.stderr
    assert (world / "out").read_text() == "a file where the folder should be"


def test_the_good_world_needs_no_mending(world: Path) -> None:
    result = CliRunner().invoke(main, ["calibrate", str(world / "job.toml")])
    assert result.exit_code == 0, result.output + result.stderr
    assert {p.name for p in (world / "ftcal-out").iterdir()} == {
        "calibration.json",
        "metrics.json",
        "report.html",
    }
