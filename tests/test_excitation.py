"""What cannot be known is named before any number: the two traps of the method among it."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from ftcal.excitation import in_words
from ftcal.fit import FitOptions, fit
from ftcal.samples import Samples
from ftcal.sensor import AXES, Workbench
from ftcal.verdict import identifiable, judge, overall
from pretend import FULL_SCALE, bent, samples, tiled, workbench

PRIOR = workbench()
POSES = (
    Path(__file__).resolve().parents[2] / "shared/data/ati-gamma-lbrmed/0-calibration_fts-accel.csv"
)


def test_rich_motion_is_accepted_in_every_direction() -> None:
    rng = np.random.default_rng(0)
    found = fit(tiled(samples(bent(PRIOR, rng), rng)), PRIOR)
    assert found.excitation.rank == 6
    assert all(identifiable(found.excitation, axis).word == "ACCEPT" for axis in range(6))


@pytest.mark.parametrize("moving", [1, 3, 5])
def test_axes_that_never_move_are_directions_not_excited(moving: int) -> None:
    rng = np.random.default_rng(1)
    some = samples(PRIOR.gain, rng, axes=moving)
    # white noise on the channels: even a still axis is never exactly still
    noisy = some.channels + rng.normal(size=some.channels.shape)
    found = fit(tiled(dataclasses.replace(some, channels=noisy)), PRIOR)
    assert found.excitation.rank == moving
    verdict = identifiable(found.excitation, 0)
    assert verdict.word == "PARTIAL"
    assert f"{6 - moving} direction" in verdict.reason
    assert all(axis in verdict.reason for axis in AXES[moving:])


def test_directions_not_excited_stay_at_the_prior() -> None:
    rng = np.random.default_rng(1)
    gain = bent(PRIOR, rng)
    some = samples(gain, rng, axes=4)
    noisy = dataclasses.replace(some, channels=some.channels + rng.normal(size=(2000, 6)))
    found = fit(tiled(noisy), PRIOR, FitOptions(kappa=0.03))
    E = (found.estimate.gain - PRIOR.gain) / FULL_SCALE[:, None] @ np.linalg.inv(PRIOR.scaling)
    for direction in found.excitation.directions:
        along = np.abs(E @ direction.vector).max()
        assert (along > 1e-3) == direction.excited
        if not direction.excited:
            assert along < 1e-9  # of what is excited, rounding
            assert (direction.share == 0).all()


def test_a_robot_that_stands_still_is_refused() -> None:
    rng = np.random.default_rng(2)
    some = samples(PRIOR.gain, rng, share=0.0, noise=1e-3)
    noisy = some.channels + rng.normal(size=some.channels.shape)
    found = fit(tiled(dataclasses.replace(some, channels=noisy)), PRIOR)
    assert [v.word for v in judge(found.excitation, None, FULL_SCALE)] == ["REFUSE"] * 6


def test_scale_gauge_of_a_lone_balance_is_refused() -> None:
    """A shank between two sensors whose sum is its constant weight: C -> 0 fits, so refuse."""
    rng = np.random.default_rng(3)
    true = samples(PRIOR.gain, rng, count=2000)
    hip, ankle = true.channels, -true.channels
    both = np.concatenate([hip, ankle], axis=1) + rng.normal(size=(2000, 12))
    weight = np.tile([0.0, 0.0, -40.0, 0.0, 0.0, 0.0], (2000, 1))
    shank = Samples("shank", 0.0, 20.0, true.time, both, weight)
    gains = np.concatenate([PRIOR.gain, PRIOR.gain], axis=1)
    prior = Workbench("both", gains, FULL_SCALE, "channels")
    plain = fit(tiled(shank), prior, FitOptions(penalty=1e-9))
    assert plain.excitation.scale_is_free
    verdicts = judge(plain.excitation, None, FULL_SCALE)
    assert {v.word for v in verdicts} == {"REFUSE"}
    assert all("scale gauge" in v.reason for v in verdicts)
    assert overall(verdicts) == "REFUSE"


@pytest.mark.skipif(not POSES.exists(), reason="shared/data/ati-gamma-lbrmed is not here")
def test_one_static_payload_leaves_three_directions_unexcited() -> None:
    """Real ATI Gamma: torque is collinear with force x centre of mass, three columns are free."""
    table = np.loadtxt(POSES, delimiter=",", skiprows=1)
    reading, gravity = table[:, :6], table[:, 9:12]
    mass, z = 0.932, 0.044
    force = mass * gravity
    torque = np.cross([0.0, 0.0, z], force)
    ratings = np.array([65.0, 65.0, 200.0, 5.0, 5.0, 5.0])  # ATI Gamma SI-65-5, data sheet
    prior = Workbench("as logged", np.eye(6), ratings, "channels")
    sign = np.sign(np.sum((reading - reading.mean(0))[:, :3] * (force - force.mean(0))))
    poses = Samples(
        "poses", 0, 24, np.arange(24.0), reading, sign * np.concatenate([force, torque], axis=1)
    )
    found = fit(tiled(poses), prior, FitOptions(kappa=0.03))
    assert found.excitation.rank == 3
    assert len(found.excitation.unexcited) == 3
    for axis in range(6):
        verdict = identifiable(found.excitation, axis)
        assert verdict.word == "PARTIAL"
        assert "3 directions not excited" in verdict.reason
    # cross-validation is blind to it: plain least squares looks fine, its null columns are noise
    plain = fit(tiled(poses), prior, FitOptions(penalty=0.0))
    assert np.abs(plain.estimate.gain - np.eye(6)).max() > 0.5


def test_a_direction_reads_like_a_person_would_say_it() -> None:
    assert in_words(np.array([0, 0.4, 0, 0, 0, 1.0]), AXES) == "tz + 0.4 fy"
    assert in_words(np.array([-1.0, 0.5, 0.1, 0, 0, 0]), AXES) == "fx - 0.5 fy"
