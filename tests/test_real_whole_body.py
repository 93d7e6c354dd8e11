"""All sensors at once on real robots: what is left over where nothing touches.

`iCubGenova02` (`examples/real_icub/whole_body.toml`): trained on both feet 0-10 s and on the swing,
judged in the double support 67-75 s that nothing was trained on. `iCubGenova01`: both feet stand
while the torso sweeps; nothing there says how large a force is, so the scale must not move. Limits
were measured first and stand 10 to 15 % above; where they are those of the issue, it is said.
"""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import pytest

from ftcal.balances import Leftover
from ftcal.calibration import read_calibration
from ftcal.config import Job, read_job
from ftcal.judging import Residual, loose_scales
from ftcal.law import Law
from ftcal.whole_pipeline import WholeOutcome, calibrate_whole_body
from real import DATA, ROOT, needs_genova02
from test_whole_body import reading_amplitude

SWEEP = DATA / "icub-genova01" / "torso_sweep"
needs_genova01 = pytest.mark.skipif(
    not SWEEP.is_dir(), reason="shared/data/icub-genova01 is absent"
)
WHOLE_JOB = ROOT / "examples" / "real_icub" / "whole_body.toml"
RIGHT_SHANK, LEFT_SHANK, RIGHT_FOOT = "r_hip_3", "l_hip_3", "r_foot"
DESCRIBED = 33.05
"""Mass of iCubGenova02 [kg] (README of the data)."""


@functools.cache
def standing() -> WholeOutcome:
    return calibrate_whole_body(read_job(WHOLE_JOB))


def held_out(outcome: WholeOutcome, sub_model: str, *, after: float = 0.0) -> Residual:
    """Return the first held-out stretch of a sub-model from `after` [s] on."""
    return next(
        one
        for one in outcome.fit.residuals
        if one.held_out and one.sub_model == sub_model and one.start >= after
    )


@needs_genova02
def test_right_shank_in_the_last_double_support() -> None:
    left = held_out(standing(), RIGHT_SHANK, after=67.0)
    # the Workbench, with the offsets that suit it best
    assert (left.workbench.force, left.workbench.torque) == pytest.approx((11.8, 6.0), rel=0.1)
    # measured 3.51 N and 1.17 Nm
    assert left.whole_body.force < 4.3
    assert left.whole_body.torque < 1.45


@needs_genova02
@pytest.mark.xfail(strict=True, reason="measured 3.51 N and 1.17 Nm")
def test_right_shank_in_the_last_double_support_as_the_issue_wants_it() -> None:
    left = held_out(standing(), RIGHT_SHANK, after=67.0)
    assert left.whole_body.force <= 3.0
    assert left.whole_body.torque <= 1.0


@needs_genova02
def test_what_is_deployed_reads_the_right_shank_in_the_last_double_support(tmp_path: Path) -> None:
    fit = standing().fit
    path = tmp_path / "calibration.json"
    path.write_text(standing().calibration.model_dump_json())
    deployed = read_calibration(path)
    (whole,) = (b for take in fit.takes for b in take.balances if b.sub_model == RIGHT_SHANK)
    first, last = whole.time.searchsorted([67.0, 75.0])
    balance = whole.rows(slice(int(first), int(last)))
    readings = {}
    for name, inputs in balance.inputs.items():
        record = deployed.sensor(name)
        (offset,) = (o for o in record.offsets if o.start <= 67.0 and o.stop > balance.time[-1])
        readings[name] = Law(record.coefficients, np.array(offset.offset)).read(inputs)
    left = Leftover.of(balance.residual(readings))
    before = held_out(standing(), RIGHT_SHANK, after=67.0).workbench
    # the new matrices as the file has them, against the Workbench with the offsets that suit best
    assert left.force < 5.0
    assert left.torque < 2.0
    assert before.force > 10.0
    assert before.torque > 5.0


@needs_genova02
def test_all_sub_models_together_are_better_than_with_the_workbench() -> None:
    found = standing().fit.together.by_name
    # measured 73 % of force, 90 % interval 54 to 90 %; torque 75 %, 35 to 104 %
    assert found["force"].percent < 90.0
    assert found["torque"].percent < 95.0
    assert standing().improved


@needs_genova02
def test_a_swing_that_was_held_out_fits_the_foot_and_the_shank() -> None:
    foot, shank = (held_out(standing(), name, after=46.0) for name in (RIGHT_FOOT, RIGHT_SHANK))
    # measured 0.99 of 4.87 N and 1.65 of 6.04 N
    assert foot.whole_body.force < 0.23 * foot.workbench.force
    assert shank.whole_body.force < 0.33 * shank.workbench.force


@needs_genova02
@pytest.mark.parametrize(
    ("sensor", "least", "most"),
    [
        ("r_leg_ft_sensor", 0.93, 1.07),
        ("r_foot_ft_sensor", 0.93, 1.07),
        ("l_leg_ft_sensor", 0.9, 1.07),
        ("l_foot_ft_sensor", 0.9, 1.07),
    ],
)
def test_no_reading_vanishes(sensor: str, least: float, most: float) -> None:
    (result,) = (s for s in standing().fit.sensors if s.sensor.name == sensor)
    # the issue wants 0.93 to 1.07 of both right ones; measured 1.01, 1.03 and 0.94, 0.93
    assert least < result.scores.by_name["force"].amplitude < most


@needs_genova02
def test_the_robot_weighs_what_its_description_says() -> None:
    read = {one.start: one.whole_body for one in standing().weighings}
    assert len(read) == 6
    # the issue: 1 %; measured 32.75 to 32.84 kg
    assert list(read.values()) == pytest.approx([DESCRIBED] * 6, rel=0.01)


@needs_genova02
def test_an_arm_that_is_not_logged_leaves_the_trunk_three_equations() -> None:
    equations = {one.sub_model: one.equations for one in standing().fit.residuals}
    assert equations == {"base_link": 3, RIGHT_SHANK: 6, LEFT_SHANK: 6, RIGHT_FOOT: 6}


@needs_genova02
def test_the_workbench_is_compared_with_the_inertia_of_the_description() -> None:
    for inertia in standing().fit.workbench.inertia.values():
        assert not inertia.any()


SWEEPING = """robot = "{robot}"
{sensors}
[[recordings]]
log = "{log}"
contact = ["l_sole", "r_sole"]
train = [[0, 70]]
test = [[72, 110]]
[fit]
scope = "whole body"
[whole_body]
by_mass = {by_mass}
"""
SENSOR = """[[sensors]]
name = "{name}"
signal = "{side}_{place}/analog:o"
full_scale = [1500, 1500, 2000, 35, 35, 25]
"""


def sweeping(folder: Path, *, by_mass: bool) -> Job:
    models = pytest.importorskip("icub_models")
    sensors = "".join(
        SENSOR.format(name=f"{side[0]}_{place}_ft", side=side, place=place)
        for side in ("left", "right")
        for place in ("leg", "foot")
    )
    job = folder / "job.toml"
    robot = models.get_model_file("iCubGenova01")
    job.write_text(
        SWEEPING.format(robot=robot, sensors=sensors, log=SWEEP, by_mass=str(by_mass).lower())
    )
    return read_job(job)


@pytest.fixture(scope="module", params=[False, True], ids=["six equations", "and by mass"])
def torso(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> WholeOutcome:
    folder = tmp_path_factory.mktemp("genova01")
    return calibrate_whole_body(sweeping(folder, by_mass=request.param))


@needs_genova01
@pytest.mark.parametrize("shank", [LEFT_SHANK, RIGHT_SHANK])
def test_torso_sweep_lowers_the_shank_on_held_out_time(torso: WholeOutcome, shank: str) -> None:
    left = held_out(torso, shank)
    # measured 2.71 of 4.06 N and 2.15 of 4.34 N; 0.20 of 0.68 Nm and 0.29 of 1.25 Nm
    assert left.whole_body.force < 0.75 * left.workbench.force
    assert left.whole_body.torque < 0.34 * left.workbench.torque


@needs_genova01
def test_torso_sweep_says_that_all_rests_on_the_workbench(torso: WholeOutcome) -> None:
    for result in torso.fit.sensors:
        assert {verdict.word for verdict in result.verdicts} == {"PARTIAL"}
        assert loose_scales(torso.fit.posterior, result.sensor.name) == [
            "the scale of its forces",
            "the scale of its torques",
        ]


@needs_genova01
def test_torso_sweep_keeps_the_scale_of_every_matrix(torso: WholeOutcome) -> None:
    posterior = torso.fit.posterior
    for words, along in posterior.unknowns.scales():
        # mean of three entries of the diagonal of E; measured -2.3 % in the left foot
        assert abs(along @ posterior.theta) / 3**0.5 < 0.03, words


@needs_genova01
def test_torso_sweep_keeps_what_all_sensors_read_of_it(torso: WholeOutcome) -> None:
    found = [reading_amplitude(torso.fit, s.sensor.name) for s in torso.fit.sensors]
    # measured 1.020 and 0.992
    assert float(np.prod(found) ** 0.25) == pytest.approx(1.0, abs=0.03)
    # measured 0.91 to 1.15
    assert min(found) > 0.8
    assert max(found) < 1.25


@needs_genova01
@pytest.mark.xfail(
    strict=True,
    reason="measured 0.94 and 1.15 in the left foot and leg (0.91 and 1.09 by mass too): their"
    " Workbenches disagree by 4 N of the 13 N that move",
)
def test_torso_sweep_keeps_every_amplitude(torso: WholeOutcome) -> None:
    for result in torso.fit.sensors:
        own = reading_amplitude(torso.fit, result.sensor.name)
        assert own == pytest.approx(1.0, abs=0.03), result.sensor.name


@needs_genova01
def test_torso_sweep_weighs_the_robot_as_the_workbench_does(torso: WholeOutcome) -> None:
    by_mass = torso.job.whole_body.by_mass
    # without the part that carries both arms there is nothing to weigh
    assert len(torso.weighings) == (2 if by_mass else 0)
    for one in torso.weighings:
        # measured 31.07 and 31.17 of 31.06 kg; the Workbench reads 30.91 and 30.86
        assert one.whole_body == pytest.approx(one.model, rel=0.01)
