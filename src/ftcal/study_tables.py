"""What a person reads of a study in a terminal of 100 columns: who trains well, what is left."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from ftcal.first_validation import IN_SITU, FirstValidation
from ftcal.report.words import figures as digits
from ftcal.second_validation import BEST, MIXED, WORKBENCH, SecondValidation, SubChain
from ftcal.sensor import UNITS
from ftcal.study import SensorStudy, StudyOutcome
from ftcal.terminal import figures, table
from ftcal.validate import Scores


def print_study(console: Console, outcome: StudyOutcome) -> None:
    """Print both validations of every sensor, then the sub-chains of the robot."""
    for study in outcome.sensors:
        console.print(Text(study.channel.sensor, "bold"))
        console.print(first_table(study))
        for line in remarks(study.first):
            console.print(Padding(Text(line), (0, 0, 0, 2)))
        if study.second is not None:
            console.print(second_table(study.second, outcome.job.study.lambdas))
            console.print(Padding(Text(summary(study.second)), (0, 0, 1, 2)))
            console.print(axes_table(study))
    if outcome.sub_chains:
        console.print(Text("External wrench where nothing touches", "bold"))
        console.print(chain_table(outcome.sub_chains))


def remarks(first: FirstValidation) -> list[str]:
    """Return why sets were dropped, and why in situ offsets were refused: one line a reason."""
    recordings: dict[str, list[str]] = {}
    for name, refusal in first.refused.items():
        # the figures differ from recording to recording: the report has them
        recordings.setdefault(refusal.split(";")[0], []).append(name.removesuffix(IN_SITU))
    refused = [f"in situ offset of {', '.join(n)} refused: {r}" for r, n in recordings.items()]
    return [f"{name} dropped: {reason}" for name, reason in first.dropped.items()] + refused


def first_table(study: SensorStudy) -> Table:
    """Return the first validation, a training set a row, judged on what it did not train on."""
    first = study.first
    made = table("trained on", "|e|\nelsewhere", "worst\nelsewhere", "force\nRMS",
                 "90 %\ninterval", "torque\nRMS", "90 %\ninterval", "",
                 right=range(1, 7))  # fmt: skip
    percent = first.percent()
    made.columns[0].no_wrap = True
    for k, (one, mean) in enumerate(zip(first.sets, first.elsewhere(), strict=True)):
        others = [
            percent[k, j]
            for j, name in enumerate(first.recordings)
            if name in first.judging and name != one.recording
        ]
        made.add_row(
            Text(one.name),
            f"{digits(mean)} %" if others else "-",
            f"{digits(max(others))} %" if others else "-",
            *cells(first.held_out[k], "force"),
            *cells(first.held_out[k], "torque"),
            "dropped" if one.name in first.dropped else "",
        )
    return made


def cells(scores: Scores | None, name: str) -> tuple[str, str]:
    """Return the RMS percentage and its interval as cells."""
    if scores is None:
        return "-", "-"
    share, interval, *_ = figures(scores.by_name[name])
    return share, interval


def second_table(second: SecondValidation, lambdas: Sequence[float]) -> Table:
    """Return the mean external force by training set and penalty, as the paper's Table II."""
    made = table(f"force [N] at {second.sub_chain}", *(f"{p:g}" for p in lambdas),
                 right=range(1, len(lambdas) + 1))  # fmt: skip
    least = min(left.force for left in second.left)
    for name, row in second.by_set.items():
        # the Workbench knows no penalty: its one figure stands in the first column
        shown = [row[p].force if p in row else None for p in lambdas]
        made.add_row(
            Text(name),
            *(
                "-" if force is None else Text(f"{force:.2f}", "bold" if force == least else "")
                for force in shown
            ),
        )
    return made


def summary(second: SecondValidation) -> str:
    """Return what best and mixed leave over, also where they were not chosen."""
    chosen = {
        WORKBENCH: second.left[0],
        BEST: second.left[second.best],
        MIXED: second.mixed_left,
    }
    found = ", ".join(f"{name} {left.force:.2f} N" for name, left in chosen.items())
    fair = ", ".join(f"{name} {left.force:.2f} N" for name, left in second.unseen.items())
    return f"{found}; on pieces that did not choose: {fair}" if fair else found


def axes_table(study: SensorStudy) -> Table:
    """Return the best matrix of every axis in both validations, as the paper's Table III."""
    made = table("axis", "1st validation", "|e|", "2nd validation", "left over", right=(2, 4))
    second = study.second.best_axes if study.second else []
    for (axis, name, percent), (_, best, left), unit in zip(
        study.first.best_per_axis(), second, UNITS, strict=True
    ):
        made.add_row(axis, Text(name), f"{percent:.0f} %", Text(best), f"{left:.2f} {unit}")
    return made


def chain_table(chains: Sequence[SubChain]) -> Table:
    """Return what is left over in every free sub-chain, by the matrices that its sensors read."""
    matrices = list(chains[0].left)
    made = table("N / Nm", "sensors", "free", *matrices, right=range(2, 3 + len(matrices)))
    for chain in chains:
        left = [f"{one.force:.1f} / {one.torque:.2f}" for one in chain.left.values()]
        sensors = Text(" ".join(chain.sensors))
        made.add_row(Text(chain.name), sensors, f"{chain.seconds:.0f} s", *left)
    return made
