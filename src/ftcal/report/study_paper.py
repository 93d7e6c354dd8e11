"""One sensor's tables beside those that the paper printed, for recordings named as its data sets.

Nothing is shown unless the sensor is in a right leg, as the paper's was, and two names match: a
number beside one of another kind of sensor would only mislead.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ftcal.first_validation import FirstValidation
from ftcal.report import published
from ftcal.report.album import Table
from ftcal.second_validation import SecondValidation
from ftcal.sensor import UNITS

if TYPE_CHECKING:
    from ftcal.study import SensorStudy

FEWEST = 2
"""Recordings that must be named as the paper's before anything is compared."""


def beside_the_paper(one: SensorStudy) -> Table | None:
    """Return Tables I to III of one sensor beside the paper's, or None where nothing compares."""
    names = published.matched(one.first.recordings)
    if len(names) < FEWEST or not published.is_right_leg(one.channel.sensor):
        return None
    return {
        "name": one.channel.sensor,
        "matched": names,
        "first": percent_table(one.first, names),
        "second": None if one.second is None else force_table(one.first, one.second, names),
        "axes": axes_table(one.first, one.second),
    }


def percent_table(first: FirstValidation, names: dict[str, str]) -> Table:
    """Return Table I, ours of either method over the paper's, which says no method."""
    percent = first.percent()
    found = {(s.recording, s.method): k for k, s in enumerate(first.sets)}

    def cell(tested: str, trained: str) -> Table:
        printed = published.PERCENT[tested][published.DATA_SETS.index(trained)]
        row = first.recordings.index(names[tested])
        centred = found.get((names[trained], "centred"))
        in_situ = found.get((names[trained], "in situ"))
        return {
            "printed": printed,
            "misprint": printed < published.MISPRINT,
            "centred": None if centred is None else float(percent[centred, row]),
            "in_situ": None if in_situ is None else float(percent[in_situ, row]),
        }

    return {
        "columns": list(names),
        "rows": [(tested, [cell(tested, trained) for trained in names]) for tested in names],
    }


def force_table(first: FirstValidation, second: SecondValidation, names: dict[str, str]) -> Table:
    """Return Table II, ours of either method over the paper's, where the penalties agree."""
    rows = second.by_set
    printed = {
        theirs: dict(zip(published.LAMBDAS, published.FORCE[theirs], strict=True))
        for theirs in names
        if theirs in published.FORCE
    }

    def force(recording: str, method: str, penalty: float) -> float | None:
        mine = (s.name for s in first.sets if (s.recording, s.method) == (recording, method))
        left = rows.get(next(mine, ""), {}).get(penalty)
        return None if left is None else left.force

    return {
        "lambdas": published.LAMBDAS,
        "workbench": second.left[0].force,
        "printed_workbench": published.WORKBENCH_FORCE,
        "rows": [
            (
                theirs,
                [
                    {
                        "printed": value,
                        "centred": force(names[theirs], "centred", penalty),
                        "in_situ": force(names[theirs], "in situ", penalty),
                    }
                    for penalty, value in row.items()
                ],
            )
            for theirs, row in printed.items()
        ],
        "best": ratio(second.left[second.best].force, second.left[0].force),
        "printed_best": ratio(
            float(np.min(list(published.FORCE.values()))), published.WORKBENCH_FORCE
        ),
    }


def ratio(least: float, workbench: float) -> float:
    """Return how much less than the Workbench's a mean is, as a fraction."""
    return 1.0 - least / workbench if workbench > 0 else 0.0


def axes_table(first: FirstValidation, second: SecondValidation | None) -> list[Table]:
    """Return Table III, ours and the paper's side by side."""
    again = [None] * 6 if second is None else second.best_axes
    return [
        {
            "axis": axis,
            "unit": unit,
            "ours": (name, percent, found and found[1], found and found[2]),
            "printed": published.AXES[axis],
        }
        for (axis, name, percent), found, unit in zip(
            first.best_per_axis(), again, UNITS, strict=True
        )
    ]
