"""The robot as its sensors cut it, what each matrix owes to the data, and how the prior was chosen.

Sub-models hang from one another as the limbs do: a circle gave all six equations of its balance, a
square the three of its forces, an open diamond none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ftcal.plots.figure import (
    AXIS_STYLES,
    BLACK,
    BLUE,
    GREY,
    ORANGE,
    Figure,
    base_layout,
    chosen_label,
    packed,
    plain,
    plain_axis,
)
from ftcal.plots.knowledge import BLUES
from ftcal.sensor import AXES
from ftcal.whole_body import Choice

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

GAVE = {
    6: ("six equations", BLUE, "circle"),
    3: ("three, by its mass", ORANGE, "square"),
    0: ("none", GREY, "diamond-open"),
}
"""Words, colour and marker by how many equations a sub-model gave."""


@dataclass(frozen=True, slots=True)
class Node:
    """One sub-model of the graph."""

    name: str
    """Its link nearest the root."""
    mass: float
    """Of its links [kg]."""
    equations: int
    """6, 3 (by its mass) or 0 (never free, or its joints are not logged)."""
    samples: int
    """Samples trained on."""
    parent: str | None
    """Sub-model on the root's side."""
    sensor: str | None
    """Sensor between the two."""


def places(nodes: Sequence[Node]) -> dict[str, tuple[float, float]]:
    """Return where each sub-model is drawn: children below their parent, leaves side by side."""
    children: dict[str | None, list[str]] = {}
    for node in nodes:
        children.setdefault(node.parent, []).append(node.name)
    found: dict[str, tuple[float, float]] = {}

    def put(name: str, depth: int, leaves: int) -> int:
        below = children.get(name, [])
        last = leaves
        for child in below:
            last = put(child, depth + 1, last)
        across = float(np.mean([found[c][0] for c in below])) if below else float(leaves)
        found[name] = (across, -float(depth))
        return last if below else leaves + 1

    leaves = 0
    for root in children.get(None, []):
        leaves = put(root, 0, leaves)
    return found


def beside(node: Node, at: dict[str, tuple[float, float]]) -> str:
    """Return where the label of a sub-model is clear of the line to its parent."""
    if node.parent is None:
        return "top center"
    return "middle left" if at[node.name][0] < at[node.parent][0] else "middle right"


def sub_model_graph(robot: str, nodes: Sequence[Node]) -> Figure:
    """Return the sub-models of a robot as nodes and the sensors between them as edges."""
    at = places(nodes)
    depth = max(-y for _, y in at.values())
    layout = base_layout(
        f"Sub-models that the sensors cut out of {robot}", 150 + 130 * round(depth)
    )
    edges = [node for node in nodes if node.parent is not None]
    ends = [(at[str(node.parent)], at[node.name]) for node in edges]
    traces: list[dict[str, Any]] = [
        {
            "type": "scatter",
            "mode": "lines",
            "x": [x for a, b in ends for x in (a[0], b[0], None)],
            "y": [y for a, b in ends for y in (a[1], b[1], None)],
            "line": {"color": "#555", "width": 2},
            "hoverinfo": "skip",
            "showlegend": False,
        },
    ]
    for equations, (words, colour, marker) in GAVE.items():
        mine = [node for node in nodes if node.equations == equations]
        if mine:
            traces.append(
                {
                    "type": "scatter",
                    "mode": "markers+text",
                    "x": [at[node.name][0] for node in mine],
                    "y": [at[node.name][1] for node in mine],
                    "text": [f"<b>{plain(node.name)}</b><br>{node.mass:.2f} kg" for node in mine],
                    "textposition": [beside(node, at) for node in mine],
                    "customdata": [node.samples for node in mine],
                    "hovertemplate": f"{words}, %{{customdata}} samples",
                    "name": words,
                    "marker": {"color": colour, "symbol": marker, "size": 18}
                    | {"line": {"width": 2, "color": colour}},
                }
            )
    across = [x for x, _ in at.values()]
    layout["annotations"] = [
        {
            "x": 0.5 * (a[0] + b[0]),
            "y": 0.5 * (a[1] + b[1]),
            "text": plain(str(node.sensor)),
            "showarrow": False,
            "bgcolor": "#fff",
        }
        for node, (a, b) in zip(edges, ends, strict=True)
    ]
    hidden = {"visible": False, "fixedrange": True}
    layout["xaxis"] = hidden | {"range": [min(across) - 0.9, max(across) + 0.9]}
    layout["yaxis"] = hidden | {"range": [-depth - 0.4, 0.4]}
    return {"data": traces, "layout": layout}


def share_map(sensor: str, columns: Sequence[str], share: Float[Array, "6 P"]) -> Figure:
    """Return how much of every entry is the data's [%]; the rest is the prior's."""
    layout = base_layout(f"What the data say of {sensor}", 330)
    heat = {
        "type": "heatmap",
        "x": list(columns),
        "y": list(AXES),
        "z": share.tolist(),
        "text": [[f"{100 * value:.0f}" for value in row] for row in share],
        "texttemplate": "%{text}",
        "zmin": 0,
        "zmax": 1,
        "colorscale": BLUES,
        "showscale": False,
        "xgap": 2,
        "ygap": 2,
        "name": "",
        "hovertemplate": "row %{y}, along %{x}: %{text} % from the data",
    }
    layout["xaxis"] = plain_axis("direction of the channels, by the wrench it makes")
    layout["yaxis"] = plain_axis("row of the matrix", autorange="reversed")
    return {"data": [heat], "layout": layout}


def stretch_curve(choice: Choice) -> Figure:
    """Return the held-out error of every stretch against the strength of the prior."""
    layout = base_layout("Strength of the prior, by holding out stretches", 400)
    traces: list[dict[str, Any]] = []
    for number, stretch in enumerate(choice.stretches):
        colour, dash, marker = AXIS_STYLES[number % len(AXIS_STYLES)]
        traces.append(
            {
                "type": "scatter",
                "mode": "lines+markers",
                "x": packed(choice.kappas),
                "y": packed(choice.error[:, number]),
                "name": plain(stretch),
                "line": {"color": colour, "dash": dash, "width": 1.3},
                "marker": {"symbol": marker, "size": 5},
                "hovertemplate": "%{y:.3g}",
            }
        )
    mean = np.exp(np.log(np.maximum(choice.error, np.finfo(float).tiny)).mean(axis=1))
    traces.append(
        {
            "type": "scatter",
            "mode": "lines",
            "x": packed(choice.kappas),
            "y": packed(mean),
            "name": "geometric mean",
            "line": {"color": BLACK, "width": 3},
            "hovertemplate": "%{y:.3g}",
        }
    )
    layout["xaxis"] = plain_axis(
        "kappa, prior standard deviation [fraction of full scale]", type="log", dtick=1
    )
    layout["yaxis"] = plain_axis("held-out mean square / noise", type="log", dtick=1)
    layout["hovermode"] = "x"
    layout["shapes"] = [
        {
            "type": "line",
            "yref": "paper",
            "x0": choice.chosen,
            "x1": choice.chosen,
            "y0": 0,
            "y1": 1,
            "line": {"color": BLACK, "width": 1.5, "dash": "dash"},
        }
    ]
    layout["annotations"] = [chosen_label(choice.chosen)]
    return {"data": traces, "layout": layout}
