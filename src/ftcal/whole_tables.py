"""What a person reads of a fit of all sensors in a terminal of 100 columns.

The verdict on all together first, then on each sensor, then the robot: what is left over where
nothing touches, and what it weighs on its own sensors.
"""

from __future__ import annotations

import numpy as np
from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from ftcal.judging import SensorResult
from ftcal.report.tried_words import BELIEVED, found_words, suspect_words, unseen
from ftcal.report.whole_metrics import means, move_words, on_the_prior, undetermined
from ftcal.report.words import figures, percent
from ftcal.sensor import AXES
from ftcal.terminal import EACH, STYLES, print_findings, reasons, score_table, table
from ftcal.verdict import advice, overall
from ftcal.whole_pipeline import WholeOutcome

EXPLAINED = (
    "evidence: logarithm of how much more probable the data are with it (5 nats: 150 times)\n"
    "held-out RMS: change of what is left over on stretches that were left out\n"
    "moves most: entry (row, column) of a matrix [% of full scale] if it is off by one sd of its"
    " prior\ninertia, which always takes part: mass, then centre of mass x, y, z"
)
"""The columns of the errors of the model that were tried."""


def print_whole(console: Console, outcome: WholeOutcome) -> None:
    """Print steps and touches, verdicts on all together and every sensor, leftovers and masses."""
    print_findings(console, [pair for pair in outcome.findings if pair[1].kind in EACH])
    print_together(console, outcome)
    for result in outcome.fit.sensors:
        print_result(console, result)
    for name in undetermined(outcome):
        console.print(Text(f"{name}: in no balance trained on; keep the Workbench"))
    console.print(Text("Left over where nothing touches", "bold"))
    console.print(left_table(outcome))
    if outcome.weighings:
        described = f"the description says {outcome.robot.mass:.2f} kg"
        console.print(Text.assemble(("Mass on its own sensors", "bold"), f", {described}"))
        console.print(mass_table(outcome))
    if outcome.tried:
        told = ", each beside the sensors and all that is believed"
        console.print(Text.assemble(("Errors of the model that were tried", "bold"), told))
        console.print(tried_table(outcome))
        console.print(Text(EXPLAINED))
        if silent := unseen(outcome.tried):
            console.print(Text(f"the data say nothing of: {', '.join(silent)}"))
        console.print()
    posterior, choice = outcome.fit.posterior, outcome.fit.choice
    down = outcome.fit.down_weighted
    less = f", {percent(down)} of their seconds count less" if down else ""
    console.print(
        f"{outcome.fit.samples} samples of balances{less}; the data determine"
        f" {posterior.spent:.0f} of {posterior.unknowns.prior} entries, the prior the rest"
    )
    console.print(
        f"prior: kappa = {posterior.kappa:.3g}: entries are believed to lie within"
        f" {percent(posterior.kappa)} of full scale of the Workbench"
        + ("" if choice is None else " (chosen by held-out stretches)")
    )
    console.print()


def print_together(console: Console, outcome: WholeOutcome) -> None:
    """Print whether the matrices are used, which they are together or not at all, and why."""
    use = "use the new matrices" if outcome.improved else "keep the Workbench matrices"
    console.print(Text.assemble(("All sensors", "bold"), f": {use}, together or not at all"))
    shares = []
    for kind in ("force", "torque"):
        score = outcome.fit.together.by_name[kind]
        low, high = score.interval
        shares.append(f"{kind} {score.percent:.1f} % [{low:.1f}, {high:.1f}]")
    console.print(Text(f"left over, held out, of the Workbench's: {', '.join(shares)}"))
    console.print(Text("in brackets the 90 % interval; that of the force must end below 100 %"))
    console.print()


def print_result(console: Console, result: SensorResult) -> None:
    """Print the verdict, the table per axis and what rests on the prior of one sensor."""
    word = overall(result.verdicts)
    console.print(
        Text.assemble((result.sensor.name, "bold"), "  ", (word, STYLES[word])),
        Text(advice(result.verdicts)),
    )
    console.print(score_table(result.scores, result.verdicts))
    for reason in reasons(result.verdicts):
        console.print(Padding(Text(reason), (0, 0, 0, 2)))
    weak = on_the_prior(result)
    if everywhere := [name for name, rows in weak.items() if len(rows) == len(AXES)]:
        line = f"every row rests on the Workbench along {', '.join(everywhere)}"
        console.print(Padding(Text(line), (0, 0, 0, 2)))
    console.print()


def left_table(outcome: WholeOutcome) -> Table:
    """Return the mean force and torque left over, a sub-model and kind of stretch a row."""
    made = table("sub-model", "contacts", "stretches", "force\nWorkbench", "force\nnew",
                 "torque\nWorkbench", "torque\nnew", right=(1, 3, 4, 5, 6))  # fmt: skip
    for one in means(outcome):
        torque = [f"{figures(left[1])} Nm" if one.equations == 6 else "-"
                  for left in (one.workbench, one.whole_body)]  # fmt: skip
        made.add_row(
            Text(one.sub_model),
            str(one.touching),
            "held out" if one.held_out else "trained on",
            f"{figures(one.workbench[0])} N",
            f"{figures(one.whole_body[0])} N",
            *torque,
        )
    return made


def mass_table(outcome: WholeOutcome) -> Table:
    """Return the mass that the sensors read in every stretch."""
    made = table("recording", "start", "stop", "touching", "Workbench", "new", right=(1, 2, 4, 5))
    for one in outcome.weighings:
        made.add_row(
            Text(one.recording),
            f"{one.start:.1f} s",
            f"{one.stop:.1f} s",
            Text(", ".join(one.touching)),
            f"{one.workbench:.2f} kg",
            f"{one.whole_body:.2f} kg",
        )
    return made


def tried_table(outcome: WholeOutcome) -> Table:
    """Return what became of every suspected error of the model that the data see, a row each."""
    made = table("suspected", "found", "evidence\n[nats]", "held-out\nRMS", "believed",
                 "moves most", right=(1, 2, 3))  # fmt: skip
    made.padding, made.show_edge = (0, 1, 0, 0), False
    made.columns[1].no_wrap = made.columns[5].no_wrap = True
    for one in outcome.tried:
        if one.seen:
            made.add_row(
                Text(suspect_words(one)),
                "\n".join(found_words(one)),
                f"{one.gain:+z.1f}",
                "-" if np.isnan(one.held_out) else f"{100 * one.held_out:+z.1f} %",
                BELIEVED[one.word],
                Text(f"{one.moves[0].percent:.1f} % {move_words(one.moves[0], outcome.fit)}"),
            )
    return made
