"""One sensor in a control loop: a sample in, its corrected wrench out, nothing allocated.

The law of `ftcal.applying`, `w = C x + o + k (T - T_ref)`, with all that never changes put together
beforehand. The temperature changes slowly and has a rate of its own: it is told when it comes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ftcal.applying import (
    AUTO,
    channels_of_logged,
    chosen_offset,
    gain_roots,
    known_centre,
    refused,
)
from ftcal.calibration import SensorCalibration
from ftcal.errors import DataError
from ftcal.sensor import AXES

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array


class WrenchReader:
    """Reads the wrench of one sensor, a sample at a time; not for two threads at once."""

    def __init__(
        self, sensor: SensorCalibration, *, offset: str = AUTO, temperature: float | None = None
    ) -> None:
        """Prepare to read `sensor`.

        `offset` is the name of a recording of the calibration, `zero`, or `auto` for the last.
        `temperature` [degree Celsius] is the first, without which `DataError` where the law has a
        term for it; `DataError` also where the logs of the sensor are in the axes of another link.
        """
        segment, _ = chosen_offset(sensor, "", offset)
        self._law = _Affine(sensor, sensor.coefficients, np.array(segment.offset), temperature)

    def read(self, logged: Float[Array, "K"]) -> Float[Array, "6"]:
        """Return the wrench [N, Nm] of a sample of what the log carries: channels, or a wrench.

        The array is the reader's own: it holds until the next sample. `DataError` where the sample
        is not K numbers; NaN stays NaN.
        """
        return self._law.read(logged)

    def tell_temperature(self, temperature: float) -> None:
        """Take the temperature of the sensor [degree Celsius] for the samples that follow."""
        self._law.tell_temperature(temperature)


class SdReader:
    """Reads how sure a `WrenchReader` is: `applying.wrench_sd`, a sample at a time."""

    def __init__(
        self, sensor: SensorCalibration, *, offset: str = AUTO, temperature: float | None = None
    ) -> None:
        """Prepare to read `sensor`, as a `WrenchReader`; `DataError` also where sd is not known."""
        segment, _ = chosen_offset(sensor, "", offset)
        centre = known_centre(sensor, segment)
        roots = gain_roots(sensor).transpose(0, 2, 1)
        known = np.array([axis not in refused(sensor) for axis in AXES])
        # of all axes one below the other, turned so that what they give is independent
        matrix = np.concatenate(list(roots))
        self._spread = _Affine(sensor, matrix, -matrix @ np.array(centre.inputs), temperature)
        self._squared = np.empty(len(matrix))
        self._by_axis = self._squared.reshape(roots.shape[:2])  # a view
        self._ones = np.ones(roots.shape[1])
        self._at_centre = np.where(known, np.square(centre.sd), np.nan)
        self._sd = np.empty(6)

    def read(self, logged: Float[Array, "K"]) -> Float[Array, "6"]:
        """Return the standard deviation [N, Nm] of the wrench; NaN of an axis that was refused.

        The array is the reader's own: it holds until the next sample.
        """
        spread = self._spread.read(logged)
        np.multiply(spread, spread, out=self._squared)
        np.dot(self._by_axis, self._ones, out=self._sd)  # a reduction would allocate
        np.add(self._sd, self._at_centre, out=self._sd)
        np.sqrt(self._sd, out=self._sd)
        return self._sd

    def tell_temperature(self, temperature: float) -> None:
        """Take the temperature of the sensor [degree Celsius] for the samples that follow."""
        self._spread.tell_temperature(temperature)


class _Affine:
    """`matrix [x, T - T_ref] + constant` of a sample, x the channels of what was logged."""

    def __init__(
        self,
        sensor: SensorCalibration,
        matrix: Float[Array, "M P"],
        constant: Float[Array, "M"],
        temperature: float | None,
    ) -> None:
        if sensor.wrench_frame is not None:
            raise DataError(
                f"{sensor.sensor!r} is logged in the axes of {sensor.wrench_frame!r}, and read in"
                f" those of {sensor.frame!r}: turn every sample back first, then read them with"
                " sensor.in_own_frame()"
            )
        decode = channels_of_logged(sensor)
        channels = len(decode)
        self._name = sensor.sensor
        self._matrix = np.ascontiguousarray(matrix[:, :channels] @ decode)
        self._per_kelvin = matrix[:, channels:].sum(axis=1)  # of one column, or of none: zero
        self._reference = sensor.reference_temperature
        self._constant = constant
        self._shift = constant.copy()
        self._result = np.empty(len(matrix))
        if temperature is not None:
            self.tell_temperature(temperature)
        elif sensor.temperature_gain is not None:
            raise DataError(
                f"calibration of {sensor.sensor!r} has a temperature term; give the temperature"
            )

    def read(self, logged: Float[Array, "K"]) -> Float[Array, "M"]:
        try:
            np.dot(self._matrix, logged, out=self._result)
        except (TypeError, ValueError) as error:
            raise DataError(
                f"a sample of {self._name!r} is {self._matrix.shape[1]} numbers, not"
                f" {np.shape(logged)}; give one sample as an array"
            ) from error
        np.add(self._result, self._shift, out=self._result)
        return self._result

    def tell_temperature(self, temperature: float) -> None:
        np.multiply(self._per_kelvin, temperature - self._reference, out=self._shift)
        np.add(self._shift, self._constant, out=self._shift)
