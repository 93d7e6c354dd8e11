"""Figures of a study: every matrix in space, what is left over in time, distances to the truth.

The paper's three figures (section V) and one that it could not draw, as the truth was not known.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ftcal.contact import ContactSchedule
from ftcal.plots.figure import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    VERMILLION,
    YELLOW,
    Figure,
    axis_id,
    base_layout,
    curve,
    packed,
    plain,
    plain_axis,
    six_panels,
    with_holes,
)
from ftcal.plots.wrench import LINES, MODEL, WORKBENCH, force_scene

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

TRACK = 700
"""Points of a curve in space: a dozen curves are turned with the mouse at once."""

Trained = tuple[str, str]
"""Recording that a matrix was trained on and how its offset left; the Workbench has no method."""

DASHES = {"centred": "solid", "in situ": "dash"}
"""How the offset left the training data."""

SETS = (BLUE, GREEN, ORANGE, PURPLE, SKY, BLACK, YELLOW)
"""Colour of each recording that trained, in order."""

LEFT: dict[str, dict[str, Any]] = {
    "Workbench": {"color": VERMILLION, "width": 1.3, "dash": "dot"},
    "best": {"color": BLUE, "width": 1.4},
    "mixed": {"color": BLACK, "width": 0.9},
}
"""Curves of what is left over, the same in both figures."""

SHADES = (SKY, ORANGE, GREEN, PURPLE, YELLOW, GREY)
"""Colour behind the intervals of each contact, in order of appearance."""

EASY_TO_READ = 10
"""A map with fewer columns has room for larger numbers."""

WORST = 1000.0
"""Percent of the Workbench's error at which the colours of a map end; 10 % is the other end."""

PERCENT_MARKS = [mark * 10.0**power for power in range(-6, 4) for mark in (1, 2, 5)]
"""Ticks of a logarithmic axis in percent, written out: bare digits between powers mislead."""

BETTER_OR_WORSE = [[0.0, BLUE], [0.5, "#ffffff"], [1.0, VERMILLION]]


def matrices_in_space(
    sensor: str,
    recording: str,
    time: Float[Array, "N"],
    model: Float[Array, "N 3"],
    readings: Mapping[Trained, Float[Array, "N 3"]],
    shown: Collection[Trained],
) -> Figure:
    """Return the force of the model and of every matrix as curves in space [N].

    Those not `shown` wait in the legend for a click.
    """
    layout = base_layout(f"Force at {sensor} by every matrix: {recording}", 640)
    recordings = list(dict.fromkeys(name for name, method in readings if method))
    traces = [track(time, model, MODEL, {"color": GREY, "width": 7}) | {"opacity": 0.6}]
    for trained, force in readings.items():
        name, method = trained
        line: dict[str, Any] = {"color": VERMILLION, "width": 3, "dash": "dot"}
        if method:
            colour = SETS[recordings.index(name) % len(SETS)]
            line = {"color": colour, "width": 3, "dash": DASHES[method]}
        one = track(time, force, f"{name}, {method}" if method else name, line)
        traces.append(one if trained in shown else {**one, "visible": "legendonly"})
    layout["scene"] = force_scene(np.concatenate([model, *(readings[one] for one in shown)]))
    layout["legend"] |= {"orientation": "v", "x": 1.0, "xanchor": "left", "y": 1, "yanchor": "top"}
    layout["margin"] |= {"l": 0, "r": 0, "b": 0, "t": 30}
    return {"data": traces, "layout": layout}


def track(
    time: Float[Array, "N"], force: Float[Array, "N 3"], name: str, line: Mapping[str, Any]
) -> dict[str, Any]:
    """Return a regular selection of a force as a curve in space, broken where the clock pauses."""
    stride = max(1, -(-len(time) // TRACK))
    _, points = with_holes(time[::stride], force[::stride])
    return {
        "type": "scatter3d",
        "mode": "lines",
        **{axis: packed(points[:, i]) for i, axis in enumerate("xyz")},
        "name": plain(name),
        "line": dict(line),
        "hovertemplate": "%{x:.3g}, %{y:.3g}, %{z:.3g} N",
    }


def leftover_in_time(
    title: str,
    time: Float[Array, "N"],
    errors: Mapping[str, Float[Array, "N 6"]],
    schedule: ContactSchedule,
) -> Figure:
    """Return what each matrix leaves over [N, Nm] against time, shaded by who touches the world.

    `errors` are keyed by `Workbench`, `best` or `mixed`; the first lies below.
    """
    layout = six_panels(title, 600, "time [s]")
    traces = []
    for number, (name, error) in enumerate(errors.items()):
        broken, values = with_holes(time, error)
        # where both agree, the lower one still shows at the edges of the upper
        line = LEFT[name] | ({"width": 2.6} if number == 0 else {})
        for axis in range(6):
            traces.append(curve(broken, values[:, axis], axis, line, name))
    spans = {}
    for interval in schedule.intervals:
        # a schedule may run to infinity, a panel does not
        start, stop = max(interval.start, float(time[0])), min(interval.stop, float(time[-1]))
        if stop > start:
            spans[start, stop] = " and ".join(interval.touching)
    colours = dict(zip(dict.fromkeys(spans.values()), SHADES, strict=False))
    layout["shapes"] = [
        shade(column, start, stop, colours[touching])
        for (start, stop), touching in spans.items()
        if touching in colours
        for column in (0, 3)
    ]
    traces += [shade_key(f"on {touching}", colour) for touching, colour in colours.items()]
    layout["margin"] |= {"t": 84}  # two lines of legend on a narrow page
    layout["hovermode"] = "x"
    return {"data": traces, "layout": layout}


def shade(column: int, start: float, stop: float, colour: str) -> dict[str, Any]:
    """Return a band behind all panels of one column; `column` is its first panel."""
    return {
        "type": "rect",
        "xref": axis_id("x", column),
        "yref": "paper",
        "x0": start,
        "x1": stop,
        "y0": 0,
        "y1": 1,
        "layer": "below",
        "fillcolor": colour,
        "opacity": 0.16,
        "line": {"width": 0},
    }


def shade_key(name: str, colour: str) -> dict[str, Any]:
    """Return a trace without points that explains a band in the legend."""
    return {
        "type": "scatter",
        "mode": "markers",
        "x": [None],
        "y": [None],
        "name": plain(name),
        "marker": {"symbol": "square", "size": 12, "color": colour, "opacity": 0.35},
        "hoverinfo": "skip",
    }


def elsewhere_map(
    sensor: str,
    sets: Sequence[Trained],
    percent: Mapping[str, Float[Array, "S"]],
) -> Figure:
    """Return the error of every set on data that it did not see, an axis a row.

    `percent` of the Workbench's error, by row; a number above 100 carries a triangle.
    """
    rows = list(percent)
    layout = base_layout(
        f"Error on data not trained on, axis by axis, at {sensor}", 130 + 30 * len(rows)
    )
    table = np.array([percent[row] for row in rows], dtype=np.float64)
    shown = np.log(np.clip(table, 1e4 / WORST, WORST) / 100.0)
    heat: dict[str, Any] = {
        "type": "heatmap",
        "x": list(range(len(sets))),
        "y": rows,
        "z": [[float(v) if np.isfinite(v) else None for v in row] for row in shown],
        "text": [[worded(v) for v in row] for row in table],
        "texttemplate": "%{text}",
        "textfont": {"size": 12 if len(sets) < EASY_TO_READ else 11},
        "zmin": -float(np.log(WORST / 100.0)),
        "zmax": float(np.log(WORST / 100.0)),
        "colorscale": BETTER_OR_WORSE,
        "showscale": False,
        "xgap": 2,
        "ygap": 2,
        "name": "",
        "customdata": [[plain(", ".join(one)) for one in sets]] * len(rows),
        "hovertemplate": "%{customdata}, %{y}: %{text} % of the Workbench's error",
    }
    layout["xaxis"] = plain_axis(
        "",
        tickmode="array",
        tickvals=list(range(len(sets))),
        ticktext=["<br>".join(map(plain, one)) for one in sets],
        showgrid=False,
        zeroline=False,
        tickangle=0 if len(sets) < EASY_TO_READ else -40,
        automargin=True,
    )
    layout["yaxis"] = plain_axis("", autorange="reversed", showgrid=False)
    layout["margin"] |= {"t": 34, "l": 70}
    return {"data": [heat], "layout": layout}


def worded(percent: float) -> str:
    """Return a percentage as the maps write it; worse than the Workbench has a triangle."""
    if not np.isfinite(percent):
        return "–"
    number = f"{percent:.1f}" if percent < 9.95 else f"{percent:.0f}"
    return f"▲ {number}" if percent > 100.0 else number


def truth_distances(
    sensor: str, workbench: float, distances: Sequence[tuple[str, float]]
) -> Figure:
    """Return the RMS distance of each matrix to the true one [% of full scale] as dots in rows."""
    rows = [(WORKBENCH, workbench), *distances]
    layout = base_layout(f"Distance to the true matrix of {sensor}", 96 + 24 * len(rows))
    values = np.array([value for _, value in rows])
    seen = values[values > 0]
    ends = (seen.min(), seen.max()) if len(seen) else (0.1, 1.0)
    dots: dict[str, Any] = {
        "type": "scatter",
        "mode": "markers",
        "x": [float(v) if v > 0 else None for v in values],
        "y": list(range(len(rows))),
        "marker": {
            "size": 10,
            "color": [VERMILLION if v >= workbench else BLUE for v in values],
            "symbol": ["square" if v >= workbench else "circle" for v in values],
        },
        "showlegend": False,
        "name": "",
        "hovertemplate": "%{x:.3g} % of full scale",
    }
    layout["xaxis"] = plain_axis(
        "RMS distance of the entries [% of full scale]",
        type="log",
        range=[float(np.log10(ends[0] / 1.3)), float(np.log10(ends[1] * 1.3))],
        tickmode="array",
        tickvals=PERCENT_MARKS,
    )
    layout["yaxis"] = plain_axis(
        "",
        autorange="reversed",
        tickmode="array",
        tickvals=list(range(len(rows))),
        ticktext=[plain(name) for name, _ in rows],
        automargin=True,
        zeroline=False,
    )
    layout["shapes"] = [
        {
            "type": "line",
            "yref": "paper",
            "x0": workbench,
            "x1": workbench,
            "y0": 0,
            "y1": 1,
            "line": {"color": LINES[WORKBENCH]["color"], "width": 1, "dash": "dot"},
        }
    ]
    layout["margin"] |= {"t": 34}
    return {"data": [dots], "layout": layout}
