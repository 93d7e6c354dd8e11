"""May the new matrix be trusted? One verdict per axis, with its reason.

* ACCEPT: the data moved in every direction, and held-out samples say the axis is better.
* PARTIAL: better on held-out samples, but named directions rest on the prior alone.
* REFUSE: the axis keeps its Workbench row.

What the data cannot say comes first: cross-validation does not see it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from ftcal.excitation import Excitation
from ftcal.sensor import AXES
from ftcal.validate import Score, Scores

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

LEAST_LOAD = 0.01
"""An axis trained on loads below this share of full scale is not shown to be right beyond them."""

LEAST_READING = 0.3
"""Least squares that leaves less of the Workbench's reading of an axis has fitted noise."""

Word = Literal["ACCEPT", "PARTIAL", "REFUSE"]


@dataclass(frozen=True, slots=True)
class Verdict:
    """What to do with one axis."""

    axis: str
    word: Word
    reason: str
    """One line a person can act on."""
    figure: str = ""
    """The held-out error that the reason starts from, where there is one."""

    @property
    def remark(self) -> str:
        """The reason without its figure, for a table that shows it."""
        return self.reason.removeprefix(self.figure).removeprefix("; ")

    @property
    def use(self) -> bool:
        """Whether the new row goes into the calibration."""
        return self.word != "REFUSE"


def identifiable(excitation: Excitation, axis: int) -> Verdict:
    """Return what the training data alone can say about an axis, before any error is looked at."""
    name = AXES[axis]
    if excitation.rank == 0:
        return Verdict(name, "REFUSE", "no direction of the channels moved beyond its noise")
    if excitation.scale_is_free:
        return Verdict(
            name,
            "REFUSE",
            f"scale gauge: the model wrench varies by {100 * excitation.amplitude:.1f} % of the"
            " Workbench's reading, so C -> 0 would leave no more than that; record a motion that"
            " turns the free half in gravity, or a known weight",
        )
    parts = []
    if excitation.unexcited:
        count = len(excitation.unexcited)
        words = ", ".join(direction.words for direction in excitation.unexcited)
        parts.append(f"{count} direction{'s' * (count > 1)} not excited: {words}")
    if weak := excitation.weak(axis):
        parts.append(f"prior outweighs the data along {', '.join(d.words for d in weak)}")
    if parts:
        return Verdict(name, "PARTIAL", "; ".join(parts))
    return Verdict(name, "ACCEPT", "the data speak in every direction")


def judge(
    excitation: Excitation, scores: Scores | None, full_scale: Float[Array, "6"]
) -> tuple[Verdict, ...]:
    """Return the verdict on every axis from what could be known and from held-out samples.

    An axis that was trained on less than `LEAST_LOAD` of its `full_scale` [N, Nm] is PARTIAL.
    """
    verdicts = []
    for axis, name in enumerate(AXES):
        known = identifiable(excitation, axis)
        if known.word == "REFUSE":
            verdicts.append(known)
        elif scores is None:
            reason = "not validated: too little data to hold any out"
            verdicts.append(Verdict(name, "REFUSE", reason))
        else:
            limit = float(full_scale[axis])
            found = scores.by_name[name]
            verdicts.append(weigh(known, found, scores.kind, limit, excitation.anchored))
    return tuple(verdicts)


def weigh(known: Verdict, score: Score, kind: str, full_scale: float, anchored: bool) -> Verdict:
    """Return the verdict on one axis whose held-out error is known."""
    name = known.axis
    partial = known.word == "PARTIAL"
    if partial and not anchored and score.amplitude < LEAST_READING:
        why = (
            f"the reading shrinks to {100 * score.amplitude:.0f} %: noise fills what is not"
            " excited; give kappa instead of lambda"
        )
        return Verdict(name, "REFUSE", f"{why} ({known.reason})")
    low, high = score.interval
    figure = f"{score.percent:.0f} % of Workbench on {kind} [{low:.0f}, {high:.0f}]"
    if not high < 100.0:
        why = doubt(low, high)
        return Verdict(name, "REFUSE", f"{figure}; {why}", figure)
    limits = [known.reason] if partial else []
    load = max(map(abs, score.trained)) / full_scale
    if load < LEAST_LOAD:
        limits.append(f"trained on {100 * load:.1f} % of full scale, not shown to hold beyond")
    if limits:
        return Verdict(name, "PARTIAL", "; ".join([figure, *limits]), figure)
    return Verdict(name, "ACCEPT", figure, figure)


def doubt(low: float, high: float) -> str:
    """Return why an interval [%] that does not end below the Workbench's 100 % speaks against."""
    if low > 100.0:
        return "worse than the Workbench"
    if high == math.inf:
        return "too little is held out to tell: not shown to be better than the Workbench"
    return "the interval reaches 100 %: not shown to be better than the Workbench"


def overall(verdicts: Sequence[Verdict]) -> Word:
    """Return ACCEPT where every axis is, REFUSE where every axis is, PARTIAL between."""
    words = {verdict.word for verdict in verdicts}
    if len(words) == 1:
        return words.pop()
    return "PARTIAL"


def advice(verdicts: Sequence[Verdict]) -> str:
    """Return one line that says what to do: `use fy, fz, tx; keep the Workbench for fx, ty, tz`."""
    use = [verdict.axis for verdict in verdicts if verdict.use]
    keep = [verdict.axis for verdict in verdicts if not verdict.use]
    if not keep:
        return "use the new matrix on every axis"
    if not use:
        return "keep the Workbench matrix on every axis"
    return f"use {', '.join(use)}; keep the Workbench for {', '.join(keep)}"
