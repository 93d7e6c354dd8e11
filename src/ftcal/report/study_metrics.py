"""A study → `study.json`: every figure of its page, for machines. Not finite is null."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from ftcal.balances import Leftover
from ftcal.first_validation import TOGETHER, FirstValidation, Norm
from ftcal.law import Law
from ftcal.report.published import is_right_leg, matched
from ftcal.report.scorecard import by_axis, finite, scores_metrics
from ftcal.report.truth import check_shape, departure
from ftcal.second_validation import BEST, MIXED, WORKBENCH, SecondValidation
from ftcal.sensor import AXES, Workbench

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

    from ftcal.study import SensorStudy, StudyOutcome

UNITS = {
    "percent": "% of the Workbench's error; N and Nm added up where axes are taken together",
    "force": "N",
    "torque": "Nm",
    "axes": "N, N, N, Nm, Nm, Nm",
    "offset": "N, N, N, Nm, Nm, Nm",
    "gain": "N or Nm per unit of the channel",
    "temperature_gain": "N/K, Nm/K",
    "secondary": "unit of the row per unit of the column",
    "seconds": "s",
    "truth_distance": "RMS over the entries, fraction of full scale",
}
"""What the numbers of the file are counted in, by key."""


def study_metrics(outcome: StudyOutcome) -> dict[str, Any]:
    """Return what `study.json` holds.

    Raises `SensorError` where a true gain is not of the shape of its Workbench matrix.
    """
    plain = {
        "format": "ftcal-study",
        "version": 1,
        "units": UNITS,
        "robot": outcome.robot.name,
        "improved": outcome.improved,
        "switching": outcome.job.study.switching,
        "lambdas": list(outcome.job.study.lambdas),
        "recordings": {
            take.name: {
                "seconds": take.duration,
                "sha256": take.digest,
                "findings": [
                    {
                        "kind": f.kind,
                        "signal": f.signal,
                        "start": f.start,
                        "stop": f.stop,
                        "cut": f.cut,
                        "message": f.message,
                    }
                    for f in take.findings
                ],
            }
            for take in outcome.recordings
        },
        "sub_chains": {
            chain.name: {
                "sensors": list(chain.sensors),
                "seconds": chain.seconds,
                "left": {matrix: leftover(left) for matrix, left in chain.left.items()},
            }
            for chain in outcome.sub_chains
        },
        "sensors": {
            one.channel.sensor: sensor_metrics(one, outcome.truth.get(one.channel.sensor))
            for one in outcome.sensors
        },
    }
    made: dict[str, Any] = finite(plain)
    return made


def sensor_metrics(one: SensorStudy, truth: Float[Array, "6 K"] | None) -> dict[str, Any]:
    """Return both validations of one sensor."""
    workbench = one.channel.workbench
    made = {
        "signal": one.channel.signal,
        "workbench": workbench.name,
        "first_validation": first_metrics(one.first, workbench),
        "second_validation": None if one.second is None else second_metrics(one.second, workbench),
        "truth_distance": None if truth is None else truth_distances(one, truth),
    }
    if is_right_leg(one.channel.sensor):
        made["named_as_in_the_paper"] = matched(one.first.recordings)
    return made


def first_metrics(first: FirstValidation, workbench: Workbench) -> dict[str, Any]:
    """Return the first validation: tables have a training set a row, a recording a column."""
    best = best_set(first)
    return {
        "sets": [
            {
                "name": one.name,
                "recording": one.recording,
                "method": one.method,
                "samples": one.moments.count,
                "gain": estimate.gain.tolist(),
                "temperature_gain": None
                if estimate.temperature_gain is None
                else estimate.temperature_gain.tolist(),
                "secondary": listed(workbench.secondary(estimate.gain)),
                "held_out": None if scores is None else scores_metrics(scores),
            }
            for one, estimate, scores in zip(
                first.sets, first.estimates, first.held_out, strict=True
            )
        ],
        "recordings": list(first.recordings),
        "judging": list(first.judging),
        "best": None if best is None else first.sets[best].name,
        "refused": first.refused,
        "dropped": first.dropped,
        "percent": {
            norm: {group: first.percent(norm, group).tolist() for group in TOGETHER}
            for norm in get_args(Norm)
        },
        "percent_elsewhere": {
            norm: {group: first.elsewhere(norm, group).tolist() for group in TOGETHER}
            for norm in get_args(Norm)
        },
        "error": {"absolute": first.absolute.tolist(), "rms": first.rms.tolist()},
        "workbench_error": {
            "absolute": first.workbench_absolute.tolist(),
            "rms": first.workbench_rms.tolist(),
        },
        "best_per_axis": {
            axis: {"set": name, "percent": percent} for axis, name, percent in first.best_per_axis()
        },
    }


def best_set(first: FirstValidation) -> int | None:
    """Return the set with the least mean error on data it did not see; None where none was seen."""
    mean = first.elsewhere()
    return int(np.nanargmin(mean)) if np.isfinite(mean).any() else None


def second_metrics(second: SecondValidation, workbench: Workbench) -> dict[str, Any]:
    """Return the second validation."""
    return {
        "sub_chain": second.sub_chain,
        "neighbours": list(second.neighbours),
        "seconds": second.seconds,
        "candidates": [
            {"training": one.training, "lambda": one.penalty, **leftover(left)}
            for one, left in zip(second.candidates, second.left, strict=True)
        ],
        "best": second.candidates[second.best].name,
        "best_per_axis": {
            axis: {"candidate": name, "mean": mean} for axis, name, mean in second.best_axes
        },
        "mixed": leftover(second.mixed_left),
        "unseen": {matrix: leftover(left) for matrix, left in second.unseen.items()},
        "laws": {name: law_metrics(law, workbench) for name, law in chosen_laws(second).items()},
    }


def chosen_laws(second: SecondValidation) -> dict[str, Law]:
    """Return the laws of the Workbench, of the best candidate and of the mixed matrix."""
    return {
        WORKBENCH: second.candidates[0].law,
        BEST: second.candidates[second.best].law,
        MIXED: second.mixed,
    }


def chosen_left(second: SecondValidation) -> dict[str, Leftover]:
    """Return what those three leave over."""
    return {
        WORKBENCH: second.left[0],
        BEST: second.left[second.best],
        MIXED: second.mixed_left,
    }


def law_metrics(law: Law, workbench: Workbench) -> dict[str, Any]:
    """Return the numbers to deploy."""
    channels = workbench.gain.shape[1]
    gain, k = law.coefficients[:, :channels], law.coefficients[:, channels:]
    return {
        "gain": gain.tolist(),
        "secondary": listed(workbench.secondary(gain)),
        "temperature_gain": by_axis(k[:, 0]) if k.shape[1] else None,
        "offset": by_axis(law.offset),
    }


def listed(matrix: Float[Array, "6 6"] | None) -> list[list[float]] | None:
    """Return a matrix as rows."""
    rows: list[list[float]] | None = None if matrix is None else matrix.tolist()
    return rows


def leftover(left: Leftover) -> dict[str, Any]:
    """Return the means of a leftover wrench."""
    return {
        "force": left.force,
        "torque": left.torque,
        "axes": dict(zip(AXES, left.axes, strict=True)),
    }


def truth_distances(one: SensorStudy, truth: Float[Array, "6 K"]) -> dict[str, Any]:
    """Return how far matrices are from the true one: RMS over entries of `F^-1 (C - C_true) T^-1`.

    The Workbench, every training set (lambda = 0), the best and the mixed matrix, in fractions of
    full scale. Raises `SensorError` where the true gain is of another shape.
    """
    workbench, channels = one.channel.workbench, truth.shape[1]
    check_shape(one.channel.sensor, truth, workbench)

    def distance(gain: Float[Array, "6 K"]) -> float:
        return float(np.sqrt(np.mean(departure(gain, truth, workbench) ** 2)))

    chosen = {} if one.second is None else chosen_laws(one.second)
    return {
        WORKBENCH: distance(workbench.gain),
        "sets": {
            training.name: distance(estimate.gain)
            for training, estimate in zip(one.first.sets, one.first.estimates, strict=True)
        },
        **{
            name: distance(chosen[name].coefficients[:, :channels]) if chosen else None
            for name in (BEST, MIXED)
        },
    }
