"""The law of a sensor in one recording, ready to read a log: gain, temperature term and offset."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal.samples import Samples

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array


@dataclass(frozen=True, slots=True, eq=False)
class Law:
    """`w = [C, k] [r, dT] + o` of one sensor in one recording."""

    coefficients: Float[Array, "6 P"]
    """C, and k as the last column where there is a thermometer."""
    offset: Float[Array, "6"]
    """o [N, Nm]."""

    def read(self, inputs: Float[Array, "N P"]) -> Float[Array, "N 6"]:
        """Return the wrench [N, Nm] of channels, and temperature where there is one."""
        return np.asarray(
            inputs[:, : self.coefficients.shape[1]] @ self.coefficients.T + self.offset
        )


def aligned(coefficients: Float[Array, "6 P"], samples: Samples) -> Law:
    """Return the law whose offset makes it agree with the model on `samples`: `o*` of P4."""
    inputs = samples.rows()[:, : coefficients.shape[1]]
    return Law(coefficients, samples.wrench.mean(axis=0) - coefficients @ inputs.mean(axis=0))
