"""An outcome → one page of HTML: the verdict first, then the evidence, then provenance.

Here are the words and the numbers; `ftcal/templates` has the order and the looks.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ftcal import plots
from ftcal.calibration import SensorCalibration
from ftcal.one_sensor import SensorOutcome
from ftcal.plots import Figure, Piece
from ftcal.recording import Finding, Recording
from ftcal.report.truth import Truth
from ftcal.report.words import TEXT_FILTERS, sentence, strength
from ftcal.sensor import AXES, UNITS
from ftcal.validate import HeldOut, Score, Scores, held_out
from ftcal.verdict import Verdict, overall

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

    from ftcal.pipeline import Outcome

Truths = Mapping[str, "Float[Array, '6 K']"]
Table = dict[str, Any]
"""What a template takes."""

SAFE_IN_SCRIPT = str.maketrans(
    {"<": "\\u003c", ">": "\\u003e", "&": "\\u0026", "\u2028": "\\u2028", "\u2029": "\\u2029"}
)
"""JSON in a script element must not be able to end it."""


class Album:
    """The figures of a page in order, each known by the id of its place."""

    def __init__(self) -> None:
        self.figures: dict[str, Figure] = {}

    def add(self, figure: Figure, caption: str) -> Table:
        """Take a figure in; return what the template needs to make room for it."""
        name = f"figure-{len(self.figures) + 1}"
        self.figures[name] = figure
        return {"id": name, "caption": caption, "height": figure["layout"]["height"]}

    def json(self) -> str:
        """Return all figures as JSON that is safe in a script element."""
        return json.dumps(self.figures, allow_nan=False).translate(SAFE_IN_SCRIPT)


def html(outcome: Outcome, truth: Truths | None = None) -> str:
    """Return the report of a job as one self-contained page.

    `truth` maps sensors to their true gain; the page then shows truth beside estimate.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from plotly.offline import get_plotlyjs

    album = Album()
    sensors = [
        sensor_section(
            number,
            sensor,
            outcome.calibration.sensor(sensor.sensor.name),
            {recording.name: recording for recording in outcome.recordings},
            (truth or {}).get(sensor.sensor.name),
            album,
        )
        for number, sensor in enumerate(outcome.sensors, 1)
    ]
    environment = Environment(
        loader=PackageLoader("ftcal", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(TEXT_FILTERS)
    return environment.get_template("report.html").render(
        robot=outcome.robot.name,
        recordings=[
            {"name": r.name, "source": r.source, "seconds": r.duration} for r in outcome.recordings
        ],
        sensors=sensors,
        health=[
            health_section(recording, outcome.findings, album) for recording in outcome.recordings
        ],
        provenance=outcome.calibration.provenance,
        points=plots.POINTS,
        figures=album.json(),
        plotly=get_plotlyjs(),
    )


def sensor_section(
    number: int,
    outcome: SensorOutcome,
    calibration: SensorCalibration,
    recordings: Mapping[str, Recording],
    truth: Float[Array, "6 K"] | None,
    album: Album,
) -> Table:
    """Return all that the page says about one sensor; its figures go into the album in order."""
    name = outcome.sensor.name
    scores = outcome.scores
    return {
        "number": number,
        "name": name,
        "signal": outcome.channel.signal,
        "workbench": outcome.channel.workbench.name,
        "frame": calibration.frame,
        "acts_on": calibration.acts_on,
        "word": overall(outcome.verdicts),
        "sentence": sentence(outcome.verdicts),
        "verdicts": outcome.verdicts,
        "kind": None if scores is None else scores.kind,
        "hold_out": table_of(outcome.hold_out, outcome.verdicts),
        "k_fold": table_of(
            outcome.k_fold, outcome.verdicts if outcome.hold_out is None else ()
        ),
        "samples": {
            "logged": sum(paired.logged for paired in outcome.paired),
            "usable": sum(len(paired.samples) for paired in outcome.paired),
            "training": outcome.fit.samples,
            "least": float(outcome.fit.independent.min()),
            "most": float(outcome.fit.independent.max()),
        },
        "prior": strength(outcome.fit),
        "wrenches": wrench_figures(outcome, recordings, album),
        "residuals": residual_figures(name, scores, album),
        "knowledge": knowledge_figures(outcome, album),
        "excitation": outcome.fit.excitation,
        "findings": findings_table(outcome.findings),
        "matrices": matrices(outcome, calibration),
        "offsets": calibration.offsets,
        "temperature_gain": calibration.temperature_gain,
        "reference_temperature": calibration.reference_temperature,
        "truth": None if truth is None else truth_section(outcome, truth, album),
    }


def table_of(scores: Scores | None, verdicts: Sequence[Verdict]) -> Table | None:
    """Return one validation as a table, with the verdict of each axis where it rests on it."""
    if scores is None:
        return None
    words = {verdict.axis: verdict for verdict in verdicts}
    return {
        "kind": scores.kind,
        "samples": scores.samples,
        "seconds": scores.seconds,
        "blocks": scores.blocks,
        "recordings": list(dict.fromkeys(piece.recording for piece in scores.pieces)),
        "judged": bool(verdicts),
        "rows": [score_row(score, words.get(name)) for name, score in scores.by_name.items()],
    }


def score_row(score: Score, verdict: Verdict | None) -> Table:
    """Return one line of a validation table."""
    return {"score": score, "verdict": verdict, "known": np.isfinite(score.interval[1])}


def wrench_figures(
    outcome: SensorOutcome, recordings: Mapping[str, Recording], album: Album
) -> list[Table]:
    """Return the figures of wrenches: in time per recording, smoothing, forces in space."""
    name = outcome.sensor.name
    gain = outcome.fit.estimate.coefficients
    pieces = [
        Piece(role, held_out(segment, gain, outcome.channel.workbench))
        for role, segments in (("train", outcome.training), ("test", outcome.test))
        for segment in segments
    ]
    pieces = [piece for piece in pieces if len(piece.reading.time)]
    made = []
    for paired in outcome.paired:
        label = paired.samples.recording
        inside = [piece for piece in pieces if piece.reading.recording == label]
        made.append(
            album.add(
                plots.wrench_in_time(name, paired.samples, inside),
                f"Recording {label}: force [N] and torque [Nm] at {name}. Broad grey: what the"
                " robot model expects. Dotted vermillion: Workbench. Thin blue: in situ, as fitted"
                " (before refused axes went back to the Workbench). Both readings get the offset"
                " that fits each shaded window best. Gaps are samples that were not usable.",
            )
        )
    longest = max((*outcome.test, *outcome.training), key=len)
    made.append(
        album.add(
            plots.smoothing_effect(recordings[longest.recording], outcome.channel, longest),
            f"Recording {longest.recording}, a few seconds of {outcome.channel.signal} as the"
            " Workbench reads it [N, Nm]: the filter that channels and model share takes the noise"
            " that would bias the regression towards zero.",
        )
    )
    if pieces:
        made.append(
            album.add(
                plots.forces_in_space(name, pieces),
                f"Force [N] at {name} in all windows of"
                f" {', '.join(p.samples.recording for p in outcome.paired)}, a regular selection of"
                " samples. Drag to turn.",
            )
        )
    return made


def residual_figures(name: str, scores: Scores | None, album: Album) -> list[Table]:
    """Return the figures of held-out residuals: in time per recording, then their distribution."""
    if scores is None:
        return []
    by_recording: dict[str, list[HeldOut]] = {}
    for piece in scores.pieces:
        by_recording.setdefault(piece.recording, []).append(piece)
    made = [
        album.add(
            plots.residuals_in_time(name, scores.kind, some),
            f"Recording {label}: sensor minus model [N, Nm] at {name} on {scores.kind} samples.",
        )
        for label, some in by_recording.items()
    ]
    made.append(
        album.add(
            plots.residual_spread(name, scores.kind, scores.pieces),
            f"Recording{'s' * (len(by_recording) > 1)} {', '.join(by_recording)}: how the"
            f" {scores.kind} residuals at {name} are spread [N, Nm]; narrow is good.",
        )
    )
    return made


def knowledge_figures(outcome: SensorOutcome, album: Album) -> Table:
    """Return the figures of what the data excite and of how the prior was chosen."""
    names = ", ".join(dict.fromkeys(segment.recording for segment in outcome.training))
    choice = outcome.fit.choice
    return {
        "directions": album.add(
            plots.directions(names, outcome.fit.excitation),
            f"Training data of {names}. Left: standard deviation [% of full scale] along each"
            " direction of the channels, named by the wrench it makes; the black tick is the noise"
            " along it, a hatched bar does not rise above three times that noise. Right: how much"
            " of the estimate is the data's [%]; the rest is the prior's.",
        ),
        "curve": None
        if choice is None
        else album.add(
            plots.prior_curve(names, choice),
            f"Training data of {names}: held-out RMS error [% of Workbench] against kappa [fraction"
            " of full scale]. Blocks in time were held out; the least geometric mean chooses.",
        ),
    }


def matrices(outcome: SensorOutcome, calibration: SensorCalibration) -> Table:
    """Return the deployed matrices with the standard error of every entry."""
    estimate, workbench = outcome.estimate, outcome.channel.workbench
    channels = estimate.gain.shape[1]
    covariance = estimate.covariance[:, :channels, :channels]
    keep = [not verdict.use for verdict in outcome.verdicts]
    made: Table = {
        "gain": entries(estimate.gain, covariance, keep),
        "secondary": None,
        "channels": range(1, channels + 1),
    }
    if calibration.secondary is not None:
        back = np.linalg.inv(workbench.gain)
        spread = back.T @ covariance @ back
        made["secondary"] = entries(np.array(calibration.secondary), spread, keep)
    return made


def entries(
    matrix: Float[Array, "6 K"], covariance: Float[Array, "6 K K"], keep: Sequence[bool]
) -> list[Table]:
    """Return the rows of a matrix, each entry with its posterior standard deviation."""
    sd = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0))
    return [
        {
            "axis": axis,
            "unit": unit,
            "kept": kept,
            "cells": [{"value": float(v), "sd": float(s)} for v, s in zip(*both, strict=True)],
        }
        for axis, unit, kept, both in zip(
            AXES, UNITS, keep, zip(matrix, sd, strict=True), strict=True
        )
    ]


def truth_section(outcome: SensorOutcome, gain: Float[Array, "6 K"], album: Album) -> Table:
    """Return the comparison with a known truth."""
    compared = Truth.of(outcome, gain)
    names = ", ".join(dict.fromkeys(segment.recording for segment in outcome.training))
    channels = gain.shape[1]
    columns = list(AXES) if channels == 6 else [f"r{j + 1}" for j in range(channels)]
    return {
        "figure": album.add(
            plots.truth_maps(names, compared.truth, compared.estimate, compared.z),
            f"Training data of {names}: entries of the true and of the fitted matrix as departures"
            " from the Workbench [% of full scale] (the Workbench is 0 everywhere), and the error"
            " of each in its own standard errors.",
        ),
        "rms": compared.rms,
        "workbench_rms": compared.workbench_rms,
        "within": compared.within,
        "rows": [
            {
                "entry": f"{AXES[i]}, {columns[j]}",
                "truth": float(compared.truth[i, j]),
                "estimate": float(compared.estimate[i, j]),
                "sd": float(compared.sd[i, j]),
                "z": float(compared.z[i, j]),
            }
            for i, j in itertools.product(range(6), range(channels))
        ],
    }


def health_section(
    recording: Recording, findings: Sequence[tuple[str, Finding]], album: Album
) -> Table:
    """Return the data health of one recording."""
    some = [finding for name, finding in findings if name == recording.name]
    return {
        "recording": recording.name,
        "figure": album.add(
            plots.health_timeline(recording, some),
            f"Recording {recording.name}: every signal against time [s]. Tall bars were cut from"
            " everything that follows; low bars are notes. Point at a bar for its message.",
        ),
        "findings": findings_table([(recording.name, finding) for finding in some]),
    }


def findings_table(findings: Sequence[tuple[str, Finding]]) -> list[Table]:
    """Return findings as lines, what covers its single spans first."""
    return [
        {"recording": recording, "finding": finding, "seconds": finding.stop - finding.start}
        for recording, finding in findings
    ]
