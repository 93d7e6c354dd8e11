"""A sensor in a control loop says what the whole log says."""

from __future__ import annotations

import gc
import sys
import tracemalloc
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from ftcal.applying import ZERO, corrected
from ftcal.calibration import (
    AxisVerdict,
    Calibration,
    Centre,
    Offset,
    Prior,
    Provenance,
    SensorCalibration,
)
from ftcal.errors import DataError
from ftcal.live import SdReader, WrenchReader
from ftcal.recording import NANOSECONDS, Recording, Signal
from ftcal.sensor import AXES

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

FULL_SCALE = [2000.0, 2000.0, 2000.0, 40.0, 40.0, 40.0]


def sensor(
    channels: int = 6, *, warm: bool = False, wrench: bool = False, refused: str = ""
) -> SensorCalibration:
    """Return a sensor of matrices drawn at random; offsets of the recordings `one` and `two`."""
    rng = np.random.default_rng(channels)
    workbench = rng.normal(size=(6, channels)) * 0.05
    gain = workbench * (1.0 + 0.1 * rng.normal(size=(6, channels)))
    inputs = channels + warm
    roots = rng.normal(size=(6, inputs, inputs)) * 1e-4
    offsets = [
        Offset(
            recording=name, start=0.0, stop=1.0, offset=rng.normal(size=6).tolist(), sd=[0.1] * 6,
            centre=Centre(inputs=(1e3 * rng.normal(size=inputs)).tolist(), sd=[0.2] * 6),
        )
        for name in ("one", "two")
    ]  # fmt: skip
    verdicts = [
        AxisVerdict(axis=axis, verdict="REFUSE" if axis == refused else "ACCEPT", reason="drawn")
        for axis in AXES
    ]
    return SensorCalibration(
        sensor="leg", signal="leg", logged="wrench" if wrench else "channels", frame="leg",
        acts_on="leg", temperature_signal="board" if warm else None, gain=gain.tolist(),
        fitted_gain=gain.tolist(), secondary=None,
        temperature_gain=rng.normal(size=6).tolist() if warm else None,
        reference_temperature=30.0, offsets=offsets,
        covariance=(roots @ roots.transpose(0, 2, 1)).tolist(), envelope={}, noise_sd=[0.1] * 6,
        inefficiency=[1.0] * 6,
        prior=Prior(
            name="drawn", gain=workbench.tolist(), full_scale=FULL_SCALE, form="kappa",
            strength=0.1, chosen_by="job",
        ),
        verdicts=verdicts, health=[],
    )  # fmt: skip


def log(samples: Float[Array, "N K"], degrees: Float[Array, "N"]) -> Recording:
    stamps = np.arange(len(samples)) * NANOSECONDS // 1000
    names = tuple(f"c{k}" for k in range(samples.shape[1]))
    board = Signal("board", ("temperature",), stamps, degrees[:, None])
    return Recording("log", "", 0, (), (Signal("leg", names, stamps, samples),), (board,))


def of_the_log(known: SensorCalibration, recording: Recording, offset: str) -> Float[Array, "N K"]:
    provenance = Provenance(ftcal="", python="", numpy="", created="", inputs=[])
    calibration = Calibration(robot="drawn", sensors=[known], provenance=provenance)
    return corrected(calibration, recording, offset, sd=True)[0].channels[0].values


@pytest.mark.parametrize("offset", ["auto", "one", ZERO])
@pytest.mark.parametrize("warm", [False, True])
@pytest.mark.parametrize(("channels", "wrench"), [(6, False), (6, True), (8, False)])
def test_a_sample_is_corrected_as_in_the_log(
    channels: int, wrench: bool, warm: bool, offset: str
) -> None:
    known = sensor(channels, warm=warm, wrench=wrench)
    rng = np.random.default_rng(1)
    samples, degrees = 1e3 * rng.normal(size=(50, channels)), 30.0 + 5.0 * rng.normal(size=50)
    expected = of_the_log(known, log(samples, degrees), offset)
    start = 20.0 if warm else None
    reader = WrenchReader(known, offset=offset, temperature=start)
    sd = SdReader(known, offset=offset, temperature=start)
    for sample, degree, row in zip(samples, degrees, expected, strict=True):
        reader.tell_temperature(float(degree))
        sd.tell_temperature(float(degree))
        # sums of products in another order: a few roundings of the largest term
        np.testing.assert_allclose(reader.read(sample), row[:6], rtol=1e-12, atol=1e-10)
        np.testing.assert_allclose(sd.read(sample), row[6:], rtol=1e-9)


def test_a_refused_axis_has_no_standard_deviation() -> None:
    known = sensor(refused="fy")
    assert np.isnan(SdReader(known).read(np.ones(6))).tolist() == [False, True, *[False] * 4]
    assert np.isfinite(WrenchReader(known).read(np.ones(6))).all()


def test_a_temperature_term_wants_a_temperature() -> None:
    with pytest.raises(DataError, match="'leg' has a temperature term; give the temperature"):
        WrenchReader(sensor(warm=True))


def test_without_a_centre_the_wrench_is_read_and_its_doubt_is_not() -> None:
    known = sensor()
    old = [offset.model_copy(update={"centre": None}) for offset in known.offsets]
    aged = known.model_copy(update={"offsets": old})
    WrenchReader(aged)
    with pytest.raises(DataError, match="has no `centre`"):
        SdReader(aged)


def test_an_unknown_offset_comes_with_the_known_ones() -> None:
    with pytest.raises(DataError, match="'tow'; did you mean two"):
        WrenchReader(sensor(), offset="tow")


@pytest.mark.parametrize("sample", [np.ones(5), np.ones((2, 6)), ["a"] * 6, None])
def test_what_is_no_sample_is_refused(sample: Any) -> None:
    with pytest.raises(DataError, match="a sample of 'leg' is 6 numbers, not"):
        WrenchReader(sensor()).read(sample)


def most_allocated(read: Callable[[Float[Array, "6"]], object]) -> int:
    """Return the most memory [bytes] that was taken at any time of 10 000 calls."""
    sample = np.ones(6)
    read(sample)
    tracer = sys.gettrace()
    sys.settrace(None)  # that of coverage takes memory, too
    gc.disable()
    tracemalloc.start()
    try:
        for _ in range(10_000):
            read(sample)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
        gc.enable()
        sys.settrace(tracer)


@pytest.mark.parametrize("make", [WrenchReader, SdReader])
def test_a_sample_allocates_nothing(make: Callable[..., WrenchReader | SdReader]) -> None:
    """No array even on the way; what the loop itself takes is not counted."""
    reader = make(sensor(warm=True), temperature=30.0)
    reader.tell_temperature(31.0)
    nothing = most_allocated(lambda sample: sample)
    assert most_allocated(reader.read) <= nothing
    assert most_allocated(lambda sample: sample + sample) > nothing  # an array does show


def test_the_answer_is_the_readers_own() -> None:
    reader = WrenchReader(sensor())
    assert reader.read(np.ones(6)) is reader.read(np.zeros(6))
