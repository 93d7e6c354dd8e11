"""An outcome → the records of `calibration.json`: the numbers to deploy and why to believe them."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Iterable, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from typing import Literal

import numpy as np

from ftcal import __version__
from ftcal.calibration import (
    AxisVerdict,
    Centre,
    ChosenBy,
    HealthFinding,
    Input,
    Offset,
    Prior,
    Provenance,
    SensorCalibration,
)
from ftcal.config import Job
from ftcal.fit import segment_offsets
from ftcal.moments import Moments
from ftcal.noise import Noise
from ftcal.one_sensor import SensorOutcome
from ftcal.pairing import FtChannel
from ftcal.recording import Finding
from ftcal.ridge import Estimate
from ftcal.robot import FtSensor, Robot
from ftcal.validate import Envelope
from ftcal.verdict import Verdict


def sensor_calibration(job: Job, outcome: SensorOutcome) -> SensorCalibration:
    """Return the part of `calibration.json` for one sensor."""
    channel, ft, found = outcome.channel, outcome.sensor, outcome.fit
    strength = found.penalty if found.kappa is None else float(found.kappa[0])
    segments = (*outcome.training, *outcome.test)
    return sensor_record(
        channel,
        ft,
        outcome.estimate,
        fitted=found.estimate,
        reference_temperature=outcome.reference_temperature,
        offsets=[
            Offset(
                recording=known.recording,
                start=known.start,
                stop=known.stop,
                offset=known.offset.tolist(),
                sd=known.sd.tolist(),
                centre=centre(segment.moments(), outcome.estimate, found.noise),
            )
            for segment, known in zip(
                segments, segment_offsets(segments, outcome.estimate, found.noise), strict=True
            )
        ],
        envelope=outcome.envelope,
        noise=found.noise,
        form="lambda" if found.kappa is None else "kappa",
        strength=float(strength or 0.0),
        chosen_by="job" if found.choice is None else "blocked cross-validation",
        verdicts=outcome.verdicts,
        findings=outcome.findings,
    )


def sensor_record(
    channel: FtChannel,
    ft: FtSensor,
    deployed: Estimate,
    *,
    fitted: Estimate,
    offsets: list[Offset],
    envelope: Envelope,
    noise: Noise,
    form: Literal["kappa", "lambda"],
    strength: float | list[float],
    chosen_by: ChosenBy,
    verdicts: Iterable[Verdict],
    findings: Iterable[tuple[str, Finding]],
    reference_temperature: float = 0.0,
) -> SensorCalibration:
    """Return what any fit found out about a sensor as its record.

    `findings` (recording and finding) may be of any signal: those of the sensor's own are kept.
    """
    workbench, k = channel.workbench, deployed.temperature_gain
    secondary = workbench.secondary(deployed.gain)
    mine = {channel.signal, channel.temperature}
    return SensorCalibration(
        sensor=ft.name,
        signal=channel.signal,
        wrench_frame=channel.wrench_frame,
        temperature_signal=channel.temperature,
        logged=workbench.logged,
        frame=frame_name(ft),
        acts_on=acted_link(ft),
        gain=deployed.gain.tolist(),
        fitted_gain=fitted.gain.tolist(),
        secondary=None if secondary is None else secondary.tolist(),
        temperature_gain=None if k is None else k.tolist(),
        reference_temperature=reference_temperature,
        offsets=offsets,
        covariance=fitted.covariance.tolist(),
        envelope=envelope,
        noise_sd=noise.sd.tolist(),
        inefficiency=noise.inefficiency.tolist(),
        prior=Prior(
            name=workbench.name,
            gain=workbench.gain.tolist(),
            full_scale=workbench.full_scale.tolist(),
            form=form,
            strength=strength,
            chosen_by=chosen_by,
        ),
        verdicts=[AxisVerdict(axis=v.axis, verdict=v.word, reason=v.reason) for v in verdicts],
        health=[
            HealthFinding(
                recording=recording,
                kind=f.kind,
                signal=f.signal,
                start=f.start,
                stop=f.stop,
                cut=f.cut,
                message=f.message,
            )
            for recording, f in findings
            if f.signal in mine
        ],
    )


def centre(moments: Moments, estimate: Estimate, noise: Noise) -> Centre:
    """Return the mean of a segment's rows `[r, dT?, w]`, and how sure the wrench is there.

    Counted from that mean the channels have none, and of the offset's error the noise is left.
    """
    about_mean = replace(moments, mean=np.zeros_like(moments.mean))
    sd = estimate.offset_error(about_mean, noise)
    return Centre(inputs=moments.mean[:-6].tolist(), sd=sd.tolist())


def provenance(job: Job, robot: Robot, digests: Sequence[str]) -> Provenance:
    """Return what went in and what computed; `digests` are those of the recordings, in order."""
    inputs = [Input(role="job", path=job.file.name, sha256=job.digest)]
    inputs.append(Input(role="robot", path=str(job.robot), sha256=robot.digest))
    for sensor in job.sensors:
        if sensor.workbench is not None:
            text = job.path(sensor.workbench).read_bytes()
            digest = hashlib.sha256(text).hexdigest()
            inputs.append(Input(role="workbench", path=str(sensor.workbench), sha256=digest))
    for section, digest in zip(job.recordings, digests, strict=True):
        inputs.append(Input(role="recording", path=str(section.log), sha256=digest))
    return Provenance(
        ftcal=__version__,
        python=platform.python_version(),
        numpy=np.__version__,
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        inputs=inputs,
    )


def frame_name(sensor: FtSensor) -> str:
    """Return the frame that expresses a sensor's wrench: a link, or `SENSOR (origin)`."""
    frames = {"child": sensor.child, "parent": sensor.parent, "sensor": f"{sensor.name} (origin)"}
    return frames[sensor.frame]


def acted_link(sensor: FtSensor) -> str:
    """Return the link on which a sensor's measured wrench acts."""
    return sensor.parent if sensor.acts_on == "parent" else sensor.child
