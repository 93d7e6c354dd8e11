from __future__ import annotations

import html as html_text
import json
import re
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import golden
import pretend
import study_pretend
from ftcal import plots, report
from ftcal.balances import Leftover
from ftcal.calibration import Input, Provenance
from ftcal.contact import ContactSchedule, Interval
from ftcal.errors import OutputError, SensorError
from ftcal.report import published, study_page
from ftcal.report.album import Album
from ftcal.report.study_album import unbroken
from ftcal.second_validation import MIXED, WORKBENCH
from ftcal.study import StudyOutcome
from test_report import BROWSER, HOSTILE, PROBE, Elements, drawn, strings, without_plotly

PAPER = "Beside the paper"


@pytest.fixture(scope="module", autouse=True)
def _same_provenance() -> Iterator[None]:
    """No clock and no version in what is compared."""
    inputs = [Input(role="recording", path="logs/walk", sha256="ab" * 32)]
    made = Provenance(
        ftcal="0", python="3", numpy="2", created="2016-03-01T12:00:00+00:00", inputs=inputs
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(study_page, "provenance", lambda *_: made)
        yield


@pytest.fixture(scope="module")
def walk() -> StudyOutcome:
    return study_pretend.an_outcome()


@pytest.fixture(scope="module")
def alone() -> StudyOutcome:
    """The least that is a study: one recording, no run that switches contacts, no truth."""
    return study_pretend.an_outcome(training=("walk",), switching=False, known=False)


@pytest.fixture(scope="module")
def page(walk: StudyOutcome) -> str:
    return report.study_html(walk)


def lines(outcome: StudyOutcome) -> str:
    return Elements(report.study_html(outcome)).lines


def section(text: str, title: str) -> str:
    return text.split(f"\n{title}\n", 1)[1]


def with_unseen(outcome: StudyOutcome, mixed: float) -> StudyOutcome:
    """Return a study whose mixed matrices leave `mixed` N on data not chosen on, of 10 N."""
    studies = []
    for one in outcome.sensors:
        assert one.second is not None
        left = {WORKBENCH: 10.0, "best": 10.0, MIXED: mixed}
        unseen = {name: Leftover(force, 1.0, (1.0,) * 6) for name, force in left.items()}
        studies.append(replace(one, second=replace(one.second, unseen=unseen)))
    return replace(outcome, sensors=tuple(studies))


def test_page_says_what_it_said(page: str) -> None:
    golden.check("study.txt", Elements(page).lines)


def test_answer_comes_before_all_figures(page: str) -> None:
    assert page.index('id="short"') < page.index('id="robot"') < page.index('class="plot"')


def test_every_figure_has_a_place_and_its_caption_names_recordings(page: str) -> None:
    places = re.findall(r'<div class="plot" id="([^"]+)"', page)
    captions = re.findall(r"<figcaption>(.*?)</figcaption>", page)
    assert places == list(drawn(page))
    assert len(captions) == len(places) == 2 * 5
    known = (*study_pretend.TRAINING, study_pretend.RUN)
    assert all(any(name in caption for name in known) for caption in captions)


def test_page_loads_nothing(page: str) -> None:
    bare = without_plotly(page)
    for forbidden in ("http://", "https://", "@import", "url("):
        assert forbidden not in bare
    for tag, attributes in Elements(bare).found:
        assert tag not in ("link", "img", "iframe", "object", "base")
        assert "src" not in attributes
        assert (attributes.get("href") or "#").startswith("#")


def test_names_from_a_log_stay_text() -> None:
    page = report.study_html(study_pretend.an_outcome(HOSTILE, count=400))
    elements = Elements(page)
    assert [tag for tag, _ in elements.found].count("script") == 3
    assert not [tag for tag, _ in elements.found if tag == "img"]
    assert not [a for _, attributes in elements.found for a in attributes if a.startswith("on")]
    assert HOSTILE in html_text.unescape("".join(elements.text))
    # plotly.js reads HTML in titles, names and hover texts
    shown = strings(drawn(page))
    assert not [text for text in shown if "<img" in text or "</script" in text]
    assert any("&lt;img" in text for text in shown)


def test_worse_than_the_workbench_is_marked_without_colour(walk: StudyOutcome) -> None:
    text = lines(walk)
    assert "▲ 103" in text
    (first, *_) = walk.sensors
    worse = (first.first.percent() > 100.0).sum()
    table = section(text, "First validation: every training set on every recording")
    rows = table.split("mean elsewhere", 1)[0]
    # the caption has none, so every triangle is a cell
    assert rows.count("▲") == worse > 0


def test_diagonal_is_boxed(walk: StudyOutcome, page: str) -> None:
    sets = sum(len(one.first.sets) for one in walk.sensors)
    tables = 2 * len(study_page.GROUPS)
    assert page.count('class="n own"') == sets * tables


def test_dropped_and_refused_sets_are_named_with_the_reason(walk: StudyOutcome) -> None:
    text = lines(walk)
    assert "Balancing dropped: 103 % of the Workbench's error" in text
    assert "ExtBal1 (in situ) refused: the centre of mass moves by 30 mm" in text


def test_least_candidate_of_the_second_validation_is_marked(walk: StudyOutcome) -> None:
    second = walk.sensors[0].second
    assert second is not None
    least = min(left.force for left in second.left)
    table = section(lines(walk), "Second validation: what is left over where nothing touches")
    forces = table.split("Mean external torque", 1)[0]
    assert forces.count("▼") == 1 + 1  # the caption explains it
    assert f"▼ {least:.2f}" in forces


def test_mixed_matrix_that_is_not_better_unseen_is_not_recommended(walk: StudyOutcome) -> None:
    better, same = (lines(with_unseen(walk, mixed)) for mixed in (9.9, 10.0))
    assert "Not shown to be better" not in better
    assert same.count("Not shown to be better") == len(walk.sensors)
    assert 'class="card refuse"' in report.study_html(with_unseen(walk, 10.0))
    assert 'class="card refuse"' not in report.study_html(with_unseen(walk, 9.9))


def test_unscored_second_validation_is_dashes(walk: StudyOutcome) -> None:
    second = walk.sensors[0].second
    assert second is not None
    short = replace(walk.sensors[0], second=replace(second, unseen={}))
    text = lines(replace(walk, sensors=(short,)))
    assert re.search(r"\| mixed \| [\d.]+ \| [\d.]+ \| – \| –", text)
    assert "Not shown to be better" not in text


def test_study_without_switching_run_has_the_first_validation_alone(alone: StudyOutcome) -> None:
    text = lines(alone)
    assert "so there is no second validation" in text
    assert "only one recording, nothing to judge training sets on" in text
    assert "Second validation:" not in text
    assert "Distance to the truth" not in text
    made = report.study_metrics(alone)
    json.dumps(made, allow_nan=False)
    sensor = made["sensors"]["r_leg_ft"]
    assert sensor["second_validation"] is None
    assert sensor["truth_distance"] is None
    assert sensor["first_validation"]["percent_elsewhere"]["rms"]["all"] == [None]


def test_eight_channels_have_no_secondary_matrix(walk: StudyOutcome) -> None:
    first, *_ = walk.sensors
    assert first.second is not None
    wide = np.hstack([first.channel.workbench.gain, np.zeros((6, 2))])
    workbench = replace(first.channel.workbench, gain=wide, logged="channels")
    law = replace(first.second.mixed, coefficients=wide)
    study = replace(
        first,
        channel=replace(first.channel, workbench=workbench),
        second=replace(first.second, mixed=law),
    )
    assert study.second is not None
    assert study_page.second_section(study, study.second, walk, Album())["secondary"] is None


def test_json_holds_what_the_records_hold(walk: StudyOutcome) -> None:
    made = json.loads(json.dumps(report.study_metrics(walk), allow_nan=False))
    assert (made["format"], made["version"]) == ("ftcal-study", 1)
    for one in walk.sensors:
        sensor = made["sensors"][one.channel.sensor]
        first, second = sensor["first_validation"], sensor["second_validation"]
        assert one.second is not None
        for norm in ("absolute", "rms"):
            for group, table in first["percent"][norm].items():
                np.testing.assert_array_equal(table, one.first.percent(norm, group))
        assert [c["force"] for c in second["candidates"]] == [x.force for x in one.second.left]
        least = min(second["candidates"], key=lambda c: c["force"])
        assert second["best"] == f"{least['training']}, {least['lambda']:g}"
        np.testing.assert_array_equal(second["laws"][MIXED]["gain"], one.second.mixed.coefficients)
        # S C_w = C, to the rounding of one solve
        np.testing.assert_allclose(
            second["laws"][MIXED]["secondary"] @ one.channel.workbench.gain,
            one.second.mixed.coefficients,
            rtol=1e-9,
            atol=1e-12,
        )
    assert list(made["sub_chains"]["shank"]["left"]) == [WORKBENCH, "best", MIXED, "truth"]


def test_distance_to_the_truth_is_zero_for_the_truth(walk: StudyOutcome) -> None:
    first, *rest = walk.sensors
    known = {first.channel.sensor: first.first.estimates[-1].gain}
    made = report.study_metrics(replace(walk, truth=known))["sensors"]
    distance = made[first.channel.sensor]["truth_distance"]
    assert distance["sets"][first.first.sets[-1].name] == 0.0
    assert distance[WORKBENCH] > 0.01
    assert made[rest[0].channel.sensor]["truth_distance"] is None
    text = lines(replace(walk, truth=known))
    assert text.count("Distance to the truth") == 1
    assert "nearest of all 0 %" in text


def test_truth_of_another_shape_is_refused(walk: StudyOutcome) -> None:
    with pytest.raises(SensorError, match=r"truth of sensor 'r_leg_ft' has shape \(6, 5\)"):
        report.study_metrics(replace(walk, truth={"r_leg_ft": np.zeros((6, 5))}))


def test_paper_stands_beside_the_right_leg_alone(walk: StudyOutcome) -> None:
    text = section(lines(walk), PAPER)
    assert "r_leg_ft" in text
    assert "\nr_foot_ft" not in text
    assert "paper 464.82" in text
    assert "other recordings, of a real robot" in text


def test_paper_is_left_out_where_fewer_than_two_names_match() -> None:
    one = study_pretend.an_outcome(training=("walk", "ext_bal-1"), count=400)
    assert PAPER not in lines(one)
    two = study_pretend.an_outcome(training=("EXT BAL 2", "ext_bal-1"), count=400)
    assert PAPER in lines(two)
    named = report.study_metrics(two)["sensors"]["r_leg_ft"]["named_as_in_the_paper"]
    assert named == {"ExtBal1": "ext_bal-1", "ExtBal2": "EXT BAL 2"}


def test_misprints_of_the_paper_stand_as_printed() -> None:
    study = study_pretend.an_outcome(training=("Balancing", "fastExtBal"), count=400)
    text = lines(study)
    assert "paper 0.4977 †" in text
    assert "† printed so" in text
    assert text.count("†") == 2
    cells = [cell for row in published.PERCENT.values() for cell in row]
    printed = [0.4977, 0.5813, 0.3311, 0.2426]
    assert [cell for cell in cells if cell < published.MISPRINT] == printed


def test_published_tables_are_whole() -> None:
    assert tuple(published.PERCENT) == published.DATA_SETS
    assert {len(row) for row in published.PERCENT.values()} == {len(published.DATA_SETS)}
    assert {len(row) for row in published.FORCE.values()} == {len(published.LAMBDAS)}
    # "around 25 % better than the Workbench", section V-B
    least = min(min(row) for row in published.FORCE.values())
    assert 1.0 - least / published.WORKBENCH_FORCE == pytest.approx(0.25, abs=0.005)


def test_first_fast_set_of_the_paper_has_two_names() -> None:
    assert published.matched(["fast_ext_bal_1"]) == {"fastExtBal": "fast_ext_bal_1"}
    assert published.matched(["fastExtBal1", "fastExtBal"]) == {"fastExtBal": "fastExtBal"}


@pytest.mark.parametrize(
    ("name", "right"),
    [
        ("r_leg_ft_sensor", True),
        ("Right-Leg FT", True),
        ("l_leg_ft", False),
        ("r_foot_ft", False),
        ("lower_leg", False),
    ],
)
def test_right_leg_is_known_by_its_name(name: str, right: bool) -> None:
    assert published.is_right_leg(name) is right


def test_figure_in_space_is_of_a_recording_no_set_trained_on(walk: StudyOutcome) -> None:
    figure = drawn(report.study_html(walk))["figure-2"]
    assert figure["layout"]["title"]["text"].endswith(f": {study_pretend.RUN}")
    names = [trace["name"] for trace in figure["data"]]
    sets = [f"{s.recording}, {s.method}" for s in walk.sensors[0].first.sets]
    assert names == ["model", WORKBENCH, *sets]
    waiting = [t["name"] for t in figure["data"] if t.get("visible") == "legendonly"]
    assert waiting == ["Balancing, centred"]


def test_figure_in_space_keeps_to_the_longest_stretch_without_a_pause() -> None:
    rng = np.random.default_rng(0)
    whole = pretend.samples(pretend.workbench().gain, rng, count=100, seconds=10.0)
    time = whole.time + np.where(whole.time >= 3.0, 60.0, 0.0)
    run = unbroken(replace(whole, time=time))
    np.testing.assert_array_equal(run.time, time[time > 60.0])
    assert len(unbroken(whole)) == len(whole)
    assert len(unbroken(whole.between(0.0, 0.05))) == 1


def test_contacts_are_shaded_inside_the_panels() -> None:
    time = np.linspace(5.0, 20.0, 50)
    schedule = ContactSchedule(
        (
            Interval(-np.inf, 10.0, "left"),
            Interval(12.0, 14.0, "<b>right"),
            Interval(15.0, 25.0, "left"),
            Interval(30.0, np.inf, "late"),
        )
    )
    figure = plots.leftover_in_time("t", time, {WORKBENCH: np.ones((50, 6))}, schedule)
    spans = {(s["x0"], s["x1"]): s["fillcolor"] for s in figure["layout"]["shapes"]}
    assert list(spans) == [(5.0, 10.0), (12.0, 14.0), (15.0, 20.0)]
    assert spans[5.0, 10.0] == spans[15.0, 20.0] != spans[12.0, 14.0]
    keys = [trace["name"] for trace in figure["data"] if trace["name"].startswith("on ")]
    assert keys == ["on left", "on &lt;b&gt;right"]
    json.dumps(figure, allow_nan=False)


def test_map_says_worse_in_the_cell_and_draws_nothing_for_nan() -> None:
    figure = plots.elsewhere_map("leg", [("a", "centred")] * 3, {"fx": np.array([5, 130, np.nan])})
    (heat,) = figure["data"]
    assert heat["text"] == [["5.0", "▲ 130", "–"]]
    assert heat["z"][0][0] < 0 < heat["z"][0][1]
    assert heat["z"][0][2] is None


def test_all_files_are_written(walk: StudyOutcome, tmp_path: Path) -> None:
    path = report.write_study(walk, tmp_path / "new" / "folder")
    assert path == tmp_path / "new" / "folder" / "study.html"
    names = ["calibration.json", "study.html", "study.json"]
    assert sorted(p.name for p in path.parent.iterdir()) == names
    assert json.loads(path.with_name("study.json").read_text())["format"] == "ftcal-study"


def test_nothing_is_written_where_one_cannot_be_made(
    walk: StudyOutcome, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: Any, **__: Any) -> None:
        raise SensorError("no page")

    monkeypatch.setattr(study_page, "rendered", broken)
    with pytest.raises(SensorError, match="no page"):
        report.write_study(walk, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_folder_that_is_a_file_is_refused(walk: StudyOutcome, tmp_path: Path) -> None:
    (tmp_path / "out").write_text("")
    with pytest.raises(OutputError, match="cannot be written"):
        report.write_study(walk, tmp_path / "out")


@pytest.mark.skipif(BROWSER is None, reason="no chromium on this machine")
def test_browser_draws_every_figure_and_runs_nothing_from_a_log(tmp_path: Path) -> None:
    assert BROWSER is not None
    outcome = study_pretend.an_outcome(HOSTILE, sensors=study_pretend.SENSORS[:1], count=400)
    text = report.study_html(outcome)
    page = tmp_path / "study.html"
    head, _, tail = text.rpartition("</body>")
    page.write_text(head + PROBE + tail)
    run = subprocess.run(
        [
            BROWSER,
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-quic",
            "--no-first-run",
            "--disable-background-networking",
            "--disable-component-update",
            "--disable-sync",
            f"--user-data-dir={tmp_path / 'profile'}",
            "--enable-logging=stderr",
            "--virtual-time-budget=60000",
            "--dump-dom",
            page.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    dom = Elements(run.stdout)
    body = next(attributes for tag, attributes in dom.found if tag == "body")
    assert body.get("data-drawn") == "yes", run.stderr
    assert body.get("data-probed") == "yes", run.stderr
    classes = [(attributes.get("class") or "").split() for _, attributes in dom.found]
    places = [c for c in classes if "plot" in c]
    assert len(places) == len(drawn(text))
    assert all("js-plotly-plot" in c for c in places)
    assert "could not be drawn" not in "".join(dom.text)
    bad = ("Uncaught", "Refused to", "WARN:", "Error", "alert")
    console = [line for line in run.stderr.splitlines() if "CONSOLE" in line]
    assert not [line for line in console if any(word in line for word in bad)]
