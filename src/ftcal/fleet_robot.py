"""One robot of a fleet: fitted from the shelf, its results put beside those that they replace.

Results that were made from the same recordings, job and robot are left as they are.
"""

from __future__ import annotations

import hashlib
import json
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from ftcal import __version__
from ftcal.archive import Shelf
from ftcal.calibration import Calibration, read_calibration, to_json, write_whole
from ftcal.config import Job
from ftcal.errors import JobError, SensorError
from ftcal.paired_takes import Work, known_robot, take_at
from ftcal.pairing import FtChannel
from ftcal.pipeline import fitted
from ftcal.progress import Steps, silent
from ftcal.report import metrics, whole_metrics, write_outcome
from ftcal.report import write_whole as write_all_sensors
from ftcal.whole_pipeline import calibrate_whole_body

CALIBRATION, METRICS, REPORT = "calibration.json", "metrics.json", "report.html"
PREVIOUS = "previous.json"
"""The calibration that the latest took the place of."""
RECEIPT = "fleet.json"
"""What a robot's results were made from."""


@dataclass(frozen=True, slots=True, eq=False)
class Fitting:
    """One robot that is to be fitted; small, for it travels."""

    job: Job
    """With the recordings that could be paired alone."""
    robot: str
    """Digest of its description."""
    channels: tuple[FtChannel, ...]
    work: tuple[Work, ...]
    places: tuple[str, ...]
    """Names of the recordings on the shelf."""
    folder: Path
    """Where the results go."""

    @property
    def made_from(self) -> str:
        """Hash of all that the results depend on."""
        told = [__version__, self.job.digest, self.robot, self.places]
        return hashlib.sha256(json.dumps(told).encode()).hexdigest()


def fit_robot(work: Fitting, shelf: Shelf, *, report: bool) -> bool:
    """Fit a robot and write its results, unless they are there already; return whether it was.

    Raises `FtcalError` where it cannot be calibrated; results of before are then left alone.
    """
    results = [CALIBRATION, METRICS, *([REPORT] if report else [])]
    receipt = to_json({"made_from": work.made_from})
    if all((work.folder / name).is_file() for name in results):
        with suppress(OSError):
            if (work.folder / RECEIPT).read_bytes() == receipt:
                return False
    if not work.job.recordings:
        raise JobError(f"{work.job.file}: none of its recordings could be read")
    if work.job.fit.scope == "whole body":
        whole = calibrate_whole_body(work.job)
        replaced(work.folder, whole.calibration)
        if report:
            write_all_sensors(whole, work.folder)
        else:
            written(work.folder, whole.calibration, whole_metrics(whole))
    else:
        robot = known_robot(work.job.path(work.job.robot), work.robot)
        takes = [
            take_at(shelf.folder / place, one, shelf)
            for place, one in zip(work.places, work.work, strict=True)
        ]
        outcome = fitted(work.job, robot, work.channels, takes, Steps(silent, 1))
        replaced(work.folder, outcome.calibration)
        if report:
            write_outcome(outcome, work.folder)
        else:
            written(work.folder, outcome.calibration, metrics(outcome))
    write_whole(work.folder / RECEIPT, receipt)
    return True


def replaced(folder: Path, fresh: Calibration) -> None:
    """Keep the calibration that a fresh one takes the place of, unless both say the same.

    They do where a run ended between results and receipt.
    """
    now = folder / CALIBRATION
    with suppress(SensorError):
        if now.exists() and said(read_calibration(now)) != said(fresh):
            write_whole(folder / PREVIOUS, now.read_bytes())


def said(calibration: Calibration) -> dict[str, object]:
    """Return what a calibration says, whenever it was made."""
    return calibration.model_dump(exclude={"provenance": {"created"}})


def written(folder: Path, calibration: Calibration, figures: dict[str, object]) -> None:
    """Write the results of a robot without a report."""
    # one of before would show other figures
    (folder / REPORT).unlink(missing_ok=True)
    write_whole(folder / METRICS, to_json(figures))
    write_whole(folder / CALIBRATION, to_json(calibration))
