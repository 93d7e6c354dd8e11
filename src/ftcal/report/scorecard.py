"""An outcome → `metrics.json`: every figure of the report, for machines. Not finite is null."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ftcal.excitation import Excitation
from ftcal.fit import Fit
from ftcal.one_sensor import SensorOutcome
from ftcal.report.truth import Truth
from ftcal.sensor import AXES
from ftcal.validate import Score, Scores
from ftcal.verdict import overall

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

    from ftcal.pipeline import Outcome


def metrics(
    outcome: Outcome, truth: Mapping[str, Float[Array, "6 K"]] | None = None
) -> dict[str, Any]:
    """Return what `metrics.json` holds; `truth` maps sensors to their true gain."""
    known = truth or {}
    kinds = [finding.kind for _, finding in outcome.findings]
    plain = {
        "format": "ftcal-metrics",
        "version": 1,
        "robot": outcome.robot.name,
        "recordings": {r.name: {"seconds": r.duration} for r in outcome.recordings},
        "findings": {kind: kinds.count(kind) for kind in sorted(set(kinds))},
        "improved": outcome.improved,
        "sensors": {s.sensor.name: sensor_metrics(s, known) for s in outcome.sensors},
    }
    made: dict[str, Any] = finite(plain)
    return made


def sensor_metrics(
    outcome: SensorOutcome, truth: Mapping[str, Float[Array, "6 K"]]
) -> dict[str, Any]:
    """Return the metrics of one sensor."""
    found = outcome.fit
    made = {
        "signal": outcome.channel.signal,
        "verdict": overall(outcome.verdicts),
        "verdicts": {v.axis: {"verdict": v.word, "reason": v.reason} for v in outcome.verdicts},
        "samples": {
            "logged": sum(paired.logged for paired in outcome.paired),
            "usable": sum(paired.usable for paired in outcome.paired),
            "training": found.samples,
            "down_weighted": found.down_weighted,
            "test": sum(map(len, outcome.test)),
        },
        "independent": by_axis(found.independent),
        "noise": {"sd": by_axis(found.noise.sd), "inefficiency": by_axis(found.noise.inefficiency)},
        "hold_out": None if outcome.hold_out is None else scores_metrics(outcome.hold_out),
        "k_fold": None if outcome.k_fold is None else scores_metrics(outcome.k_fold),
        "excitation": excitation_metrics(found.excitation),
        "prior": prior_metrics(found),
    }
    if outcome.sensor.name in truth:
        made["truth"] = Truth.of(outcome, truth[outcome.sensor.name]).metrics()
    return made


def by_axis(values: Float[Array, "6"]) -> dict[str, float]:
    """Return six numbers keyed by axis."""
    return {axis: float(value) for axis, value in zip(AXES, values, strict=True)}


def scores_metrics(scores: Scores) -> dict[str, Any]:
    """Return one validation."""
    return {
        "kind": scores.kind,
        "samples": scores.samples,
        "seconds": scores.seconds,
        "blocks": scores.blocks,
        "scores": {name: score_metrics(score) for name, score in scores.by_name.items()},
    }


def score_metrics(score: Score) -> dict[str, Any]:
    """Return one row of a validation table."""
    return {
        "unit": score.unit,
        "rms": score.rms,
        "workbench_rms": score.workbench_rms,
        "percent": score.percent,
        "interval": list(score.interval),
        "percent_absolute": score.percent_absolute,
        "amplitude": score.amplitude,
        "trained": list(score.trained),
        "tested": list(score.tested),
        "beyond": score.beyond,
    }


def excitation_metrics(excitation: Excitation) -> dict[str, Any]:
    """Return what the data could say."""
    return {
        "rank": excitation.rank,
        "condition": excitation.condition,
        "amplitude": excitation.amplitude,
        "scale_is_free": excitation.scale_is_free,
        "directions": [
            {
                "words": direction.words,
                "vector": direction.vector.tolist(),
                "sd": direction.sd,
                "signal": direction.signal,
                "excited": direction.excited,
                "share": by_axis(direction.share),
            }
            for direction in excitation.directions
        ],
    }


def prior_metrics(fit: Fit) -> dict[str, Any]:
    """Return how strongly the Workbench was believed, and the curve that chose it."""
    choice = fit.choice
    return {
        "kappa": None if fit.kappa is None else by_axis(fit.kappa),
        "lambda": fit.penalty,
        "curve": None
        if choice is None
        else {
            "kappa": choice.kappas.tolist(),
            "rms": {axis: choice.error[:, i].tolist() for i, axis in enumerate(AXES)},
            "workbench_rms": by_axis(choice.workbench),
            "chosen": choice.chosen,
        },
    }


def finite(value: Any) -> Any:
    """Return nested lists and tables with null for every number that JSON cannot say."""
    if isinstance(value, dict):
        return {key: finite(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [finite(inner) for inner in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return value
