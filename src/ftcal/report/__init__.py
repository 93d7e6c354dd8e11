"""What a job or a study leaves on disk: JSON for machines and one self-contained page.

The page opens without a network, ten years from now: plotly.js and all data are inside it. Whatever
comes from a log, a file name or a robot is shown as text, never as markup.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from ftcal.calibration import to_json, write_whole
from ftcal.report.page import html
from ftcal.report.scorecard import metrics
from ftcal.report.study_metrics import study_metrics
from ftcal.report.study_page import study_html

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

    from ftcal.pipeline import Outcome
    from ftcal.study import StudyOutcome

__all__ = ["html", "metrics", "study_html", "study_metrics", "write_outcome", "write_study"]


def write_outcome(
    outcome: Outcome, folder: Path, truth: Mapping[str, Float[Array, "6 K"]] | None = None
) -> Path:
    """Write calibration, metrics and report into `folder`; return the report's path.

    All three are made before the first is written, and each is written whole. `truth` maps sensors
    to their true gain, where a simulation knows it. Raises `OutputError` where the folder cannot be
    written.
    """
    contents = {
        "calibration.json": to_json(outcome.calibration),
        "metrics.json": to_json(metrics(outcome, truth)),
        "report.html": html(outcome, truth).encode(),
    }
    for name, content in contents.items():
        write_whole(folder / name, content)
    return folder / "report.html"


def write_study(outcome: StudyOutcome, folder: Path) -> Path:
    """Write the figures and the page of a study into `folder`; return the page's path.

    Both are made before the first is written, and each is written whole. Raises `OutputError` where
    the folder cannot be written, `SensorError` where a true gain is not of its sensor's shape.
    """
    contents = {
        "study.json": to_json(study_metrics(outcome)),
        "study.html": study_html(outcome).encode(),
    }
    for name, content in contents.items():
        write_whole(folder / name, content)
    return folder / "study.html"
