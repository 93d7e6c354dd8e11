"""Stretches that do not fit count less: a knock, a brushing toe, a hand on the robot.

The weights are Huber's (P. J. Huber, "Robust Estimation of a Location Parameter", Ann. Math. Stat.
35, 1964): one up to what good data reach in one of a hundred cases, beyond it falling with the
distance. What is weighed is a cell of about a second with all its axes at once, for what touches a
limb lasts and spares no axis; the measure is the spread of the other cells of the same stretch
(their median absolute deviation): a loaded stretch is not an outlier among unloaded ones.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

FEWEST = 8
"""Cells of a stretch below which none is an outlier among them."""

TO_SD = 1.4826
"""Standard deviation of normal errors over their median absolute deviation."""

REACH = {3: 3.37, 6: 4.10}
"""Root of the 99 % quantile of chi squared, by the number of axes."""


def huber_weights(means: Float[Array, "B D"]) -> Float[Array, "B"]:
    """Return what each cell of a stretch counts, from its mean residuals on D = 3 or 6 axes."""
    if len(means) < FEWEST:
        return np.ones(len(means))
    apart = means - np.median(means, axis=0)
    spread = TO_SD * np.median(np.abs(apart), axis=0)
    # an axis that is exact but for rounding has no outliers
    spread = np.maximum(spread, 1e-9 * max(float(np.abs(apart).max()), np.finfo(float).tiny))
    distance = np.linalg.norm(apart / spread, axis=1)
    return np.asarray(REACH[means.shape[1]] / np.maximum(distance, REACH[means.shape[1]]))
