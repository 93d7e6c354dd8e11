from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ftcal.errors import SensorError
from ftcal.firmware import (
    decode,
    encode,
    estimate_full_scale,
    identify,
    lattice_error,
    lattice_fit,
    read_matrix,
    smallest_full_scale,
)

ROBOT = Path(__file__).resolve().parents[2] / "shared" / "data" / "icub-genova02"
real = pytest.mark.skipif(not ROBOT.is_dir(), reason="the recordings of iCubGenova02 are not here")
SERIALS = {
    "right_leg": "SN026",
    "right_foot": "SN230",
    "left_leg": "SN217",
    "left_foot": "SN229",
    "left_arm": "SN153",
    "right_arm": "SN151",
}
FULL_SCALE = [1587, 1823, 2113, 37, 38, 24]


def text_of(words: np.ndarray, scales: list[int]) -> str:
    return "\n".join([*(f"{int(w):X}" for w in words.ravel()), "1", *map(str, scales)]) + "\n"


def good_words(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 1 << 16, (6, 6))


def logged(serial: str) -> np.ndarray:
    part = next(part for part, number in SERIALS.items() if number == serial)
    path = ROBOT / "left_leg_support" / "icub" / part / "analog:o" / "data.log"
    return np.asarray(np.loadtxt(path)[:, 2:])


@given(
    words=arrays(np.uint16, (6, 6), elements=st.integers(0, 65535)),
    scales=st.lists(st.integers(1, 5000), min_size=6, max_size=6),
)
def test_encode_inverts_decode(words: np.ndarray, scales: list[int]) -> None:
    assume(np.linalg.cond(words.view(np.int16) / 32768) < 1e7)
    text = text_of(words, scales)
    decoded = decode(text, serial="SN1")
    np.testing.assert_array_equal(decoded.words.view(np.uint16), words)
    assert encode(decoded.matrix, decoded.full_scale) == text


@given(seed=st.integers(0, 1000), size=st.floats(1e-4, 1.0))
def test_decode_of_encode_is_within_half_a_word(seed: int, size: float) -> None:
    C = size * np.random.default_rng(seed).standard_normal((6, 6))
    decoded = decode(encode(C), serial="SN1")
    half_word = decoded.full_scale[:, None] / 32767 / 32768 / 2
    # a little more than half for the rounding of the products
    assert (np.abs(decoded.matrix - C) <= half_word * (1 + 1e-9)).all()
    # no reading of 32767 counts can overflow an output
    assert (np.abs(C).sum(axis=1) * 32767 <= decoded.full_scale * (1 + 1e-11)).all()


@real
@pytest.mark.parametrize("serial", SERIALS.values())
def test_published_files_survive_bit_by_bit(serial: str) -> None:
    path = ROBOT / "matrices" / f"matrix_{serial}.txt"
    matrix = read_matrix(path)
    assert matrix.serial == serial
    assert encode(matrix.matrix, matrix.full_scale).split() == path.read_text().split()


@real
def test_sn026_is_the_matrix_of_the_paper() -> None:
    matrix = read_matrix(ROBOT / "matrices" / "matrix_SN026.txt")
    assert matrix.full_scale.tolist() == FULL_SCALE
    assert round(float(np.linalg.cond(matrix.matrix))) == 90


@real
def test_every_log_names_its_serial_and_no_other() -> None:
    matrices = {s: read_matrix(ROBOT / "matrices" / f"matrix_{s}.txt") for s in SERIALS.values()}
    for serial in SERIALS.values():
        values = logged(serial)
        assert identify(values, matrices) == (serial,)
        scale = matrices[serial].full_scale
        # text of six decimals: at most 5e-7 of a step of 7e-4 Nm
        assert lattice_error(values, scale).max() < 1e-3
        estimate = estimate_full_scale(values)
        assert estimate.tolist() == scale.tolist()


def on_lattice(n: int = 500, seed: int = 0) -> np.ndarray:
    counts = np.random.default_rng(seed).integers(-8000, 8000, (n, 6))
    return np.asarray(np.round(counts * np.array(FULL_SCALE) / 32768, 6))


def test_lattice_fit_tells_neighbouring_full_scales_apart() -> None:
    for axis in range(6):
        neighbour = np.array(FULL_SCALE)
        neighbour[axis] += 1
        assert lattice_fit(on_lattice(), neighbour) == "off"
    assert lattice_fit(on_lattice(), np.array(FULL_SCALE)) == "fits"


def test_full_scale_is_estimated_from_values_alone() -> None:
    assert estimate_full_scale(on_lattice()).tolist() == FULL_SCALE
    noise = np.random.default_rng(0).standard_normal((500, 6))
    assert estimate_full_scale(noise).tolist() == [0] * 6
    assert estimate_full_scale(np.zeros((500, 6))).tolist() == [0] * 6


def test_full_scale_of_a_dense_axis_is_not_doubled() -> None:
    # every reading of a range; one in ten of them, from the first on, would all be even
    counts = np.arange(2, 2002)[:, None] * np.ones(6)
    values = np.round(counts * FULL_SCALE / 32768, 6)
    assert estimate_full_scale(values).tolist() == FULL_SCALE
    even = np.round(2 * counts * FULL_SCALE / 32768, 6)
    assert (estimate_full_scale(even) / FULL_SCALE).tolist() == [2] * 6


def test_frozen_or_zero_log_decides_nothing() -> None:
    frozen = np.repeat(on_lattice(1), 500, axis=0)
    assert lattice_fit(frozen, np.array(FULL_SCALE)) == "undecided"
    assert lattice_fit(np.zeros((500, 6)), np.array(FULL_SCALE)) == "undecided"
    assert np.isnan(lattice_error(np.zeros((5, 6)), np.array(FULL_SCALE))).all()


def test_one_wrong_axis_is_enough_to_refuse_even_if_another_is_silent() -> None:
    values = on_lattice()
    values[:, 0] = 0.0
    values[:, 5] += 0.4 * 24 / 32768
    assert lattice_fit(values, np.array(FULL_SCALE)) == "off"


def test_counts_invert_the_matrix() -> None:
    matrix = decode(text_of(good_words(), FULL_SCALE), serial="SN1")
    raw = np.random.default_rng(1).uniform(-30000, 30000, (50, 6))
    # condition about 1e2 times rounding of readings up to 3e4
    np.testing.assert_allclose(matrix.counts(raw @ matrix.matrix.T), raw, atol=1e-7)


def test_row_of_one_entry_gets_a_full_scale_that_holds_it() -> None:
    C = np.diag([1000, 1000, 2000, 30, 30, 20]) / 32767
    assert smallest_full_scale(C).tolist() == [1001, 1001, 2001, 31, 31, 21]
    assert decode(encode(C), serial="SN1").full_scale.tolist() == [1001, 1001, 2001, 31, 31, 21]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({0: None}, r"matrix SN1: 42 entries instead of 43"),
        ({3: "12G4"}, r"word 4 is '12G4', not 1 to 4 hex digits"),
        ({3: "12345"}, r"word 4 is '12345', not 1 to 4 hex digits"),
        ({36: "2"}, r"entry 37 is '2', not the constant 1"),
        ({38: "0", 39: "-3"}, r"full scale 2 is '0', .*; full scale 3 is '-3', not a positive"),
        (dict.fromkeys(range(6), "0"), r"singular, condition number"),
    ],
)
def test_broken_files_are_refused(change: dict[int, str | None], message: str) -> None:
    entries: list[str | None] = list(text_of(good_words(), FULL_SCALE).split())
    for index, entry in change.items():
        entries[index] = entry
    with pytest.raises(SensorError, match=message):
        decode("\n".join(e for e in entries if e is not None), serial="SN1")


@pytest.mark.parametrize(
    ("scale", "message"),
    [
        ([1587, 10, 2113, 37, 38, 24], r"row 2 needs a word of .*; raise full scale 2 from 10 to"),
        ([1587, 0, 2113, 37, 38, 24], r"full scale 2 is 0, not a positive whole number"),
        ([1587, 3.5, 2113, 37, 38, 24], r"full scale 2 is 3.5, not a positive whole number"),
    ],
)
def test_what_does_not_fit_is_never_written(scale: list[float], message: str) -> None:
    C = decode(text_of(good_words(), FULL_SCALE), serial="SN1").matrix
    with pytest.raises(SensorError, match=message):
        encode(C, np.array(scale))


def test_matrix_that_is_not_finite_is_refused() -> None:
    with pytest.raises(SensorError, match="6 x 6 finite numbers"):
        encode(np.full((6, 6), np.nan))


def test_file_errors_name_the_file(tmp_path: Path) -> None:
    path = tmp_path / "matrix_SN009.txt"
    with pytest.raises(SensorError, match=r"matrix_SN009.txt: cannot be read"):
        read_matrix(path)
    path.write_text("FF1E 43")
    with pytest.raises(SensorError, match=r"matrix_SN009.txt: matrix SN009: 2 entries"):
        read_matrix(path)
