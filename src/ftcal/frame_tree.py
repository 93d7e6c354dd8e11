"""Which frame hangs on which, and how each of them turned: the attitude of one seen from another.

Every frame has one parent, whose transform is logged once (a bolt) or over time (a joint). Only
orientations are kept: they say where gravity points.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ftcal.errors import DataError, LogError, raise_all, unknown
from ftcal.recording import NANOSECONDS, Signal
from ftcal.signals import interpolate

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

UNIT = 1e-3
"""A quaternion's norm may miss 1 by so much: float32 and rounding stay far below."""

SAME = np.radians(0.01)
"""Orientations nearer than this [rad] are one: rounding, not motion."""

JUMP, ALTERNATES = np.radians(0.5), 0.2
"""Orientations that leap so far [rad] and back in this share of samples come from two sources."""

SHOWN = 12
"""Frames that an error lists."""


@dataclass(frozen=True, slots=True)
class Turns:
    """How one frame turned in another."""

    parent: str
    child: str
    turned: Signal
    """Quaternion x y z w, child to parent, of unit norm; one sample of what is `fixed`."""
    fixed: bool = False

    @property
    def title(self) -> str:
        """How messages call it."""
        return f"{self.parent} -> {self.child}"


def turns(
    source: str, parent: str, child: str, quaternions: Signal, *, fixed: bool = False
) -> Turns:
    """Return the transform that `quaternions` (x y z w, in the order of arrival) say.

    Raises `LogError` where a number is not finite or time goes back, `DataError` where a quaternion
    is none, or where two publishers send the transform and differ.
    """
    found = Turns(parent, child, quaternions, fixed)
    where, q = f"{source}: transform {found.title}", quaternions.values
    if not np.isfinite(q).all():
        row, column = np.argwhere(~np.isfinite(q))[0]
        raise LogError(f"{where}, message {row + 1}: quaternion {'xyzw'[column]} is"
                       f" {q[row, column]}; mend its publisher, or cut these messages")  # fmt: skip
    with np.errstate(over="ignore"):  # infinity is refused as any other norm
        norms = np.linalg.norm(q, axis=1)
    if (error := np.abs(norms - 1.0)).max() > UNIT:
        row = int(error.argmax())
        raise DataError(f"{where}, message {row + 1}: quaternion of norm {norms[row]:.4g}, not 1;"
                        " mend its publisher (x y z w, unit norm)")  # fmt: skip
    q = _continuous(q / norms[:, None])
    step = np.diff(quaternions.stamps)
    cure = "two publishers send it; record without one of them"
    if fixed:
        if (apart := _angle(q[:1], q).max()) > SAME:
            raise DataError(f"{where}: static, but said {np.degrees(apart):.3g} deg apart; {cure}")
        return replace(found, turned=replace(quaternions, stamps=quaternions.stamps[:1],
                                             values=q[:1]))  # fmt: skip
    if (step < 0).any():
        row = int(np.flatnonzero(step < 0)[0])
        raise LogError(f"{where}, message {row + 2}: time goes back by"
                       f" {-int(step[row]) / NANOSECONDS:.6f} s; {cure}, or split the log"
                       " there")  # fmt: skip
    leap = _angle(q[:-1], q[1:])
    if (leap[step == 0] > SAME).any():
        row = int(np.flatnonzero((step == 0) & (leap > SAME))[0])
        raise DataError(f"{where}, message {row + 2}: differs by {np.degrees(leap[row]):.3g} deg"
                        f" from the one of the same stamp; {cure}")  # fmt: skip
    fresh = np.concatenate(([True], step > 0))
    q = q[fresh]
    leap, back = _angle(q[:-1], q[1:])[:-1], _angle(q[:-2], q[2:])
    if len(leap) and np.mean((leap > JUMP) & (back < leap / 3)) > ALTERNATES:
        raise DataError(f"{where}: leaps by {np.degrees(np.median(leap)):.3g} deg and back from"
                        f" message to message; {cure}")  # fmt: skip
    return replace(found, turned=replace(quaternions, stamps=quaternions.stamps[fresh], values=q))


@dataclass(frozen=True, slots=True)
class FrameTree:
    """All transforms of a log, each by the frame that it places."""

    source: str
    transforms: Mapping[str, Turns]

    @classmethod
    def of(cls, source: str, transforms: Iterable[Turns]) -> FrameTree:
        """Return the tree; `DataError` where a frame has two parents, or hangs on itself."""
        parents: dict[str, dict[str, list[Turns]]] = {}
        for one in transforms:
            parents.setdefault(one.child, {}).setdefault(one.parent, []).append(one)
        faults = [
            f"frame {child!r} hangs on {' and on '.join(map(repr, sorted(known)))}; record without"
            " one of their publishers"
            for child, known in parents.items() if len(known) > 1
        ]  # fmt: skip
        faults += [
            f"transform {same[0].title} is static and moves; record without one of its publishers"
            for known in parents.values() for same in known.values() if len(same) > 1
        ]  # fmt: skip
        raise_all(DataError, source, faults)
        tree = cls(source, {child: next(iter(known.values()))[0]
                            for child, known in parents.items()})  # fmt: skip
        loops = {frozenset(loop): loop for frame in parents if (loop := tree._loop(frame))}
        told = [" -> ".join((*reversed(loop), loop[-1])) for loop in loops.values()]
        raise_all(DataError, source, [f"frames hang on each other: {loop}; mend the publisher"
                                      for loop in told])  # fmt: skip
        return tree

    @property
    def frames(self) -> list[str]:
        """Every frame once, by name."""
        parents = (one.parent for one in self.transforms.values())
        return sorted({*self.transforms, *parents})

    def attitude(self, base: str, sensor: str) -> Signal:
        """Return the rotation sensor to base, row by row, over time.

        On the stamps of the transform between them that is logged most often; others are
        interpolated, and what lies in their holes or beyond is left out. Raises `DataError` where a
        frame is unknown, nothing joins them, or nothing between them moves.
        """
        faults = [unknown("frame", name, self.frames) for name in (base, sensor)
                  if name not in self.frames]  # fmt: skip
        if faults:
            faults.append(f"frames are {listed(self.frames)}")
        raise_all(DataError, self.source, faults)
        up, down = self._up(base), self._up(sensor)
        while up and down and up[-1] is down[-1]:
            up.pop()
            down.pop()
        roots = [
            (path[-1].parent if path else frame) for path, frame in ((up, base), (down, sensor))
        ]
        if roots[0] != roots[1]:
            raise DataError(
                f"{self.source}: nothing joins {base!r} (its tree begins at {roots[0]!r}) and"
                f" {sensor!r} (at {roots[1]!r}); record the transform between {roots[0]!r} and"
                f" {roots[1]!r}"
            )
        moving = [one.turned for one in (*up, *down) if not one.fixed]
        if not moving:
            raise DataError(
                f"{self.source}: nothing between {base!r} and {sensor!r} moves; name a base that"
                " stays where it is while the wrist turns"
            )
        clock = max(moving, key=len).stamps
        base_R_root = np.swapaxes(_product(list(reversed(up)), clock), 1, 2)
        rotation = base_R_root @ _product(list(reversed(down)), clock)
        known = np.isfinite(rotation).all(axis=(1, 2))
        if not known.any():
            raise DataError(
                f"{self.source}: the transforms between {base!r} and {sensor!r} are at no time all"
                " known; record them in one run, more than once each"
            )
        names = tuple(f"r{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3))
        return Signal(f"{base} -> {sensor}", names, clock[known],
                      np.ascontiguousarray(rotation[known].reshape(-1, 9)))  # fmt: skip

    def _up(self, frame: str) -> list[Turns]:
        """Return the transforms from a frame to the root of its tree."""
        path = []
        while frame in self.transforms:
            path.append(self.transforms[frame])
            frame = path[-1].parent
        return path

    def _loop(self, frame: str) -> list[str]:
        """Return the frames of the loop that `frame` is in, child first; none where it is not."""
        path = [frame]
        while (one := self.transforms.get(path[-1])) and len(path) <= len(self.transforms):
            if one.parent == frame:
                return path
            path.append(one.parent)
        return []


def listed(names: Iterable[str]) -> str:
    """Return names for an error: the first of them, and how many more there are."""
    known = sorted(set(names))
    more = f" and {len(known) - SHOWN} more" if len(known) > SHOWN else ""
    return (", ".join(known[:SHOWN]) or "none") + more


def rotation_from_quaternion(xyzw: Float[Array, "N 4"]) -> Float[Array, "N 3 3"]:
    """Return the rotations of unit quaternions; x y z is the vector part, w the scalar."""
    x, y, z, w = xyzw.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def _product(path: Sequence[Turns], clock: Float[Array, "N"]) -> Float[Array, "N 3 3"]:
    """Return the rotation of the last frame of a path in the first, on a clock; NaN if unknown."""
    total = np.broadcast_to(np.eye(3), (len(clock), 3, 3))
    for one in path:
        if one.fixed:
            q = one.turned.values
        else:
            q = interpolate(one.turned, clock)
            q = q / np.linalg.norm(q, axis=1, keepdims=True)
        total = total @ rotation_from_quaternion(q)
    return np.asarray(total)


def _continuous(q: Float[Array, "N 4"]) -> Float[Array, "N 4"]:
    """Return quaternions of the same rotations that do not change sign between neighbours."""
    turns_over = np.where(np.einsum("nk,nk->n", q[:-1], q[1:]) < 0, -1.0, 1.0)
    return q * np.concatenate(([1.0], np.cumprod(turns_over)))[:, None]


def _angle(one: Float[Array, "N 4"], other: Float[Array, "N 4"]) -> Float[Array, "N"]:
    """Return the angles between rotations [rad]."""
    dot = np.einsum("nk,nk->n", *np.broadcast_arrays(one, other))
    near = np.where(dot < 0, -1.0, 1.0)[:, None]  # q and -q are one rotation
    return np.asarray(4 * np.arcsin(np.minimum(np.linalg.norm(one - near * other, axis=1) / 2, 1)))
