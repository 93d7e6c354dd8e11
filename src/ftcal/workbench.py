"""The Workbench matrix of a sensor from the file that the manufacturer gave."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from ftcal.errors import SensorError
from ftcal.firmware import read_matrix
from ftcal.sensor import Workbench


def read_workbench(
    path: Path | None,
    *,
    full_scale: Sequence[float] | None = None,
    logged: Literal["wrench", "channels"] = "wrench",
) -> Workbench:
    """Return the Workbench matrix in `path`.

    `*.csv` holds six rows of K numbers [N or Nm per unit of the channel]; any other file is a
    firmware matrix file. Without a path the log itself is believed: C_w is the identity. A
    `full_scale` [N, Nm] is needed where the file has none. Raises `SensorError`.
    """
    if path is None:
        scale = required(full_scale, "the log")
        return Workbench("as logged", np.eye(6), scale, "channels")
    if path.suffix.lower() != ".csv":
        firmware = read_matrix(path)
        scale = np.asarray(
            firmware.full_scale if full_scale is None else full_scale, dtype=np.float64
        )
        return Workbench(firmware.serial, firmware.matrix, scale, logged, firmware)
    try:
        gain = np.loadtxt(path, delimiter=",", ndmin=2)
    except (OSError, ValueError) as error:
        raise SensorError(
            f"{path}: not a matrix of numbers separated by commas: {error}"
        ) from error
    return Workbench(path.stem, gain, required(full_scale, str(path)), logged)


def required(
    full_scale: Sequence[float] | None, source: str
) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return the full scale, or raise `SensorError` with what to write in the job."""
    if full_scale is None:
        raise SensorError(
            f"{source} has no full scale: give full_scale = [fx, fy, fz, tx, ty, tz] of the sensor"
            " in N and Nm (its data sheet's ratings)"
        )
    return np.asarray(full_scale, dtype=np.float64)
