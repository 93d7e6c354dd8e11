"""A study → one page of HTML: what to deploy first, then both validations as the paper has them.

Here are the words and the numbers; `ftcal/templates/study.html` has the order and the looks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import TYPE_CHECKING

from ftcal.evidence import provenance
from ftcal.first_validation import FirstValidation, Norm
from ftcal.preparation import Prepared
from ftcal.report.album import Album, Table
from ftcal.report.page import findings_lines, score_row
from ftcal.report.rendering import rendered
from ftcal.report.study_album import (
    axes_figure,
    leftover_figures,
    space_figure,
    truth_figure,
)
from ftcal.report.study_metrics import best_set, chosen_laws, chosen_left, truth_distances
from ftcal.report.study_paper import beside_the_paper
from ftcal.second_validation import BEST, MIXED, WORKBENCH, SecondValidation
from ftcal.sensor import AXES, UNITS
from ftcal.validate import Scores

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

    from ftcal.study import SensorStudy, StudyOutcome

GROUPS = ("all", "force", "torque", *AXES)
"""Axes that are scored together, in the order of the page."""


def study_html(outcome: StudyOutcome) -> str:
    """Return the report of a study as one self-contained page.

    Raises `SensorError` where a true gain is not of the shape of its Workbench matrix.
    """
    album = Album()
    takes = {take.name: take for take in outcome.recordings}
    sensors = [
        sensor_section(number, one, takes, outcome, album)
        for number, one in enumerate(outcome.sensors, 1)
    ]
    return rendered(
        "study.html",
        album,
        robot=outcome.robot.name,
        recordings=outcome.recordings,
        switching=outcome.job.study.switching,
        lambdas=outcome.job.study.lambdas,
        chains=outcome.sub_chains,
        sensors=sensors,
        papers=[found for one in outcome.sensors if (found := beside_the_paper(one)) is not None],
        health=[
            {"recording": take.name, "findings": findings_lines(take.findings)}
            for take in outcome.recordings
        ],
        provenance=provenance(
            outcome.job, outcome.robot, [take.digest for take in outcome.recordings]
        ),
        axes=list(zip(AXES, UNITS, strict=True)),
    )


def sensor_section(
    number: int,
    one: SensorStudy,
    takes: Mapping[str, Prepared],
    outcome: StudyOutcome,
    album: Album,
) -> Table:
    """Return all that the page says about one sensor; its figures go into the album in order."""
    name, first, second = one.channel.sensor, one.first, one.second
    gain = outcome.truth.get(name)
    return {
        "number": number,
        "name": name,
        "signal": one.channel.signal,
        "workbench": one.channel.workbench.name,
        "card": card(first, second),
        "first": first_sheets(first),
        "reasons": [
            *((s, "refused", reason) for s, reason in first.refused.items()),
            *((s, "dropped", reason) for s, reason in first.dropped.items()),
        ],
        "map": axes_figure(one, album),
        "space": space_figure(one, takes, album),
        "second": None if second is None else second_section(one, second, outcome, album),
        "best_axes": best_axes(first, second),
        "truth": None if gain is None else truth_section(one, gain, album),
    }


def card(first: FirstValidation, second: SecondValidation | None) -> Table:
    """Return the short of one sensor: which set trains best, what is left before and after."""
    best = best_set(first)
    made: Table = {"set": None, "second": None, "word": "refuse"}
    if best is not None:
        scores = first.held_out[best]
        made["set"] = {
            "name": first.sets[best].name,
            "percent": float(first.elsewhere()[best]),
            "better": best in first.surviving,
            "scores": [row for _, (row,) in held_out_rows([scores]) if row],
        }
        made["word"] = "accept" if best in first.surviving else "refuse"
    if second is not None:
        left = chosen_left(second)
        fair = second.unseen
        better = bool(fair) and fair[MIXED].force < fair[WORKBENCH].force
        made["second"] = {
            "sub_chain": second.sub_chain,
            "neighbours": second.neighbours,
            "seconds": second.seconds,
            "best": second.candidates[second.best],
            "rows": [(matrix, left[matrix], fair.get(matrix)) for matrix in left],
            "fair": bool(fair),
            "better": better,
        }
        if fair:
            made["word"] = "accept" if better else "refuse"
    return made


def first_sheets(first: FirstValidation) -> Table:
    """Return Table I in both norms, for all axes together and for each group of them."""

    def sheets(norm: Norm) -> list[Table]:
        return [
            {
                "group": group,
                "rows": percent_rows(first, norm, group),
                "elsewhere": first.elsewhere(norm, group).tolist(),
            }
            for group in GROUPS
        ]

    return {
        "heads": [
            (recording, [training.method for training in some])
            for recording, some in groupby(first.sets, key=lambda training: training.recording)
        ],
        "absolute": sheets("absolute"),
        "rms": sheets("rms"),
        "held_out": held_out_rows(first.held_out),
    }


def held_out_rows(scores: Sequence[Scores | None]) -> list[tuple[str, list[Table | None]]]:
    """Return force and torque on data not trained on, a training set a column."""
    return [
        (name, [None if one is None else score_row(one.by_name[name], None) for one in scores])
        for name in ("force", "torque")
    ]


def percent_rows(first: FirstValidation, norm: Norm, group: str) -> list[Table]:
    """Return the errors of all sets, a recording tested on a row."""
    percent = first.percent(norm, group)
    return [
        {
            "recording": recording,
            "judging": recording in first.judging,
            "cells": [
                {"value": float(percent[k, j]), "own": training.recording == recording}
                for k, training in enumerate(first.sets)
            ],
        }
        for j, recording in enumerate(first.recordings)
    ]


def second_section(
    one: SensorStudy, second: SecondValidation, outcome: StudyOutcome, album: Album
) -> Table:
    """Return Table II, the figures of what is left over, and the laws to deploy."""
    run = str(outcome.job.study.switching)
    schedule = next(r for r in outcome.job.recordings if r.label == run).schedule()
    workbench = one.channel.workbench
    secondary = workbench.secondary(second.mixed.coefficients[:, : workbench.gain.shape[1]])
    lambdas = outcome.job.study.lambdas
    sets = [(name, row) for name, row in second.by_set.items() if name != WORKBENCH]
    return {
        "sub_chain": second.sub_chain,
        "neighbours": second.neighbours,
        "seconds": second.seconds,
        "workbench": second.left[0],
        "rows": [(name, [row[penalty] for penalty in lambdas]) for name, row in sets],
        "least": {
            "force": min(left.force for left in second.left),
            "torque": min(left.torque for left in second.left),
        },
        "figures": leftover_figures(one.channel.sensor, run, second, schedule, album),
        "offsets": [(name, law.offset.tolist()) for name, law in chosen_laws(second).items()],
        "secondary": None
        if secondary is None
        else [
            (axis, unit, row.tolist(), name)
            for (axis, name, _), unit, row in zip(second.best_axes, UNITS, secondary, strict=True)
        ],
    }


def best_axes(first: FirstValidation, second: SecondValidation | None) -> list[Table]:
    """Return Table III: the best matrix of every axis in both validations."""
    again = [None] * 6 if second is None else second.best_axes
    return [
        {
            "axis": axis,
            "unit": unit,
            "set": name,
            "percent": percent,
            "second": found and {"name": found[1], "left": found[2]},
            "workbench": None if second is None else second.left[0].axes[i],
        }
        for i, ((axis, name, percent), unit, found) in enumerate(
            zip(first.best_per_axis(), UNITS, again, strict=True)
        )
    ]


def truth_section(one: SensorStudy, gain: Float[Array, "6 K"], album: Album) -> Table:
    """Return how far every matrix is from a known truth."""
    distances = truth_distances(one, gain)
    rows = [(name, value) for name, value in distances["sets"].items()]
    rows += [(name, distances[name]) for name in (BEST, MIXED) if distances[name] is not None]
    return {
        "workbench": distances[WORKBENCH],
        "rows": rows,
        "nearest": min([distances[WORKBENCH], *(value for _, value in rows)]),
        "figure": truth_figure(one, distances, album),
    }
