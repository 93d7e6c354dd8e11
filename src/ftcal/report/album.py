"""The figures of one page: each with its caption, in the order in which the page shows them."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any, Literal

from ftcal import plots
from ftcal.one_sensor import SensorOutcome
from ftcal.pairing import SignalOptions
from ftcal.plots import POINTS, Figure, Piece
from ftcal.segments import Segment
from ftcal.takes import Glimpses
from ftcal.validate import HeldOut, Scores, held_out

Table = dict[str, Any]
"""What a template takes."""

THINNED = (
    f" Curves of more than {POINTS} points are thinned to the least and greatest value of every"
    " bin."
)

SAFE_IN_SCRIPT = str.maketrans(
    {"<": "\\u003c", ">": "\\u003e", "&": "\\u0026", "\u2028": "\\u2028", "\u2029": "\\u2029"}
)
"""JSON in a script element must not be able to end it."""


class Album:
    """The figures of a page in order, each known by the id of its place."""

    def __init__(self) -> None:
        self.figures: dict[str, Figure] = {}

    def add(self, figure: Figure, caption: str) -> Table:
        """Take a figure in; return what the template needs to make room for it."""
        name = f"figure-{len(self.figures) + 1}"
        self.figures[name] = figure
        return {"id": name, "caption": caption, "height": figure["layout"]["height"]}

    def json(self) -> str:
        """Return all figures as JSON that is safe in a script element."""
        return json.dumps(self.figures, allow_nan=False).translate(SAFE_IN_SCRIPT)


def one_in(steps: Iterable[int], what: str) -> str:
    """Return how few samples of long recordings are kept for the eye; nothing where all are."""
    every = sorted(set(steps))
    if every[-1] == 1:
        return ""
    return f" One {what} in {' to '.join(map(str, dict.fromkeys([every[0], every[-1]])))} is drawn."


def drawn(steps: Iterable[int]) -> str:
    """Return what curves leave out: samples that were not kept, and points too many to draw."""
    return one_in(steps, "sample") + THINNED


def wrench_figures(
    outcome: SensorOutcome, logs: Glimpses, options: SignalOptions, album: Album
) -> list[Table]:
    """Return the figures of wrenches: in time per recording, smoothing, forces in space."""
    name = outcome.sensor.name
    gain = outcome.fit.estimate.coefficients
    roles: tuple[tuple[Literal["train", "test"], tuple[Segment, ...]], ...] = (
        ("train", outcome.training),
        ("test", outcome.test),
    )
    pieces = [
        Piece(role, held_out(segment, gain, outcome.channel.workbench))
        for role, segments in roles
        for segment in segments
    ]
    made = []
    for paired in outcome.paired:
        label = paired.samples.recording
        inside = [piece for piece in pieces if piece.reading.recording == label]
        step = round(paired.usable / max(len(paired.samples), 1))
        made.append(
            album.add(
                plots.wrench_in_time(name, paired.samples, inside),
                f"Recording {label}: force [N] and torque [Nm] at {name}. Broad grey: what the"
                " robot model expects. Dotted vermillion: Workbench. Thin blue: in situ, as fitted"
                " (before refused axes went back to the Workbench). Both readings get the offset"
                " that fits each shaded window best. Gaps are samples that were not usable."
                + drawn([step, *(piece.reading.step for piece in inside)]),
            )
        )
    longest = max((*outcome.test, *outcome.training), key=len).samples
    span = plots.glimpse_in(float(longest.time[0]), float(longest.time[-1]))
    around = (span[0] - options.smoothing, span[1] + options.smoothing)
    glimpse = logs.between(longest.recording, *around)
    made.append(
        album.add(
            plots.smoothing_effect(glimpse, outcome.channel, options, span),
            f"Recording {longest.recording}, a few seconds of {outcome.channel.signal} as the"
            " Workbench reads it [N, Nm]: the filter that channels and model share takes the noise"
            " that would bias the regression towards zero.",
        )
    )
    if pieces:
        made.append(
            album.add(
                plots.forces_in_space(name, pieces),
                f"Force [N] at {name} in all windows of"
                f" {', '.join(p.samples.recording for p in outcome.paired)}, a regular selection of"
                " samples. Drag to turn.",
            )
        )
    return made


def residual_figures(name: str, scores: Scores | None, album: Album) -> list[Table]:
    """Return the figures of held-out residuals: in time per recording, then their distribution."""
    if scores is None:
        return []
    by_recording: dict[str, list[HeldOut]] = {}
    for piece in scores.pieces:
        by_recording.setdefault(piece.recording, []).append(piece)
    made = [
        album.add(
            plots.residuals_in_time(name, scores.kind, some),
            f"Recording {label}: sensor minus model [N, Nm] at {name}, {scores.kind}."
            + drawn(piece.step for piece in some),
        )
        for label, some in by_recording.items()
    ]
    made.append(
        album.add(
            plots.residual_spread(name, scores.kind, scores.pieces),
            f"Recording{'s' * (len(by_recording) > 1)} {', '.join(by_recording)}: how the"
            f" {scores.kind} residuals at {name} are spread [N, Nm]; narrow is good."
            + one_in([piece.step for piece in scores.pieces], "sample"),
        )
    )
    return made


def knowledge_figures(outcome: SensorOutcome, album: Album) -> Table:
    """Return the figures of what the data excite and of how the prior was chosen."""
    names = ", ".join(dict.fromkeys(one.samples.recording for one in outcome.training))
    choice = outcome.fit.choice
    return {
        "directions": album.add(
            plots.directions(names, outcome.fit.excitation),
            f"Training data of {names}. Left: standard deviation [% of full scale] along each"
            " direction of the channels, named by the wrench it makes; the black tick is the noise"
            " along it, a hatched bar does not rise above three times that noise. Right: how much"
            " of the estimate is the data's [%]; the rest is the prior's.",
        ),
        "curve": None
        if choice is None
        else album.add(
            plots.prior_curve(names, choice),
            f"Training data of {names}: held-out RMS error [% of Workbench] against kappa [fraction"
            " of full scale]. Blocks in time were held out; the weakest prior within 0.2 %"
            " of the least geometric mean is chosen.",
        ),
    }
