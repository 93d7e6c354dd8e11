"""One sensor start to end on a pretend iCub: temperature, in situ offset, folds, windows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ftcal.config import FitSection, Job, read_job
from ftcal.demonstration import LEG, SENSOR, SIGNAL, SUPPORT, icub_path
from ftcal.errors import DataError
from ftcal.motion import FixedContact
from ftcal.motions import extended_balancing, grid
from ftcal.one_sensor import SensorOutcome
from ftcal.pipeline import calibrate
from ftcal.support import standing_on
from ftcal.synthetic import Conditions, Session, Take, simulate, write_session
from ftcal.urdf import read_robot

pytest.importorskip("icub_models")


def session(kind: str, *, conditions: Conditions | None = None, seed: int = 0) -> Session:
    robot = read_robot(icub_path())
    generator = np.random.default_rng(seed)
    if kind == "grid":
        # nothing beyond the sensor moves: the centre of mass of the leg stands still in its frame
        motion = grid(robot, ["r_hip_pitch", "r_hip_roll"], points=(5, 5), duration=80.0)
        take = Take("grid", motion, standing_on(FixedContact("root_link")))
    else:
        wide = extended_balancing(robot, LEG, generator=generator, support=SUPPORT, duration=60.0)
        take = Take("balancing", wide, standing_on(FixedContact("l_sole")))
    sensors = {SENSOR: SIGNAL}
    return simulate(robot, [take], sensors=sensors, generator=generator, conditions=conditions)


def run(made: Session, folder: Path, **fit: object) -> SensorOutcome:
    job = read_job(write_session(made, folder / "session", urdf=icub_path()))
    section = FitSection.model_validate(fit)
    (sensor,) = calibrate(Job.model_validate({**dict(job), "fit": section})).sensors
    return sensor


def test_a_sensor_that_warms_up_is_told_from_one_that_is_loaded(tmp_path: Path) -> None:
    made = session("balancing", conditions=Conditions(warming=8.0))
    truth = made.truth[SENSOR]
    found = run(made, tmp_path)
    assert truth.temperature_gain is not None
    assert found.fit.estimate.temperature_gain is not None
    error = found.fit.estimate.temperature_gain - truth.temperature_gain
    # 6 entries within 4 of their standard errors: chance misses one in ten thousand
    assert (np.abs(error) < 4.0 * found.fit.estimate.standard_error[:, -1]).all()
    assert np.abs(truth.temperature_gain).max() > 0.01


def test_in_situ_offset_is_the_true_one_where_the_centre_of_mass_stands_still(
    tmp_path: Path,
) -> None:
    made = session("grid")
    truth = made.truth[SENSOR]
    found = run(made, tmp_path, offset="in situ")
    (offset,) = found.in_situ
    true = np.linalg.solve(truth.gain, -truth.offsets["grid"])
    wrench = truth.gain @ (offset.offset - true)
    # an encoder step of 1.5 mrad turns 45 N by 0.07 N; offsets ride on hundreds of N
    np.testing.assert_allclose(wrench[:3], 0.0, atol=1.0)
    np.testing.assert_allclose(wrench[3:], 0.0, atol=0.2)


def test_in_situ_offset_is_refused_where_the_leg_bends(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"centre of mass moves by \d+ mm"):
        run(session("balancing"), tmp_path, offset="in situ")


def test_without_test_windows_the_verdict_rests_on_folds(tmp_path: Path) -> None:
    found = run(session("balancing"), tmp_path)
    assert found.hold_out is None
    assert found.scores is found.k_fold
    assert found.k_fold is not None
    # every training sample was held out once, by a fit that never saw it
    assert found.k_fold.samples == found.fit.samples


def test_a_narrow_motion_leaves_directions_to_the_prior(tmp_path: Path) -> None:
    """Hip pitch and roll alone: torque stays collinear with force, three directions are free."""
    found = run(session("grid"), tmp_path)
    assert found.fit.excitation.rank <= 4
    assert "not excited" in found.verdicts[0].reason or not found.verdicts[0].use
