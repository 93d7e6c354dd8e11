"""What all figures share: colours, text that is never markup, numbers packed and thinned, panels.

Colours are those of M. Okabe, K. Ito, "Color Universal Design" (2008), told apart with every kind
of colour vision; a dash, a marker or a pattern says the same again.
"""

from __future__ import annotations

import base64
import math
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ftcal.sensor import AXES, UNITS

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray as Array

Figure = dict[str, Any]
"""`data` and `layout` as plotly.js takes them."""

BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
YELLOW, BLUE, VERMILLION, PURPLE = "#F0E442", "#0072B2", "#D55E00", "#CC79A7"
GREY = "#8A8A8A"

AXIS_STYLES = (
    (BLUE, "solid", "circle"),
    (VERMILLION, "dot", "square"),
    (GREEN, "dash", "diamond"),
    (PURPLE, "dashdot", "triangle-up"),
    (ORANGE, "longdash", "x"),
    (SKY, "longdashdot", "cross"),
)
"""Colour, dash and marker of fx … tz where they share a panel."""

POINTS = 2000
"""Most points of a curve: a panel is about 600 pixels wide, three of its columns a pixel."""

HOLE = 5.0
"""A pause this many sampling periods long breaks a curve."""

LONGEST_TITLE = 110
"""Characters of a title; a longer name ends in an ellipsis, the caption has it in full."""

FONT = {"family": "system-ui, -apple-system, 'Segoe UI', sans-serif", "size": 12, "color": "#222"}


def plain(text: str) -> str:
    """Return text that Plotly shows as it is: it reads a subset of HTML everywhere it writes.

    Control characters go, and with them line breaks.
    """
    shown = "".join(c if c.isprintable() else " " for c in text)
    return shown.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


def wrapped(text: str, width: int = 70) -> str:
    """Return `plain` text in lines of about `width` characters."""
    return "<br>".join(plain(line) for line in textwrap.wrap(text, width))


def shortened(text: str) -> str:
    """Return `plain` text that fits a title."""
    cut = text if len(text) <= LONGEST_TITLE else text[: LONGEST_TITLE - 1] + "…"
    return plain(cut)


def packed(values: Float[Array, "*N"] | Sequence[float]) -> dict[str, str]:
    """Return numbers as Plotly's typed array: single precision is finer than any screen."""
    content = np.ascontiguousarray(values, dtype="<f4")
    return {"dtype": "f4", "bdata": base64.b64encode(content.tobytes()).decode()}


def with_holes(
    time: Float[Array, "N"], values: Float[Array, "N D"]
) -> tuple[Float[Array, "M"], Float[Array, "M D"]]:
    """Return the rows with a NaN row wherever the clock pauses, so that a curve breaks there."""
    if len(time) < 2:
        return time, values
    pause = np.diff(time)
    at = np.flatnonzero(pause > HOLE * np.median(pause)) + 1
    return np.insert(time, at, time[at]), np.insert(values, at, np.nan, axis=0)


def joined(
    pieces: Sequence[tuple[Float[Array, "N"], Float[Array, "N D"]]],
) -> tuple[Float[Array, "M"], Float[Array, "M D"]]:
    """Return several stretches as one table, a NaN row after each."""
    times, tables = [], []
    for time, values in pieces:
        if len(time):
            broken, rows = with_holes(time, values)
            times += [broken, broken[-1:]]
            tables += [rows, np.full((1, rows.shape[1]), np.nan)]
    if not times:
        return np.zeros(0), np.zeros((0, 6))
    return np.concatenate(times), np.concatenate(tables)


def chosen_label(kappa: float) -> dict[str, Any]:
    """Return the label of the kappa that was chosen, at the foot of a logarithmic axis of them."""
    return {
        "text": f"chosen {kappa:.3g}",
        "showarrow": False,
        "x": math.log10(kappa),  # annotations count a logarithmic axis in powers
        "xanchor": "left",
        "yref": "paper",
        "y": 0.01,
        "yanchor": "bottom",
        "xshift": 4,
    }


def thinned(values: Float[Array, "N"], points: int = POINTS) -> Int[Array, "M"]:
    """Return the rows to draw: least and greatest of every bin, and all NaN.

    Peaks survive, as they would not in a strided sample.
    """
    if len(values) <= points:
        return np.arange(len(values))
    bins = points // 2
    width = -(-len(values) // bins)
    table = np.pad(values, (0, bins * width - len(values)), constant_values=np.nan)
    table = table.reshape(bins, width)
    first = np.arange(bins) * width
    least = first + np.where(np.isnan(table), np.inf, table).argmin(axis=1)
    most = first + np.where(np.isnan(table), -np.inf, table).argmax(axis=1)
    holes = np.flatnonzero(np.isnan(values))
    rows = np.unique(np.concatenate([least, most, holes]))
    return np.asarray(rows[rows < len(values)])


def curve(
    time: Float[Array, "N"], values: Float[Array, "N"], panel: int, line: dict[str, Any], name: str
) -> dict[str, Any]:
    """Return one curve of a panel; its name is in the legend once, with the first panel."""
    rows = thinned(values)
    return {
        "type": "scatter",
        "mode": "lines",
        "x": packed(time[rows]),
        "y": packed(values[rows]),
        "xaxis": axis_id("x", panel),
        "yaxis": axis_id("y", panel),
        "line": line,
        "name": name,
        "legendgroup": name,
        "showlegend": panel == 0,
        "hovertemplate": "%{y:.3g}",
    }


def axis_id(letter: str, panel: int) -> str:
    """Return Plotly's name of an axis: x, x2, x3 …."""
    return letter if panel == 0 else f"{letter}{panel + 1}"


def base_layout(title: str, height: int) -> dict[str, Any]:
    """Return the layout that every figure starts from; the title is text, not markup."""
    return {
        "title": {"text": shortened(title), "x": 0, "xref": "container", "pad": {"l": 8}}
        | {"y": 1, "yanchor": "top", "yref": "container", "font": {"size": 13}}
        | {"automargin": False},
        "height": height,
        "font": FONT,
        "paper_bgcolor": "#fff",
        "plot_bgcolor": "#fff",
        "margin": {"l": 56, "r": 14, "t": 56, "b": 44},
        "legend": {"orientation": "h", "x": 0, "y": 1, "yref": "paper", "yanchor": "bottom"},
        "hovermode": "closest",
    }


def plain_axis(title: str, **more: Any) -> dict[str, Any]:
    """Return an axis with a light grid."""
    return {
        "title": {"text": title, "standoff": 6},
        "gridcolor": "#e6e6e6",
        "zerolinecolor": "#bbb",
        "linecolor": "#999",
        "showline": True,
        "ticks": "outside",
        "ticklen": 3,
        **more,
    }


def six_panels(title: str, height: int, x_title: str, *, shared_x: bool = True) -> dict[str, Any]:
    """Return a layout of six panels: forces on the left, torques on the right.

    Panel i (axes `axis_id("x", i)`) is that of axis i of the wrench; `y_names` may be set after.
    """
    layout = base_layout(title, height)
    gap = 0.06
    row = (1 - 2 * gap) / 3
    for i, (axis, unit) in enumerate(zip(AXES, UNITS, strict=True)):
        top = 1 - (i % 3) * (row + gap)
        domain = [0.0, 0.45] if i < 3 else [0.56, 1.0]
        number = "" if i == 0 else str(i + 1)
        bottom = i % 3 == 2
        layout[f"xaxis{number}"] = plain_axis(
            x_title if bottom else "",
            domain=domain,
            anchor=axis_id("y", i),
            showticklabels=bottom or not shared_x,
            **({"matches": "x"} if shared_x and i else {}),
        )
        layout[f"yaxis{number}"] = plain_axis(
            f"{axis} [{unit}]", domain=[top - row, top], anchor=axis_id("x", i)
        )
    return layout
