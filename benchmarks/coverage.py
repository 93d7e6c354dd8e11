"""How often nominal 90 % intervals hold the truth: matrices, offsets, corrected wrenches.

    python benchmarks/coverage.py [--sessions 50] [--noise 1e-4] [--errors] [--first 1]

Every session is a simulated iCub of its own (`humanoid.py`, the rich protocol): six bent sensors,
a grid in the air, both feet, either foot; encoders of 12 bits, white noise on the channels and, on
top, noise that remembers a third of a second. Each sensor by itself and all at once are run on the
same logs. Intervals are those that a user gets: the covariance in `calibration.json` for the
entries of the fitted C, `centre.sd` for the offset at the mean of training, `apply --sd` for
wrenches: readings of the double support that was held out, and loads drawn inside the envelope of
the training.

With `--errors` the robot is not its description: links weigh wrong by 2 %, centres of mass are off
by 3 mm, encoders read 0.2 degrees at zero. No covariance of a fit holds that, and none should.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from humanoid import one_by_one, protocols, session, together

from ftcal import logs
from ftcal.applying import wrench_sd
from ftcal.calibration import SensorCalibration
from ftcal.config import Job, RecordingSection, read_job
from ftcal.law import Law
from ftcal.logs import yarp
from ftcal.sensor import AXES

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

NINETY = 1.6448536
"""Standard deviations on either side of 90 % of a normal distribution."""
MEMORY = 30
"""Samples, at 100 Hz, over which the added noise is averaged."""
LOADS = 100
"""Loads drawn for each sensor."""
ERRORS = {"mass": 0.02, "com": 0.003, "joint_zero": float(np.deg2rad(0.2))}
KINDS = ("entries of C", "offsets", "held-out stance", "inside the envelope")


def remembering(rng: np.random.Generator, count: int) -> Float[Array, "N 6"]:
    """Return unit noise, six columns, that remembers `MEMORY` samples."""
    kernel = np.full(MEMORY, MEMORY**-0.5)
    white = rng.normal(size=(count + MEMORY - 1, 6))
    return np.stack([np.convolve(column, kernel, "valid") for column in white.T], axis=1)


def noisy(job: Job, share: float, rng: np.random.Generator, scale: Mapping[str, Any]) -> Job:
    """Return the job of the same logs, written again with noise of `share` of full scale."""
    sections = []
    for section in job.recordings:
        path = job.path(section.log)
        recording = logs.read(path, section.layout(), name=section.label)
        channels = tuple(
            replace(
                signal,
                values=signal.values
                + share * np.array(scale[signal.name]) * remembering(rng, len(signal)),
            )
            for signal in recording.channels
        )
        folder = path.with_name(f"{path.name}_noisy")
        yarp.write(replace(recording, channels=channels), folder)
        sections.append(section.model_copy(update={"log": folder, "name": section.label}))
    return job.model_copy(update={"recordings": tuple(sections)})


def inside(rng: np.random.Generator, sensor: SensorCalibration) -> Float[Array, "N 6"]:
    """Return wrenches inside the training envelope, of every axis and of force and torque."""
    low, high = np.array([sensor.envelope[axis] for axis in AXES]).T
    some = rng.uniform(low, high, size=(200 * LOADS, 6))
    kept = np.ones(len(some), dtype=bool)
    for name, part in (("force", some[:, :3]), ("torque", some[:, 3:])):
        least, most = sensor.envelope[name]
        size = np.linalg.norm(part, axis=1)
        kept &= (size >= least) & (size <= most)
    return some[kept][:LOADS]


def departures(
    sensor: SensorCalibration, true: Law, raw: Float[Array, "N 6"], take: str
) -> dict[str, Float[Array, "M 6"]]:
    """Return errors over their predicted standard deviation, by kind; columns are axes."""
    workbench = sensor.workbench()
    back = np.linalg.inv(workbench.scaling)
    covariance = back.T @ np.array(sensor.covariance) @ back
    wrong = (np.array(sensor.fitted_gain) - true.coefficients) @ back
    entries = wrong / np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    offset = [one for one in sensor.offsets if one.recording == take][-1]
    if offset.centre is None:
        raise ValueError("a calibration of this ftcal has the centre of every offset")
    law = Law(sensor.coefficients, np.array(offset.offset))
    centre = np.array(offset.centre.inputs)[None]
    loads = inside(np.random.default_rng(0), sensor)
    drawn = np.linalg.solve(true.coefficients, (loads - true.offset).T).T
    refused = np.array([verdict.verdict == "REFUSE" for verdict in sensor.verdicts])
    found = {
        "entries of C": entries.T,
        "offsets": (law.read(centre) - true.read(centre)) / np.array(offset.centre.sd),
        "held-out stance": (law.read(raw) - true.read(raw)) / wrench_sd(sensor, raw, offset),
        "inside the envelope": (law.read(drawn) - true.read(drawn))
        / wrench_sd(sensor, drawn, offset),
    }
    # a refused row is the Workbench's, of which nobody says how sure it is
    found["offsets"] = np.where(refused, np.nan, found["offsets"])
    return found


def stance(job: Job, walk: RecordingSection, signal: str) -> Float[Array, "N 6"]:
    """Return what a sensor logged in the last test window [N, Nm by its Workbench]."""
    recording = logs.read(job.path(walk.log), walk.layout(), name=walk.label)
    channel = recording.channel(signal)
    seconds = recording.seconds(channel)
    start, stop = walk.test[-1]
    return channel.values[(seconds >= start) & (seconds < stop)][::5]


def run(
    seed: int, noise: float, **errors: float
) -> dict[tuple[str, str, str], Float[Array, "M 6"]]:
    """Return the departures of one session, by scope, sensor and kind."""
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        file = session(Path(folder), seed, **errors)
        truth = json.loads((file.parent / "truth.json").read_text(encoding="utf-8"))["sensors"]
        clean = protocols(read_job(file))["rich"]
        scale = {s.signal: truth[s.name]["full_scale"] for s in clean.sensors}
        job = noisy(clean, noise, np.random.default_rng(seed), scale)
        walk = job.recordings[-1]
        scopes = {
            "each sensor": one_by_one(job).calibration,
            "whole body": together(job).calibration,
        }
        for scope, calibration in scopes.items():
            for sensor in calibration.sensors:
                known = truth[sensor.sensor]
                true = Law(np.array(known["gain"]), np.array(known["offsets"][walk.label]))
                # the reading without the noise that was added: it is not the calibration's
                raw = sensor.workbench().channels(
                    stance(clean, clean.recordings[-1], sensor.signal)
                )
                for kind, values in departures(sensor, true, raw, walk.label).items():
                    found[scope, sensor.sensor, kind] = values
    return found


def share(some: Float[Array, "*N"]) -> float:
    """Return the share of departures, where known, that a nominal 90 % interval holds."""
    known = some[np.isfinite(some)]
    return float((np.abs(known) < NINETY).mean()) if len(known) else float("nan")


def report(found: list[dict[tuple[str, str, str], Float[Array, "M 6"]]]) -> list[str]:
    """Return a line for every scope and kind, then one a sensor for wrenches."""
    lines = []
    for scope in ("each sensor", "whole body"):
        for kind in KINDS:
            by_session = [
                np.concatenate([v for (s, _, k), v in one.items() if (s, k) == (scope, kind)])
                for one in found
            ]
            every = np.concatenate(by_session)
            spread = np.nanstd([share(one) for one in by_session]) / len(found) ** 0.5
            axes = " ".join(f"{100 * share(column):3.0f}" for column in every.T)
            lines.append(
                f"{scope}: {kind:<20} {100 * share(every):5.1f} % ± {100 * spread:.1f}"
                f"   by axis {axes}   rms {np.sqrt(np.nanmean(every**2)):.2f}"
            )
        for sensor in dict.fromkeys(name for _, name, _ in found[0]):
            shares = [
                100 * share(np.concatenate([one[scope, sensor, kind] for one in found]))
                for kind in KINDS
            ]
            lines.append(f"    {sensor:<18}" + " ".join(f"{one:5.0f}" for one in shares))
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sessions", type=int, default=50)
    parser.add_argument("--first", type=int, default=1, help="seed of the first session")
    parser.add_argument("--noise", type=float, default=1e-4, help="share of full scale, remembered")
    parser.add_argument("--errors", action="store_true", help="the robot is not its description")
    told = parser.parse_args()
    found = []
    for seed in range(told.first, told.first + told.sessions):
        found.append(run(seed, told.noise, **(ERRORS if told.errors else {})))
        if len(found) % 10 == 0 or len(found) == told.sessions:
            print(f"\nafter {len(found)} sessions", *report(found), sep="\n", flush=True)


if __name__ == "__main__":
    main()
