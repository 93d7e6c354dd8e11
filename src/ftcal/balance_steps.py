"""Steps of any sensor's offset, found in all balances of the robot at once.

A sensor that is never free has neighbours: every balance that it is part of (`ftcal.balances`)
must close with the same matrices and offsets. A step of its offset opens all of them by six sizes
that turn and lever as its readings do; no neighbour's step does quite that, unless the joints
between them stand still. Then the balances cannot tell, and both are said to step.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ftcal.balances import Balance
from ftcal.pairing import FtChannel
from ftcal.signals import SMOOTHING_ORDER
from ftcal.step_blocks import Blocks, Part, Problem
from ftcal.step_search import KAPPA, LEAST, StepFit
from ftcal.steps import Step, Unrest, search_untouched, touch_messages, unrest_in
from ftcal.terms import CHUNK, MODEL, Frame, ModelPrior, features

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray as Array

MOST_BLOCKS = 300
"""Blocks of a recording: all sensors share one search."""

TIE = 10.0
"""Twice the logarithm of how much likelier one sensor must be than another to be the one."""


def unrest_in_balances(
    balances: Sequence[Balance],
    channels: Sequence[FtChannel],
    frames: Mapping[str, Frame],
    *,
    smoothing: float,
    model: ModelPrior,
    breaks: Mapping[str, Sequence[float]],
) -> dict[str, Unrest]:
    """Return what disturbed each sensor, by its name; arguments are those of `balance_problem`.

    A step that another sensor explains as well is given to both, and the messages say so. A touch
    of a sub-model is one of every sensor on its border; one that enters by its mass departs from it
    whenever what is not logged moves, and nothing is said of that.
    """
    problem, sensors = balance_problem(
        balances, frames, smoothing=smoothing, model=model, breaks=breaks
    )
    by_name = {channel.sensor: channel for channel in channels}
    mine = [by_name[sensor] for sensor in sensors]
    fit, spans = search_untouched(problem)
    found = [unrest_in(fit, i, channel, smoothing) for i, channel in enumerate(mine)]
    steps = [list(one.steps) for one in found]
    for k, event in enumerate(fit.events):
        gains = fit.rivals(k)
        likely = np.flatnonzero(gains > max(0.0, gains[event.sensor] - TIE))
        others = [int(i) for i in likely if i != event.sensor]
        said = [event.sensor, *others]
        for i in others:
            events = (*fit.events[:k], replace(event, sensor=i), *fit.events[k + 1 :])
            refit = StepFit.of(fit.problem, events, fit.sd)
            steps[i] += at_time(unrest_in(refit, i, mine[i], smoothing).steps, event.time)
        for i in said if others else ():
            rivals = ", ".join(mine[j].signal for j in said if j != i)
            steps[i] = [
                replace(step, message=f"{step.message}; or else of {rivals}: balances do not tell")
                if step in at_time(steps[i], event.time) else step
                for step in steps[i]
            ]  # fmt: skip
    whole = {balance.sub_model for balance in balances if not balance.by_mass}
    touches = {
        sub_model: touch_messages(f"{sub_model}: touched? it", some)
        for sub_model, some in spans.items()
        if sub_model in whole
    }
    border = {balance.sub_model: balance.inputs for balance in balances}
    return {
        sensor: Unrest(
            tuple(steps[i]),
            (
                *found[i].touches,
                *(t for name, some in touches.items() if sensor in border[name] for t in some),
            ),
        )
        for i, sensor in enumerate(sensors)
    }


def at_time(steps: Iterable[Step], time: float) -> list[Step]:
    """Return the steps whose unsettled time holds a given one."""
    return [step for step in steps if step.unsettled[0] <= time < step.unsettled[1]]


def balance_problem(
    balances: Sequence[Balance],
    frames: Mapping[str, Frame],
    *,
    smoothing: float,
    model: ModelPrior,
    breaks: Mapping[str, Sequence[float]],
) -> tuple[Problem, tuple[str, ...]]:
    """Return the search for steps in balances smoothed over some seconds, and their sensors.

    Unknown besides: E of every sensor, its offset and drift, the steps of it that are known
    already (`breaks` [s]), and mass and centre of mass of every sub-model.
    """
    sensors = tuple(dict.fromkeys(name for one in balances for name in one.inputs))
    time = np.unique(np.concatenate([one.time for one in balances]))
    blocks = Blocks.of(time, smoothing, SMOOTHING_ORDER, most=MOST_BLOCKS)
    references = {
        name: np.concatenate([b.inputs[name] for b in balances if name in b.inputs]).mean(axis=0)
        for name in sensors
    }
    # what the offset of each sensor may do over time: drift, and step where that is known
    courses = {
        name: np.hstack([blocks.drift(), blocks.stepped(np.array(breaks.get(name, ())))])
        for name in sensors
    }
    places: dict[str, tuple[int, int]] = {}
    prior: list[Float[Array, "K"]] = []
    at = 0
    for name in sensors:
        wide, many = frames[name].unknowns, 6 * courses[name].shape[1]
        places[name] = (at, at + wide)
        prior += [np.full(wide, 1.0 / KAPPA), np.ones(many)]
        at += wide + many
    total = at + MODEL * len(balances)
    held = np.concatenate([*prior, np.ones(MODEL * len(balances))])
    parts: list[Part] = []
    owners: list[str] = []
    least: list[float] = []
    for index, balance in enumerate(balances):
        block, weight, table = block_features(blocks, balance, frames, references, model)
        for equation in range(balance.equations):
            mine = table[:, equation] * weight[:, None]
            rows = np.zeros((len(block), total))
            levers = {name: np.zeros((len(block), 6)) for name in sensors}
            start = 0
            for name in balance.inputs:
                here, after = places[name]
                wide = after - here
                rows[:, here:after] = mine[:, start : start + wide]
                lever = levers[name] = mine[:, start + wide : start + wide + 6]
                course = courses[name][block]
                turned = course[:, :, None] * lever[:, None, :]
                rows[:, after : after + 6 * course.shape[1]] = turned.reshape(len(block), -1)
                start += wide + 6
            rows[:, at + MODEL * index : at + MODEL * (index + 1)] = mine[:, start : start + MODEL]
            group = np.full(len(block), len(owners))
            parts.append(Part(block, group, rows, mine[:, -1], held, tuple(levers.values())))
            share = sum(np.mean((lever * LEAST) ** 2, axis=0).sum() for lever in levers.values())
            least.append(float(np.sqrt(share)))
            owners.append(balance.sub_model)
    whole = Part(
        np.concatenate([part.block for part in parts]),
        np.concatenate([part.group for part in parts]),
        np.concatenate([part.rows for part in parts]),
        np.concatenate([part.target for part in parts]),
        held,
        tuple(np.concatenate(some) for some in zip(*(p.levers for p in parts), strict=True)),
    )
    return Problem(blocks, (whole,), np.array(least), tuple(owners)), sensors


def block_features(
    blocks: Blocks,
    balance: Balance,
    frames: Mapping[str, Frame],
    references: Mapping[str, Float[Array, "P"]],
    model: ModelPrior,
) -> tuple[Int[Array, "R"], Float[Array, "R"], Float[Array, "R E D"]]:
    """Return the blocks of a balance, their weights and the means of features and target."""
    cell = np.searchsorted(blocks.start, balance.time, side="right") - 1
    opens = np.flatnonzero(np.diff(cell, prepend=-1))
    pieces = np.array_split(opens, max(1, min(len(opens), len(cell) // CHUNK)))
    ends = [*(int(piece[0]) for piece in pieces[1:]), len(cell)]
    found = []
    for piece, stop in zip(pieces, ends, strict=True):
        part = balance.rows(slice(int(piece[0]), stop))
        table = features(part, frames, references, model).transpose(1, 0, 2)
        found.append(np.add.reduceat(table, piece - piece[0], axis=0))
    counts = np.diff([*opens, len(cell)])
    means = np.concatenate(found) / counts[:, None, None]
    return cell[opens], np.sqrt(counts / counts.mean()), means
