"""In situ offset: right on a still centre of mass, refused on a moving one."""

from __future__ import annotations

import numpy as np

from ftcal.moments import Moments
from ftcal.offset import InSituOffset, in_situ_offset
from pretend import bent, workbench

PRIOR = workbench()
OFFSET = np.array([4000.0, -9000.0, 12000.0, -700.0, 20000.0, 3000.0])


def swung(spread: float, *, plane: bool = False) -> InSituOffset:
    """Return the offset found where a mass of 4 kg swings, its centre moving by `spread` m."""
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(500, 3))
    if plane:
        direction[:, 2] = 0.0
    gravity = 9.81 * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    centre = np.array([0.02, -0.01, 0.15]) + spread * rng.normal(size=(500, 3))
    force = 4.0 * gravity
    wrench = np.concatenate([force, np.cross(centre, force)], axis=1)
    gain = bent(PRIOR, rng)
    channels = np.linalg.solve(gain, wrench.T).T + OFFSET
    return in_situ_offset(Moments.of(np.hstack([channels, gravity, centre])), PRIOR.scaling)


def test_offset_is_exact_with_a_constant_centre_of_mass() -> None:
    found = swung(0.0)
    assert found.refusal is None
    np.testing.assert_allclose(found.offset, OFFSET, atol=1e-6)


def test_a_moving_centre_of_mass_is_refused_with_the_figure() -> None:
    found = swung(0.05)
    assert found.refusal is not None
    assert "centre of mass moves by 8" in found.refusal


def test_gravity_that_stays_in_a_plane_is_refused() -> None:
    found = swung(0.0, plane=True)
    assert found.refusal is not None
    assert "plane" in found.refusal
