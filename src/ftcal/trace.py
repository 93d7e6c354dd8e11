"""Arithmetic that writes itself down: run a formula on `Value`s, keep the straight-line program.

Constants fold, products with 0 and ±1 and sums with 0 vanish, equal expressions are one node, and
minus signs move outwards until an addition swallows them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Union

Number = Union["Value", float]
"""What a traced formula computes with; constants stay Python floats."""


@dataclass(frozen=True, slots=True, eq=False)
class Value:
    """One number of the program."""

    trace: Trace
    """The program it belongs to."""
    id: int
    """Index of its node."""

    def __add__(self, other: Number) -> Number:
        return self.trace.add(self, other)

    def __radd__(self, other: Number) -> Number:
        return self.trace.add(other, self)

    def __sub__(self, other: Number) -> Number:
        return self.trace.add(self, self.trace.negated(other))

    def __rsub__(self, other: Number) -> Number:
        return self.trace.add(other, self.trace.negated(self))

    def __mul__(self, other: Number) -> Number:
        return self.trace.multiply(self, other)

    def __rmul__(self, other: Number) -> Number:
        return self.trace.multiply(other, self)

    def __neg__(self) -> Number:
        return self.trace.negated(self)


@dataclass(frozen=True, slots=True)
class Node:
    """An operation on earlier nodes (by index) and constants."""

    kind: str
    """input, add, sub, mul, neg, sin, cos; shift and scale have a constant second operand."""
    operands: tuple[int | float, ...]
    """Indices (int) and constants (float); for an input its number."""
    section: int
    """Part of the program in which it was first needed."""


@dataclass(slots=True, eq=False)
class Trace:
    """The program so far."""

    nodes: list[Node] = field(default_factory=list)
    """In an order in which operands come first."""
    section: int = 0
    """Part that new nodes join."""
    _known: dict[tuple[str, tuple[int | float, ...]], Value] = field(default_factory=dict)

    def next_section(self) -> None:
        """Start another part: sections become separate functions."""
        self.section += 1

    def input(self, number: int) -> Value:
        """Return the input of that number."""
        return self._node("input", number)

    def sin_cos(self, angle: Number) -> tuple[Number, Number]:
        """Return sine and cosine [rad]."""
        if not isinstance(angle, Value):
            return math.sin(angle), math.cos(angle)
        return self._node("sin", angle.id), self._node("cos", angle.id)

    def add(self, a: Number, b: Number) -> Number:
        """Return `a + b`."""
        if not isinstance(a, Value):
            a, b = b, a
        if not isinstance(a, Value):
            return a + b
        if not isinstance(b, Value):
            return a if b == 0.0 else self._node("shift", a.id, b)
        minus_a, minus_b = self._inside(a), self._inside(b)
        if minus_a is not None and minus_b is not None:
            return self.negated(self.add(minus_a, minus_b))
        if minus_b is not None:
            return 0.0 if minus_b is a else self._node("sub", a.id, minus_b.id)
        if minus_a is not None:
            return 0.0 if minus_a is b else self._node("sub", b.id, minus_a.id)
        return self._node("add", *sorted((a.id, b.id)))

    def multiply(self, a: Number, b: Number) -> Number:
        """Return `a b`."""
        if not isinstance(a, Value):
            a, b = b, a
        if not isinstance(a, Value):
            return a * b
        inside = self._inside(a)
        if inside is not None:
            return self.negated(self.multiply(inside, b))
        if not isinstance(b, Value):
            if b < 0.0:
                return self.negated(self.multiply(a, -b))
            return 0.0 if b == 0.0 else a if b == 1.0 else self._node("scale", a.id, b)
        inside = self._inside(b)
        if inside is not None:
            return self.negated(self.multiply(a, inside))
        return self._node("mul", *sorted((a.id, b.id)))

    def negated(self, a: Number) -> Number:
        """Return `-a`."""
        if not isinstance(a, Value):
            return -a
        node = self.nodes[a.id]
        if node.kind == "sub":
            return self._node("sub", *reversed(node.operands))
        inside = self._inside(a)
        return self._node("neg", a.id) if inside is None else inside

    def _inside(self, a: Value) -> Value | None:
        """Return x where `a` is -x."""
        node = self.nodes[a.id]
        if node.kind != "neg":
            return None
        inner = self.nodes[int(node.operands[0])]
        return self._known[inner.kind, inner.operands]

    def _node(self, kind: str, *operands: int | float) -> Value:
        key = (kind, operands)
        if key not in self._known:
            self._known[key] = Value(self, len(self.nodes))
            self.nodes.append(Node(kind, operands, self.section))
        return self._known[key]

    def needed(self, outputs: list[Number]) -> list[bool]:
        """Return for each node whether some output depends on it."""
        alive = [False] * len(self.nodes)
        for value in outputs:
            if isinstance(value, Value):
                alive[value.id] = True
        for index in range(len(self.nodes) - 1, -1, -1):
            node = self.nodes[index]
            if alive[index] and node.kind != "input":
                for operand in node.operands:
                    if isinstance(operand, int):
                        alive[operand] = True
        return alive
