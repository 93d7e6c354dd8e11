"""Both validations of the paper find what was planted, and a study is made once."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from click.testing import CliRunner

from ftcal import logs
from ftcal.archive import Shelf, packed
from ftcal.balances import Balance
from ftcal.cli import main
from ftcal.config import read_job
from ftcal.contact import ContactSchedule, Interval
from ftcal.errors import DataError, FtcalError, JobError, RobotError
from ftcal.external import external_wrenches
from ftcal.first_validation import FirstValidation, first_validation, norms, training_sets
from ftcal.law import Law, aligned
from ftcal.logs import yarp
from ftcal.moments import Moments
from ftcal.motion import FixedContact
from ftcal.offset import InSituOffset, in_situ_offset
from ftcal.pairing import one_sided
from ftcal.pipeline import ft_channel
from ftcal.preparation import KINDS, SensorTake, ingredients
from ftcal.samples import Samples
from ftcal.second_validation import (
    BEST,
    MIXED,
    TRUTH,
    WORKBENCH,
    SecondValidation,
    judging_balance,
    second_validation,
    sub_chains,
)
from ftcal.signals import joint_motion
from ftcal.spatial import pose, rotation_about, wrench_transform
from ftcal.study import StudyOutcome, same_sensors, study
from ftcal.urdf import read_robot
from pretend import FULL_SCALE, bent, samples, workbench
from study_world import (
    LEGS,
    RECORDINGS,
    RIGHT,
    SWITCHING,
    Sensor,
    planted_offset,
    pretend_sensors,
    take,
    unit,
    write_study,
)
from walker import SIGNALS, walker

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

PRIOR = workbench()
TRUE = bent(PRIOR, np.random.default_rng(1))
REFUSED = InSituOffset(np.zeros(6), 1.0, 1.0, 1.0, 0.0)
LAMBDAS = (0.0, 0.5, 10.0)


# --------------------------------------------------------------------------- the first validation


def planted(
    gain: Float[Array, "6 6"], seed: int, *, noise: float = 0.0, offset: float = 0.1
) -> SensorTake:
    """Return a take of two segments of 20 s with an offset each, both known in situ."""
    segments, offsets = [], []
    for k in range(2):
        rng = np.random.default_rng((seed, k))
        raw = -np.linalg.solve(gain, (k - 0.5) * offset * FULL_SCALE)
        segments.append(samples(gain, rng, offset=(k - 0.5) * offset, noise=noise))
        offsets.append(InSituOffset(raw, 0.0, 0.0, 0.0, 1.0))
    return SensorTake(tuple(segments), tuple(offsets), segments[0], (0,) * 6)


def every(takes: dict[str, SensorTake]) -> FirstValidation:
    return first_validation(takes, tuple(takes), tuple(takes), PRIOR)


def test_a_planted_law_leaves_nothing_on_any_recording() -> None:
    first = every({name: planted(TRUE, seed) for seed, name in enumerate("abc")})
    assert [one.name for one in first.sets] == ["a", "a (in situ)", "b", "b (in situ)", "c",
                                                "c (in situ)"]  # fmt: skip
    # percent of the Workbench's error; raw offsets of thousands of counts ride on the signal
    for norm in ("absolute", "rms"):
        assert first.percent(norm).max() < 1e-8
    assert not first.dropped
    for estimate in first.estimates:
        np.testing.assert_allclose(estimate.gain, TRUE, rtol=0, atol=1e-10 * abs(TRUE).max())


def test_no_matrix_has_less_rms_on_a_recording_than_the_one_fitted_to_it() -> None:
    # true of least squares alone: neither of the sum of |e| nor of offsets known beforehand
    takes = {name: planted(bent(PRIOR, np.random.default_rng(seed)), seed, noise=0.01)
             for seed, name in enumerate("abcd")}  # fmt: skip
    first = every(takes)
    for j, name in enumerate(takes):
        (own,) = (k for k, one in enumerate(first.sets) if one.name == name)
        least = first.rms[own, j]
        assert (first.rms[:, j] >= least * (1 - 1e-12)).all()
        assert (first.workbench_rms[j] >= least).all()


def test_a_set_that_learns_nothing_is_the_workbench_at_100_percent() -> None:
    silent = planted(TRUE, 0)
    # nothing moves but the model: least squares of least norm stays where it was
    dead = tuple(replace(s, channels=np.zeros_like(s.channels)) for s in silent.segments)
    takes = {"dead": replace(silent, segments=dead, offsets=(REFUSED,)), "good": planted(TRUE, 1)}
    first = first_validation(takes, ["dead", "good"], ["good"], PRIOR)
    assert first.sets[0].name == "dead"
    np.testing.assert_array_equal(first.estimates[0].gain, PRIOR.gain)
    for norm in ("absolute", "rms"):
        np.testing.assert_allclose(first.percent(norm)[0], 100.0, rtol=1e-12)
    assert first.dropped == {"dead": "100 % of the Workbench's error on the data sets it did not"
                                     " see"}  # fmt: skip


def test_both_norms_are_those_of_a_direct_computation() -> None:
    takes = {name: planted(bent(PRIOR, np.random.default_rng(seed)), seed, noise=0.01)
             for seed, name in enumerate("ab")}  # fmt: skip
    first = every(takes)

    def centred(parts: Sequence[Array]) -> Array:
        return np.concatenate([part - part.mean(axis=0) for part in parts])

    tables = [
        (centred([s.channels for s in take.segments]), centred([s.wrench for s in take.segments]))
        for take in takes.values()
    ]
    channels, wrench = tables[0]
    gain = np.linalg.lstsq(channels, wrench, rcond=None)[0].T
    for j, (r, w) in enumerate(tables):
        new, old = abs(r @ gain.T - w), abs(r @ PRIOR.gain.T - w)
        assert first.sets[0].name == "a"
        for group, axes in {"force": slice(3), "tx": slice(3, 4), "all": slice(6)}.items():
            percent = 100 * new[:, axes].sum() / old[:, axes].sum()
            assert first.percent("absolute", group)[0, j] == pytest.approx(percent, rel=1e-9)
            percent = 100 * np.sqrt((new[:, axes] ** 2).sum() / (old[:, axes] ** 2).sum())
            assert first.percent("rms", group)[0, j] == pytest.approx(percent, rel=1e-9)


def test_norms_are_mean_and_root_mean_square() -> None:
    absolute, rms = norms(np.array([[3.0] * 6, [-4.0] * 6]))
    np.testing.assert_allclose(absolute, 3.5)
    np.testing.assert_allclose(rms, np.sqrt(12.5))


def test_a_set_that_is_worse_than_the_workbench_elsewhere_is_dropped_with_the_figure() -> None:
    wrong = bent(PRIOR, np.random.default_rng(7), 0.3)
    takes = {"a": planted(TRUE, 0), "b": planted(TRUE, 1), "bad": planted(wrong, 2)}
    first = first_validation(takes, ["a", "b", "bad"], ["a", "b"], PRIOR)
    assert set(first.dropped) == {"bad", "bad (in situ)"}
    figure = first.elsewhere()[4]
    assert figure > 300
    assert first.dropped["bad"].startswith(f"{figure:.0f} % of the Workbench's error")
    assert [first.sets[k].name for k in first.surviving] == ["a", "a (in situ)", "b",
                                                            "b (in situ)"]  # fmt: skip
    # on the data it learnt from it is perfect all the same
    assert first.percent()[4, 2] < 1e-8


def test_its_own_recording_and_the_switching_run_do_not_judge_a_set() -> None:
    takes = {"a": planted(TRUE, 0), "b": planted(TRUE, 1, noise=0.01), "run": planted(TRUE, 2)}
    first = first_validation(takes, ["a", "b"], ["a", "b"], PRIOR)
    assert first.recordings == ("a", "b", "run")
    assert first.elsewhere()[0] == first.percent()[0, 1]
    assert first.held_out[0] is not None
    assert {piece.recording for piece in first.held_out[0].pieces} == {"pretend"}
    assert len(first.held_out[0].pieces) == 2


def test_a_set_that_nothing_else_judges_survives() -> None:
    first = every({"alone": planted(TRUE, 0)})
    assert np.isnan(first.elsewhere()).all()
    assert first.surviving == (0, 1)
    assert first.held_out == (None, None)
    assert first.best_per_axis()[0] == ("fx", "Workbench", 100.0)


def test_the_best_row_of_an_axis_may_be_the_workbench_s() -> None:
    better = PRIOR.gain.copy()
    better[2] = TRUE[2]
    worse = bent(PRIOR, np.random.default_rng(7), 0.3)
    takes = {"judge": planted(better, 0)}
    takes["learner"] = planted(np.where(np.arange(6)[:, None] == 2, TRUE, worse), 1)
    first = first_validation(takes, ["learner"], ["judge", "learner"], PRIOR)
    best = {axis: (name, percent) for axis, name, percent in first.best_per_axis()}
    assert best["fz"][0].startswith("learner")
    assert best["fz"][1] < 1e-6
    assert {best[axis] for axis in ("fx", "fy", "tx", "ty", "tz")} == {("Workbench", 100.0)}


def test_an_offset_in_situ_is_used_only_where_every_segment_s_holds() -> None:
    good = planted(TRUE, 0)
    moving = InSituOffset(good.offsets[1].offset, 0.0, 0.0, 0.18, 1.0)
    both, refused = training_sets("a", good)
    assert [one.method for one in both] == ["centred", "in situ"]
    assert not refused
    one, refused = training_sets("a", replace(good, offsets=(good.offsets[0], moving)))
    assert [found.method for found in one] == ["centred"]
    assert refused == {"a (in situ)": "the centre of mass moves by 180 mm"}


def test_a_wrong_offset_in_situ_spoils_that_set_alone() -> None:
    good = planted(TRUE, 0)
    shifted = tuple(replace(o, offset=o.offset + 2000.0) for o in good.offsets)
    first = every({"a": replace(good, offsets=shifted), "b": planted(TRUE, 1)})
    percent = first.percent()
    assert percent[0].max() < 1e-8
    assert percent[1].min() > 1.0


def test_a_recording_shorter_than_two_blocks_is_refused_by_name() -> None:
    short = samples(TRUE, np.random.default_rng(0), count=390, seconds=3.9)
    take = SensorTake((short,), (REFUSED,), short, (0,) * 6)
    with pytest.raises(DataError, match=r"'stub': 3\.9 s .* less than two blocks of 2 s") as error:
        first_validation({"stub": take}, ["stub"], ["stub"], PRIOR)
    assert_one_line(error.value)


# -------------------------------------------------------------------------- the second validation

SECONDS = 60.0


def free_body(
    true: Float[Array, "6 6"], *, later: Float[Array, "6 6"] | None = None
) -> tuple[Balance, dict[str, Law], Samples]:
    """Return a sub-chain between two sensors, `one` true and its neighbour as believed.

    From every second 10 s on `one` follows `later`. Its Workbench law is aligned on the samples.
    """
    rng = np.random.default_rng(11)
    mine = samples(true, rng, count=6000, seconds=SECONDS, noise=0.0, offset=0.05)
    other = samples(PRIOR.gain, rng, count=6000, seconds=SECONDS, noise=0.0)
    felt = mine.wrench
    if later is not None:
        odd = (mine.time // 10.0) % 2 == 1
        offset = aligned(true, mine).offset
        felt = np.where(odd[:, None], Law(later, offset).read(mine.channels), felt)
    X, Y = (moved_frame(rng, len(mine)) for _ in range(2))
    required = np.einsum("nij,nj->ni", X, felt) - np.einsum("nij,nj->ni", Y, other.wrench)
    balance = Balance(
        "shank", mine.time, {"one": mine.channels, "other": other.channels},
        {"one": X, "other": -Y}, required,
    )  # fmt: skip
    aligning = mine.between(0.0, 10.0)
    laws = {"one": aligned(PRIOR.gain, aligning), "other": aligned(PRIOR.gain, other)}
    return balance, laws, aligning


def moved_frame(rng: np.random.Generator, count: int) -> Float[Array, "N 6 6"]:
    R = rotation_about(unit(rng), rng.uniform(0, 3, count))
    return wrench_transform(pose(R, rng.normal(size=(count, 3)) / 3))


def part(balance: Balance, rows: slice) -> Balance:
    return Balance(
        balance.sub_model,
        balance.time[rows],
        {name: values[rows] for name, values in balance.inputs.items()},
        {name: values[rows] for name, values in balance.transforms.items()},
        balance.required[rows],
    )


def validated(
    gains: dict[str, Float[Array, "6 6"]], body: tuple[Balance, dict[str, Law], Samples]
) -> SecondValidation:
    """Return the second validation of sets that learnt `gains`; none of them is dropped."""
    takes = {name: planted(gain, seed) for seed, (name, gain) in enumerate(gains.items())}
    first = first_validation(takes, list(takes), [], PRIOR)
    return second_validation("one", first, body[0], body[1], body[2], PRIOR, LAMBDAS)


def test_the_true_matrix_among_right_neighbours_leaves_nothing() -> None:
    wrong = bent(PRIOR, np.random.default_rng(5), 0.1)
    second = validated({"right": TRUE, "wrong": wrong}, free_body(TRUE))
    best = second.candidates[second.best]
    assert (best.training.removesuffix(" (in situ)"), best.penalty) == ("right", 0.0)
    workbench_left = second.left[0]
    assert second.candidates[0].name == WORKBENCH
    assert workbench_left.force > 1.0
    assert second.left[second.best].force < 1e-9 * workbench_left.force
    assert second.left[second.best].torque < 1e-9 * workbench_left.torque
    assert second.mixed_left.force < 1e-9 * workbench_left.force
    assert second.neighbours == ("other",)
    assert second.seconds == pytest.approx(SECONDS)
    # Workbench, then two sets in two ways at three penalties
    assert len(second.candidates) == 1 + 2 * 2 * 3


def test_a_dropped_set_is_not_tried() -> None:
    wrong = bent(PRIOR, np.random.default_rng(7), 0.3)
    takes = {"a": planted(TRUE, 0), "b": planted(TRUE, 1), "bad": planted(wrong, 2)}
    first = first_validation(takes, list(takes), ["a", "b"], PRIOR)
    body = free_body(TRUE)
    second = second_validation("one", first, body[0], body[1], body[2], PRIOR, LAMBDAS)
    assert {one.training.removesuffix(" (in situ)") for one in second.candidates} == {
        WORKBENCH, "a", "b",
    }  # fmt: skip


def test_the_mixed_matrix_has_the_best_row_of_every_axis_and_its_own_offset() -> None:
    wrong = bent(PRIOR, np.random.default_rng(5), 0.1)
    upper = np.arange(6)[:, None] < 3
    body = free_body(TRUE)
    gains = {"forces": np.where(upper, TRUE, wrong), "torques": np.where(upper, wrong, TRUE)}
    second = validated(gains, body)
    chosen = [second.candidates[k].training.removesuffix(" (in situ)")
              for k in second.best_per_axis]  # fmt: skip
    assert chosen == ["forces"] * 3 + ["torques"] * 3
    for axis, k in enumerate(second.best_per_axis):
        row = second.candidates[k].law.coefficients[axis]
        assert np.array_equal(second.mixed.coefficients[axis], row)
        assert second.left[k].axes[axis] == min(left.axes[axis] for left in second.left)
    aligning = body[2]
    mean = second.mixed.read(aligning.channels).mean(axis=0)
    # of readings of 30 000 counts
    np.testing.assert_allclose(mean, aligning.wrench.mean(axis=0), atol=1e-9)
    assert second.mixed_left.force < 1e-9 * second.left[0].force
    assert second.left[second.best].torque > 1e-3 * second.left[0].torque


def test_what_is_unseen_was_not_chosen_by() -> None:
    # in every second 10 s the sensor is its Workbench: who wins elsewhere fails there
    body = free_body(TRUE, later=PRIOR.gain)
    body[1]["one"] = Law(PRIOR.gain, aligned(TRUE, body[2]).offset)
    second = validated({"bait": TRUE}, body)
    assert second.unseen[WORKBENCH].force < 1e-9 * second.left[0].force
    for name in (BEST, MIXED):
        assert second.unseen[name].force > 0.5 * second.left[0].force
    # on all seconds together the bait looks no worse than half of it
    assert second.left[second.best].force <= second.left[0].force


def test_a_run_of_one_piece_leaves_nothing_unseen() -> None:
    balance, laws, aligning = free_body(TRUE)
    second = validated({"right": TRUE}, (part(balance, slice(900)), laws, aligning))
    assert second.unseen == {}


def test_a_run_without_a_sample_to_choose_by_leaves_nothing_unseen() -> None:
    balance, laws, aligning = free_body(TRUE)
    second = validated({"right": TRUE}, (part(balance, slice(1100, 1900)), laws, aligning))
    assert second.unseen == {}


def test_a_row_without_a_thermometer_mixes_with_one_that_has() -> None:
    body, laws, aligning = free_body(TRUE)
    warm = np.linspace(-5.0, 5.0, len(body.time))
    k = np.linspace(0.1, 0.6, 6)
    X = body.transforms["one"]
    heated = replace(
        body,
        inputs={**body.inputs, "one": np.column_stack([body.inputs["one"], warm])},
        required=body.required + np.einsum("nij,nj->ni", X, np.outer(warm, k)),
    )
    early = warm[: len(aligning)]
    told = replace(aligning, temperature=early, wrench=aligning.wrench + np.outer(early, k))
    take = planted(TRUE, 0)
    segments = tuple(
        replace(s, temperature=s.time - 10.0, wrench=s.wrench + np.outer(s.time - 10.0, k))
        for s in take.segments
    )
    takes = {"right": replace(take, segments=segments, offsets=(REFUSED,))}
    first = first_validation(takes, ["right"], [], PRIOR)
    laws["one"] = aligned(PRIOR.gain, told)
    second = second_validation("one", first, heated, laws, told, PRIOR, (0.0,))
    assert second.mixed.coefficients.shape == (6, 7)
    np.testing.assert_allclose(second.mixed.coefficients[:, 6], k, rtol=1e-9)
    assert second.mixed_left.force < 1e-9 * second.left[0].force


def test_all_sensors_read_right_leave_nothing_in_any_sub_chain() -> None:
    balance, laws, aligning = free_body(TRUE)
    right = {**laws, "one": aligned(TRUE, aligning)}
    (chain,) = sub_chains([balance], {WORKBENCH: laws, "truth": right})
    assert (chain.name, chain.sensors) == ("shank", ("one", "other"))
    assert chain.left["truth"].force < 1e-9 * chain.left[WORKBENCH].force


def test_the_sub_chain_that_is_free_longest_judges_then_the_one_of_fewest_sensors() -> None:
    shank = free_body(TRUE)[0]
    foot = replace(shank, sub_model="foot", inputs={"one": shank.inputs["one"]},
                   transforms={"one": shank.transforms["one"]})  # fmt: skip
    assert judging_balance("one", [shank, foot]).sub_model == "foot"
    shorter = replace(foot, time=foot.time[:5000])
    assert judging_balance("one", [shorter, shank]).sub_model == "shank"
    with pytest.raises(DataError, match="sensor 'tow': no sub-chain beside it is ever free"):
        judging_balance("tow", [shank])


# ---------------------------------------------------------------------------------- study, on disk


@pytest.fixture(scope="module")
def sensors() -> dict[str, Sensor]:
    return pretend_sensors()


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory, sensors: dict[str, Sensor]) -> Path:
    """Return the folder of a study, its shelf filled."""
    folder = tmp_path_factory.mktemp("study")
    write_study(folder, sensors)
    study(read_job(folder / "study.toml"), shelf=folder / "shelf")
    return folder


@pytest.fixture
def own(world: Path, tmp_path: Path) -> Path:
    """Return a copy of the world that a test may spoil."""
    shutil.copytree(world, tmp_path / "own")
    return tmp_path / "own"


@pytest.fixture
def reads(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return the names of the recordings that are read from now on."""
    names: list[str] = []
    original = logs.read

    def counting(path: Path, layout: logs.Layout, *, name: str | None = None) -> object:
        names.append(str(name))
        return original(path, layout, name=name)

    monkeypatch.setattr(logs, "read", counting)
    return names


def run(folder: Path) -> StudyOutcome:
    return study(read_job(folder / "study.toml"), shelf=folder / "shelf")


@pytest.fixture(scope="module")
def outcome(world: Path) -> StudyOutcome:
    return run(world)


def edit(folder: Path, old: str, new: str) -> None:
    text = (folder / "study.toml").read_text()
    assert old in text
    (folder / "study.toml").write_text(text.replace(old, new))


def test_a_study_finds_the_planted_matrices(
    outcome: StudyOutcome, sensors: dict[str, Sensor]
) -> None:
    assert [one.sensor.name for one in outcome.sensors] == list(RIGHT)
    assert outcome.improved
    for one in outcome.sensors:
        first, name = one.first, one.sensor.name
        assert first.recordings == ("wide", "grid", "run")
        assert first.judging == ("wide", "grid")
        centred = [k for k, s in enumerate(first.sets) if s.method == "centred"]
        # the logs keep six decimals, and the grid turns gravity by little
        assert first.percent()[centred].max() < 0.1
        wide = first.estimates[0].gain
        error = abs(wide - sensors[name].gain).max() / abs(sensors[name].gain).max()
        assert error < 1e-3
    right = {chain.name: chain for chain in outcome.sub_chains}
    assert set(right) == {"trunk", "r_thigh", "r_foot"}
    # the shank reads 300 N; both of its sensors are as they are in the mounting
    assert right["r_thigh"].left[WORKBENCH].force > 10.0


def test_the_grid_tells_the_raw_offset_and_a_moving_centre_of_mass_refuses_it(
    outcome: StudyOutcome, sensors: dict[str, Sensor]
) -> None:
    grid = outcome.recordings[1]
    for name, one in sensors.items():
        planted_raw = -np.linalg.solve(one.gain, planted_offset("grid", name))
        (offset,) = grid.sensors[name].offsets
        assert offset.refusal is None
        # quasi-static, not static: one share in a thousand of the offset
        error = np.linalg.norm(offset.offset - planted_raw) / np.linalg.norm(planted_raw)
        assert error < 5e-3
    leg = outcome.sensors[0].first
    assert [one_set.name for one_set in leg.sets] == ["wide", "grid", "grid (in situ)"]
    assert leg.refused["wide (in situ)"].startswith("the centre of mass moves by")


def test_an_ellipsoid_without_dynamics_has_the_planted_centre() -> None:
    rng = np.random.default_rng(4)
    gravity = 9.81 * np.array([unit(rng) for _ in range(500)])
    centre = np.broadcast_to([0.02, 0.01, -0.2], (500, 3))
    wrench = np.hstack([8.0 * gravity, np.cross(centre, 8.0 * gravity)])
    offset = 0.1 * FULL_SCALE
    channels = np.linalg.solve(TRUE, (wrench - offset).T).T
    found = in_situ_offset(Moments.of(np.hstack([channels, gravity, centre])), PRIOR.scaling)
    assert found.refusal is None
    planted_raw = -np.linalg.solve(TRUE, offset)
    np.testing.assert_allclose(found.offset, planted_raw, atol=1e-9 * abs(planted_raw).max())


def test_the_workbench_leaves_the_external_wrench(world: Path, outcome: StudyOutcome) -> None:
    robot = read_robot(world / "walker.urdf")
    job = outcome.job
    section = job.recordings[2]
    recording = logs.read(job.path(section.log), section.layout(), name="run")
    law, raw = {}, {}
    for one in outcome.sensors:
        assert one.second is not None
        law[one.sensor.name] = one.second.candidates[0].law
        logged = recording.channel(SIGNALS[one.sensor.name]).values
        raw[one.sensor.name] = one.channel.workbench.channels(logged)
    clock = recording.channel(SIGNALS[RIGHT[0]])
    motion, known = joint_motion(recording, LEGS, clock.stamps)
    readings = {name: law[name].read(values) for name, values in raw.items()}
    parts = []
    for interval in SWITCHING.intervals:
        rows = known & (motion.time >= interval.start) & (motion.time < interval.stop)
        here = {name: values[rows] for name, values in readings.items()}
        contact = FixedContact(interval.link)
        found = external_wrenches(robot, motion.rows(rows), contact, here, {"r_thigh": "r_thigh"})
        parts.append(found.wrench["r_thigh"])
    wrench = np.concatenate(parts)
    leg = outcome.sensors[0].second
    assert leg is not None
    assert leg.sub_chain == "r_thigh"
    # the sensor's frame is the thigh's, and its reading acts on the hip: both signs are turned
    np.testing.assert_allclose(leg.error[WORKBENCH], wrench, atol=1e-9 * abs(wrench).max())
    force = np.linalg.norm(wrench[:, :3], axis=1).mean()
    assert leg.left[0].force == pytest.approx(force, rel=1e-9)


def test_a_second_study_reads_no_log(own: Path, reads: list[str], outcome: StudyOutcome) -> None:
    again = run(own)
    assert reads == []
    for kept, made in zip(again.recordings, outcome.recordings, strict=True):
        assert packed(kept) == packed(made)


def test_other_penalties_or_training_sets_read_no_log(own: Path, reads: list[str]) -> None:
    edit(own, "[study]", '[study]\nlambdas = [0, 3]\ntraining = ["grid"]')
    changed = run(own).sensors[0]
    assert reads == []
    assert {one.recording for one in changed.first.sets} == {"grid"}
    assert changed.second is not None
    assert {one.penalty for one in changed.second.candidates} == {0.0, 3.0}


def places(folder: Path) -> dict[str, Path]:
    """Return where each recording of a job lies on the shelf."""
    job = read_job(folder / "study.toml")
    robot = read_robot(job.path(job.robot))
    channels = [ft_channel(job, robot, section) for section in job.sensors]
    shelf = Shelf(folder / "shelf", KINDS)
    return {
        section.label: shelf.place(ingredients(job, robot, channels, section))
        for section in job.recordings
    }


def text_in(file: str, old: str, new: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        text = (folder / file).read_text()
        assert old in text
        (folder / file).write_text(text.replace(old, new, 1))

    return change


ALL = set(RECORDINGS)
OPTIONS: dict[str, tuple[Callable[[Path], None], set[str]]] = {
    "nothing": (lambda folder: None, set()),
    "output": (text_in("study.toml", "robot =", 'output = "elsewhere"\nrobot ='), set()),
    "penalties": (text_in("study.toml", "[study]", "[study]\nlambdas = [1]"), set()),
    "smoothing": (text_in("study.toml", "[study]", "[signals]\nsmoothing = 0.81\n[study]"), ALL),
    "joint filter": (text_in("study.toml", "[study]", "[signals]\njoint_order = 3\n[study]"), ALL),
    "full scale": (text_in("study.toml", "[1587.0", "[1588.0"), ALL),
    "Workbench": (text_in("r_leg_ft_sensor.csv", "0.0", "0.1"), ALL),
    "mass of a link": (text_in("walker.urdf", '<mass value="18', '<mass value="17'), ALL),
    "window": (text_in("study.toml", 'log = "grid"', 'log = "grid"\ntrain = [[2, 20]]'), {"grid"}),
    "gravity": (
        text_in("study.toml", 'log = "wide"', 'log = "wide"\ngravity = [0, 0, -9.81]'),
        {"wide"},
    ),
    "contacts": (text_in("study.toml", "start = 14", "start = 15"), {"run"}),
    "no run": (text_in("study.toml", 'switching = "run"\nalign = [1, 13]', ""), {"run"}),
}


@pytest.mark.parametrize("option", OPTIONS)
def test_a_recording_is_found_again_until_what_made_it_changes(own: Path, option: str) -> None:
    change, anew = OPTIONS[option]
    before = places(own)
    change(own)
    after = places(own)
    assert {name for name in RECORDINGS if before[name] != after[name]} == anew


def test_another_align_window_makes_the_run_alone_anew(own: Path) -> None:
    before = places(own)
    edit(own, "align = [1, 13]", "align = [2, 13]")
    after = places(own)
    assert {name for name in RECORDINGS if before[name] != after[name]} == {"run"}


def test_a_changed_byte_of_a_log_makes_that_recording_anew(own: Path, reads: list[str]) -> None:
    log = next((own / "grid").rglob("right_foot/analog:o/data.log"))
    text = log.read_text()
    first = text.index(".", text.index(" ", text.index(" ") + 1))
    digit = text[first + 6]
    log.write_text(text[: first + 6] + str((int(digit) + 1) % 10) + text[first + 7 :])
    run(own)
    assert reads == ["grid"]


def test_a_spoilt_file_on_the_shelf_is_made_anew(own: Path, reads: list[str]) -> None:
    files = sorted((own / "shelf").iterdir())
    assert len(files) == 3
    whole = files[0].read_bytes()
    files[0].write_bytes(whole[: len(whole) // 2])
    run(own)
    assert len(reads) == 1
    assert files[0].read_bytes() == whole


def test_two_workers_make_what_one_makes(own: Path, outcome: StudyOutcome) -> None:
    text = (own / "study.toml").read_text()
    (own / "study.toml").write_text(text[: text.index('[[recordings]]\nname = "run"')])
    told: list[tuple[int, int]] = []
    both = study(
        read_job(own / "study.toml"),
        workers=2,
        progress=lambda _, done, total: told.append((done, total)),
    )
    for one, other in zip(outcome.recordings[:2], both.recordings, strict=True):
        assert packed(one) == packed(other)
    assert told == [(done, 4) for done in range(5)]
    # without a run that switches contacts there is the first validation alone
    assert both.sub_chains == ()
    assert [one.second for one in both.sensors] == [None, None]


def write_truth(file: Path, sensors: dict[str, Sensor]) -> None:
    table = {name: {"gain": one.gain.tolist()} for name, one in sensors.items()}
    file.write_text(json.dumps({"sensors": table}))


def test_the_truth_leaves_nothing_where_it_is_known(own: Path, sensors: dict[str, Sensor]) -> None:
    write_truth(own / "truth.json", sensors)
    edit(own, "[study]", '[study]\ntruth = "truth.json"')
    for chain in run(own).sub_chains:
        # six decimals of N; the offset is the mean of half a minute
        assert chain.left[TRUTH].force < 1e-5
        assert chain.left[WORKBENCH].force > 0.1


def test_the_truth_may_have_any_name(own: Path, sensors: dict[str, Sensor]) -> None:
    write_truth(own / "true_gains.json", sensors)
    edit(own, "[study]", '[study]\ntruth = "true_gains.json"')
    assert set(run(own).truth) == set(RIGHT)


# ------------------------------------------------------------------------------------- bad input


def assert_one_line(error: FtcalError) -> str:
    (line,) = str(error).splitlines()
    return line


def toml(old: str, new: str) -> Callable[[Path], None]:
    return lambda folder: edit(folder, old, new)


def without_signal(folder: Path) -> None:
    shutil.rmtree(next((folder / "grid").rglob("right_foot")))


def without_ankle(folder: Path) -> None:
    head, tail = (folder / "study.toml").read_text().split('name = "grid"')
    fewer = tail.replace("'r_ankle'", "''", 1)
    (folder / "study.toml").write_text(head + 'name = "grid"' + fewer)


def without_training(folder: Path) -> None:
    text = (folder / "study.toml").read_text()
    run_alone = re.sub(r'\[\[recordings\]\]\nname = "(wide|grid)"\n(.*\n){3}', "", text)
    (folder / "study.toml").write_text(run_alone)


RUN = '  {start = 14, stop = 26, link = "l_sole"},\n'
CASES: dict[str, tuple[Callable[[Path], None], type[FtcalError], list[str]]] = {
    "overlapping intervals": (
        toml("start = 14", "start = 12"),
        JobError,
        ["intervals [1, 13) and [12, 26) s overlap"],
    ),
    "unordered intervals": (
        toml(RUN + '  {start = 27, stop = 39, link = "r_sole"},\n',
             '  {start = 27, stop = 39, link = "r_sole"},\n' + RUN),
        JobError,
        ["[27, 39) and [14, 26) s", "out of order"],
    ),
    "unknown contact": (toml('"l_sole"', '"l_sol"'), RobotError, ["no link 'l_sol'", "l_sole"]),
    "both halves always touch": (
        toml('log = "grid"\ncontact = "trunk"', 'log = "grid"\ncontact = ["trunk", "r_sole"]'),
        RobotError,
        ["both halves at sensor 'r_leg_ft_sensor'", "trunk", "r_sole"],
    ),
    "switching recording not in the job": (
        toml('switching = "run"', 'switching = "rum"'),
        JobError,
        ["no recording 'rum'", "did you mean run"],
    ),
    "training set not in the job": (
        toml("[study]", '[study]\ntraining = ["gird"]'),
        JobError,
        ["no recording 'gird'", "did you mean grid"],
    ),
    "switching run trains": (
        toml("[study]", '[study]\ntraining = ["run"]'),
        JobError,
        ["'run' cannot both train and switch contacts"],
    ),
    "align without samples": (
        toml("align = [1, 13]", "align = [50, 60]"),
        DataError,
        ["'run'", "no usable sample in align = [50.0, 60.0]"],
    ),
    "align backwards": (
        toml("align = [1, 13]", "align = [13, 1]"),
        JobError,
        ["align [13.0, 1.0] ends before it starts"],
    ),
    "truth missing": (
        toml("[study]", '[study]\ntruth = "truth.json"'),
        JobError,
        ["truth.json", "No such file"],
    ),
    "missing log": (
        lambda folder: shutil.rmtree(folder / "grid"),
        JobError,
        ["no log at grid", "relative"],
    ),
    "missing signal": (without_signal, DataError, ["no F/T signal of recording 'grid'"]),
    "missing joint": (without_ankle, DataError, ["r_ankle", "not logged"]),
    "training window beyond the log": (
        toml('log = "grid"', 'log = "grid"\ntrain = [[900, 950]]'),
        DataError,
        ["'grid'", "no usable sample in any window of `train`"],
    ),
    "training window shorter than two blocks": (
        toml('log = "grid"', 'log = "grid"\ntrain = [[10, 13]]'),
        DataError,
        ["'grid'", "less than two blocks"],
    ),
    "nothing to train on": (
        without_training,
        JobError,
        ["no recording to train on"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_bad_input_is_one_line(own: Path, case: str) -> None:
    change, kind, words = CASES[case]
    change(own)
    with pytest.raises(FtcalError) as error:
        run(own)
    line = assert_one_line(error.value)
    assert isinstance(error.value, kind), repr(error.value)
    assert not [word for word in words if word not in line], line


@pytest.mark.parametrize(
    ("case", "recording"),
    [
        ("overlapping intervals", "run"),
        ("unordered intervals", "run"),
        ("unknown contact", "run"),
        ("both halves always touch", "grid"),
        ("missing joint", "grid"),
    ],
)
def test_bad_input_names_the_recording(own: Path, case: str, recording: str) -> None:
    CASES[case][0](own)
    with pytest.raises(FtcalError, match=f"'{recording}'"):
        run(own)


def test_recordings_of_robots_with_other_boards_are_told_apart(
    own: Path, sensors: dict[str, Sensor]
) -> None:
    other = np.array([1500.0, 1700.0, 1900.0, 33.0, 34.0, 21.0])
    for name, scale in (("wide", FULL_SCALE), ("grid", other)):
        yarp.write(take(name, sensors, steps=scale / 32768), own / name)
    with pytest.raises(JobError, match="recordings of different robots") as error:
        run(own)
    line = assert_one_line(error.value)
    for sensor in RIGHT:
        assert f"{sensor} shows full scales" in line
    assert "'grid'" in line
    assert "'wide'" in line


BOARD, TWICE, CHANCE = (
    (1500, 1500, 0, 35, 35, 25),
    (3000, 1500, 0, 70, 0, 50),
    (1502, 9, 0, 35, 35, 25),
)
STRANGE, SILENT = (900, 1100, 700, 35, 35, 20), (0,) * 6


def boards(outcome: StudyOutcome, *scales: tuple[int, ...]) -> None:
    """Compare recordings whose sensors show these full scales."""
    shown = [
        replace(
            outcome.recordings[0],
            name=f"take {k}",
            sensors={
                name: replace(sensor, full_scale=scale)
                for name, sensor in outcome.recordings[0].sensors.items()
            },
        )
        for k, scale in enumerate(scales)
    ]
    same_sensors(shown, [one.channel for one in outcome.sensors])


def test_what_few_readings_show_of_a_board_is_not_another_robot(outcome: StudyOutcome) -> None:
    boards(outcome, BOARD, TWICE, CHANCE, SILENT)
    with pytest.raises(JobError, match=r"'take 0' but .* in 'take 2'"):
        boards(outcome, BOARD, SILENT, STRANGE)


def test_a_first_recording_that_shows_nothing_hides_no_other_robot(outcome: StudyOutcome) -> None:
    with pytest.raises(JobError, match="recordings of different robots"):
        boards(outcome, SILENT, BOARD, STRANGE)


def test_intervals_in_which_both_halves_touch_are_passed_over() -> None:
    robot = walker()
    touching = ContactSchedule((
        Interval(0.0, 1.0, "l_sole", ("r_sole",)),
        Interval(1.0, 2.0, "l_sole"),
        Interval(2.0, 3.0, "r_sole", ("r_shin",)),
        Interval(3.0, 4.0, "trunk"),
    ))  # fmt: skip
    kept = one_sided(robot, "r_leg_ft_sensor", touching).intervals
    assert [interval.start for interval in kept] == [1.0, 2.0, 3.0]
    kept = one_sided(robot, "r_foot_ft_sensor", touching).intervals
    assert [interval.start for interval in kept] == [1.0, 3.0]
    both = ContactSchedule(touching.intervals[:1])
    with pytest.raises(RobotError, match="both halves at sensor 'r_foot_ft_sensor'"):
        one_sided(robot, "r_foot_ft_sensor", both)
    later = ContactSchedule((Interval(0.0, 1.0, "l_sole"), Interval(1.0, 2.0, "r_soul")))
    with pytest.raises(RobotError, match="no link 'r_soul'; did you mean r_sole"):
        one_sided(robot, "r_foot_ft_sensor", later)


def test_the_command_prints_both_validations_and_writes_three_files(own: Path) -> None:
    result = CliRunner().invoke(
        main, ["study", str(own / "study.toml"), "-o", str(own / "out"), "--workers", "1"]
    )
    assert result.exit_code == 0, result.output
    assert {"study.html", "study.json", "calibration.json"} <= {
        file.name for file in (own / "out").iterdir()
    }
    words = result.stdout
    for head in ("trained on", "N / Nm", "2nd validation", "on pieces that did not choose"):
        assert head in words
    assert "in situ offset of wide refused: the centre of mass moves by" in words
    paths = ("report", "calibration")
    assert all(len(line) <= 100 for line in words.splitlines() if not line.startswith(paths))
    told = CliRunner().invoke(
        main,
        ["study", str(own / "study.toml"), "-o", str(own / "out"), "--workers", "1", "--json"],
    )
    assert json.loads(told.stdout)["format"] == "ftcal-study"
