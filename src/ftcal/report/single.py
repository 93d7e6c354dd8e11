"""One figure as a page of its own that opens without a network."""

from __future__ import annotations

from pathlib import Path

from ftcal.calibration import write_whole
from ftcal.plots.figure import Figure


def write_plot(path: Path, figure: Figure) -> None:
    """Write `figure` as HTML with plotly.js inside; raises `OutputError`."""
    from plotly.io import to_html

    write_whole(path, to_html(figure, include_plotlyjs=True, validate=False).encode())
