"""A drafted job file says what the log shows, asks what it does not, and runs as it stands."""

from __future__ import annotations

import tomllib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner

from ftcal.cli import main
from ftcal.config import read_job
from ftcal.contact import ContactSchedule, Interval
from ftcal.job_draft import draft
from ftcal.recording import Recording, Signal
from ftcal.timeline import Phase
from real import DATA, needs_genova02
from small_world import write_world
from walker import walker

NOTHING = np.zeros((2, 6))
STAMPS = np.array([0, 100_000_000_000])


def recording(*channels: str, values: np.ndarray = NOTHING) -> Recording:
    signals = tuple(Signal(name, tuple("abcdef"), STAMPS, values) for name in channels)
    return Recording("take", "take", 0, (), signals)


def written(text: str, folder: Path) -> Path:
    file = folder / "job.toml"
    file.write_text(text)
    return file


def ask(*words: str | Path) -> str:
    result = CliRunner().invoke(main, ["inspect", *map(str, words), "--init"])
    assert result.exit_code == 0, result.output
    return result.stdout


def test_a_drafted_job_runs_as_it_stands(tmp_path: Path) -> None:
    described = read_job(write_world(tmp_path))
    log = described.path(described.recordings[0].log)
    text = ask(log, "--robot", tmp_path / "arm.urdf", "--contact", "base")
    job = written(text, tmp_path)
    found = read_job(job)
    assert found.recordings[0].contact == "base"
    # the one question that the file cannot be without an answer to: which sensor is it
    answered = text.replace('name = ""', 'name = "ft_sensor"')
    # raw channels want their matrix
    answered = answered.replace("matrix.csv", str(described.sensors[0].workbench))
    answered = answered.replace(
        "# ? full_scale = [fx, fy, fz, tx, ty, tz]", "full_scale = [1587, 1823, 2113, 37, 38, 24]"
    )
    job.write_text(answered)
    result = CliRunner().invoke(main, ["calibrate", str(job), "-o", str(tmp_path / "out")])
    assert result.exit_code in {0, 3}, result.output
    assert (tmp_path / "out" / "calibration.json").exists()


def test_sensors_are_matched_by_the_place_in_their_names() -> None:
    log = recording("left_foot/analog:o", "tool/analog:o")
    text = draft(log, Path("take"), walker(), Path("walker.urdf"), None, {})
    job = tomllib.loads(text)
    assert [(s["name"], s["signal"]) for s in job["sensors"]] == [
        ("l_foot_ft_sensor", "left_foot/analog:o")
    ]
    assert "# not matched: tool/analog:o" in text


def test_who_stood_becomes_contacts_and_their_ends_are_held_out() -> None:
    spans = ContactSchedule(
        (Interval(0.001, 10.0, "l_sole", ("r_sole",)), Interval(10.011, 50.019, "l_sole"))
    )
    log = recording("left_foot/analog:o", "right_foot/analog:o")
    job = tomllib.loads(draft(log, Path("take"), walker(), None, spans, {}))
    (take,) = job["recordings"]
    assert take["contacts"] == [
        {"start": 0.01, "stop": 10.0, "link": ["l_sole", "r_sole"]},
        {"start": 10.02, "stop": 50.01, "link": "l_sole"},
    ]
    assert take["train"] == [[0.01, 10.0], [10.02, 40.01]]
    assert take["test"] == [[40.01, 50.01]]
    assert job["fit"] == {"scope": "whole body"}


def test_what_only_a_person_knows_is_asked() -> None:
    text = draft(recording("a", "b"), Path("my log"), None, None, None, {"time": 'a "stamp"'})
    job = tomllib.loads(text)
    assert job["recordings"][0]["time"] == 'a "stamp"'
    assert job["recordings"][0]["contact"] == "base_link"
    asked = [line for line in text.splitlines()[2:] if "# ?" in line]
    # the robot, its contact; of each sensor name, matrix and full scale
    assert len(asked) == 2 + 2 * 3


def test_raw_counts_want_their_matrix() -> None:
    counts = np.array([[20000.0, -31000, 5, 4, 3, 2], [20001, -31010, 5, 4, 3, 2]])
    (sensor,) = tomllib.loads(
        draft(recording("a", values=counts), Path("a"), None, None, None, {})
    )["sensors"]
    assert sensor["logged"] == "channels"
    assert sensor["workbench"] == "matrix.csv"


@needs_genova02
def test_a_real_log_is_drafted_with_contacts_and_full_scales() -> None:
    home = DATA / "icub-genova02"
    log = home / "left_leg_support"
    text = ask(log, "--robot", home / "iCubGenova02.urdf", "--feet", "l_sole", "r_sole")
    job = tomllib.loads(text)
    assert [s["name"] for s in job["sensors"]] == [
        f"{side}_{place}_ft_sensor" for place in ("arm", "leg", "foot") for side in "lr"
    ]
    assert job["sensors"][3]["full_scale"] == [1587, 1823, 2113, 37, 38, 24]
    support = job["recordings"][0]["contacts"][2]
    assert support["link"] == "l_sole"


FEET = ("--feet", "base", "wrist_link")


def standing(folder: Path, monkeypatch: pytest.MonkeyPatch, *phases: Phase) -> list[str | Path]:
    """Write a log in which the feet stood as `phases` say; return what asks for a look at it."""
    write_world(folder)
    shown = SimpleNamespace(phases=phases)
    monkeypatch.setattr("ftcal.inspection.propose_timeline", lambda *_, **__: shown)
    return [folder / "one.csv", "--robot", folder / "arm.urdf", *FEET]


def test_a_look_at_the_feet_proposes_the_contacts_of_the_draft(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = standing(
        tmp_path,
        monkeypatch,
        Phase(0.0, 10.0, "double", ("base", "wrist_link")),
        Phase(10.0, 20.004, "support", ("base",)),
        Phase(20.004, 21.0, "brushing", ("base", "wrist_link")),
        Phase(21.0, 40.0, "unknown", ()),
    )
    seen = CliRunner().invoke(main, ["inspect", *map(str, words)])
    told = tomllib.loads(seen.stdout.partition("job file:")[2])
    (drafted,) = tomllib.loads(ask(*words))["recordings"]
    assert told == {"contacts": drafted["contacts"]}
    assert told["contacts"] == [
        {"start": 0.0, "stop": 10.0, "link": ["base", "wrist_link"]},
        {"start": 10.0, "stop": 20.0, "link": "base"},
        {"start": 20.01, "stop": 21.0, "link": ["base", "wrist_link"]},
    ]


def test_feet_that_show_nothing_leave_the_contact_to_a_person(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = standing(tmp_path, monkeypatch, Phase(0.0, 40.0, "unknown", ()))
    text = ask(*words)
    (take,) = tomllib.loads(text)["recordings"]
    assert take["contact"] == "base"
    assert 'contact = "base"  # ? link that touches the world' in text
    seen = CliRunner().invoke(main, ["inspect", *map(str, words)])
    assert "proposed" not in seen.stdout


def test_init_prints_a_job_file_alone(tmp_path: Path) -> None:
    write_world(tmp_path)
    result = CliRunner().invoke(main, ["inspect", str(tmp_path), "--init", "--json"])
    assert result.exit_code == 2
    assert "--init prints a job file alone" in result.stderr


@pytest.mark.parametrize("name", ["a.b", 'quote"d', "grün"])
def test_any_name_is_a_toml_string(name: str) -> None:
    text = draft(recording(name), Path(name), None, None, None, {})
    assert tomllib.loads(text)["sensors"][0]["signal"] == name
