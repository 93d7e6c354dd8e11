"""Wrenches in time and space: what the model expects beside what both matrices read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ftcal.pairing import FtChannel, SignalOptions
from ftcal.plots.figure import (
    BLUE,
    GREY,
    ORANGE,
    SKY,
    VERMILLION,
    Figure,
    axis_id,
    base_layout,
    curve,
    joined,
    packed,
    plain_axis,
    six_panels,
    with_holes,
)
from ftcal.recording import Recording
from ftcal.run_filter import odd_window
from ftcal.samples import Samples
from ftcal.sensor import AXES, UNITS
from ftcal.signals import runs, smooth_runs
from ftcal.validate import HeldOut

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

MODEL, WORKBENCH, IN_SITU = "model", "Workbench", "in situ"

LINES: dict[str, dict[str, Any]] = {
    MODEL: {"color": GREY, "width": 3},
    WORKBENCH: {"color": VERMILLION, "width": 1.3, "dash": "dot"},
    IN_SITU: {"color": BLUE, "width": 1.4},
}
"""The same three curves in every figure: broad grey, dotted vermillion, thin blue."""

MARKERS = {MODEL: "circle", WORKBENCH: "square-open", IN_SITU: "diamond"}

IN_SPACE = 1200
"""Points of a cloud in space: more hide one another."""

THINNEST = 0.6
"""Least side of the box around a cloud in space, of its longest."""

GLIMPSE = 6.0
"""Seconds that show what smoothing does."""

BINS = 60
"""Bins of a distribution of residuals."""


@dataclass(frozen=True, slots=True)
class Piece:
    """A stretch of a recording read by both matrices."""

    role: Literal["train", "test"]
    reading: HeldOut
    """Each reading aligned to the model's mean over the stretch."""

    @property
    def readings(self) -> dict[str, Float[Array, "N 6"]]:
        """The three wrenches [N, Nm] by name."""
        return {
            MODEL: self.reading.model,
            WORKBENCH: self.reading.workbench,
            IN_SITU: self.reading.in_situ,
        }


def wrench_in_time(sensor: str, background: Samples, pieces: Sequence[Piece]) -> Figure:
    """Return force and torque against time in one recording, its windows shaded.

    The model's wrench (`background`) runs through the whole recording; what the matrices read is
    drawn where an offset is known, that is inside the windows.
    """
    layout = six_panels(f"Wrench at {sensor}: {background.recording}", 640, "time [s]")
    traces = []
    time, model = with_holes(background.time, background.wrench)
    for axis in range(6):
        traces.append(curve(time, model[:, axis], axis, LINES[MODEL], MODEL))
    for name in (WORKBENCH, IN_SITU):
        times, values = joined([(p.reading.time, p.readings[name]) for p in pieces])
        for axis in range(6):
            traces.append(curve(times, values[:, axis], axis, LINES[name], name))
    layout["shapes"] = window_shades(pieces)
    layout["annotations"] = window_names(pieces)
    layout["legend"]["y"] = 1.03  # above the windows' names
    layout["margin"] |= {"t": 70}
    layout["hovermode"] = "x"
    return {"data": traces, "layout": layout}


def window_shades(pieces: Sequence[Piece]) -> list[dict[str, Any]]:
    """Return a rectangle behind every panel for every window."""
    shades = []
    for piece in pieces:
        if not len(piece.reading.time):
            continue
        colour = SKY if piece.role == "train" else ORANGE
        for axis in range(6):
            shades.append(
                {
                    "type": "rect",
                    "xref": axis_id("x", axis),
                    "yref": f"{axis_id('y', axis)} domain",
                    "x0": float(piece.reading.time[0]),
                    "x1": float(piece.reading.time[-1]),
                    "y0": 0,
                    "y1": 1,
                    "layer": "below",
                    "fillcolor": colour,
                    "opacity": 0.18,
                    "line": {"width": 0},
                }
            )
    return shades


def window_names(pieces: Sequence[Piece]) -> list[dict[str, Any]]:
    """Return `train` or `test` over every window of the two uppermost panels."""
    return [
        {
            "text": piece.role,
            "showarrow": False,
            "xref": axis_id("x", axis),
            "yref": f"{axis_id('y', axis)} domain",
            "x": 0.5 * float(piece.reading.time[0] + piece.reading.time[-1]),
            "y": 1,
            "yanchor": "bottom",
            "font": {"size": 11},
        }
        for piece in pieces
        if len(piece.reading.time)
        for axis in (0, 3)
    ]


def residuals_in_time(sensor: str, kind: str, pieces: Sequence[HeldOut]) -> Figure:
    """Return the held-out residuals, sensor minus model, of one recording against time."""
    title = f"{kind.capitalize()} residual, sensor minus model, at {sensor}: {pieces[0].recording}"
    layout = six_panels(title, 600, "time [s]")
    traces = []
    for name in (WORKBENCH, IN_SITU):
        times, values = joined([(p.time, residual(p, name)) for p in pieces])
        for axis in range(6):
            traces.append(curve(times, values[:, axis], axis, LINES[name], name))
    layout["hovermode"] = "x"
    return {"data": traces, "layout": layout}


def residual(piece: HeldOut, name: str) -> Float[Array, "N 6"]:
    """Return sensor minus model of one reading [N, Nm]."""
    reading = piece.workbench if name == WORKBENCH else piece.in_situ
    return np.asarray(reading - piece.model)


def residual_spread(sensor: str, kind: str, pieces: Sequence[HeldOut]) -> Figure:
    """Return the distribution of the held-out residuals of all recordings, axis by axis."""
    names = ", ".join(dict.fromkeys(piece.recording for piece in pieces))
    title = f"Distribution of the {kind} residual at {sensor}: {names}"
    layout = base_layout(title, 430)
    both = {
        name: np.concatenate([residual(piece, name) for piece in pieces])
        for name in (WORKBENCH, IN_SITU)
    }
    # samples that are kept count for those that are not
    each = np.concatenate([np.full(len(p.time), p.each) for p in pieces])
    traces = []
    for axis in range(6):
        column, row = axis % 3, axis // 3
        number = "" if axis == 0 else str(axis + 1)
        x = column / 3 + 0.02 * column
        layout[f"xaxis{number}"] = plain_axis(
            f"{AXES[axis]} residual [{UNITS[axis]}]",
            domain=[x, x + 0.29],
            anchor=axis_id("y", axis),
        )
        layout[f"yaxis{number}"] = plain_axis(
            "share [%]" if column == 0 else "",
            domain=[0.6, 1.0] if row == 0 else [0.0, 0.4],
            anchor=axis_id("x", axis),
            rangemode="tozero",
        )
        reach = max(float(np.abs(table[:, axis]).max()) for table in both.values())
        edges = np.linspace(-reach, reach, BINS + 1) if reach > 0 else np.linspace(-1, 1, BINS + 1)
        for name, table in both.items():
            count = np.histogram(table[:, axis], edges, weights=each)[0]
            traces.append(
                {
                    **curve(
                        0.5 * (edges[1:] + edges[:-1]), count / each.sum() * 100, axis, {}, name
                    ),
                    "line": {**LINES[name], "shape": "hvh"},
                    "fill": "tozeroy",
                    "fillcolor": "rgba(213,94,0,0.10)"
                    if name == WORKBENCH
                    else "rgba(0,114,178,0.18)",
                    "hovertemplate": "%{x:.3g}: %{y:.1f} %",
                }
            )
    return {"data": traces, "layout": layout}


def forces_in_space(sensor: str, pieces: Sequence[Piece]) -> Figure:
    """Return the force as a cloud in space: model, Workbench and in situ [N]."""
    names = ", ".join(dict.fromkeys(piece.reading.recording for piece in pieces))
    layout = base_layout(f"Force at {sensor}: {names}", 520)
    total = sum(len(piece.reading.time) for piece in pieces)
    stride = max(1, -(-total // IN_SPACE))
    traces = []
    for name in (MODEL, WORKBENCH, IN_SITU):
        force = np.concatenate([piece.readings[name][::stride, :3] for piece in pieces])
        traces.append(
            {
                "type": "scatter3d",
                "mode": "markers",
                **{axis: packed(force[:, i]) for i, axis in enumerate("xyz")},
                "name": name,
                "marker": {
                    "size": 3.2 if name == MODEL else 2.4,
                    "symbol": MARKERS[name],
                    "color": LINES[name]["color"],
                },
                "hovertemplate": "%{x:.3g}, %{y:.3g}, %{z:.3g} N",
            }
        )
    force = np.concatenate([piece.reading.model[:, :3] for piece in pieces])
    layout["scene"] = force_scene(force)
    layout["legend"]["itemsizing"] = "constant"
    layout["margin"] |= {"l": 0, "r": 0, "b": 0}
    return {"data": traces, "layout": layout}


def force_scene(force: Float[Array, "N 3"]) -> dict[str, Any]:
    """Return the axes around forces in space: to scale, but no side too thin to be read."""
    reach = np.maximum(np.ptp(force, axis=0), np.finfo(float).tiny)
    sides = np.maximum(reach / reach.max(), THINNEST)
    return {
        **{f"{axis}axis": {"title": {"text": f"f{axis} [N]"}} for axis in "xyz"},
        "aspectmode": "manual",
        "aspectratio": {axis: float(side) for axis, side in zip("xyz", sides, strict=True)},
        "camera": {"eye": {"x": 1.2, "y": 1.2, "z": 0.5}, "center": {"x": 0, "y": 0, "z": -0.12}},
    }


def glimpse_in(start: float, stop: float) -> tuple[float, float]:
    """Return some seconds in the middle of a stretch, the same for stretches nearly alike."""
    half = min(GLIMPSE, stop - start) / 2
    middle = (
        float(np.rint(0.5 * (start + stop)))
        if stop - start > 2 * GLIMPSE
        else (0.5 * (start + stop))
    )
    return middle - half, middle + half


def smoothing_effect(
    glimpse: Recording, channel: FtChannel, options: SignalOptions, span: tuple[float, float]
) -> Figure:
    """Return the Workbench's reading in a span [s] before and after the filter [N, Nm].

    `glimpse` is the recording there, and half a smoothing window around it.
    """
    signal = glimpse.channel(channel.signal)
    seconds = glimpse.seconds(signal)
    inside = (seconds >= span[0]) & (seconds < span[1])
    raw = channel.workbench.channels(signal.values) @ channel.workbench.gain.T
    window = odd_window(options.smoothing, signal.period)
    stretches = runs(signal, max_gap=options.max_gap)
    smoothed = smooth_runs(raw, stretches, window, options.smoothing_order)
    known = inside & np.isfinite(smoothed).all(axis=1)
    title = f"{channel.signal} by the Workbench, before and after smoothing: {glimpse.name}"
    layout = six_panels(title, 480, "time [s]")
    traces = []
    shown = (
        ("as logged", seconds[inside], raw[inside], {"color": ORANGE, "width": 1}),
        ("smoothed", seconds[known], smoothed[known], {"color": "#000", "width": 2}),
    )
    for name, time, values, line in shown:
        broken, table = with_holes(time, values)
        for axis in range(6):
            traces.append(curve(broken, table[:, axis], axis, line, name))
    return {"data": traces, "layout": layout}
