import re
from pathlib import Path

import numpy as np
import pytest

from ftcal.errors import DataError
from ftcal.firmware import FirmwareMatrix, decode, read_matrix
from ftcal.health import examine, logs_counts
from ftcal.recording import Finding, FindingKind, Recording, Signal
from ftcal.signals import runs, usable

ROBOT = Path(__file__).resolve().parents[2] / "shared" / "data" / "icub-genova02"
real = pytest.mark.skipif(not ROBOT.is_dir(), reason="the recordings of iCubGenova02 are not here")
EPOCH = 1_457_614_036_659_765_000
FULL_SCALE = np.array([1587, 1823, 2113, 37, 38, 24])
CHANNELS = ("fx", "fy", "fz", "tx", "ty", "tz")
SERIALS = {
    "right_leg": "SN026",
    "right_foot": "SN230",
    "left_leg": "SN217",
    "left_foot": "SN229",
    "left_arm": "SN153",
    "right_arm": "SN151",
}


def ft(values: np.ndarray, name: str = "ft", period: float = 0.01, **more: object) -> Signal:
    stamps = EPOCH + np.arange(len(values)) * round(period * 1e9)
    return Signal(name, CHANNELS, stamps, values, **more)  # type: ignore[arg-type]


def take(*channels: Signal, joints: tuple[Signal, ...] = ()) -> Recording:
    return Recording("take", "here", EPOCH, joints, channels)


def lively(n: int = 1000, scale: np.ndarray = FULL_SCALE, seed: int = 0) -> np.ndarray:
    counts = np.random.default_rng(seed).integers(-8000, 8000, (n, 6))
    return np.asarray(np.round(counts * scale / 32768, 6))


def matrix(full_scale: np.ndarray = FULL_SCALE, name: str = "SN1") -> FirmwareMatrix:
    words = np.where(np.eye(6, dtype=bool), 0x4000, 0x0100)
    entries = [*(f"{w:X}" for w in words.ravel()), "1", *map(str, full_scale)]
    return decode("\n".join(entries), serial=name)


def sent(raw: np.ndarray, C: FirmwareMatrix) -> np.ndarray:
    """Return what the board sends of raw counts: whole steps of full scale / 32768."""
    step = C.full_scale / 32768
    return np.asarray(np.rint(raw @ C.matrix.T / step) * step)


def found(
    kind: FindingKind,
    recording: Recording,
    sensors: dict[str, FirmwareMatrix | None] | None = None,
) -> tuple[Finding, ...]:
    return tuple(f for f in examine(recording, sensors=sensors) if f.kind == kind)


def test_freeze_is_found_counted_and_cut() -> None:
    values = lively()
    values[300:360] = values[300]
    values[364:372] = values[364]  # comes back for 40 ms: the same stretch
    values[700:710] = values[700]
    signal = ft(values)
    recording = take(signal)
    summary, *stretches = found("frozen", recording)
    assert not summary.cut
    assert summary.message == (
        "ft: 78 of 1000 samples frozen (7.8 %) in 2 stretches, longest 0.71 s:"
        " all channels repeat exactly"
    )
    assert [s.cut for s in stretches] == [True, True]
    left = usable(recording, signal, stretches)
    assert np.flatnonzero(~left).tolist() == [*range(300, 372), *range(700, 710)]
    assert runs(signal, usable=left) == [slice(0, 300), slice(372, 700), slice(710, 1000)]


def test_one_moving_channel_is_no_freeze() -> None:
    values = lively()
    values[300:400, :5] = values[300, :5]
    assert found("frozen", take(ft(values))) == ()


def test_short_repetitions_are_no_freeze() -> None:
    values = lively()
    values[300:303] = values[300]
    assert found("frozen", take(ft(values))) == ()


def test_slow_sensor_in_a_fast_log_is_not_frozen() -> None:
    held = ft(np.repeat(lively(200), 10, axis=0), period=0.001)
    assert found("frozen", take(held)) == ()
    values = np.repeat(lively(200), 10, axis=0)
    values[500:700] = values[500]
    stuck = ft(values, period=0.001)
    assert len(found("frozen", take(stuck))) == 2


def test_quiet_quantised_sensor_is_not_frozen() -> None:
    # noise of a third of a step: most samples repeat in all six channels
    noise = np.random.default_rng(0).normal(0.2, 0.12, (20_000, 6))
    quiet = ft(np.rint(noise))
    assert (quiet.values[1:] == quiet.values[:-1]).all(axis=1).mean() > 0.8
    assert found("frozen", take(quiet)) == ()


def test_log_that_is_frozen_throughout_is_cut_throughout() -> None:
    dead = ft(np.repeat(lively(1), 500, axis=0))
    recording = take(dead)
    findings = found("frozen", recording)
    assert "500 of 500 samples frozen (100.0 %)" in findings[0].message
    assert not usable(recording, dead, findings).any()


def test_saturation_is_read_from_raw_counts() -> None:
    C = matrix()
    raw = np.random.default_rng(0).uniform(-20000, 20000, (1000, 6))
    raw[400:420, 3] = -31_700
    raw[600:602] = raw[600]  # a repetition while a channel is near its end
    raw[600:602, 2] = 31_200
    raw[800:802] = raw[800]  # a repetition within the range
    signal = ft(sent(raw, C))
    recording = take(signal)
    summary, *stretches = found("saturated", recording, {"ft": C})
    assert "22 of 1000 samples saturated (2.2 %) in 2 stretches" in summary.message
    # an output is rounded to a step, of which 31700 counts make 16 000
    assert re.search("raw channel 4 reaches 3170[01] counts", summary.message)
    left = usable(recording, signal, stretches)
    assert np.flatnonzero(~left).tolist() == [*range(400, 420), 600, 601]


def test_saturation_of_logged_counts_needs_no_matrix() -> None:
    raw = np.rint(np.random.default_rng(0).uniform(-20000, 20000, (1000, 6)))
    raw[400:420, 3] = 31_650
    signal = ft(raw)
    assert logs_counts(signal)
    assert "20 of 1000 samples" in found("saturated", take(signal))[0].message
    assert found("serial", take(signal), {"ft": matrix()}) == ()


def test_missing_numbers_do_not_hide_saturation() -> None:
    C = matrix()
    raw = np.random.default_rng(0).uniform(-20000, 20000, (1000, 6))
    raw[400:420, 3] = 31_700
    values = sent(raw, C)
    values[100] = np.nan
    signal = ft(values)
    assert "20 of 1000 samples" in found("saturated", take(signal), {"ft": C})[0].message


def test_plateau_tells_saturation_without_a_matrix() -> None:
    t = np.arange(2000) * 0.01
    clipped = np.column_stack([np.sin(t + k) * (k + 1.0) for k in range(6)])
    assert found("saturated", take(ft(clipped))) == ()
    clipped[:, 2] = np.minimum(clipped[:, 2], 2.5)
    signal = ft(clipped)
    recording = take(signal)
    findings = found("saturated", recording)
    expected = clipped[:, 2] == 2.5
    np.testing.assert_array_equal(~usable(recording, signal, findings), expected)


def test_rest_at_an_extreme_is_no_plateau() -> None:
    t = np.arange(3000) * 0.01
    fall = np.where(t < 10, 300 - 30 * t, 0.0)
    noise = np.random.default_rng(0).normal(0, 0.6, 3000)
    values = np.repeat(np.rint(fall + noise)[:, None], 6, axis=1)
    assert found("saturated", take(ft(values))) == ()


def test_hole_has_its_span() -> None:
    signal = ft(lively())
    stamps = signal.stamps.copy()
    stamps[500:] += 530_000_000
    signal = Signal("ft", CHANNELS, stamps, signal.values)
    (gap,) = found("gap", take(signal))
    assert [gap.start, gap.stop] == pytest.approx([4.99, 5.53])
    assert not gap.cut
    assert gap.message == "ft: no samples for 0.54 s from 4.99 s (period 10 ms)"
    session = Signal("ft", CHANNELS, stamps, signal.values, breaks=(500,))
    assert found("gap", take(session)) == ()


def test_hole_of_all_signals_is_a_clock_jump() -> None:
    a, b = ft(lively(), "a"), ft(lively(seed=1), "b")
    moved = a.stamps + np.where(np.arange(1000) >= 500, 3_600_000_000_000, 0)
    a, b = (Signal(s.name, CHANNELS, moved, s.values) for s in (a, b))
    (jump,) = found("clock jump", take(a, b))
    assert jump.kind == "clock jump"
    assert "all 2 signals pause for 3.6e+03 s at 4.99 s" in jump.message
    alone = Signal("b", CHANNELS, ft(lively()).stamps, b.values)
    assert found("clock jump", take(a, alone)) == ()
    assert found("clock jump", take(a)) == ()


def kinds(findings: tuple[Finding, ...]) -> list[str]:
    return [finding.kind for finding in findings]


def test_serial_is_confirmed_refuted_or_open() -> None:
    own, other = matrix(), matrix(FULL_SCALE + 5, "SN2")
    signal, beside = ft(lively()), ft(lively(scale=FULL_SCALE + 5, seed=1), "beside")
    both = take(signal, beside)
    confirmed, _ = found("serial", both, {"ft": own, "beside": other})
    assert "lie on the lattice of SN1" in confirmed.message
    wrong, _ = found("off lattice", both, {"ft": other, "beside": own})
    assert "off the lattice of SN2" in wrong.message
    assert "SN1 fits; check the serial number" in wrong.message
    (nothing,) = found("off lattice", take(signal), {"ft": other})
    assert "no matrix given fits" in nothing.message
    dead = ft(np.repeat(lively(1), 500, axis=0))
    (unclear,) = found("serial", take(dead), {"ft": own})
    assert "too few distinct readings" in unclear.message
    guess, *_ = found("serial", both, {"ft": None, "beside": own})
    assert guess.message == "ft: readings show full scales 1587 1823 2113 37 38 24; SN1 fits"
    noise = ft(np.random.default_rng(0).standard_normal((1000, 6)))
    assert found("serial", take(noise)) == ()


def test_examination_of_a_healthy_log_only_names_the_serial() -> None:
    signal = ft(lively())
    leg = Signal("leg", ("knee",), signal.stamps, np.zeros((1000, 1)))
    assert kinds(examine(take(signal, joints=(leg,)), sensors={"ft": matrix()})) == ["serial"]


def test_empty_signal_is_named() -> None:
    empty = Signal("ft", CHANNELS, np.empty(0, dtype=np.int64), np.empty((0, 6)))
    (finding,) = examine(take(empty))
    assert (finding.kind, finding.message) == ("empty", "ft: no samples")


def test_single_sample_is_examined() -> None:
    assert examine(take(ft(lively(1)))) == ()


def test_matrix_for_an_unknown_signal_is_refused() -> None:
    with pytest.raises(
        DataError, match=r"no F/T signal of recording 'take' 'fd'; did you mean ft\?"
    ):
        examine(take(ft(lively())), sensors={"fd": None})


def genova() -> Recording:
    signals = []
    for part in SERIALS:
        log = ROBOT / "left_leg_support" / "icub" / part / "analog:o" / "data.log"
        rows = [line.split() for line in log.read_text().splitlines()]
        stamps = np.array([round(float(row[1]) * 1e9) for row in rows])
        values = np.array([[float(value) for value in row[2:]] for row in rows])
        signals.append(Signal(f"{part}/analog:o", CHANNELS, stamps, values))
    return Recording("genova", "there", min(int(s.stamps[0]) for s in signals), (), tuple(signals))


@real
def test_real_robot_all_six_serials_are_verified_and_two_hips_saturate() -> None:
    recording = genova()
    sensors: dict[str, FirmwareMatrix | None] = {
        f"{part}/analog:o": read_matrix(ROBOT / "matrices" / f"matrix_{number}.txt")
        for part, number in SERIALS.items()
    }
    findings = examine(recording, sensors=sensors)
    named = {f.signal: f.message for f in findings if f.kind == "serial"}
    assert named.keys() == sensors.keys()
    assert all(SERIALS[name.split("/")[0]] in message for name, message in named.items())
    assert not [f for f in findings if f.kind in ("gap", "clock jump", "off lattice", "empty")]
    assert {f.signal for f in findings if f.kind == "frozen"} == {"left_leg/analog:o"}
    assert {f.signal for f in findings if f.kind == "saturated"} == {
        "left_leg/analog:o",
        "right_leg/analog:o",
    }
    hip = recording.channel("left_leg/analog:o")
    lost = 1.0 - usable(recording, hip, findings).mean()
    assert 0.21 < lost < 0.32  # 21 % repeat, with the comings and goings between
    right = recording.channel("right_leg/analog:o")
    cut = recording.seconds(right)[~usable(recording, right, findings)]
    assert 57.5 < cut.min() < cut.max() < 59.5  # where its offset steps back


@real
def test_real_robot_swapped_serials_are_found() -> None:
    recording = genova()
    right, left = (
        read_matrix(ROBOT / "matrices" / f"matrix_{number}.txt") for number in ("SN026", "SN217")
    )
    swapped = {"right_leg/analog:o": left, "left_leg/analog:o": right}
    wrong = [f.message for f in examine(recording, sensors=swapped) if f.kind == "off lattice"]
    assert len(wrong) == 2
    assert "SN026 fits" in wrong[0] or "SN026 fits" in wrong[1]


@real
def test_the_matrix_of_another_sensor_cuts_nothing() -> None:
    """Counts behind a wrong matrix would seem saturated; the lattice says it is the wrong one."""
    from ftcal.logs import read

    other = read_matrix(ROBOT / "matrices" / "matrix_SN217.txt")
    recording = read(ROBOT / "left_leg_support")
    findings = examine(recording, sensors={"right_leg/analog:o": other})
    mine = [finding for finding in findings if finding.signal == "right_leg/analog:o"]
    assert [finding.kind for finding in mine] == ["off lattice"]
    assert not mine[0].cut
