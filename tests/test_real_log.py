"""The main job on the one public log of the paper's own robot (method.md, section 7)."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import pytest

from ftcal.config import FitSection, Job, read_job
from ftcal.firmware import identify, read_matrix
from ftcal.logs import read
from ftcal.pipeline import Outcome, calibrate
from real import GENOVA02, REAL_JOB, needs_genova02

pytestmark = needs_genova02

RECIPE = {"noise": (0.3, 0.4, 0.3, 0.03, 0.03, 0.02), "samples_per_independent": 100}
"""Residual sd and effective samples of method.md; 20 of every 5th sample are 100 samples."""


@functools.cache
def outcome(**fit: object) -> Outcome:
    job = read_job(REAL_JOB)
    section = FitSection.model_validate({**job.fit.model_dump(by_alias=True), **fit})
    return calibrate(Job.model_validate({**dict(job), "fit": section}))


@pytest.mark.parametrize(
    ("fit", "force", "torque"),
    [
        ({"lambda": 0}, 68, 61),
        ({"lambda": 10}, 48, 52),
        ({"kappa": 0.03, **RECIPE}, 32, 47),
    ],
    ids=["least squares", "lambda 10", "kappa 0.03"],
)
def test_hand_cut_split_gives_the_figures_of_the_method(
    fit: dict[str, object], force: float, torque: float
) -> None:
    scores = outcome(**fit).sensors[0].hold_out
    assert scores is not None
    # within two points, as the issue asks: the test windows here keep a second from training
    assert scores.by_name["force"].percent == pytest.approx(force, abs=2.0)
    assert scores.by_name["torque"].percent == pytest.approx(torque, abs=2.0)


def test_kappa_chosen_inside_the_training_part_beats_the_workbench_on_the_test_part() -> None:
    sensor = outcome().sensors[0]
    assert sensor.fit.choice is not None
    assert sensor.hold_out is not None
    assert sensor.hold_out.by_name["force"].interval[1] < 100
    assert sensor.hold_out.by_name["torque"].interval[1] < 100
    words = {verdict.axis: verdict.word for verdict in sensor.verdicts}
    # the leg never loads fx: the verdict says so
    assert words["fx"] == "REFUSE"
    assert words["fy"] == "PARTIAL"
    assert any("fx" in d.words for d in sensor.fit.excitation.unexcited)


def test_refused_axes_keep_their_workbench_row() -> None:
    sensor = outcome().sensors[0]
    for row, verdict in enumerate(sensor.verdicts):
        kept = np.array_equal(sensor.estimate.gain[row], sensor.channel.workbench.gain[row])
        assert kept is not verdict.use


def test_the_saturated_step_of_the_sensor_is_cut() -> None:
    kinds = {finding.kind for _, finding in outcome().sensors[0].findings if finding.cut}
    assert "saturated" in kinds


def test_all_six_serials_are_verified_from_the_log() -> None:
    recording = read(GENOVA02 / "left_leg_support")
    matrices = {file.stem[-5:]: read_matrix(file) for file in GENOVA02.glob("matrices/*.txt")}
    mounted = {
        "right_leg": "SN026", "right_foot": "SN230", "left_leg": "SN217",
        "left_foot": "SN229", "left_arm": "SN153", "right_arm": "SN151",
    }  # fmt: skip
    for part, serial in mounted.items():
        values = recording.channel(f"{part}/analog:o").values
        assert identify(values, matrices) == (serial,)


def test_the_decoded_matrix_has_condition_ninety() -> None:
    matrix = read_matrix(GENOVA02 / "matrices/matrix_SN026.txt").matrix
    assert np.linalg.cond(matrix) == pytest.approx(90, abs=0.5)


def test_example_names_no_place_on_this_machine() -> None:
    assert not any(Path(word).is_absolute() for word in REAL_JOB.read_text().split('"')[1::2])
