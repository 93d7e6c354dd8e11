"""What a stretch of balances adds to the normal equations is what its residuals say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from ftcal.balances import Balance
from ftcal.terms import CHUNK, MODEL, Frame, ModelPrior, Segment, Terms, features, summed
from pretend import FULL_SCALE, workbench

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

BELIEF = ModelPrior(mass=0.02, com=0.01)
# sums of some hundred products of rounded numbers, next to the largest of them
ROUNDING = 1e-10
SOME = settings(max_examples=12, deadline=None, derandomize=True)
seeds = st.integers(0, 2**32 - 1)
ALWAYS = Segment("take", -np.inf, np.inf)


def a_balance(
    seed: int, *, count: int = 60, warm: tuple[str, ...] = (), by_mass: bool = False
) -> Balance:
    """Return a balance of three sensors over six seconds; those that are `warm` have a dT."""
    rng = np.random.default_rng(seed)
    names = ("a", "b", "c")
    inputs = {n: rng.normal(size=(count, 7 if n in warm else 6)) * 1e3 + 2e4 for n in names}
    transforms = {name: rng.normal(size=(count, 6, 6)) for name in names}
    required = rng.normal(size=(count, 6)) * 100
    time = np.arange(count) * (6.0 / count)
    return Balance("part", time, inputs, transforms, required, by_mass)


def frames_of(balance: Balance) -> dict[str, Frame]:
    return {
        name: Frame.of(workbench(seed), values.shape[1])
        for seed, (name, values) in enumerate(balance.inputs.items())
    }


def means_of(balance: Balance) -> dict[str, Float[Array, "P"]]:
    return {name: values.mean(axis=0) for name, values in balance.inputs.items()}


def terms_of(
    balance: Balance,
    segments: Mapping[str, tuple[Segment, ...]] | None = None,
    stretch: tuple[float, float] = (-np.inf, np.inf),
) -> list[Terms]:
    segments = segments or dict.fromkeys(balance.inputs, (ALWAYS,))
    frames, references = frames_of(balance), means_of(balance)
    return summed(balance, "take", frames, references, segments, stretch, BELIEF)


def size(values: Float[Array, "*N"]) -> float:
    return float(abs(values).max())


@given(seeds, st.booleans())
@SOME
def test_features_times_unknowns_are_the_residual_of_the_laws_they_stand_for(
    seed: int, by_mass: bool
) -> None:
    balance = a_balance(seed, warm=("b",), by_mass=by_mass)
    frames, references = frames_of(balance), means_of(balance)
    rng = np.random.default_rng(seed + 1)
    unknowns, readings = [], {}
    for name, inputs in balance.inputs.items():
        E, o = rng.normal(size=(6, inputs.shape[1])) * 0.03, rng.normal(size=6) * 0.1
        C = frames[name].coefficients(E)
        readings[name] = (inputs - references[name]) @ C.T + FULL_SCALE * o
        unknowns += [E.ravel(), o]
    mass, *shift = inertia = rng.normal(size=MODEL)
    required = balance.required * (1.0 + BELIEF.mass * mass)
    required[:, 3:] += np.cross(BELIEF.com * np.array(shift), balance.required[:, :3])
    expected = -replace(balance, required=required).residual(readings)[:, : balance.equations]
    table = features(balance, frames, references, BELIEF)
    found = (table @ np.append(-np.concatenate([*unknowns, inertia]), 1.0)).T
    assert found.shape == (60, balance.equations)
    assert size(found - expected) < ROUNDING * size(table)
    (terms,) = terms_of(balance)
    theta = np.concatenate([*unknowns, inertia])
    # a sum of squares of differences: rounding of its largest part
    scale = float(np.abs(terms.products).max())
    assert np.allclose(
        terms.squares(theta), (expected**2).sum(axis=0), rtol=1e-8, atol=1e-9 * scale
    )
    weight = np.bincount(np.minimum((balance.time / balance.time[-1] * 6).astype(int), 5)) / 60
    assert np.allclose(
        weight @ terms.cell_means(theta), expected.mean(axis=0), rtol=1e-6, atol=1e-6
    )


@given(seeds, st.floats(0.5, 5.5))
@SOME
def test_products_of_split_stretches_add_up(seed: int, cut: float) -> None:
    balance = a_balance(seed, warm=("a", "c"))
    (whole,) = terms_of(balance)
    parts = [*terms_of(balance, stretch=(-np.inf, cut)), *terms_of(balance, stretch=(cut, np.inf))]
    assert sum(part.count for part in parts) == whole.count == 60
    total = np.sum([part.products for part in parts], axis=0)
    assert size(total - whole.products) < ROUNDING * size(whole.products)


def test_products_of_many_chunks_are_those_of_all_samples() -> None:
    balance = a_balance(3, count=2 * CHUNK + 77)
    (terms,) = terms_of(balance)
    table = features(balance, frames_of(balance), means_of(balance), BELIEF)
    direct = np.einsum("end,enf->edf", table, table)
    assert size(terms.products - direct) < ROUNDING * size(direct)


def test_a_step_of_one_sensor_parts_the_stretch_and_that_sensors_offset_alone() -> None:
    balance = a_balance(4)
    early, late = Segment("take", -np.inf, 2.5), Segment("take", 2.5, np.inf)
    segments = {"a": (ALWAYS,), "b": (early, late), "c": (ALWAYS,)}
    first, second = terms_of(balance, segments)
    assert first.segments == (ALWAYS, early, ALWAYS)
    assert second.segments == (ALWAYS, late, ALWAYS)
    assert (first.count, second.count) == (25, 35)


def test_samples_in_no_segment_of_a_sensor_are_left_out() -> None:
    balance = a_balance(5)
    segments = {"a": (ALWAYS,), "b": (Segment("take", 1.0, 3.0),), "c": (ALWAYS,)}
    (terms,) = terms_of(balance, segments)
    assert (terms.count, terms.stretch.start, terms.stretch.stop) == (20, 1.0, 3.0)
    assert not terms_of(balance, segments, (4.0, 6.0))


def test_a_sub_model_by_mass_gives_three_equations_without_a_say_on_its_centre() -> None:
    (terms,) = terms_of(a_balance(6, by_mass=True))
    assert len(terms.products) == 3
    # the last but the target: where the centre of mass is
    assert not terms.products[:, -MODEL:-1].any()


def test_entries_of_zero_are_the_workbench_matrix() -> None:
    prior = workbench(2)
    assert np.array_equal(Frame.of(prior, 6).coefficients(np.zeros((6, 6))), prior.gain)
    warm = Frame.of(prior, 7).coefficients(np.zeros((6, 7)))
    assert np.array_equal(warm, np.hstack([prior.gain, np.zeros((6, 1))]))
