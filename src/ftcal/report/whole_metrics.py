"""A fit of all sensors → `metrics.json`: every figure of its page, for machines.

Not finite is null.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ftcal.all_sensors import WholeBody
from ftcal.balances import Leftover
from ftcal.judging import LEAST_SHARE, Residual, SensorResult, loose_scales
from ftcal.model_errors import Move, Tried
from ftcal.plots import Node
from ftcal.report.scorecard import by_axis, finite, scores_metrics
from ftcal.report.truth import Truth, check_shape, departure
from ftcal.sensor import AXES
from ftcal.verdict import overall
from ftcal.weighing import Weighing

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

    from ftcal.whole_pipeline import WholeOutcome

UNITS = {
    "force": "N",
    "torque": "Nm",
    "mass": "kg",
    "com": "m, in the frame of the sub-model's first link",
    "start": "s",
    "stop": "s",
    "kappa": "fraction of full scale",
    "share": "of the entry, the rest is the prior's",
    "noise": "N and Nm",
    "log_evidence": "nats gained by an error of the model",
    "held_out": "change of the RMS residual of stretches left out, as a share (in model_errors)",
    "moves": "of full scale, by one standard deviation of the prior",
}
"""What the numbers of the file are counted in, by key."""


@dataclass(frozen=True, slots=True)
class Inertia:
    """What the fit believes of a sub-model beside the robot description."""

    sub_model: str
    described: float
    """Mass of the robot description [kg]."""
    mass: float
    """Mass to add [kg]."""
    mass_sd: float
    """Its standard deviation [kg]."""
    com: Float[Array, "3"]
    """Shift of the centre of mass [m], in the frame of the first link."""
    com_sd: Float[Array, "3"]
    """Its standard deviation [m]."""
    priors: Float[Array, "4"]
    """Mass and shift in standard deviations of their prior."""


@dataclass(frozen=True, slots=True)
class Mean:
    """What is left over in all stretches of one kind, weighted by their samples."""

    sub_model: str
    touching: int
    """Links that touch the world: one while a leg swings, two in double support."""
    held_out: bool
    equations: int
    workbench: tuple[float, float]
    """Mean force [N] and torque [Nm]."""
    whole_body: tuple[float, float]
    """Mean force [N] and torque [Nm]."""


def whole_metrics(
    outcome: WholeOutcome, truth: Mapping[str, Float[Array, "6 K"]] | None = None
) -> dict[str, Any]:
    """Return what `metrics.json` holds; `truth` maps sensors to their true gain.

    Raises `SensorError` where a true gain is not of the shape of its Workbench matrix.
    """
    fit = outcome.fit
    kinds = [finding.kind for _, finding in outcome.findings]
    plain = {
        "format": "ftcal-whole-body",
        "version": 1,
        "units": UNITS,
        "robot": outcome.robot.name,
        "recordings": {r.name: {"seconds": r.duration} for r in outcome.recordings},
        "findings": {kind: kinds.count(kind) for kind in sorted(set(kinds))},
        "improved": outcome.improved,
        "together": scores_metrics(fit.together),
        "undetermined": undetermined(outcome),
        "samples": fit.samples,
        "down_weighted": fit.down_weighted,
        "prior": prior_metrics(fit),
        "noise": {
            sub_model: {
                kind: {"sd": known.sd, "inefficiency": known.inefficiency}
                for (name, kind), known in fit.posterior.noise.items()
                if name == sub_model
            }
            for sub_model in fit.posterior.unknowns.models
        },
        "sub_models": {node.name: node_metrics(node) for node in nodes(outcome)},
        "residuals": [residual_metrics(one, touching(outcome, one)) for one in fit.residuals],
        "weighings": [weighing_metrics(one) for one in outcome.weighings],
        "inertia": {one.sub_model: inertia_metrics(one) for one in inertias(outcome)},
        "model_errors": {one.words: tried_metrics(one, fit) for one in outcome.tried},
        "sensors": {s.sensor.name: sensor_metrics(s, fit, truth or {}) for s in fit.sensors},
    }
    made: dict[str, Any] = finite(plain)
    return made


def undetermined(outcome: WholeOutcome) -> list[str]:
    """Return the sensors of the job that are in no balance trained on."""
    asked = [outcome.robot.sensor(section.name).name for section in outcome.job.sensors]
    return [name for name in asked if name not in outcome.fit.posterior.unknowns.entries]


def nodes(outcome: WholeOutcome) -> list[Node]:
    """Return the sub-models that the sensors of the job cut out, with what each gave."""
    robot = outcome.robot
    sensors = [robot.sensor(section.name) for section in outcome.job.sensors]
    models = robot.sub_models([sensor.name for sensor in sensors])
    of_link = {link: model.name for model in models for link in model.links}
    above = {of_link[sensor.child]: sensor for sensor in sensors}
    trained = [one for one in outcome.fit.residuals if not one.held_out]
    found = []
    for model in models:
        mine = [one for one in trained if one.sub_model == model.name]
        sensor = above.get(model.name)
        found.append(
            Node(
                model.name,
                sum(robot.links[link].mass for link in model.links),
                max((one.equations for one in mine), default=0),
                sum(one.samples for one in mine),
                None if sensor is None else of_link[sensor.parent],
                None if sensor is None else sensor.name,
            )
        )
    return found


def touching(outcome: WholeOutcome, residual: Residual) -> tuple[str, ...]:
    """Return the links that touched the world in a stretch."""
    section = next(r for r in outcome.job.recordings if r.label == residual.recording)
    inside = (i for i in section.schedule().intervals if i.start <= residual.start < i.stop)
    return next(inside).touching


def means(outcome: WholeOutcome) -> list[Mean]:
    """Return the leftovers by sub-model, number of contacts, and trained on or held out."""
    grouped: dict[tuple[str, int, bool], list[Residual]] = {}
    for one in outcome.fit.residuals:
        key = (one.sub_model, len(touching(outcome, one)), one.held_out)
        grouped.setdefault(key, []).append(one)
    return [
        Mean(
            *key,
            min(one.equations for one in some),
            mean_of([one.workbench for one in some], [one.samples for one in some]),
            mean_of([one.whole_body for one in some], [one.samples for one in some]),
        )
        for key, some in sorted(grouped.items())
    ]


def mean_of(left: Sequence[Leftover], samples: Sequence[int]) -> tuple[float, float]:
    """Return mean force [N] and torque [Nm] over the samples of several stretches."""
    force, torque = np.average([(one.force, one.torque) for one in left], axis=0, weights=samples)
    return float(force), float(torque)


def inertias(outcome: WholeOutcome) -> list[Inertia]:
    """Return what the fit believes of every sub-model beside the robot description."""
    posterior, prior = outcome.fit.posterior, outcome.job.whole_body
    described = {node.name: node.mass for node in nodes(outcome)}
    found = []
    for name in posterior.unknowns.models:
        place = posterior.unknowns.model(name)
        theta = posterior.theta[place]
        sd = np.sqrt(np.diag(posterior.error)[place])
        kilograms = prior.mass * described[name]
        found.append(
            Inertia(
                name,
                described[name],
                float(kilograms * theta[0]),
                float(kilograms * sd[0]),
                prior.com * theta[1:],
                prior.com * sd[1:],
                theta,
            )
        )
    return found


def move_words(move: Move, fit: WholeBody) -> str:
    """Return sensor, row and column of the entry that moves most with an error of the model."""
    frame = fit.frames[move.sensor]
    known = np.zeros((len(AXES), len(frame.basis)))
    along = directions(known, frame.workbench.gain.shape[1])[move.column]
    return f"{move.sensor} {AXES[move.row]}, {along}"


def directions(share: Float[Array, "6 P"], channels: int) -> list[str]:
    """Return the names of the directions of the channels, the temperature last."""
    names = list(AXES) if channels == 6 else [f"channel {j + 1}" for j in range(channels)]
    return [*names, "temperature"][: share.shape[1]]


def on_the_prior(result: SensorResult) -> dict[str, list[str]]:
    """Return the rows in which the prior has the say, by direction; the others are left out."""
    names = directions(result.share, result.fitted.gain.shape[1])
    weak = {
        name: [axis for axis, part in zip(AXES, column, strict=True) if part < LEAST_SHARE]
        for name, column in zip(names, result.share.T, strict=True)
    }
    return {name: rows for name, rows in weak.items() if rows}


def truth_of(
    fit: WholeBody, result: SensorResult, truth: Mapping[str, Float[Array, "6 K"]]
) -> Truth | None:
    """Return the fit of a sensor beside its true gain, where it is known."""
    name = result.sensor.name
    if name not in truth:
        return None
    workbench = result.channel.workbench
    check_shape(name, truth[name], workbench)
    channels = truth[name].shape[1]
    place = fit.posterior.unknowns.entries[name]
    sd = np.sqrt(np.diag(fit.posterior.error)[place]).reshape(6, -1)
    return Truth(
        departure(truth[name], workbench.gain, workbench),
        fit.posterior.entries(name)[:, :channels],
        sd[:, :channels],
    )


def sensor_metrics(
    result: SensorResult, fit: WholeBody, truth: Mapping[str, Float[Array, "6 K"]]
) -> dict[str, Any]:
    """Return the metrics of one sensor."""
    names = directions(result.share, result.fitted.gain.shape[1])
    made = {
        "signal": result.channel.signal,
        "verdict": overall(result.verdicts),
        "verdicts": {v.axis: {"verdict": v.word, "reason": v.reason} for v in result.verdicts},
        "scale": result.scores.by_name["force"].amplitude,
        "share": {
            axis: dict(zip(names, map(float, row), strict=True))
            for axis, row in zip(AXES, result.share, strict=True)
        },
        "on_the_prior": on_the_prior(result),
        "loose_scales": loose_scales(fit.posterior, result.sensor.name),
        "noise": {"sd": by_axis(result.noise), "inefficiency": by_axis(result.inefficiency)},
        "held_out": scores_metrics(result.scores),
    }
    compared = truth_of(fit, result, truth)
    if compared is not None:
        made["truth"] = compared.metrics()
    return made


def prior_metrics(fit: WholeBody) -> dict[str, Any]:
    """Return how strongly the Workbench was believed, and the curve that chose it."""
    choice = fit.choice
    return {
        "kappa": fit.posterior.kappa,
        "determined": fit.posterior.spent,
        "entries": fit.posterior.unknowns.prior,
        "curve": None
        if choice is None
        else {
            "kappa": choice.kappas.tolist(),
            "error": dict(zip(choice.stretches, choice.error.T.tolist(), strict=True)),
            "chosen": choice.chosen,
        },
    }


def node_metrics(node: Node) -> dict[str, Any]:
    """Return one sub-model."""
    return {
        "mass": node.mass,
        "equations": node.equations,
        "samples": node.samples,
        "parent": node.parent,
        "sensor": node.sensor,
    }


def residual_metrics(one: Residual, links: Sequence[str]) -> dict[str, Any]:
    """Return what is left over of one sub-model in one stretch."""
    return {
        "sub_model": one.sub_model,
        "sensors": list(one.sensors),
        "recording": one.recording,
        "start": one.start,
        "stop": one.stop,
        "touching": list(links),
        "held_out": one.held_out,
        "samples": one.samples,
        "equations": one.equations,
        "workbench": {"force": one.workbench.force, "torque": one.workbench.torque},
        "whole_body": {"force": one.whole_body.force, "torque": one.whole_body.torque},
    }


def weighing_metrics(one: Weighing) -> dict[str, Any]:
    """Return one weighing [kg]."""
    return {
        "recording": one.recording,
        "start": one.start,
        "stop": one.stop,
        "touching": list(one.touching),
        "model": one.model,
        "workbench": one.workbench,
        "whole_body": one.whole_body,
    }


def tried_metrics(one: Tried, fit: WholeBody) -> dict[str, Any]:
    """Return what became of one suspected error of the model."""
    return {
        "verdict": one.word,
        "numbers": {
            number.error.name: {
                "value": number.value,
                "sd": number.sd,
                "prior_sd": number.error.sd,
                "unit": number.error.unit,
            }
            for number in one.numbers
        },
        "log_evidence": one.gain,
        "held_out": one.held_out,
        "moves": {
            move.sensor: {"entry": move_words(move, fit), "percent": move.percent}
            for move in one.moves
        },
        "rivals": list(one.rivals),
    }


def inertia_metrics(one: Inertia) -> dict[str, Any]:
    """Return what the fit believes of one sub-model."""
    return {
        "described": one.described,
        "mass": one.mass,
        "mass_sd": one.mass_sd,
        "com": one.com.tolist(),
        "com_sd": one.com_sd.tolist(),
        "priors": one.priors.tolist(),
    }
