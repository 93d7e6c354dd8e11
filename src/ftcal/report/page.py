"""An outcome → one page of HTML: the verdict first, then the evidence, then provenance.

Here are the words and the numbers; `ftcal/templates` has the order and the looks.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ftcal import plots
from ftcal.calibration import SensorCalibration
from ftcal.judging import SensorResult
from ftcal.one_sensor import SensorOutcome
from ftcal.pairing import SignalOptions
from ftcal.recording import Finding, Recording
from ftcal.report.album import (
    Album,
    Table,
    knowledge_figures,
    residual_figures,
    wrench_figures,
)
from ftcal.report.rendering import rendered
from ftcal.report.truth import Truth
from ftcal.report.words import strength
from ftcal.sensor import AXES, UNITS
from ftcal.takes import Glimpses
from ftcal.validate import Score, Scores
from ftcal.verdict import Verdict, advice, overall

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

    from ftcal.pipeline import Outcome


def html(outcome: Outcome, truth: Mapping[str, Float[Array, "6 K"]] | None = None) -> str:
    """Return the report of a job as one self-contained page.

    `truth` maps sensors to their true gain; the page then shows truth beside estimate.
    """
    album = Album()
    sensors = [
        sensor_section(
            number,
            sensor,
            outcome.calibration.sensor(sensor.sensor.name),
            outcome.logs,
            outcome.job.signals.options(),
            (truth or {}).get(sensor.sensor.name),
            album,
        )
        for number, sensor in enumerate(outcome.sensors, 1)
    ]
    return rendered(
        "report.html",
        album,
        robot=outcome.robot.name,
        recordings=[
            {"name": r.name, "source": r.source, "seconds": r.duration} for r in outcome.recordings
        ],
        sensors=sensors,
        health=[
            health_section(recording, outcome.findings, album) for recording in outcome.recordings
        ],
        provenance=outcome.calibration.provenance,
    )


def sensor_section(
    number: int,
    outcome: SensorOutcome,
    calibration: SensorCalibration,
    logs: Glimpses,
    options: SignalOptions,
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
        "sentence": advice(outcome.verdicts),
        "verdicts": outcome.verdicts,
        "kind": None if scores is None else scores.kind,
        "hold_out": table_of(outcome.hold_out, outcome.verdicts),
        "k_fold": table_of(outcome.k_fold, outcome.verdicts if outcome.hold_out is None else ()),
        "samples": {
            "logged": sum(paired.logged for paired in outcome.paired),
            "usable": sum(paired.usable for paired in outcome.paired),
            "training": outcome.fit.samples,
            "less": outcome.fit.down_weighted,
            "least": float(outcome.fit.independent.min()),
            "most": float(outcome.fit.independent.max()),
        },
        "prior": strength(outcome.fit),
        "wrenches": wrench_figures(outcome, logs, options, album),
        "residuals": residual_figures(name, scores, album),
        "knowledge": knowledge_figures(outcome, album),
        "excitation": outcome.fit.excitation,
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


def matrices(outcome: SensorOutcome | SensorResult, calibration: SensorCalibration) -> Table:
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
    names = ", ".join(dict.fromkeys(one.samples.recording for one in outcome.training))
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
        "findings": findings_lines(some),
    }


def findings_lines(findings: Sequence[Finding]) -> list[Table]:
    """Return findings as lines that name their signal."""
    return [
        {
            "finding": finding,
            "message": finding.message
            if finding.signal in finding.message
            else f"{finding.signal}: {finding.message}",
        }
        for finding in findings
    ]
