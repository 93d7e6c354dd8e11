"""What a job or a study leaves on disk: JSON for machines and one self-contained page.

The page opens without a network, ten years from now: plotly.js and all data are inside it. Whatever
comes from a log, a file name or a robot is shown as text, never as markup.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from ftcal.calibration import to_json
from ftcal.calibration import write_whole as write_file
from ftcal.report.page import html
from ftcal.report.scorecard import metrics
from ftcal.report.study_metrics import study_metrics
from ftcal.report.study_page import study_html
from ftcal.report.whole_metrics import whole_metrics
from ftcal.report.whole_page import whole_html
from ftcal.study_evidence import study_calibration

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

    from ftcal.pipeline import Outcome
    from ftcal.study import StudyOutcome
    from ftcal.whole_pipeline import WholeOutcome

__all__ = [
    "html",
    "metrics",
    "study_html",
    "study_metrics",
    "whole_html",
    "whole_metrics",
    "write_outcome",
    "write_study",
    "write_whole",
]


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
        write_file(folder / name, content)
    return folder / "report.html"


def write_study(outcome: StudyOutcome, folder: Path) -> Path:
    """Write the figures and the page of a study into `folder`; return the page's path.

    With a second validation also `calibration.json`, the mixed matrices. All are made before the
    first is written, and each is written whole. Raises `OutputError` where the folder cannot be
    written, `SensorError` where a true gain is not of its sensor's shape.
    """
    contents = {
        "study.json": to_json(study_metrics(outcome)),
        "study.html": study_html(outcome).encode(),
    }
    if (mixed := study_calibration(outcome)) is not None:
        contents["calibration.json"] = to_json(mixed)
    for name, content in contents.items():
        write_file(folder / name, content)
    return folder / "study.html"


def write_whole(
    outcome: WholeOutcome, folder: Path, truth: Mapping[str, Float[Array, "6 K"]] | None = None
) -> Path:
    """Write calibration, metrics and report of a fit of all sensors; return the report's path.

    All three are made before the first is written, and each is written whole. `truth` maps sensors
    to their true gain, where a simulation knows it. Raises `OutputError` where the folder cannot be
    written, `SensorError` where a true gain is not of its sensor's shape.
    """
    contents = {
        "calibration.json": to_json(outcome.calibration),
        "metrics.json": to_json(whole_metrics(outcome, truth)),
        "report.html": whole_html(outcome, truth).encode(),
    }
    for name, content in contents.items():
        write_file(folder / name, content)
    return folder / "report.html"
