"""Data health in time: one row a signal, what the data doctor found as spans on it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ftcal.plots.figure import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    VERMILLION,
    YELLOW,
    Figure,
    base_layout,
    plain,
    plain_axis,
    wrapped,
)
from ftcal.recording import Finding, Recording

KINDS: dict[str, tuple[str, str]] = {
    "frozen": (BLUE, "/"),
    "saturated": (VERMILLION, "x"),
    "gap": (PURPLE, "|"),
    "session": (GREY, "|"),
    "clock jump": (YELLOW, "+"),
    "duplicate stamps": (SKY, "."),
    "truncated": (GREY, "\\"),
    "lost packets": (ORANGE, "."),
    "empty": (GREY, "x"),
    "off lattice": (ORANGE, "-"),
    "serial": (GREEN, ""),
    "unit": (VERMILLION, "-"),
    "offset step": (PURPLE, "\\"),
    "touch": (GREEN, "."),
}
"""Colour and hatch of each kind of finding."""

LEGEND_LINE = 22
"""Pixels of a line of the legend, which has three entries on a narrow page."""

LEAST_SPAN = 0.002
"""Share of the recording that the shortest finding is drawn with: a freeze of 50 ms is seen."""


def health_timeline(recording: Recording, findings: Sequence[Finding]) -> Figure:
    """Return every signal of a recording as a row with its findings.

    Tall bars were cut; low bars are notes that changed nothing.
    """
    signals = [*recording.joints, *recording.channels, *recording.temperatures, *recording.imus]
    names = list(dict.fromkeys([*(s.name for s in signals), *(f.signal for f in findings)]))
    rows = {name: number for number, name in enumerate(names)}
    kinds = {(finding.kind, finding.cut) for finding in findings}
    below = 60 + LEGEND_LINE * -(-len(kinds) // 3)
    layout = base_layout(f"Data health: {recording.name}", 40 + 24 * len(rows) + below)
    logged: dict[str, Any] = {
        "type": "scatter",
        "mode": "lines",
        "x": [],
        "y": [],
        "name": "logged",
        "line": {"color": "#c8c8c8", "width": 2},
        "hoverinfo": "skip",
    }
    for signal in signals:
        if len(signal):
            seconds = recording.seconds(signal)
            logged["x"] += [float(seconds[0]), float(seconds[-1]), None]
            logged["y"] += [rows[signal.name]] * 2 + [None]
    traces = [logged]
    least = LEAST_SPAN * max(recording.duration, 1e-9)
    for kind, (colour, hatch) in KINDS.items():
        for cut in (True, False):
            some = [f for f in findings if f.kind == kind and f.cut == cut]
            if some:
                traces.append(spans(kind, cut, some, rows, (colour, hatch), least))
    first = min([0.0, *(f.start for f in findings)])
    last = max([recording.duration, *(f.stop for f in findings)])
    pad = 0.01 * (last - first)
    layout["xaxis"] = plain_axis("time [s]", range=[first - pad, last + pad], zeroline=False)
    layout["yaxis"] = plain_axis(
        "",
        range=[len(rows) - 0.4, -0.6],
        tickmode="array",
        tickvals=list(rows.values()),
        ticktext=[plain(name) for name in rows],
        automargin=True,
        showgrid=False,
        zeroline=False,
    )
    layout["barmode"] = "overlay"
    layout["legend"] |= {"yref": "container", "y": 0, "yanchor": "bottom"}
    layout["margin"] |= {"t": 36, "b": below}
    layout["showlegend"] = bool(kinds)
    return {"data": traces, "layout": layout}


def spans(
    kind: str,
    cut: bool,
    findings: Sequence[Finding],
    rows: dict[str, int],
    style: tuple[str, str],
    least: float,
) -> dict[str, Any]:
    """Return the findings of one kind as bars: tall where samples were cut, low where not."""
    colour, hatch = style
    return {
        "type": "bar",
        "orientation": "h",
        "base": [f.start for f in findings],
        "x": [max(f.stop - f.start, least) for f in findings],
        "y": [rows[f.signal] + (0.0 if cut else 0.32) for f in findings],
        "width": 0.62 if cut else 0.14,
        "name": f"{kind}, {'cut' if cut else 'note'}",
        "marker": {
            "color": colour,
            "pattern": {
                "shape": hatch,
                "fgcolor": "#fff",
                "fillmode": "overlay",
                "size": 5,
                "solidity": 0.25,
            },
            "line": {"color": colour, "width": 0.8},
        },
        "opacity": 1.0 if cut else 0.6,
        "hovertext": [wrapped(f.message) for f in findings],
        "hovertemplate": "%{hovertext}<extra></extra>",
    }
