"""Poses and wrenches, batched over samples.

`A_H_B` is the pose of frame B in frame A (homogeneous 4x4), `A_X_B` moves a wrench and its point
of reduction from B to A: `A_f = A_X_B @ B_f`, force first. R. Featherstone, *Rigid Body Dynamics
Algorithms*, Springer 2008, section 2.8, with the linear part first.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array


def skew(v: Float[Array, "*N 3"]) -> Float[Array, "*N 3 3"]:
    """Return the matrix `[v]x` with `[v]x u = v x u`."""
    v = np.asarray(v, dtype=np.float64)
    m: Array = np.zeros((*v.shape, 3))
    m[..., 2, 1], m[..., 0, 2], m[..., 1, 0] = v[..., 0], v[..., 1], v[..., 2]
    m -= np.swapaxes(m, -1, -2).copy()  # antisymmetric
    return m


def pose(A_R_B: Float[Array, "*N 3 3"], A_p_B: Float[Array, "*N 3"]) -> Float[Array, "*N 4 4"]:
    """Return `A_H_B` of a rotation and the origin of B in A [m]."""
    shape = np.broadcast_shapes(np.shape(A_R_B)[:-2], np.shape(A_p_B)[:-1])
    A_H_B = np.zeros((*shape, 4, 4))
    A_H_B[..., :3, :3], A_H_B[..., :3, 3], A_H_B[..., 3, 3] = A_R_B, A_p_B, 1.0
    return A_H_B


def inverse(A_H_B: Float[Array, "*N 4 4"]) -> Float[Array, "*N 4 4"]:
    """Return `B_H_A` of `A_H_B`."""
    B_R_A = np.swapaxes(A_H_B[..., :3, :3], -1, -2)
    return pose(B_R_A, -(B_R_A @ A_H_B[..., :3, 3:])[..., 0])


def wrench_transform(A_H_B: Float[Array, "*N 4 4"]) -> Float[Array, "*N 6 6"]:
    """Return `A_X_B`, which moves a wrench and its point of reduction from B to A."""
    A_R_B, A_p_B = A_H_B[..., :3, :3], A_H_B[..., :3, 3]
    A_X_B = np.zeros((*A_H_B.shape[:-2], 6, 6))
    A_X_B[..., :3, :3] = A_X_B[..., 3:, 3:] = A_R_B
    A_X_B[..., 3:, :3] = skew(A_p_B) @ A_R_B
    return A_X_B


def rotation_from_rpy(rpy: Float[Array, "*N 3"]) -> Float[Array, "*N 3 3"]:
    """Return the rotation of URDF roll, pitch, yaw [rad]: `Rz(yaw) Ry(pitch) Rx(roll)`."""
    r, p, y = np.moveaxis(np.asarray(rpy, dtype=np.float64), -1, 0)
    cr, sr, cp, sp, cy, sy = np.cos(r), np.sin(r), np.cos(p), np.sin(p), np.cos(y), np.sin(y)
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def rotation_about(axis: Float[Array, 3], angle: Float[Array, "*N"]) -> Float[Array, "*N 3 3"]:
    """Return the rotation by `angle` [rad] about the unit vector `axis` (Rodrigues)."""
    k = skew(np.asarray(axis, dtype=np.float64))
    angle = np.asarray(angle, dtype=np.float64)[..., None, None]
    return np.asarray(np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * (k @ k))
