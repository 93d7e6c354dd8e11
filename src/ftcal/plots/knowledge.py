"""What the data could say: directions excited, share of the prior, its strength, the truth."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ftcal.excitation import LEAST_SIGNAL, Excitation
from ftcal.fit import PriorChoice
from ftcal.plots.figure import (
    AXIS_STYLES,
    BLACK,
    BLUE,
    VERMILLION,
    Figure,
    base_layout,
    chosen_label,
    packed,
    plain,
    plain_axis,
)
from ftcal.sensor import AXES

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

BLUES = [[0.0, "#ffffff"], [1.0, BLUE]]
"""White where the prior speaks, blue where the data do."""

PERCENT_TICKS = [5, 10, 20, 30, 50, 70, 100, 150, 200, 300, 500, 1000, 2000, 5000, 10000]

DIVERGING = [[0.0, VERMILLION], [0.5, "#ffffff"], [1.0, BLUE]]


def directions(names: str, excitation: Excitation) -> Figure:
    """Return the spread of the data along each direction beside the data's share per axis.

    Bars on a logarithmic scale in percent of full scale; a black tick marks the noise, a hatched
    bar a direction that does not rise above it.
    """
    seen = excitation.directions
    rows = list(range(len(seen)))
    height = 110 + 34 * len(rows)
    layout = base_layout(f"What the data excite, and what they determine: {names}", height)
    sd = np.array([100 * d.sd for d in seen])
    signal = np.array([d.signal for d in seen])
    noise = np.divide(sd, signal, out=np.zeros_like(sd), where=np.isfinite(signal) & (signal > 0))
    drawn = np.concatenate([sd[sd > 0], noise[noise > 0]])
    reach = [drawn.min() / 2, drawn.max() * 2] if len(drawn) else [0.1, 1.0]
    labels = [f"{i + 1}.  {plain(d.words)}" for i, d in enumerate(seen)]
    bars = [
        {
            "type": "bar",
            "orientation": "h",
            "x": [float(sd[i]) for i in rows if seen[i].excited == excited],
            "y": [i for i in rows if seen[i].excited == excited],
            "width": 0.62,
            "name": name,
            "marker": {"color": colour, "line": {"color": "#444", "width": 0.6}}
            | {"pattern": {"shape": hatch, "fgcolor": "#555", "fillmode": "overlay"}},
            "hovertemplate": "%{x:.3g} % of full scale",
        }
        for excited, name, colour, hatch in (
            (True, "excited", BLUE, ""),
            (False, f"below {LEAST_SIGNAL:g} × noise: the prior alone speaks", "#d0d0d0", "/"),
        )
        if any(d.excited == excited for d in seen)
    ]
    ticks: dict[str, Any] = {
        "type": "scatter",
        "mode": "markers",
        "x": [x if x > 0 else None for x in noise.tolist()],
        "y": rows,
        "name": "noise along it",
        "marker": {"symbol": "line-ns-open", "size": 18, "color": BLACK, "line": {"width": 3}},
        "hovertemplate": "noise %{x:.3g} % of full scale",
    }
    share = np.array([d.share for d in seen])
    heat: dict[str, Any] = {
        "type": "heatmap",
        "x": list(AXES),
        "y": rows,
        "z": share.tolist(),
        "text": [[f"{100 * value:.0f}" for value in row] for row in share],
        "texttemplate": "%{text}",
        "zmin": 0,
        "zmax": 1,
        "colorscale": BLUES,
        "showscale": False,
        "xgap": 2,
        "ygap": 2,
        "xaxis": "x2",
        "yaxis": "y",
        "name": "share of the data",
        "hovertemplate": "%{x}: %{text} % from the data",
    }
    layout["xaxis"] = plain_axis(
        "standard deviation [% of full scale]",
        type="log",
        domain=[0.0, 0.56],
        range=[float(np.log10(r)) for r in reach],
        dtick=1,
    )
    layout["xaxis2"] = plain_axis("share of the data, not of the prior [%]", domain=[0.6, 1.0])
    layout["yaxis"] = plain_axis(
        "",
        autorange="reversed",
        tickmode="array",
        tickvals=rows,
        ticktext=labels,
        automargin=True,
        showgrid=False,
        zeroline=False,
    )
    layout["barmode"] = "overlay"
    return {"data": [*bars, ticks, heat], "layout": layout}


def prior_curve(names: str, choice: PriorChoice) -> Figure:
    """Return the held-out error against the strength of the prior, the chosen one marked."""
    layout = base_layout(f"Strength of the prior, by blocked cross-validation: {names}", 380)
    percent = 100.0 * choice.error / np.maximum(choice.workbench, np.finfo(float).tiny)
    traces = []
    for axis, (colour, dash, marker) in enumerate(AXIS_STYLES):
        traces.append(
            {
                "type": "scatter",
                "mode": "lines+markers",
                "x": packed(choice.kappas),
                "y": packed(percent[:, axis]),
                "name": AXES[axis],
                "line": {"color": colour, "dash": dash, "width": 1.3},
                "marker": {"symbol": marker, "size": 5},
                "hovertemplate": "%{y:.0f} %",
            }
        )
    mean = np.exp(np.log(np.maximum(percent, 1e-9)).mean(axis=1))
    traces.append(
        {
            "type": "scatter",
            "mode": "lines",
            "x": packed(choice.kappas),
            "y": packed(mean),
            "name": "geometric mean",
            "line": {"color": BLACK, "width": 3},
            "hovertemplate": "%{y:.0f} %",
        }
    )
    layout["xaxis"] = plain_axis(
        "kappa, prior standard deviation [fraction of full scale]", type="log", dtick=1
    )
    layout["yaxis"] = plain_axis("held-out RMS [% of Workbench]", type="log")
    layout["yaxis"] |= {"tickmode": "array", "tickvals": PERCENT_TICKS}
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
        },
        {
            "type": "line",
            "xref": "paper",
            "x0": 0,
            "x1": 1,
            "y0": 100,
            "y1": 100,
            "line": {"color": "#666", "width": 1, "dash": "dash"},
            "label": {"text": "Workbench", "textposition": "end", "font": {"size": 10}},
        },
    ]
    layout["annotations"] = [chosen_label(choice.chosen)]
    return {"data": traces, "layout": layout}


def truth_maps(
    names: str,
    truth: Float[Array, "6 K"],
    estimate: Float[Array, "6 K"],
    z: Float[Array, "6 K"],
) -> Figure:
    """Return truth and estimate, both as departure from the Workbench [% of full scale], and z."""
    layout = base_layout(f"Truth beside estimate: {names}", 380)
    columns = list(AXES) if truth.shape[1] == 6 else [f"r{j + 1}" for j in range(truth.shape[1])]
    reach = 100 * max(float(np.abs(truth).max()), float(np.abs(estimate).max()), 1e-12)
    maps = (
        ("truth [% of full scale]", 100 * truth, reach),
        ("estimate [% of full scale]", 100 * estimate, reach),
        ("(estimate − truth) / standard error", z, 3.0),
    )
    traces = []
    for panel, (title, table, limit) in enumerate(maps):
        number = "" if panel == 0 else str(panel + 1)
        left = panel * 0.345
        traces.append(
            {
                "type": "heatmap",
                "x": columns,
                "y": list(AXES),
                "z": np.where(np.isfinite(table), table, 0.0).tolist(),
                "text": [[f"{v:.1f}" if np.isfinite(v) else "–" for v in row] for row in table],
                "texttemplate": "%{text}",
                "zmin": -limit,
                "zmax": limit,
                "colorscale": DIVERGING,
                "showscale": False,
                "xgap": 2,
                "ygap": 2,
                "xaxis": f"x{number}",
                "yaxis": f"y{number}",
                "hovertemplate": "row %{y}, column %{x}: %{text}",
                "name": "",
            }
        )
        layout[f"xaxis{number}"] = plain_axis(title, domain=[left, left + 0.31])
        layout[f"yaxis{number}"] = plain_axis("", autorange="reversed", anchor=f"x{number}")
    layout["margin"] |= {"t": 36}
    return {"data": traces, "layout": layout}
