"""The momentum balance of what lies behind each sensor: Newton and Euler, from contact to tips.

One source, whatever its numbers are: NumPy arrays (the reference) or symbols of a trace
(`ftcal.kernel` compiles it). Outwards along the tree go angular velocity `w`, angular acceleration
`dw` and proper acceleration `a` (gravity subtracted: what an accelerometer would read) of each
body's frame; inwards come force `f` and torque `n`. A point at x of a body accelerates by
`a + A x` with `A = [dw]x + [w]x [w]x`, so that with the moments of the body's mass

    f = integral (a + A x) dm,        n = integral x × (a + A x) dm

are linear in ten constants. J. Luh, M. Walker, R. Paul, *On-line computational scheme for
mechanical manipulators*, 1980, written with the pseudo-inertia of Wensing et al. 2018.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ftcal.tree import Body, Cut, Tree

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

Vector = list[Any]
"""Three numbers of any kind."""


@dataclass(frozen=True, slots=True)
class Twist:
    """Motion of a body's frame, in that frame."""

    w: Vector
    """Angular velocity [rad/s]."""
    dw: Vector
    """Angular acceleration [rad/s^2]."""
    a: Vector
    """Proper acceleration of the origin [m/s^2]."""


def wrenches(
    tree: Tree,
    base: Twist,
    joints: Mapping[str, tuple[Any, Any, Any]],
    sin_cos: Callable[[Any], tuple[Any, Any]],
    section: Callable[[], None] = lambda: None,
) -> list[Vector]:
    """Return what each sensor of `tree` reads: force [N], torque [Nm].

    `base` is the motion of the body that touches the world, `joints` the position, velocity and
    acceleration of each joint. `section` is called wherever a limb starts or ends.
    """
    readings: dict[str, Vector] = {}

    def note(index: int, f: Vector, n: Vector) -> tuple[Vector, Vector]:
        for cut in tree.cuts:
            if cut.body == index:
                readings[cut.sensor] = reading(cut, f, n)
        return f, n

    sweep(tree, base, joints, sin_cos, section, note)
    return [readings[cut.sensor] for cut in tree.cuts]


def sweep(
    tree: Tree,
    base: Twist,
    joints: Mapping[str, tuple[Any, Any, Any]],
    sin_cos: Callable[[Any], tuple[Any, Any]],
    section: Callable[[], None],
    handed: Callable[[int, Vector, Vector], tuple[Vector, Vector]],
) -> None:
    """Carry motion out to the tips of `tree` and wrenches back in; arguments as in `wrenches`.

    `handed` learns, body by body and tips first, force and torque on the body of that index and all
    that hangs on it, in its frame, and returns those that the body before it has to supply.
    """
    hanging: list[list[int]] = [[] for _ in tree.bodies]
    for index, body in enumerate(tree.bodies[1:], start=1):
        hanging[body.before].append(index)

    def visit(index: int, twist: Twist) -> tuple[Vector, Vector]:
        A = _point_acceleration(twist)
        body = tree.bodies[index]
        f, n = _rate_of_momentum(body, A, twist.a) if body.behind else ([0.0] * 3, [0.0] * 3)
        for other in hanging[index]:
            if len(hanging[index]) > 1:
                section()
            limb = tree.bodies[other]
            q, dq, ddq = joints[limb.joint] if limb.joint else (0.0, 0.0, 0.0)
            turn, lift = _placed(limb, q, sin_cos)
            outer = visit(other, _outwards(limb, twist, A, turn, (lift, dq, ddq)))
            if body.behind:
                force, torque = _inwards(limb, *outer, turn, lift)
                f, n = _plus(f, force), _plus(n, torque)
        if len(hanging[index]) > 1:
            section()
        return handed(index, f, n)

    visit(0, base)


def arguments(
    tree: Tree, gravity: Sequence[float] | None, numbers: Sequence[Any]
) -> tuple[Twist, dict[str, tuple[Any, Any, Any]]]:
    """Return base and joints for `wrenches` from `numbers`, three a joint of `tree`.

    Where `gravity` is None the contact moves, and w, dw, a of its frame follow.
    """
    count = 3 * len(tree.joints)
    triples = zip(numbers[0:count:3], numbers[1:count:3], numbers[2:count:3], strict=True)
    joints = dict(zip(tree.joints, triples, strict=True))
    if gravity is not None:
        return Twist([0.0] * 3, [0.0] * 3, [-g for g in gravity]), joints
    w, dw, a = (list(numbers[count + k : count + k + 3]) for k in (0, 3, 6))
    return Twist(w, dw, a), joints


def _outwards(
    body: Body, before: Twist, A: list[Vector], turn: tuple[Any, Any], joint: tuple[Any, Any, Any]
) -> Twist:
    """Return the motion of `body` from that of the body before it."""
    lift, dq, ddq = joint
    H = body.before_H_body
    at_zero = Twist(
        _rotated(H[:3, :3].T, before.w),
        _rotated(H[:3, :3].T, before.dw),
        _rotated(H[:3, :3].T, _plus(before.a, _times(A, H[:3, 3]))),
    )
    w, dw, a = (_about_z(turn, v, -1.0) for v in (at_zero.w, at_zero.dw, at_zero.a))
    across = [w[1] * dq, -(w[0] * dq)]  # w × dq z
    if body.kind == "revolute":
        spin = [w[0], w[1], w[2] + dq]
        return Twist(spin, [dw[0] + across[0], dw[1] + across[1], dw[2] + ddq], a)
    A_here = _point_acceleration(Twist(w, dw, a))
    a = [
        a[0] + A_here[0][2] * lift + 2.0 * across[0],
        a[1] + A_here[1][2] * lift + 2.0 * across[1],
        a[2] + A_here[2][2] * lift + ddq,
    ]
    return Twist(w, dw, a)


def _placed(
    body: Body, q: Any, sin_cos: Callable[[Any], tuple[Any, Any]]
) -> tuple[tuple[Any, Any], Any]:
    """Return how far its joint turns `body` (sin, cos) and moves it along z."""
    turn = sin_cos(q) if body.kind == "revolute" else (0.0, 1.0)
    return turn, q if body.kind == "prismatic" else 0.0


def _inwards(
    body: Body, f: Vector, n: Vector, turn: tuple[Any, Any], lift: Any
) -> tuple[Vector, Vector]:
    """Return force and torque on `body`, expressed and reduced at the body before it."""
    n = [n[0] - lift * f[1], n[1] + lift * f[0], n[2]]
    R, p = body.before_H_body[:3, :3], body.before_H_body[:3, 3]
    f, n = _rotated(R, _about_z(turn, f, 1.0)), _rotated(R, _about_z(turn, n, 1.0))
    return f, _plus(n, _cross(p, f))


def carried_outwards(
    body: Body, f: Vector, n: Vector, q: Any, sin_cos: Callable[[Any], tuple[Any, Any]]
) -> tuple[Vector, Vector]:
    """Return at `body` a force and torque given at the body before it; `q` is that of its joint."""
    turn, lift = _placed(body, q, sin_cos)
    R, p = body.before_H_body[:3, :3].T, -body.before_H_body[:3, 3]
    n = _about_z(turn, _rotated(R, _plus(n, _cross(p, f))), -1.0)
    f = _about_z(turn, _rotated(R, f), -1.0)
    return f, [n[0] + lift * f[1], n[1] - lift * f[0], n[2]]


def reading(cut: Cut, f: Vector, n: Vector) -> Vector:
    """Return force and torque at the measurement frame, on the side the sensor says."""
    R, p = cut.sign * cut.sensor_H_body[:3, :3], cut.sensor_H_body[:3, 3]
    f, n = _rotated(R, f), _rotated(R, n)
    return f + _plus(n, _cross(p, f))


def _point_acceleration(twist: Twist) -> list[Vector]:
    """Return `[dw]x + [w]x [w]x`."""
    (x, y, z), (dx, dy, dz) = twist.w, twist.dw
    xx, yy, zz, xy, xz, yz = x * x, y * y, z * z, x * y, x * z, y * z
    return [
        [-(yy + zz), xy - dz, xz + dy],
        [xy + dz, -(xx + zz), yz - dx],
        [xz - dy, yz + dx, -(xx + yy)],
    ]


def _rate_of_momentum(body: Body, A: list[Vector], a: Vector) -> tuple[Vector, Vector]:
    """Return the integrals of the module docstring."""
    S, h, m = body.moments[:3, :3], body.moments[:3, 3], body.moments[3, 3]
    f = [_sum([m, *h], [a[i], *A[i]]) for i in range(3)]
    turning = [
        _sum([*S[j], *-S[k]], [*A[k], *A[j]]) for j, k in ((1, 2), (2, 0), (0, 1))
    ]  # component i of x × (A x), with i, j, k cyclic
    return f, _plus(turning, _cross(h, a))


def _sum(constants: Iterable[float], values: Sequence[Any]) -> Any:
    """Return the sum of products; constants that are 0 or ±1 cost nothing."""
    total: Any = 0.0
    for constant, value in zip(constants, values, strict=True):
        if constant == 1.0:
            total = total + value
        elif constant == -1.0:
            total = total - value
        elif constant != 0.0:
            total = total + float(constant) * value
    return total


def _plus(u: Vector, v: Vector) -> Vector:
    return [a + b for a, b in zip(u, v, strict=True)]


def _rotated(R: Float[Array, "3 3"], v: Vector) -> Vector:
    return [_sum(row, v) for row in R]


def _times(A: list[Vector], p: Float[Array, "3"]) -> Vector:
    return [_sum(p, row) for row in A]


def _cross(p: Float[Array, "3"], v: Vector) -> Vector:
    """Return `p × v` of a constant `p`."""
    return [_sum([p[j], -p[k]], [v[k], v[j]]) for j, k in ((1, 2), (2, 0), (0, 1))]


def _about_z(turn: tuple[Any, Any], v: Vector, way: float) -> Vector:
    """Return `v` turned about z by an angle of given (sin, cos); backwards where `way` is -1."""
    s, c = turn
    x, y, z = v
    if way > 0.0:
        return [c * x - s * y, s * x + c * y, z]
    return [c * x + s * y, c * y - s * x, z]
