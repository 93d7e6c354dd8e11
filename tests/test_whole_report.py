"""The page, the figures and the terminal's tables of a fit of all sensors."""

from __future__ import annotations

import html as html_text
import json
import re
from dataclasses import replace
from functools import cache
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

import golden
from ftcal import report
from ftcal.calibration import Calibration, Input, Provenance
from ftcal.config import Job
from ftcal.errors import OutputError, SensorError
from ftcal.judging import loose_scales
from ftcal.plots.whole_body import Node, places, sub_model_graph
from ftcal.recording import Finding
from ftcal.report.whole_metrics import nodes as sub_models
from ftcal.sensor import AXES
from ftcal.verdict import Verdict
from ftcal.whole_pipeline import WholeOutcome, result_record, weighings_of
from ftcal.whole_tables import print_whole
from test_report import HOSTILE, Elements, drawn, strings, without_plotly
from test_whole_body import World, fitted, job, world
from walker import SENSORS, WEIGHT, walker

WINDOWS = {"train": [[1, 15], [16, 22], [31, 45]], "test": [[23, 30]]}
NOISE = 2e-4
"""Fractions of full scale: enough that rounding decides no verdict."""


@cache
def an_outcome(
    name: str = "", *, sensors: tuple[str, ...] = SENSORS, chosen: bool = False
) -> WholeOutcome:
    """Return what a job on the planted walker gives; `name` is part of every name in its log.

    With `chosen`, the strength of the prior is chosen by holding out stretches.
    """
    one = world(noise=NOISE)
    label = f"take{name}"
    kept = [channel for channel in one.channels if channel.sensor in sensors]
    channels = [
        replace(c, signal=f"{c.signal}{name}", workbench=replace(c.workbench, name=f"SN{name}"))
        for c in kept
    ]
    signals = tuple(replace(s, name=f"{s.name}{name}") for s in one.recording.channels)
    recording = replace(one.recording, name=label, channels=signals)
    fields = {**WINDOWS, "name": label}
    described = job(
        [fields],
        sensors=[{"name": c.sensor, "signal": c.signal} for c in channels],
        fit={"scope": "whole body"} | ({} if chosen else {"kappa": 0.05}),
    )
    fit = fitted(described, [recording], channels)
    robot = replace(walker(), name=f"walker{name}")
    findings = (
        (label, Finding("frozen", channels[0].signal, 10.5, 11.0, True, f"frozen {name}")),
        (label, Finding("serial", channels[0].signal, 0.0, 45.0, False, f"lattice of {name}")),
    )
    made = Provenance(
        ftcal="0",
        python="3",
        numpy="2",
        created="2016-03-01T12:00:00+00:00",
        inputs=[Input(role="recording", path=f"logs/{label}", sha256="ab" * 32)],
    )
    records = [result_record(described, fit, sensor, findings) for sensor in fit.sensors]
    return WholeOutcome(
        described,
        robot,
        (recording,),
        findings,
        fit,
        tuple(weighings_of(described, robot, channels, fit)),
        Calibration(robot=robot.name, sensors=records, provenance=made),
    )


def planted() -> World:
    return world(noise=NOISE)


@pytest.fixture(scope="module")
def page() -> str:
    return report.whole_html(an_outcome(chosen=True), planted().gain)


def in_words(text: str) -> str:
    """Return text with every number as #: their last digits are those of the machine."""
    return re.sub(r"[−+-]?\d+(?:[.,]\d+)*(?:e[+-]?\d+)?", "#", text)


def test_page_says_what_it_said(page: str) -> None:
    golden.check("whole.txt", in_words(Elements(page).lines))


def test_verdicts_come_first_then_the_robot_then_a_section_for_each_sensor(page: str) -> None:
    names = ("verdict", "robot", *(f"sensor-{k}" for k in range(1, 5)), "health")
    at = [page.index(f'id="{name}"') for name in names]
    assert at == sorted(at)
    assert page.index('id="verdict"') < page.index('class="plot"')
    assert len(re.findall(r'<article class="card', page)) == len(SENSORS)


def test_page_opens_with_all_sub_models_together(page: str) -> None:
    lines = Elements(page).lines.splitlines()
    at = next(n for n, line in enumerate(lines) if line.startswith("Use the new matrices of all"))
    assert "used together or not at all" in lines[at]
    for score in map(an_outcome(chosen=True).fit.together.by_name.__getitem__, ("force", "torque")):
        low, high = score.interval
        assert f"{score.percent:.1f} % of the Workbench's {score.name} (90 %" in lines[at + 1]
        assert f"interval {low:.1f}–{high:.1f} %" in lines[at + 1]
    # before the first sensor
    assert lines[at + 2].endswith(f"{SENSORS[0]}: use the new matrix on every axis.")


def refused() -> WholeOutcome:
    """Return an outcome in which all sub-models together are not shown to be better."""
    outcome = an_outcome()
    sensors = tuple(
        replace(
            sensor,
            verdicts=tuple(Verdict(axis, "REFUSE", "not shown to be better") for axis in AXES),
        )
        for sensor in outcome.fit.sensors
    )
    return replace(outcome, fit=replace(outcome.fit, sensors=sensors))


def test_matrices_that_are_not_better_together_are_all_kept_from_use() -> None:
    outcome = refused()
    assert "Keep the Workbench matrices of all sensors" in report.whole_html(outcome)
    into = StringIO()
    print_whole(Console(file=into, width=100), outcome)
    assert "All sensors: keep the Workbench matrices, together or not at all" in into.getvalue()
    assert not report.whole_metrics(outcome)["improved"]


def test_a_scale_of_torques_that_rests_on_the_prior_is_not_held_against_forces() -> None:
    outcome = an_outcome()
    (foot,) = (s for s in outcome.fit.sensors if s.sensor.name == "l_foot_ft_sensor")
    assert loose_scales(outcome.fit.posterior, foot.sensor.name) == ["the scale of its torques"]
    for verdict in foot.verdicts[:3]:
        assert "scale of its torques" not in verdict.reason


def test_every_figure_has_a_place_and_its_caption_names_the_recording(page: str) -> None:
    found = re.findall(r'<div class="plot" id="([^"]+)"', page)
    captions = re.findall(r"<figcaption>(.*?)</figcaption>", page)
    assert sorted(found) == sorted(drawn(page))
    # graph and prior; residuals in time, their spread, share and truth of each sensor; health
    assert len(found) == len(captions) == 2 + 4 * len(SENSORS) + 1
    assert all("take" in caption for caption in captions)


def test_page_loads_nothing(page: str) -> None:
    bare = without_plotly(page)
    for forbidden in ("http://", "https://", "@import", "url("):
        assert forbidden not in bare
    for tag, attributes in Elements(bare).found:
        assert tag not in ("link", "img", "iframe", "object", "base")
        assert "src" not in attributes
        assert (attributes.get("href") or "#").startswith("#")


def test_names_from_a_log_stay_text() -> None:
    text = report.whole_html(an_outcome(HOSTILE))
    elements = Elements(text)
    assert [tag for tag, _ in elements.found].count("script") == 3
    assert not [tag for tag, _ in elements.found if tag == "img"]
    assert not [a for _, attributes in elements.found for a in attributes if a.startswith("on")]
    assert HOSTILE in html_text.unescape("".join(elements.text))
    shown = strings(drawn(text))
    assert not [one for one in shown if "<img" in one or "</script" in one]


def test_graph_says_what_every_sub_model_gave() -> None:
    nodes = {node.name: node for node in sub_models(an_outcome())}
    assert set(nodes) == {"trunk", "l_thigh", "r_thigh", "l_foot", "r_foot"}
    assert nodes["trunk"].parent is None
    assert (nodes["r_foot"].parent, nodes["r_foot"].sensor) == ("r_thigh", "r_foot_ft_sensor")
    assert {node.equations for node in nodes.values()} == {6}
    assert sum(node.mass for node in nodes.values()) == pytest.approx(WEIGHT)


def test_sub_models_are_drawn_below_their_parents_and_apart() -> None:
    nodes = [
        Node("a", 1.0, 6, 10, None, None),
        Node("b", 1.0, 3, 10, "a", "s"),
        Node("c", 1.0, 0, 0, "a", "t"),
        Node("d", 1.0, 6, 10, "c", "u"),
    ]
    at = places(nodes)
    assert len(set(at.values())) == 4
    assert at["b"][1] == at["c"][1] < at["a"][1]
    assert at["d"][1] < at["c"][1]
    figure = sub_model_graph("robot", nodes)
    # one drawing of edges and one a kind of node, told apart by colour and marker
    names = [trace["name"] for trace in figure["data"][1:]]
    assert names == ["six equations", "three, by its mass", "none"]
    assert len({trace["marker"]["symbol"] for trace in figure["data"][1:]}) == 3


def test_a_sensor_in_no_balance_is_named() -> None:
    outcome = an_outcome()
    asked = Job.model_validate(
        {
            **outcome.job.model_dump(),
            "sensors": [
                *outcome.job.model_dump()["sensors"],
                {"name": "l_sole_joint", "signal": "more/analog:o"},
            ],
        }
    )
    found = report.whole_metrics(replace(outcome, job=asked))
    assert found["undetermined"] == ["l_sole_joint"]
    text = Elements(report.whole_html(replace(outcome, job=asked))).lines
    assert "No balance that was trained on contains" in text


def test_metrics_are_plain_json_and_agree_with_the_fit() -> None:
    outcome = an_outcome(chosen=True)
    found = report.whole_metrics(outcome, planted().gain)
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    assert found["prior"]["kappa"] == outcome.fit.posterior.kappa
    for kind in ("force", "torque"):
        score = outcome.fit.together.by_name[kind]
        assert found["together"]["scores"][kind]["percent"] == score.percent
        assert found["together"]["scores"][kind]["interval"] == list(score.interval)
    assert set(found["sensors"]) == set(SENSORS)
    assert len(found["residuals"]) == len(outcome.fit.residuals)
    touching = {(one["start"] > 15.5, one["start"] > 30.5): one["touching"]
                for one in found["residuals"]}  # fmt: skip
    assert touching == {
        (False, False): ["trunk"],
        (True, False): ["l_sole"],
        (True, True): ["r_sole"],
    }
    for result in outcome.fit.sensors:
        mine = found["sensors"][result.sensor.name]
        assert mine["scale"] == result.scores.by_name["force"].amplitude
        assert mine["loose_scales"] == loose_scales(outcome.fit.posterior, result.sensor.name)
        for direction, rows in mine["on_the_prior"].items():
            assert all(mine["share"][axis][direction] < 0.5 for axis in rows)


def test_truth_is_compared_in_fractions_of_full_scale() -> None:
    outcome = an_outcome()
    found = report.whole_metrics(outcome, planted().gain)
    for name in SENSORS:
        truth = found["sensors"][name]["truth"]
        # bent by 2 % of full scale
        assert truth["workbench_rms"] == pytest.approx(0.02, rel=0.3)
        assert np.array(truth["estimate"]) == pytest.approx(outcome.fit.posterior.entries(name))
    assert "truth" not in report.whole_metrics(outcome)["sensors"][SENSORS[0]]


def test_truth_of_another_shape_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    with pytest.raises(SensorError, match="truth of sensor 'r_leg_ft_sensor' has shape"):
        report.write_whole(an_outcome(), tmp_path / "out", {"r_leg_ft_sensor": np.eye(5)})
    assert not (tmp_path / "out").exists()


def test_all_three_files_are_written(tmp_path: Path) -> None:
    outcome = an_outcome()
    path = report.write_whole(outcome, tmp_path / "out")
    assert path == tmp_path / "out" / "report.html"
    assert {file.name for file in path.parent.iterdir()} == {
        "report.html",
        "metrics.json",
        "calibration.json",
    }
    metrics = json.loads(path.with_name("metrics.json").read_text())
    assert metrics == report.whole_metrics(outcome)


def test_folder_that_is_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("")
    with pytest.raises(OutputError, match="cannot be written"):
        report.write_whole(an_outcome(), tmp_path / "out")


@pytest.mark.parametrize("name", ["", "[bold]"])
def test_terminal_shows_verdicts_leftovers_and_mass_in_100_columns(name: str) -> None:
    outcome = an_outcome(name)
    into = StringIO()
    print_whole(Console(file=into, width=100), outcome)
    text = into.getvalue()
    assert max(map(len, text.splitlines())) <= 100
    together = f"force {outcome.fit.together.by_name['force'].percent:.1f} % ["
    assert text.startswith("All sensors: use the new matrices, together or not at all\n")
    for word in (together, *SENSORS, "Left over where nothing touches", "held out", f"take{name}"):
        assert word in text
    read = [f"{one.whole_body:.2f} kg" for one in outcome.weighings]
    assert read
    assert all(mass in text for mass in read)
