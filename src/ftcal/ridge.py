"""Regression towards the Workbench matrix: from moments to a gain with its covariance.

Two forms of one ridge regression towards the Workbench matrix, from one eigendecomposition each:

* the paper's penalty (P7), `min 1/(6N) sum |w^ - C r^|^2 + lambda |C - C_w|_F^2`; the printed P7
  averages over N samples, the published code over their 6N residuals: lambda here is the code's;
* the scaled prior (method 4): `C = C_w + F E T` with `E_ij ~ N(0, kappa^2)` in fractions of full
  scale, each axis weighed by its noise and by how many of its samples are independent. This is a
  maximum a posteriori estimate with the posterior covariance of every entry.

A temperature, where logged, is one more column of the regression: prior of k is kappa of full
scale per `TEMPERATURE_SPAN`; the paper's penalty leaves it free.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal.errors import DataError
from ftcal.moments import Moments
from ftcal.noise import Noise
from ftcal.sensor import Workbench

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

TEMPERATURE_SPAN = 30.0
"""Warming [K] over which the offset is believed to move by kappa of full scale."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A gain with its uncertainty; P = K, or K + 1 with a temperature as the last column."""

    gain: Float[Array, "6 K"]
    """C [N or Nm per unit of the channel]."""
    temperature_gain: Float[Array, "6"] | None
    """k [N/K, Nm/K]."""
    covariance: Float[Array, "6 P P"]
    """Posterior covariance of each row of `[C, k]`; rows are independent problems."""

    @property
    def standard_error(self) -> Float[Array, "6 P"]:
        """Posterior standard deviation of every entry of `[C, k]`."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2)))

    @property
    def coefficients(self) -> Float[Array, "6 P"]:
        """`[C, k]`."""
        if self.temperature_gain is None:
            return self.gain
        return np.column_stack([self.gain, self.temperature_gain])

    def offset(self, moments: Moments) -> Float[Array, "6"]:
        """Return `o* = mean(w) - C mean(r) - k mean(dT)` of one segment (P4)."""
        return np.asarray(moments.mean[-6:] - self.coefficients @ moments.mean[:-6])

    def offset_error(self, moments: Moments, noise: Noise) -> Float[Array, "6"]:
        """Return the posterior standard deviation of `offset` [N, Nm]."""
        inputs = moments.mean[:-6]
        from_gain = np.einsum("p,ipq,q->i", inputs, self.covariance, inputs)
        independent = np.maximum(moments.count / noise.inefficiency, 1.0)
        return np.asarray(np.sqrt(noise.sd**2 / independent + from_gain))


def ridge_path(
    S_yy: Float[Array, "P P"], S_zy: Float[Array, "6 P"], penalty: Float[Array, "L 6"]
) -> Float[Array, "L 6 P"]:
    """Return the minimisers of `sum (z_i - E_i y)^2 + penalty_i |E_i|^2` for L penalties a row.

    One eigendecomposition serves them all. Where a penalty is zero and y is not excited the
    minimiser of least norm is returned.
    """
    d, V = np.linalg.eigh(S_yy)
    d = np.where(d > d[-1] * len(d) * np.finfo(float).eps, d, 0.0)
    weight = d + penalty[..., None]
    inverse = np.divide(1.0, weight, out=np.zeros_like(weight), where=weight > 0)
    return np.asarray(((S_zy @ V) * inverse) @ V.T)


def free_columns(scatter: Float[Array, "D D"], keep: int) -> Float[Array, "D-1 D-1"]:
    """Return the scatter with column `keep` regressed out of all others (Schur complement)."""
    others = np.delete(np.arange(len(scatter)), keep)
    rest = scatter[np.ix_(others, others)]
    if scatter[keep, keep] <= 0:
        return rest
    cross = scatter[others, keep]
    return np.asarray(rest - np.outer(cross, cross) / scatter[keep, keep])


def penalty_path(
    moments: Moments, workbench: Workbench, lambdas: Float[Array, "L"]
) -> list[Estimate]:
    """Return the P7 estimate for every lambda from centred moments of `[r, dT?, w]`.

    lambda = 0 is least squares (P2 by P4-P6; of least norm from C_w where the channels are not
    excited), lambda -> infinity the Workbench matrix. The covariance is that of least squares
    noise through the ridge; `posterior` gives the better one.
    """
    lambdas = np.asarray(lambdas, dtype=np.float64)
    if not (np.isfinite(lambdas).all() and (lambdas >= 0).all()):
        raise DataError(f"lambda must be finite and not negative, got {lambdas.min():g}")
    channels = workbench.gain.shape[1]
    width = len(moments.mean)
    full = moments.scatter
    has_temperature = width == channels + 7
    S = free_columns(full, channels) if has_temperature else full
    S_rr, S_wr = S[:channels, :channels], S[channels:, :channels]
    penalty = np.broadcast_to(6.0 * moments.count * lambdas[:, None], (len(lambdas), 6))
    steps = ridge_path(S_rr, S_wr - workbench.gain @ S_rr, penalty)
    estimates = []
    for step, mu in zip(steps, penalty, strict=True):
        gain = workbench.gain + step
        k = None
        if has_temperature:
            own = full[channels, channels]
            left = full[-6:, channels] - gain @ full[:channels, channels]
            k = left / own if own > 0 else np.zeros(6)
        residual = full_residual(full, gain, k)
        inverse = np.linalg.pinv(S_rr + mu[0] * np.eye(channels), hermitian=True)
        sandwich = inverse @ S_rr @ inverse
        covariance = np.zeros((6, width - 6, width - 6))
        variance = np.maximum(np.diag(residual), 0.0) / max(moments.count, 1)
        covariance[:, :channels, :channels] = variance[:, None, None] * sandwich
        estimates.append(Estimate(gain, k, covariance))
    return estimates


def full_residual(
    scatter: Float[Array, "D D"], gain: Float[Array, "6 K"], k: Float[Array, "6"] | None
) -> Float[Array, "6 6"]:
    """Return the scatter of `w - C r - k dT` from that of `[r, dT?, w]`."""
    inputs = gain if k is None else np.column_stack([gain, k])
    B = np.concatenate([-inputs, np.eye(6)], axis=1)
    return np.asarray(B @ scatter @ B.T)


def scaling_map(workbench: Workbench, inputs: int) -> Float[Array, "D D"]:
    """Return the matrix that takes a row `[r, dT?, w]` to `[y, z]` of `ScaledProblem`.

    `inputs` counts the columns before the wrench: K channels, or K + 1 with a temperature. Raises
    `DataError` where they are not those of the Workbench.
    """
    channels = workbench.gain.shape[1]
    if inputs not in (channels, channels + 1):
        raise DataError(
            f"samples have {inputs} columns beside the wrench, Workbench"
            f" {workbench.name!r} has {channels} channels"
        )
    to_yz = np.zeros((inputs + 6, inputs + 6))
    to_yz[:channels, :channels] = workbench.scaling
    if inputs > channels:
        to_yz[channels, channels] = 1.0 / TEMPERATURE_SPAN
    to_yz[inputs:, :channels] = -workbench.gain / workbench.full_scale[:, None]
    to_yz[inputs:, inputs:] = np.diag(1.0 / workbench.full_scale)
    return to_yz


@dataclass(frozen=True, slots=True)
class ScaledProblem:
    """The regression in the coordinates where the prior is one number: `z = E y + noise`."""

    moments: Moments
    """Moments of `[y, z]`: `y = T r` (and dT over its span), `z = F^-1 (w - C_w r)`."""
    basis: Float[Array, "P P"]
    """T, with the temperature's scale as its last diagonal entry where there is one."""
    workbench: Workbench

    @staticmethod
    def of(moments: Moments, workbench: Workbench) -> ScaledProblem:
        """Return the problem of (centred, or pooled) moments of `[r, dT?, w]`."""
        inputs = len(moments.mean) - 6
        to_yz = scaling_map(workbench, inputs)
        return ScaledProblem(moments.map(to_yz), to_yz[:inputs, :inputs], workbench)

    @property
    def S_yy(self) -> Float[Array, "P P"]:
        """Scatter of y."""
        n = len(self.basis)
        return self.moments.scatter[:n, :n]

    @property
    def S_zy(self) -> Float[Array, "6 P"]:
        """Cross scatter of z and y."""
        n = len(self.basis)
        return self.moments.scatter[n:, :n]

    def along(self, directions: Float[Array, "M P"]) -> ScaledProblem:
        """Return the problem that sees y along M orthonormal directions only.

        In all others E stays at the prior: noise in a channel that nothing moved would otherwise
        pull its gain towards zero.
        """
        n = len(self.basis)
        project = np.eye(n + 6)
        project[:n, :n] = directions.T @ directions
        return ScaledProblem(self.moments.map(project), self.basis, self.workbench)

    def noise_power(self, noise: Noise) -> Float[Array, "6"]:
        """Variance of z that counts against one sample: `inefficiency (sd / F)^2`."""
        return np.asarray(noise.inefficiency * (noise.sd / self.workbench.full_scale) ** 2)

    def penalties(self, kappas: Float[Array, "*L 6"], noise: Noise) -> Float[Array, "*L 6"]:
        """Return the ridge penalty that the prior standard deviation kappa amounts to."""
        return np.asarray(self.noise_power(noise) / np.asarray(kappas) ** 2)

    def path(self, kappas: Float[Array, "L 6"], noise: Noise) -> Float[Array, "L 6 P"]:
        """Return E for L prior standard deviations per row."""
        return ridge_path(self.S_yy, self.S_zy, self.penalties(kappas, noise))

    def squared_error(self, E: Float[Array, "*L 6 P"]) -> Float[Array, "*L 6"]:
        """Return the sum over these samples of `(F (z - E y))^2` per axis [N^2, Nm^2]."""
        n = len(self.basis)
        S_zz = np.diag(self.moments.scatter[n:, n:])
        own = np.einsum("...ip,pq,...iq->...i", E, self.S_yy, E)
        cross = np.einsum("...ip,ip->...i", E, self.S_zy)
        scale = self.workbench.full_scale**2
        return np.asarray(np.maximum(S_zz - 2.0 * cross + own, 0.0) * scale)

    def coefficients(self, E: Float[Array, "6 P"]) -> Float[Array, "6 P"]:
        """Return `[C, k]` that E stands for."""
        found = self.workbench.full_scale[:, None] * (E @ self.basis)
        channels = self.workbench.gain.shape[1]
        found[:, :channels] += self.workbench.gain
        return np.asarray(found)

    def estimate(self, E: Float[Array, "6 P"], covariance: Float[Array, "6 P P"]) -> Estimate:
        """Return the estimate that E and the covariance of its rows stand for."""
        channels = self.workbench.gain.shape[1]
        scale = self.workbench.full_scale
        found = self.coefficients(E)
        spread = scale[:, None, None] ** 2 * (self.basis.T @ covariance @ self.basis)
        k = found[:, -1] if len(self.basis) > channels else None
        return Estimate(found[:, :channels], k, spread)

    def posterior(self, kappa: Float[Array, "6"], noise: Noise) -> Estimate:
        """Return the maximum a posteriori estimate and its covariance for a prior sd per row."""
        E = self.path(np.asarray(kappa)[None], noise)[0]
        d, V = np.linalg.eigh(self.S_yy)
        precision = np.maximum(d, 0.0) / self.noise_power(noise)[:, None]
        variance = 1.0 / (precision + 1.0 / np.asarray(kappa)[:, None] ** 2)
        return self.estimate(E, np.einsum("pj,ij,qj->ipq", V, variance, V))
