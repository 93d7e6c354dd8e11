"""An unknown tool on a wrist sensor: its mass, its centre of mass, and the sensor's offset.

Held still, the tool makes the sensor read its weight alone,

    w = s [m g; m c x g] + o ,

`g` gravity in the sensor's frame, `s` = +1 where the sensor reads what the tool does to it and -1
where it reads the reaction. The sensor itself is taken as its maker calibrated it: one still tool
makes torque a fixed map of force, so three columns of `C` would stay free.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal.conventions import Reading, alike, believed, readings
from ftcal.errors import DataError
from ftcal.gravity_fit import GravityFit, held_out, rounding, weights
from ftcal.moments import Moments
from ftcal.noise import Noise, inefficiency
from ftcal.poses import Poses
from ftcal.sensor import AXES

if TYPE_CHECKING:
    from jaxtyping import Bool, Float
    from numpy import ndarray as Array

LEAST_POSES = 4
"""With fewer attitudes the residual says nothing about noise."""

LEAST_TURN = 0.02
"""Gravity that turns less than this [rad, RMS] is lost in the attitude's own error."""

LEAST_SIGNAL = 3.0
"""A mass below this many of its standard errors is not seen."""

SEVERAL = 8
"""With fewer attitudes there is no saying which one is odd."""

FAR = 6.0
"""A pose is named whose residual exceeds this many robust standard deviations."""

BLIND = 0.05
"""Share of a direction that is not determined, from which a component counts as unknown too."""


@dataclass(frozen=True, slots=True)
class Outlier:
    """A pose that the others do not explain."""

    rows: tuple[int, int]
    """First and last row of the table."""
    axis: str
    """The axis that is farthest off."""
    residual: float
    """Reading minus what the other poses predict [N or Nm]."""


@dataclass(frozen=True, slots=True, eq=False)
class Payload:
    """A tool as a wrist sensor weighs it. What is not determined is NaN."""

    mass: float
    """Kilograms."""
    mass_error: float
    """Standard error."""
    centre: Float[Array, "3"]
    """Centre of mass in the sensor's frame [m]."""
    centre_error: Float[Array, "3"]
    """Standard errors [m]."""
    offset: Float[Array, "6"]
    """What the sensor reads without a load [N, Nm]."""
    offset_error: Float[Array, "6"]
    """Standard errors [N, Nm]."""
    sign: int
    """+1: the sensor reads what the tool does to it; -1: the reaction, or gravity points up."""
    noise: Noise
    """Per axis, of the residuals."""
    residual: Float[Array, "N 6"]
    """Reading minus model [N, Nm]."""
    held_out: Float[Array, "N 6"]
    """Reading minus what all poses but its own predict [N, Nm]."""
    poses: int
    """Attitudes that were told apart."""
    turn: Float[Array, "3"]
    """RMS by which gravity moved along its principal directions, as a share of its norm."""
    condition: float
    """Of the regressor of the lever: best over worst seen direction."""
    readings: tuple[Reading, ...]
    """How the table may be meant: as told, then the others, the best first."""
    refused: tuple[str, ...]
    """Why figures are not to be used, a line each; empty where they may be."""
    outliers: tuple[Outlier, ...]
    """Poses to look at; they were not left out."""
    notes: tuple[str, ...]
    """What reading the table showed."""

    def rms(self, residual: Float[Array, "N 6"]) -> tuple[float, float]:
        """Return the RMS per component of force [N] and torque [Nm]."""
        square = np.mean(residual**2, axis=0)
        return float(np.sqrt(square[:3].mean())), float(np.sqrt(square[3:].mean()))


def estimate(poses: Poses) -> Payload:
    """Return mass, centre of mass and offset by least squares, axes weighed by their noise.

    A standard error is the larger of two: noise over its independent samples, and the jackknife
    over attitudes.

    Raises `DataError` with fewer than four attitudes, or where gravity hardly turns in the sensor's
    frame: mass and offset are one sum then. Gravity that moves along one line leaves the centre of
    mass on that line undetermined; it is NaN and `refused` says so.
    """
    number = poses.number
    count = int(number[-1]) + 1 if len(number) else 0
    if count < LEAST_POSES:
        raise DataError(
            f"{poses.source}: {len(number)} rows hold {count} attitudes, at least {LEAST_POSES} are"
            " needed; turn the wrist between them so that gravity comes from every side"
        )
    rows = np.column_stack([poses.gravity, poses.wrench])
    moments = Moments.of(rows)
    spread, axes, norm = _turns(moments)
    if np.linalg.norm(spread) < LEAST_TURN:
        raise DataError(
            f"{poses.source}: gravity turns by {np.degrees(np.linalg.norm(spread)):.2g} deg (RMS)"
            " in the sensor's frame: mass and offset are one sum; turn the wrist by tens of degrees"
        )
    weight = weights(moments, rows)
    found = GravityFit.of(moments, weight)
    left = found.residual(poses.gravity, poses.wrench)
    noise = Noise(found.sd(left, weight), inefficiency([left]))
    power = noise.sd**2 * noise.inefficiency
    meat = np.einsum("iab,i->ab", found.normal, weight**2 * power)
    covariance = found.bread @ meat @ found.bread
    told = readings(poses)
    misread = _misread(told)
    figures, slope = found.figures()
    own = np.concatenate([np.zeros(4), power / moments.count])  # of the means that offsets rest on
    variance = own + np.einsum("ia,ab,ib->i", slope, covariance, slope)
    left_out, repeated = held_out(number, rows, weight)
    error = np.sqrt(np.maximum(variance, repeated))
    mass, mass_error = abs(float(figures[0])), float(error[0])
    centre, centre_error, offset, offset_error = figures[1:4], error[1:4], figures[4:], error[4:]
    lost, across, unknown = _not_determined(spread, axes[:, 0], moments.mean[:3] / norm)
    if mass <= LEAST_SIGNAL * mass_error:
        lost[:] = True
        unknown.append(
            f"a mass of {mass:.3g} kg is not seen in its standard error of {mass_error:.2g} kg, so"
            " there is no centre of mass; take a heavier tool or more poses"
        )
    centre[lost] = centre_error[lost] = np.nan
    offset[across] = offset_error[across] = np.nan
    lever = np.sort(spread @ spread - spread**2)
    return Payload(
        mass=mass,
        mass_error=mass_error,
        centre=centre,
        centre_error=centre_error,
        offset=offset,
        offset_error=offset_error,
        sign=1 if figures[0] >= 0 else -1,
        noise=noise,
        residual=left,
        held_out=left_out,
        poses=count,
        turn=spread,
        condition=float(np.sqrt(lever[-1] / lever[0])) if lever[0] > 0 else float("inf"),
        readings=told,
        # a table read wrongly explains every other complaint
        refused=(misread,) if misread else (*([poses.moving] * bool(poses.moving)), *unknown),
        outliers=() if misread else _outliers(poses, left_out),
        notes=poses.notes if misread else (*poses.notes, *_undecided(told)),
    )


def _turns(moments: Moments) -> tuple[Float[Array, "3"], Float[Array, "3 3"], float]:
    """Return how far gravity moved along its principal directions [share of its norm]."""
    variance, axes = np.linalg.eigh(moments.covariance()[:3, :3])
    norm = float(np.sqrt(variance.sum() + moments.mean[:3] @ moments.mean[:3]))
    return np.sqrt(np.maximum(variance[::-1], 0.0)) / norm, axes[:, ::-1], norm


def _not_determined(
    spread: Float[Array, "3"], line: Float[Array, "3"], mean: Float[Array, "3"]
) -> tuple[Bool[Array, "3"], Bool[Array, "6"], list[str]]:
    """Return which components of centre and offset the data leave open, and why.

    Gravity that moves along one `line` alone makes no torque with the part of the centre of mass
    on that line; the torque that this part makes with the mean gravity cannot be told from offset.
    """
    lost, across = np.zeros(3, dtype=bool), np.zeros(6, dtype=bool)
    if spread[1] >= LEAST_TURN:
        return lost, across, []
    lost[:] = np.abs(line) > BLIND
    across[3:] = np.abs(np.cross(line, mean)) > BLIND
    names = [f"c{'xyz'[k]}" for k in np.flatnonzero(lost)]
    names += [f"offset {AXES[k]}" for k in np.flatnonzero(across)]
    along = ", ".join(f"{x:+.2f}" for x in line)
    return lost, across, [
        f"gravity moves along ({along}) alone, so the centre of mass on that line is not determined"
        f" ({', '.join(names)}); add poses with gravity off it"
    ]  # fmt: skip


def _misread(found: tuple[Reading, ...]) -> str:
    """Return which reading fits clearly better than the one told, and by how much; or nothing."""
    told, best = found[0], believed(found)
    if best is told:
        return ""
    return (
        f"read as told the fit leaves {told.force:.3g} N and {told.torque:.3g} Nm, but"
        f" {best.force:.3g} N and {best.torque:.3g} Nm read as {best.words}; {best.cure}"
    )


def _undecided(found: tuple[Reading, ...]) -> tuple[str, ...]:
    others = alike(found)
    if not others:
        return ()
    more = f", or in {len(others) - 1} other ways" if len(others) > 1 else ""
    return (
        f"these poses fit about as well read as {others[0].words}{more}: what was told is believed;"
        " add poses with gravity from other sides",
    )


def _outliers(poses: Poses, left_out: Float[Array, "N 6"]) -> tuple[Outlier, ...]:
    """Return the poses far from what the others predict, by median absolute residual."""
    number = poses.number
    if number[-1] + 1 < SEVERAL:
        return ()
    starts = np.flatnonzero(np.diff(number, prepend=-1))
    mean = np.add.reduceat(left_out, starts, axis=0) / np.diff([*starts, len(number)])[:, None]
    robust = 1.4826 * np.median(np.abs(mean), axis=0)  # of a Gaussian: one standard deviation
    far = np.abs(mean) / np.maximum(robust, rounding(poses.wrench))
    stops = np.append(starts[1:], len(number)) - 1
    return tuple(
        Outlier(
            (int(poses.rows[starts[k]]), int(poses.rows[stops[k]])),
            AXES[int(far[k].argmax())],
            float(mean[k, far[k].argmax()]),
        )
        for k in np.flatnonzero(far.max(axis=1) > FAR)
    )
