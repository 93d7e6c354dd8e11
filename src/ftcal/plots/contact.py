"""Load on each foot in time, on bands that say who stood: to check a proposed timeline by eye."""

from __future__ import annotations

from typing import Any

from ftcal.plots.figure import (
    BLUE,
    GREY,
    ORANGE,
    SKY,
    VERMILLION,
    Figure,
    base_layout,
    curve,
    plain,
    plain_axis,
)
from ftcal.timeline import Phase, Timeline

BANDS = {"support": SKY, "brushing": ORANGE, "double": "#ffffff", "unknown": GREY}
"""Colour behind each kind of phase; a word says the same again where there is room."""

LINES = ((BLUE, "solid"), (VERMILLION, "dot"))
"""Colour and dash of the first and the second foot."""

WRITTEN = 0.04
"""Share of the log from which a phase is long enough for its word."""


def contact_timeline(timeline: Timeline, name: str) -> Figure:
    """Return the vertical load of both feet over their phases; `name` is the recording's."""
    layout = base_layout(f"Contacts proposed: {name}", 420)
    # words stand above the curves, the legend below the axis
    layout["margin"]["b"] = 96
    layout["legend"] |= {"y": -0.2, "yanchor": "top"}
    first, last = timeline.phases[0].start, timeline.phases[-1].stop
    layout["xaxis"] = plain_axis("time [s]", range=[first, last], zeroline=False)
    layout["yaxis"] = plain_axis("load on the foot [N]")
    layout["shapes"] = [band(phase) for phase in timeline.phases]
    layout["annotations"] = [
        word(phase)
        for phase in timeline.phases
        if phase.stop - phase.start >= WRITTEN * (last - first)
    ]
    traces = []
    for foot, (colour, dash) in zip(timeline.feet, LINES, strict=True):
        zero = "" if foot.free else ", zero unknown: never lifted"
        label = plain(f"{foot.place.frame} ({foot.place.sensor}{zero})")
        traces.append(
            curve(timeline.time, foot.load, 0, {"color": colour, "dash": dash, "width": 1.5}, label)
        )
    return {"data": traces, "layout": layout}


def band(phase: Phase) -> dict[str, Any]:
    """Return the background of one phase."""
    return {
        "type": "rect",
        "xref": "x",
        "yref": "paper",
        "x0": phase.start,
        "x1": phase.stop,
        "y0": 0,
        "y1": 1,
        "fillcolor": BANDS[phase.kind],
        "opacity": 0.25,
        "layer": "below",
        "line": {"width": 0.5, "color": GREY},
    }


def word(phase: Phase) -> dict[str, Any]:
    """Return the kind of a phase, and who stands alone, written above it."""
    stands = f"<br>{plain(phase.feet[0])}" if phase.kind == "support" else ""
    return {
        "x": (phase.start + phase.stop) / 2,
        "y": 1,
        "xref": "x",
        "yref": "paper",
        "yanchor": "bottom",
        "showarrow": False,
        "text": f"{phase.kind}{stands}",
    }
