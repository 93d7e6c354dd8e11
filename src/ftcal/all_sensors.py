"""All sensors at once, start to end: balance, fit, hold out, judge.

The counterpart of `one_sensor` for `[fit] scope = "whole body"`: every equation that the recordings
contain (`balances`), one fit (`whole_body`), and for every sensor the same scores and verdicts.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal.balanced_take import ALTOGETHER, ENOUGH, BalancedTake, balanced
from ftcal.config import Job
from ftcal.errors import DataError
from ftcal.judging import Residual, SensorResult, predictions, residuals, sensor_result, together
from ftcal.pairing import FtChannel
from ftcal.progress import Steps
from ftcal.recording import Finding, Recording
from ftcal.robot import Robot
from ftcal.solution import Solution
from ftcal.terms import Frame, ModelPrior, Terms
from ftcal.unknowns import Normal, Posterior, offsets_alone
from ftcal.validate import Scores, load_envelope, score
from ftcal.whole_body import Choice, fit_all, robust_weights

if TYPE_CHECKING:
    pass

ROBUST_ROUNDS = 2
"""Rounds of weights and fit."""


@dataclass(frozen=True, slots=True, eq=False)
class WholeBody:
    """The fit of all sensors with what it was made of and how it does."""

    posterior: Posterior
    choice: Choice | None
    frames: dict[str, Frame]
    takes: tuple[BalancedTake, ...]
    workbench: Solution
    """Every matrix its Workbench, with the offsets that suit best: what is compared with."""
    whole_body: Solution
    """The fit, with offsets of what was held out."""
    together: Scores
    """Of all sub-models whose six equations are known, on held-out stretches."""
    sensors: tuple[SensorResult, ...]
    residuals: tuple[Residual, ...]
    samples: int
    """Samples of all balances trained on."""
    down_weighted: float
    """Share of their cells of a second that count less than once."""


def calibrate_all(
    job: Job,
    robot: Robot,
    channels: Sequence[FtChannel],
    recordings: Sequence[Recording],
    findings: Sequence[Sequence[Finding]],
    steps: Steps,
    *,
    balancing: Callable[..., BalancedTake] | None = None,
) -> WholeBody:
    """Return the fit of all sensors of a job to all its recordings.

    Balances are those of `balanced`, or of a `balancing` of the same arguments that knows more of
    what is wrong with the model. Raises `DataError` where no free sub-model is left to train on or
    nothing can be held out.
    """
    frames = {
        channel.sensor: Frame.of(
            channel.workbench,
            channel.workbench.gain.shape[1] + (channel.temperature is not None),
        )
        for channel in channels
    }
    model = ModelPrior(mass=job.whole_body.mass, com=job.whole_body.com)
    takes: list[BalancedTake] = []
    trained: list[list[Terms]] = []
    held: list[Terms] = []
    for section, recording, found in zip(job.recordings, recordings, findings, strict=True):
        steps.begin(f"balancing {section.label}")
        take = (balancing or balanced)(job, robot, channels, section, recording, found)
        trained.append(take.terms(take.train, frames, model))
        held += take.terms(take.test, frames, model)
        takes.append(take.thinned(min(ENOUGH, ALTOGETHER // len(recordings))))
    steps.begin("fitting all sensors")
    terms = list(itertools.chain(*trained))
    samples = int(sum(term.count for term in terms))
    posterior, choice = fit_all(
        terms, frames, kappa=job.fit.strength, strength=job.whole_body.strength
    )
    for _ in range(ROBUST_ROUNDS if job.fit.robust else 0):
        # only sums were kept: recordings with a cell that stands apart are balanced once more
        for i, mine in enumerate(trained):
            if weights := robust_weights(mine, posterior):
                take = (balancing or balanced)(
                    job, robot, channels, job.recordings[i], recordings[i], findings[i]
                )
                trained[i] = take.terms(take.train, frames, model, weights)
        terms = list(itertools.chain(*trained))
        posterior, _ = fit_all(terms, frames, kappa=posterior.kappa)
    steps.begin("holding out stretches")
    noise = posterior.noise
    normal = Normal.of(terms, posterior.unknowns)
    workbench, fitted = (
        Solution.of(posterior.unknowns, theta).completed(held, frames, noise)
        for theta in (offsets_alone(normal, noise), posterior.theta)
    )
    predicted = list(predictions(takes, frames, terms, posterior, workbench, fitted))
    pieces = [together(one) for one in predicted if not one.balance.by_mass]
    if not pieces:
        raise DataError(
            "nothing is held out: name `test` windows, or train on two stretches or more"
        )
    loads = load_envelope(np.concatenate([piece.model for piece in pieces]))
    all_of_them = score("all sub-models together", pieces, loads)
    sensors = tuple(
        sensor_result(
            robot,
            channel,
            frames,
            takes,
            predicted,
            posterior=posterior,
            solution=fitted,
            all_of_them=all_of_them,
        )
        for channel in channels
        if channel.sensor in posterior.unknowns.entries
    )
    return WholeBody(
        posterior,
        choice,
        frames,
        tuple(takes),
        workbench,
        fitted,
        all_of_them,
        sensors,
        tuple(residuals(takes, frames, workbench, fitted)),
        samples,
        float(np.mean(np.concatenate([term.weights for term in terms]) < 1.0)),
    )
