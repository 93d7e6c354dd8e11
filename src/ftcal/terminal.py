"""What a person reads in a terminal of 100 columns: verdict tables, log contents, findings.

Everything that comes from a log or a file is printed as text, never as markup.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from ftcal.delay import Delay
from ftcal.diagnosis import Diagnosis
from ftcal.extents import Extent
from ftcal.inspection import Inspection
from ftcal.recording import Finding, Recording
from ftcal.report.truth import Truth
from ftcal.report.words import figures as digits
from ftcal.report.words import percent, strength
from ftcal.robot import Robot
from ftcal.sensor import AXES
from ftcal.steps import Step
from ftcal.timeline import Phase, to_toml
from ftcal.validate import Score, Scores
from ftcal.verdict import Verdict, advice, overall

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

    from ftcal.one_sensor import SensorOutcome

STYLES = {"ACCEPT": "bold green", "PARTIAL": "bold yellow", "REFUSE": "bold red"}


def table(*headers: str, right: Iterable[int] = ()) -> Table:
    """Return an empty table; columns in `right` hold numbers."""
    made = Table(box=SIMPLE_HEAD, pad_edge=False, header_style="bold")
    aligned = set(right)
    for number, header in enumerate(headers):
        made.add_column(Text(header), justify="right" if number in aligned else "left")
    return made


def figures(score: Score) -> list[str]:
    """Return the figures of one score as cells: error, interval, both RMS, amplitude."""
    low, high = score.interval
    places = 1 if max(score.percent, high) < 10 else 0
    interval = "-" if high == float("inf") else f"{low:.{places}f}-{high:.{places}f}"
    return [
        f"{score.percent:.{places}f} %",
        interval,
        f"{digits(score.rms)} {score.unit}",
        f"{digits(score.workbench_rms)} {score.unit}",
        f"{score.amplitude:.2f}",
    ]


def print_sensor(console: Console, outcome: SensorOutcome) -> None:
    """Print the verdict, the table per axis and what the data could say of one sensor."""
    word = overall(outcome.verdicts)
    console.print(
        Text.assemble((outcome.sensor.name, "bold"), "  ", (word, STYLES[word])),
        Text(advice(outcome.verdicts)),
    )
    scores = outcome.scores
    if scores is not None:
        console.print(score_table(scores, outcome.verdicts))
    found = outcome.fit
    seen = found.excitation
    console.print(
        f"{found.samples} samples, {min(found.independent):.0f} to {max(found.independent):.0f}"
        f" independent; {seen.rank} of {len(seen.directions)} directions excited"
        + ("" if not found.down_weighted else f"; {percent(found.down_weighted)} count less")
    )
    console.print(Text(f"prior: {strength(found)}"))
    for reason in reasons(outcome.verdicts):
        console.print(Padding(Text(reason), (0, 0, 0, 2)))
    console.print()


def print_truth(console: Console, outcome: SensorOutcome, gain: Float[Array, "6 K"]) -> None:
    """Print how far a fit is from the truth that a simulation knows."""
    known = Truth.of(outcome, gain)
    before, after = 100 * known.workbench_rms, 100 * known.rms
    within = 100 * np.mean(np.abs(known.z) < 3)
    console.print(
        f"truth known: entries are off by {before:.2g} % of full scale (Workbench), {after:.2g} %"
        f" (in situ)\n             {within:.0f} % of them within three standard errors"
    )
    console.print()


def reasons(verdicts: Sequence[Verdict]) -> list[str]:
    """Return the reasons of all verdicts but ACCEPT, axes that share one named together.

    The figure that the table shows is left out.
    """
    axes: dict[tuple[str, str], list[str]] = {}
    for verdict in verdicts:
        if verdict.word != "ACCEPT":
            axes.setdefault((verdict.word, verdict.remark), []).append(verdict.axis)
    return [f"{word} {', '.join(names)}: {remark}" for (word, remark), names in axes.items()]


def score_table(scores: Scores, verdicts: Sequence[Verdict] | None = None) -> Table:
    """Return the scores of one validation, an axis a row."""
    made = table(
        *(scores.kind, *(["verdict"] if verdicts else [])),
        *("error, of\nWorkbench", "90 %\ninterval", "RMS\nin situ", "RMS\nWorkbench"),
        *("amplitude\nratio", "beyond\ntraining"),
        right=range(2 if verdicts else 1, 8),
    )
    words = {verdict.axis: verdict.word for verdict in verdicts or ()}
    for name in (*AXES, "force", "torque"):
        score = scores.by_name[name]
        word = words.get(name, "")
        beyond = percent(score.beyond) if score.beyond else "-"
        judged = [Text(word, STYLES.get(word, ""))] if verdicts else []
        made.add_row(name, *judged, *figures(score), beyond)
        if name == AXES[-1]:
            made.add_section()
    return made


EACH = {"offset step", "touch"}
"""Kinds of findings that are told one by one: it matters when each of them was."""


def print_findings(console: Console, findings: Sequence[tuple[str, Finding]]) -> None:
    """Print what the data doctor found, one line for each kind and signal, what is cut first.

    Where stretches are cut, the note that sums them up is their line.
    """
    cut = {(recording, one.signal, one.kind) for recording, one in findings if one.cut}
    sums: dict[tuple[str, str, str], Finding] = {}
    groups: dict[tuple[bool, str, str, str, float], list[Finding]] = {}
    for recording, finding in findings:
        named = (recording, finding.signal, finding.kind)
        if not finding.cut and named in cut:
            sums[named] = finding
            continue
        when = finding.start if finding.kind in EACH else 0.0
        key = (not finding.cut, *named, when)
        groups.setdefault(key, []).append(finding)
    if not groups:
        return
    console.print(Text("data health", "bold"))
    lines = Table.grid(padding=(0, 2))
    for (kept, recording, signal, kind, _), found in sorted(groups.items()):
        summary = None if kept else sums.get((recording, signal, kind))
        message = (summary or found[0]).message.removeprefix(f"{signal}: ")
        if summary is not None:
            message += f"; between {summary.start:.2f} and {summary.stop:.2f} s"
        elif len(found) > 1:
            lengths = [finding.stop - finding.start for finding in found]
            message = (
                f"{kind} {len(found)} times, {sum(lengths):.1f} s in all, longest"
                f" {max(lengths):.2f} s"
            )
        lines.add_row("note" if kept else "cut", Text(recording), Text(f"{signal}: {message}"))
    console.print(lines)
    console.print()


def print_recording(
    console: Console, recording: Recording, extents: Iterable[Extent], robot: Robot | None
) -> None:
    """Print what is in a log: signals, rates, spans, and what of it the robot knows."""
    console.print(
        Text.assemble((recording.name, "bold"), f"  {recording.duration:.1f} s, {recording.source}")
    )
    made = table("signal", "kind", "columns", "samples", "rate", "start", "stop", right=range(2, 7))
    for extent in extents:
        made.add_row(Text(extent.name), KINDS[extent.role], *spans(extent))
    console.print(made)
    if robot is not None:
        print_matches(console, recording, robot)


KINDS = {"joints": "joints", "channels": "F/T", "temperatures": "temperature", "imus": "IMU"}
"""What a role is called in a table."""


def spans(extent: Extent) -> list[str]:
    """Return the cells that say how much of a signal there is."""
    rate = "-" if extent.rate is None else f"{extent.rate:.1f} Hz"
    ends = ["-" if end is None else f"{end:.2f} s" for end in (extent.start, extent.stop)]
    return [str(len(extent.columns)), str(extent.samples), rate, *ends]


def print_matches(console: Console, recording: Recording, robot: Robot) -> None:
    """Print which joints and sensors of the robot the log has."""
    logged = {column for signal in recording.joints for column in signal.columns}
    known = [joint for joint in robot.moving_joints if joint in logged]
    missing = [joint for joint in robot.moving_joints if joint not in logged]
    console.print(
        Text(
            f"robot {robot.name}: {robot.mass:.2f} kg,"
            f" {len(known)} of {len(robot.moving_joints)} joints logged"
        )
    )
    lines = Table.grid(padding=(0, 2))
    if missing:
        lines.add_row("not logged", Text(", ".join(missing)))
    if strangers := sorted(logged - set(robot.joints)):
        lines.add_row("not in the robot", Text(", ".join(strangers)))
    for sensor in robot.sensors.values():
        lines.add_row(
            Text(sensor.name),
            Text(
                f"F/T sensor between {sensor.parent} and {sensor.child}, wrench on the"
                f" {sensor.acts_on} in the {sensor.frame} frame"
            ),
        )
    console.print(lines)
    console.print()


def print_diagnosis(console: Console, diagnosis: Diagnosis) -> None:
    """Print which hypothesis explains a log best: a line for each sensor, each part, each rival."""
    console.print(Text(f"diagnosis with robot {diagnosis.robot}", "bold"))
    lines = Table.grid(padding=(0, 2))
    for sensor in diagnosis.sensors:
        lines.add_row(Text(sensor.sensor), Text(sensor.told))
    console.print(lines)
    made = table("free part", "misfit", "force\nleft", "of its\nload", "torque\nleft",
                 "of its\nload", right=range(1, 6))  # fmt: skip
    for part in diagnosis.parts:
        cells = [f"{part.misfit[0]:.2f}"]
        for left, load, unit in zip((part.force, part.torque), part.load, ("N", "Nm"), strict=True):
            share = f"{100 * left[0] / load:.0f} %" if load > 0 else "-"
            cells += [f"{digits(left[0])} {unit}", share]
        rests = f"; {len(part.resting)} joints not logged" if part.resting else ""
        made.add_row(Text(f"{part.frame} ({', '.join(part.sensors)}{rests})"), *cells)
    console.print(made)
    for rival in diagnosis.rivals:
        text = f"{rival.robot}: {rival.words}"
        if rival.ratios is not None:
            low, high = rival.ratios
            text += f" (misfits {low:.2f} to {high:.2f} times as large)"
        console.print(Text(text), soft_wrap=True)
    console.print(Text(f"{diagnosis.word}: {diagnosis.sentence}"), soft_wrap=True)


def print_noticed(
    console: Console, delays: Iterable[Delay], steps: Mapping[str, Sequence[Step]]
) -> None:
    """Print delays between joints and F/T signals, and steps of offsets with what to do."""
    for delay in delays:
        console.print(Text(delay.message), soft_wrap=True)
    for sensor, some in steps.items():
        for step in some:
            console.print(Text(f"{sensor}: {step.message}"), soft_wrap=True)
    # one key of the recording: TOML has no second `breaks`
    found = [
        f"{sensor} = [{', '.join(f'{step.time:.2f}' for step in some)}]"
        for sensor, some in steps.items()
        if some
    ]
    if found:
        console.print(Text(f"  breaks = {{ {', '.join(found)} }}"), soft_wrap=True)


def print_inspection(console: Console, seen: Inspection) -> None:
    """Print what a log shows."""
    print_recording(console, seen.recording, seen.extents, seen.robot)
    print_findings(console, [(seen.recording.name, finding) for finding in seen.findings])
    if seen.phases:
        print_phases(console, seen.phases)
        if seen.contacts is not None:
            console.print(Text("proposed for the recording in the job file:"))
            text = to_toml(seen.contacts, duration=seen.recording.duration)
            console.print(Text(text), soft_wrap=True)
    if seen.diagnosis is not None:
        print_diagnosis(console, seen.diagnosis)
        print_noticed(console, seen.delays, seen.steps or {})


def print_phases(console: Console, phases: Sequence[Phase]) -> None:
    """Print who stood when."""
    made = table("contact", "start", "stop", "feet", right=(1, 2))
    for phase in phases:
        span = f"{phase.start:.2f} s", f"{phase.stop:.2f} s"
        made.add_row(phase.kind, *span, Text(", ".join(phase.feet)))
    console.print(made)
