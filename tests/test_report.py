from __future__ import annotations

import html as html_text
import json
import re
import shutil
import subprocess
from dataclasses import dataclass, replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import golden
import pretend
from ftcal import report
from ftcal.calibration import Calibration, Input, Provenance
from ftcal.config import Job
from ftcal.cross_validation import validate_by_folds
from ftcal.errors import OutputError, SensorError
from ftcal.evidence import sensor_calibration
from ftcal.fit import FitOptions, fit
from ftcal.folds import cells
from ftcal.gathering import PairedSensor
from ftcal.logs.pieces import mapped, signal_rows
from ftcal.moments import within
from ftcal.one_sensor import SensorOutcome, deployed
from ftcal.pairing import FtChannel
from ftcal.pipeline import Outcome
from ftcal.plots.figure import plain, shortened, thinned, with_holes
from ftcal.progress import Steps, silent
from ftcal.recording import NANOSECONDS, Finding, Recording, Signal
from ftcal.report.words import figures, fixed, percent, strength, whisker
from ftcal.robot import FtSensor, Joint, Link, Robot
from ftcal.samples import Samples
from ftcal.segments import Segment, enveloping
from ftcal.sensor import Workbench
from ftcal.validate import HeldOut, held_out, named, score
from ftcal.verdict import judge

HOSTILE = "</script><img src=x onerror=alert(1)>"


def a_robot(name: str) -> Robot:
    body = {n: Link(n, 1.0, np.zeros(3), np.eye(3)) for n in ("base", "leg")}
    joint = Joint("hip", "fixed", "base", "leg", np.eye(4), np.array([0.0, 0.0, 1.0]))
    return Robot(name, "base", body, {"hip": joint}, {}, "00" * 32)


def a_recording(samples: Samples, signal: str, workbench: Workbench) -> Recording:
    stamps = np.rint(samples.time * NANOSECONDS).astype(np.int64)
    logged = samples.channels @ workbench.gain.T
    if workbench.logged == "channels":
        logged = samples.channels
    names = tuple(f"c{i}" for i in range(logged.shape[1]))
    joint = Signal(f"joints of {signal}", ("hip",), stamps[::2], np.zeros((len(stamps[::2]), 1)))
    return Recording(
        samples.recording,
        "logs/walk",
        0,
        (joint,),
        (Signal(signal, names, stamps, logged),),
    )


@dataclass(frozen=True)
class InMemory:
    recordings: tuple[Recording, ...]

    def between(self, name: str, start: float, stop: float) -> Recording:
        (found,) = (one for one in self.recordings if one.name == name)
        return mapped(
            found, lambda s: signal_rows(s, *np.searchsorted(found.seconds(s), [start, stop]))
        )


def an_outcome(
    name: str = "walk",
    *,
    options: FitOptions | None = None,
    prior: Workbench | None = None,
    axes: int = 6,
    count: int = 2000,
    warm: bool = False,
    tested: bool = True,
) -> tuple[Outcome, np.ndarray]:
    """Return what a job on two pretend recordings gives, and the true gain.

    Half of each recording trains; of the first, 12 to 19 s test. `name` is that of everything.
    """
    rng = np.random.default_rng(7)
    prior = prior or pretend.workbench()
    prior = replace(prior, name=f"SN000 {name}")
    truth = np.asarray(
        prior.gain
        + pretend.FULL_SCALE[:, None] * (rng.normal(size=prior.gain.shape) * 0.03 @ prior.scaling)
    )
    sensor, signal = f"{name} sensor", f"{name}/analog:o"
    takes = []
    for take in ("one", "two"):
        square = pretend.samples(
            np.eye(6), rng, count=count, axes=axes, noise=2e-4, recording=f"{name} {take}"
        )
        channels = square.channels @ np.linalg.pinv(truth).T
        channels = channels + rng.normal(size=channels.shape) * 3.0 + 500.0
        drift = 0.1 * square.time if warm else None
        takes.append(replace(square, channels=channels, temperature=drift))
    recordings = tuple(a_recording(take, signal, prior) for take in takes)
    training = tuple(Segment.of(take.between(0.0, 10.0), 0.5) for take in takes)
    test = (Segment.of(takes[0].between(12.0, 19.0), 0.5),) if tested else ()
    job = Job(
        robot=Path("robot.urdf"),
        sensors=({"name": sensor, "signal": signal},),  # type: ignore[arg-type]
        recordings=({"log": "logs/walk", "contact": "base"},),  # type: ignore[arg-type]
    )
    tiles = cells(training)
    found = fit(tiles, prior, options)
    envelope = named(enveloping(training))
    pieces = [held_out(s, found.estimate.coefficients, prior) for s in test]
    hold_out = score("hold-out", pieces, envelope) if pieces else None
    k_fold = validate_by_folds(tiles, prior, options or FitOptions(), within, Steps(silent, 5))
    verdicts = judge(found.excitation, hold_out or k_fold, prior.full_scale)
    findings = (
        Finding("frozen", signal, 10.5, 11.0, True, f"{signal}: frozen from 10.5 to 11 s {name}"),
        Finding("saturated", signal, 3.0, 3.01, True, "a channel at its end"),
        Finding("serial", signal, 0.0, 20.0, False, f"{signal}: lies on the lattice of SN000"),
        Finding("empty", f"arm of {name}", 0.0, 0.0, False, "no samples"),
    )
    flat = tuple((recordings[0].name, finding) for finding in findings)
    ft = FtSensor(sensor, "hip", "base", "leg", "child", "parent", np.eye(4))
    outcome = SensorOutcome(
        ft,
        FtChannel(sensor, signal, prior, f"{name}/heat" if warm else None),
        tuple(PairedSensor(take, len(take), len(take), training, test) for take in takes),
        training,
        test,
        found,
        (),
        envelope,
        hold_out,
        k_fold,
        25.0,
        verdicts,
        deployed(found.estimate, prior, verdicts),
        flat,
    )
    robot = a_robot(f"robot of {name}")
    calibration = Calibration(
        robot=robot.name,
        sensors=[sensor_calibration(job, outcome)],
        provenance=Provenance(
            ftcal="0",
            python="3",
            numpy="2",
            created="2016-03-01T12:00:00+00:00",
            inputs=[Input(role="recording", path=f"logs/{name}", sha256="ab" * 32)],
        ),
    )
    return Outcome(
        job, robot, recordings, InMemory(recordings), flat, (outcome,), calibration
    ), truth


@pytest.fixture(scope="module")
def walk() -> Outcome:
    return an_outcome()[0]


@pytest.fixture(scope="module")
def bare() -> Outcome:
    """All that a page must live without: no test windows, no folds, the paper's lambda."""
    outcome, _ = an_outcome(options=FitOptions(penalty=1.0, folds=40), tested=False)
    assert outcome.sensors[0].scores is None
    return outcome


class Elements(HTMLParser):
    """Every element of a page with its attributes, and the text of all but scripts and styles."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.text: list[str] = []
        self.inside = ""
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))
        if tag in ("script", "style"):
            self.inside = tag
        elif tag in ("p", "li", "tr", "h1", "h2", "h3", "caption", "figcaption", "summary", "dt"):
            self.text.append("\n")
        elif tag in ("br", "dd"):
            self.text.append(" ")
        elif tag in ("td", "th"):
            self.text.append(" | ")

    def handle_endtag(self, tag: str) -> None:
        if tag == self.inside:
            self.inside = ""

    def handle_data(self, data: str) -> None:
        if not self.inside:
            self.text.append(data)

    @property
    def lines(self) -> str:
        words = "".join(self.text).replace("\u00a0", " ")
        marked = re.sub(r"[ \t\n]*\n[ \t\n]*", "\n", words)
        return "\n".join(" ".join(line.split()) for line in marked.strip().splitlines()) + "\n"


def drawn(page: str) -> dict[str, Any]:
    """Return the figures inside a page."""
    text = page.split('id="figures">', 1)[1].split("</script>", 1)[0]
    figures: dict[str, Any] = json.loads(text)
    return figures


def strings(value: Any) -> list[str]:
    """Return every text in nested JSON."""
    if isinstance(value, dict):
        return [text for inner in value.values() for text in strings(inner)]
    if isinstance(value, list):
        return [text for inner in value for text in strings(inner)]
    return [value] if isinstance(value, str) else []


def rounded(value: Any) -> Any:
    """Return numbers with three digits: linear algebra libraries differ in the last ones."""
    if isinstance(value, dict):
        return {key: rounded(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [rounded(inner) for inner in value]
    return float(f"{value:.3g}") if isinstance(value, float) else value


def without_plotly(page: str) -> str:
    from plotly.offline import get_plotlyjs

    bundle = get_plotlyjs()
    assert page.count(bundle) == 1
    return page.replace(bundle, "")


def test_metrics_are_as_they_were(walk: Outcome) -> None:
    text = json.dumps(rounded(report.metrics(walk)), indent=1, allow_nan=False)
    # the vector of a direction may turn round within a nearly equal pair; its words do not
    golden.check("metrics.json", re.sub(r'"vector": \[[^]]*\],\s*', "", text) + "\n")


def test_report_says_what_it_said(walk: Outcome) -> None:
    golden.check("report.txt", Elements(report.html(walk)).lines)


def test_verdict_comes_before_all_figures(walk: Outcome) -> None:
    page = report.html(walk)
    assert page.index('id="verdict"') < page.index('class="plot"')
    assert "use the new matrix on every axis" in Elements(page).lines


def test_every_figure_has_a_place_a_caption_and_names_its_recording(walk: Outcome) -> None:
    page = report.html(walk)
    places = re.findall(r'<div class="plot" id="([^"]+)"', page)
    captions = re.findall(r"<figcaption>(.*?)</figcaption>", page)
    figures = drawn(page)
    assert places == list(figures)
    assert all("walk" in caption for caption in captions)
    assert all("walk" in figure["layout"]["title"]["text"] for figure in figures.values())


def test_page_loads_nothing(walk: Outcome) -> None:
    page = without_plotly(report.html(walk))
    assert "http://" not in page
    assert "https://" not in page
    assert "@import" not in page
    assert "url(" not in page
    for tag, attributes in Elements(page).found:
        assert tag not in ("link", "img", "iframe", "object", "base")
        assert "src" not in attributes
        assert (attributes.get("href") or "#").startswith("#")


def test_names_from_a_log_stay_text() -> None:
    outcome, truth = an_outcome(HOSTILE)
    page = report.html(outcome, {outcome.sensors[0].sensor.name: truth})
    elements = Elements(page)
    assert [tag for tag, _ in elements.found].count("script") == 3
    assert not [tag for tag, _ in elements.found if tag == "img"]
    assert not [a for _, attributes in elements.found for a in attributes if a.startswith("on")]
    assert HOSTILE in html_text.unescape("".join(elements.text))
    # plotly.js reads HTML in titles, names and hover texts
    shown = strings(drawn(page))
    assert not [text for text in shown if "<img" in text or "</script" in text]
    assert any("&lt;img" in text for text in shown)


@given(st.text())
def test_plain_text_has_no_markup(text: str) -> None:
    shown = plain(text)
    assert "<" not in shown
    assert html_text.unescape(shown) == "".join(c if c.isprintable() else " " for c in text)


@given(
    st.lists(st.floats(-1e6, 1e6) | st.just(float("nan")), min_size=1, max_size=400),
    st.integers(2, 50),
)
def test_thinning_keeps_the_extremes_and_the_holes(values: list[float], points: int) -> None:
    curve = np.array(values)
    rows = thinned(curve, points)
    assert (np.diff(rows) > 0).all()
    kept, holes = curve[rows], np.isnan(curve)
    assert np.isnan(kept).sum() == holes.sum()
    assert len(rows) <= points + holes.sum()
    if not holes.all():
        assert np.nanmin(kept) == np.nanmin(curve)
        assert np.nanmax(kept) == np.nanmax(curve)


def test_curve_breaks_where_the_clock_pauses() -> None:
    time = np.array([0.0, 0.1, 0.2, 5.0, 5.1])
    broken, values = with_holes(time, np.ones((5, 6)))
    np.testing.assert_array_equal(broken, [0.0, 0.1, 0.2, 5.0, 5.0, 5.1])
    assert np.isnan(values[3]).all()
    assert len(with_holes(time[:1], np.ones((1, 6)))[0]) == 1


def test_long_title_ends_in_an_ellipsis() -> None:
    assert shortened("<" * 200) == "&lt;" * 109 + "…"


def test_numbers_have_few_digits_and_no_negative_zero() -> None:
    assert [figures(x) for x in (0.42, -1234.5, 46.0, 1e-7)] == [
        "0.420",
        "−1234",
        "46.0",
        "1.00e−07",
    ]
    assert figures(None) == figures(float("nan")) == fixed(float("inf")) == "–"
    assert fixed(-1e-9) == "0.00"
    assert [percent(x) for x in (0.0043, 0.15, float("nan"))] == ["0.43\u00a0%", "15\u00a0%", "–"]
    assert [whisker(x) for x in (0.0, 100.0, 500.0, float("inf"))] == [0.0, 75.0, 150.0, 150.0]


def test_prior_says_who_chose_it(walk: Outcome) -> None:
    fitted = walk.sensors[0].fit
    assert strength(replace(fitted, choice=None)).endswith("(given by the job)")
    assert fitted.choice is not None
    ends = replace(fitted.choice, chosen=fitted.choice.kappas[0])
    assert "at the end of those tried" in strength(replace(fitted, choice=ends))


def test_page_without_validation_says_so(bare: Outcome) -> None:
    text = Elements(report.html(bare)).lines
    assert "Not validated: no data could be held out." in text
    assert "keep the Workbench matrix on every axis" in text
    assert "lambda = 1 (given by the job)" in text
    made = report.metrics(bare)["sensors"]["walk sensor"]
    assert made["hold_out"] is None
    assert made["k_fold"] is None
    assert made["prior"] == {"kappa": None, "lambda": 1.0, "curve": None}


def test_direction_without_motion_is_drawn_as_not_excited() -> None:
    outcome, _ = an_outcome(axes=3)
    page = report.html(outcome)
    names = [trace["name"] for f in drawn(page).values() for trace in f["data"] if "name" in trace]
    assert "below 3 × noise: the prior alone speaks" in names
    text = Elements(page).lines
    assert "3 of 6 directions excited" in text
    # torques that never were: the fit flattens them
    assert "⚠ vanishing" in text


def test_eight_channels_and_a_temperature_are_shown() -> None:
    rng = np.random.default_rng(3)
    gain = pretend.FULL_SCALE[:, None] * rng.normal(size=(6, 8)) / 32767.0
    prior = Workbench("SN8", gain, pretend.FULL_SCALE, "channels")
    outcome, truth = an_outcome(prior=prior, warm=True)
    page = report.html(outcome, {"walk sensor": truth})
    text = Elements(page).lines
    assert "Secondary matrix S" not in text
    assert "Temperature gain k" in text
    assert "fx, r8 | " in text


def test_scores_without_interval_become_null(walk: Outcome) -> None:
    sensor = walk.sensors[0]
    assert sensor.hold_out is not None
    piece = sensor.hold_out.pieces[0]
    short = HeldOut.of_all(
        piece.recording,
        piece.start,
        piece.stop,
        piece.time * 1e-3,
        piece.model,
        piece.workbench,
        piece.in_situ,
    )
    few = score("hold-out", [short], sensor.envelope)
    outcome = replace(walk, sensors=(replace(sensor, hold_out=few),))
    made = report.metrics(outcome)
    json.dumps(made, allow_nan=False)
    assert made["sensors"]["walk sensor"]["hold_out"]["scores"]["fx"]["interval"] == [0.0, None]
    assert "| – |" in Elements(report.html(outcome)).lines


def test_truth_equal_to_the_estimate_has_no_error(walk: Outcome) -> None:
    fitted = walk.sensors[0].fit.estimate.gain
    made = report.metrics(walk, {"walk sensor": fitted})["sensors"]["walk sensor"]["truth"]
    np.testing.assert_allclose(made["z"], 0.0, atol=1e-12)
    assert made["rms"] == 0.0
    assert made["within_two_sd"] == 1.0


def test_truth_is_found_within_its_standard_errors() -> None:
    outcome, truth = an_outcome()
    known = {"walk sensor": truth}
    made = report.metrics(outcome, known)["sensors"]["walk sensor"]["truth"]
    assert made["rms"] < 0.2 * made["workbench_rms"]
    text = Elements(report.html(outcome, known)).lines
    assert "Truth beside estimate" in text
    assert "Truth beside estimate" not in Elements(report.html(outcome)).lines


def test_truth_of_another_shape_is_refused(walk: Outcome) -> None:
    with pytest.raises(SensorError, match=r"shape \(6, 5\)"):
        report.metrics(walk, {"walk sensor": np.zeros((6, 5))})


def test_three_files_are_written(walk: Outcome, tmp_path: Path) -> None:
    path = report.write_outcome(walk, tmp_path / "new" / "folder")
    assert path == tmp_path / "new" / "folder" / "report.html"
    assert sorted(p.name for p in path.parent.iterdir()) == [
        "calibration.json",
        "metrics.json",
        "report.html",
    ]
    assert json.loads(path.with_name("metrics.json").read_text())["format"] == "ftcal-metrics"


def test_nothing_is_written_where_one_cannot_be_made(walk: Outcome, tmp_path: Path) -> None:
    with pytest.raises(SensorError):
        report.write_outcome(walk, tmp_path / "out", {"walk sensor": np.zeros((6, 5))})
    assert not (tmp_path / "out").exists()


def test_folder_that_is_a_file_is_refused(walk: Outcome, tmp_path: Path) -> None:
    (tmp_path / "out").write_text("")
    with pytest.raises(OutputError, match="cannot be written"):
        report.write_outcome(walk, tmp_path / "out")


BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "chrome"))), None)

PROBE = """<script>
(async () => {
  let seen = "";
  while (!document.body.dataset.drawn) await new Promise((r) => setTimeout(r, 50));
  for (const place of document.querySelectorAll(".plot")) {
    for (let curve = 0; curve < place.data.length; curve++) {
      const trace = place.data[curve];
      if (trace.type === "scatter3d") continue;
      const panel = (trace.xaxis || "x") + (trace.yaxis || "y");
      const pointNumber = trace.type === "heatmap" ? [0, 0] : 0;
      Plotly.Fx.hover(place, [{ curveNumber: curve, pointNumber }], panel);
      await new Promise((r) => setTimeout(r, 80));  // plotly.js hovers every 50 ms at most
      seen += [...place.querySelectorAll(".hoverlayer text")].map((t) => t.textContent).join(" ");
    }
  }
  document.body.dataset.seen = seen;
  document.body.dataset.probed = "yes";
})();
</script></body>"""
"""Points at the first sample of every curve, so that hover texts are drawn too."""


@pytest.mark.skipif(BROWSER is None, reason="no chromium on this machine")
def test_browser_draws_every_figure_and_runs_nothing_from_a_log(tmp_path: Path) -> None:
    assert BROWSER is not None
    outcome, truth = an_outcome(HOSTILE)
    text = report.html(outcome, {outcome.sensors[0].sensor.name: truth})
    page = tmp_path / "report.html"
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
    assert "onerror=alert" in (body.get("data-seen") or "")
    classes = [(attributes.get("class") or "").split() for _, attributes in dom.found]
    plots = [c for c in classes if "plot" in c]
    assert len(plots) == len(drawn(text))
    assert all("js-plotly-plot" in c for c in plots)
    assert sum("main-svg" in c for c in classes) >= len(plots)
    assert "could not be drawn" not in "".join(dom.text)
    pictures = [attributes.get("src") or "" for tag, attributes in dom.found if tag == "img"]
    assert all(source.startswith("data:image/png") for source in pictures)
    bad = ("Uncaught", "Refused to", "WARN:", "Error", "alert")
    console = [line for line in run.stderr.splitlines() if "CONSOLE" in line]
    assert not [line for line in console if any(word in line for word in bad)]
