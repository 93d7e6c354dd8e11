"""The commands as a person meets them: help, tables of 100 columns, exit codes, JSON."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from ftcal.cli import main
from ftcal.cli.frame import NOT_BETTER
from golden import check
from real import GENOVA02, needs_genova02
from small_world import robot_text, write_world

COMMANDS = ["inspect", "calibrate", "study", "validate", "apply", "payload", "simulate", "demo"]


def run(*words: str | Path) -> Result:
    return CliRunner().invoke(main, [str(word) for word in words], prog_name="ftcal")


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("world")
    write_world(folder)
    assert run("calibrate", folder / "job.toml").exit_code == 0
    return folder


def test_help_texts_are_the_pinned_ones() -> None:
    texts = [run("--help").output, *(run(command, "--help").output for command in COMMANDS)]
    check("help.txt", "\n".join(texts))


def test_help_loads_no_heavy_library() -> None:
    code = (
        "import sys; from ftcal.cli import main\n"
        "try: main(['calibrate', '--help'])\n"
        "except SystemExit: pass\n"
        "heavy = {'numpy', 'pyarrow', 'plotly', 'pydantic', 'rich'} & set(sys.modules)\n"
        "sys.exit(f'loaded: {heavy}' if heavy else 0)"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr


def test_inspect_shows_signals_and_what_the_robot_knows(world: Path) -> None:
    result = run("inspect", world / "one.csv", "--robot", world / "arm.urdf")
    assert result.exit_code == 0
    check("inspect.txt", result.stdout.replace(str(world), "WORLD"))
    assert all(len(line) <= 100 for line in result.stdout.splitlines())


def test_inspect_for_machines_is_json(world: Path) -> None:
    result = run("inspect", world / "one.csv", "--robot", world / "arm.urdf", "--json")
    record = json.loads(result.stdout)
    assert [signal["name"] for signal in record["signals"]] == ["one", "ft"]
    assert record["robot"]["joints_missing"] == []
    assert record["signals"][1]["samples"] == 4000


def test_calibrate_prints_verdicts_and_where_the_report_is(world: Path, tmp_path: Path) -> None:
    result = run("calibrate", world / "job.toml", "-o", tmp_path / "out")
    assert result.exit_code == 0
    text = result.stdout.replace(str(tmp_path), "OUT")
    # the last digits of an error differ between processors: pin the words, not the numbers
    check("calibrate.txt", re.sub(r"[ ─]*\d[\d.e+-]*", " #", text))
    assert all(len(line) <= 100 for line in result.stdout.splitlines() if "OUT" not in line)
    assert (tmp_path / "out" / "report.html").is_file()


def test_calibrate_for_machines_is_the_metrics_file(world: Path, tmp_path: Path) -> None:
    result = run("calibrate", world / "job.toml", "-o", tmp_path, "--json")
    assert json.loads(result.stdout) == json.loads((tmp_path / "metrics.json").read_text())


def test_validate_scores_a_finished_calibration(world: Path) -> None:
    result = run("validate", world / "ftcal-out" / "calibration.json", world / "job.toml", "--json")
    assert result.exit_code == 0
    scores = json.loads(result.stdout)["ft_sensor"]
    assert all(scores["scores"][axis]["percent"] < 100 for axis in ("fx", "tz", "force"))


def test_a_sensor_that_was_right_all_along_ends_with_three(world: Path, tmp_path: Path) -> None:
    """With the truth as Workbench nothing can be better: done, but keep the Workbench."""
    import shutil

    import numpy as np

    from small_world import truth

    shutil.copytree(world, tmp_path / "right")
    np.savetxt(tmp_path / "right" / "workbench.csv", truth(), delimiter=",")
    result = run("calibrate", tmp_path / "right" / "job.toml")
    assert result.exit_code == NOT_BETTER
    assert "keep the Workbench matrix on every axis" in result.stdout


def test_validate_and_apply_refuse_what_is_no_calibration(world: Path) -> None:
    robot, job, log = world / "arm.urdf", world / "job.toml", world / "one.csv"
    for result in (run("validate", robot, job), run("apply", robot, log, "-o", world / "out.csv")):
        assert result.exit_code == 1
        assert "not a calibration" in result.stderr


def test_a_wrong_option_is_a_usage_error() -> None:
    assert run("calibrate").exit_code == 2
    assert run("calibrate", "job.toml", "--kapa", "1").exit_code == 2


def test_markup_in_a_name_is_printed_as_text(world: Path, tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(
        robot_text().replace('name="ft_sensor"', 'name="[red]ft[/red]"')
    )
    result = run("inspect", world / "one.csv", "--robot", tmp_path / "arm.urdf")
    assert "[red]ft[/red]" in result.stdout


def test_demo_shows_truth_beside_estimate(tmp_path: Path) -> None:
    pytest.importorskip("icub_models")
    result = run("demo", "-o", tmp_path / "demo", "--seed", "3")
    assert result.exit_code == 0, result.stderr
    assert "within three standard errors" in result.stdout
    assert "Truth beside estimate" in (tmp_path / "demo" / "report.html").read_text()
    again = run("demo", "-o", tmp_path / "again", "--seed", "3")
    assert again.stdout.splitlines()[:-2] == result.stdout.splitlines()[:-2]


@needs_genova02
def test_inspect_proposes_the_contacts_of_a_job(tmp_path: Path) -> None:
    log, robot = GENOVA02 / "left_leg_support", GENOVA02 / "iCubGenova02.urdf"
    feet = ("--zero", "right_leg/analog:o", "--feet", "l_sole", "r_sole")
    plot = tmp_path / "contacts.html"
    result = run("inspect", log, "--robot", robot, *feet, "--plot", plot)
    assert result.exit_code == 0, result.stderr
    contacts = tomllib.loads(result.stdout.partition("job file:")[2])["contacts"]
    (contact,) = (one for one in contacts if one["link"] == "l_sole")
    # the job's windows by hand lie inside
    assert contact["start"] < 16.8
    assert contact["stop"] > 61.5
    assert "Contacts proposed" in plot.read_text()
    record = json.loads(run("inspect", log, "--robot", robot, *feet, "--json").stdout)
    assert "support" in {phase["kind"] for phase in record["phases"]}


def test_what_is_cut_is_told_once(world: Path, tmp_path: Path) -> None:
    lines = (world / "one.csv").read_text().splitlines()
    for first, last in ((1000, 1080), (2000, 2090)):
        held = lines[first].split(",")[4:]
        for row in range(first, last):
            lines[row] = ",".join([*lines[row].split(",")[:4], *held])
    (tmp_path / "held.csv").write_text("\n".join(lines) + "\n")
    text = run("inspect", tmp_path / "held.csv").stdout
    assert max(map(len, text.splitlines())) <= 100
    assert text.count("frozen") == 1
    assert (
        "cut held ft: 170 of 4000 samples frozen (4.2 %) in 2 stretches, longest 0.89 s: all"
        " channels repeat exactly; between 9.99 and 20.88 s"
    ) in " ".join(text.split())


def test_feet_without_a_robot_are_a_usage_error(world: Path) -> None:
    assert run("inspect", world / "one.csv", "--feet", "a", "b").exit_code == 2
    assert run("inspect", world / "one.csv", "--plot", "x.html").exit_code == 2


@needs_genova02
@pytest.mark.no_cover
def test_inspect_tells_delays_and_steps_of_offsets() -> None:
    log, robot = GENOVA02 / "left_leg_support", GENOVA02 / "iCubGenova02.urdf"
    words = ("inspect", log, "--robot", robot, "--zero", "right_leg/analog:o")
    asked = ("--feet", "l_sole", "r_sole", "--diagnose")
    told = run(*words, *asked)
    assert told.exit_code == 0, told.stderr
    assert "as described: nothing in the log speaks against" in told.stdout
    assert "  breaks = { r_leg_ft_sensor = [" in told.stdout
    record = json.loads(run(*words, *asked, "--json").stdout)
    assert record["diagnosis"]["word"] == "as described"
    assert {"seconds", "sd", "determined", "message"} == set(record["delays"][0])
    # a cover touched the sensor at 22.4 s and let go at 58.7 s (README of the data)
    first, second = (step["time"] for step in record["steps"]["r_leg_ft_sensor"])
    assert abs(first - 22.4) < 1.0
    assert abs(second - 58.7) < 1.0
