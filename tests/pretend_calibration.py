"""Invented calibrations: what `ftcal calibrate` writes, without a robot or a log."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from ftcal.calibration import (
    AxisVerdict,
    Calibration,
    Input,
    Offset,
    Prior,
    Provenance,
    SensorCalibration,
)
from ftcal.sensor import AXES

FULL_SCALE = [2048.0, 2048.0, 2048.0, 64.0, 64.0, 64.0]


def sensor(
    gain: np.ndarray,
    prior: np.ndarray,
    *,
    name: str = "r_leg_ft_sensor",
    serial: str = "SN900",
    logged: Literal["wrench", "channels"] = "wrench",
    offset: Sequence[float] = (20.0, -4.0, 64.0, 1.5, -0.25, 0.0),
    temperature_gain: Sequence[float] | None = None,
    reference_temperature: float = 30.0,
    refused: Sequence[str] = (),
    full_scale: Sequence[float] = FULL_SCALE,
) -> SensorCalibration:
    """Return the calibration of one sensor; refused axes keep the row of the prior."""
    keep = [axis in refused for axis in AXES]
    deployed = np.where(np.array(keep)[:, None], prior, gain)
    width = gain.shape[1] + (temperature_gain is not None)
    spans = {axis: (-32.0, 64.0) if axis[0] == "f" else (-4.0, 2.0) for axis in AXES}
    return SensorCalibration(
        sensor=name,
        signal="right_leg/analog:o",
        logged=logged,
        frame="r_hip_3",
        acts_on="r_hip_2",
        temperature_signal=None if temperature_gain is None else "right_leg/temperature:o",
        gain=deployed.tolist(),
        fitted_gain=gain.tolist(),
        secondary=None,
        temperature_gain=None if temperature_gain is None else list(temperature_gain),
        reference_temperature=reference_temperature,
        offsets=[
            Offset(recording="first", start=0, stop=9, offset=[0.5] * 6, sd=[0.1] * 6),
            Offset(recording="last", start=1, stop=30, offset=list(offset), sd=[0.1] * 6),
        ],
        covariance=[np.eye(width).tolist()] * 6,
        envelope={**spans, "force": (1.0, 100.0), "torque": (0.1, 7.0)},
        noise_sd=[0.1] * 6,
        inefficiency=[10.0] * 6,
        prior=Prior(
            name=serial,
            gain=prior.tolist(),
            full_scale=list(full_scale),
            form="kappa",
            strength=0.03,
            chosen_by="blocked cross-validation",
        ),
        verdicts=[
            AxisVerdict(axis=axis, verdict="REFUSE" if kept else "ACCEPT", reason="invented")
            for axis, kept in zip(AXES, keep, strict=True)
        ],
        health=[],
    )


def calibration(*sensors: SensorCalibration) -> Calibration:
    """Return a calibration of sensors."""
    return Calibration(
        robot="iCubPretend",
        sensors=list(sensors),
        provenance=Provenance(
            ftcal="0.1.0",
            python="3.12",
            numpy="2.0",
            created="2026-01-02T03:04:05+00:00",
            inputs=[Input(role="job", path="job.toml", sha256="ab")],
        ),
    )


def exact_prior() -> np.ndarray:
    """Return a Workbench of powers of two, two to a row: nothing that follows from it is rounded.

    Counts of 32767 on all channels make 3/4 of full scale.
    """
    mixing = np.eye(6)[[2, 0, 1, 5, 3, 4]] + 0.5 * np.triu(np.eye(6)[[2, 0, 1, 5, 3, 4]], 3)
    return np.array(FULL_SCALE)[:, None] * mixing / 65536.0


def exact_secondary() -> np.ndarray:
    """Return a secondary matrix of powers of two whose inverse is exact as well."""
    S = np.diag([1.0, 0.5, 2.0, 1.0, 2.0, 1.0])
    S[0, 3], S[1, 5], S[2, 4], S[3, 0] = 0.25, -0.5, 4.0, 0.0
    return S


def exact(**changes: Any) -> SensorCalibration:
    """Return a sensor whose every exported number is the same on every machine."""
    prior = exact_prior()
    return sensor(exact_secondary() @ prior, prior, **changes)


def random_gains(seed: int, channels: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a gain and its Workbench, of the size and condition of a real sensor's."""
    rng = np.random.default_rng(seed)
    mixing = np.linalg.qr(rng.normal(size=(channels, channels)))[0][:6]
    prior = np.array(FULL_SCALE)[:, None] * mixing * rng.uniform(0.4, 1.0, (1, channels)) / 32767.0
    E = 0.05 * rng.normal(size=(6, channels)) / np.sqrt(channels)
    return prior + np.array(FULL_SCALE)[:, None] * E / 32767.0, prior
