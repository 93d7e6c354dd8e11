"""The demo over many seeds: its standard errors tell the truth about its truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ftcal.config import read_job
from ftcal.demonstration import write_demo
from ftcal.pipeline import calibrate
from ftcal.synthetic import TRUTH, read_truth

# long, and what they run is covered by the others: tracing would cost half as much again
pytestmark = pytest.mark.no_cover

pytest.importorskip("icub_models")

SEEDS = 30


@pytest.mark.slow
def test_truth_lies_within_three_standard_errors_on_the_demo(tmp_path: Path) -> None:
    """At least 97 % of the entries of C over 30 sessions, from the written logs."""
    inside = []
    for seed in range(SEEDS):
        job = write_demo(tmp_path / str(seed), seed=seed)
        (sensor,) = calibrate(read_job(job)).sensors
        (truth,) = read_truth(job.with_name(TRUTH)).values()
        estimate = sensor.fit.estimate
        inside.append(np.abs(estimate.gain - truth) < 3.0 * estimate.standard_error)
        assert sensor.fit.excitation.rank == 6
        assert all(verdict.word == "ACCEPT" for verdict in sensor.verdicts)
    assert np.mean(inside) >= 0.97
