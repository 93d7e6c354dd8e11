"""The momentum balance as machine code, run in vectors on arrays of any layout.

Traced once (`ftcal.trace`), written as LLVM IR (`ftcal.program`, `ftcal.tiles`), compiled
(`ftcal.jit`). A kernel knows nothing of robots but its `Tree`; `ftcal.dynamics` keeps kernels.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal import jit
from ftcal.newton_euler import arguments, wrenches
from ftcal.program import Program
from ftcal.tiles import BLOCK_HEAD, ROW
from ftcal.trace import Number, Trace
from ftcal.tree import Tree

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray as Array


@dataclass(frozen=True, slots=True, eq=False)
class WrenchKernel:
    """Compiled wrenches of some sensors; safe to call from several threads."""

    outputs: int
    """Sensors whose wrench it returns."""
    rows: int
    """Rows of scratch it needs."""
    sections: int
    """Functions that take turns on a tile."""
    width: int
    """Samples of a vector."""
    module: jit.Module
    """The machine code."""

    def __call__(
        self, columns: Sequence[Float[Array, "N"]], count: int
    ) -> list[Float[Array, "N 6"]]:
        """Return the wrenches for `count` samples of float64 signals of any stride."""
        results = [np.empty((count, 6)) for _ in range(self.outputs)]
        scratch = np.zeros((self.rows + 1) * ROW + 8)
        aligned = -(-scratch.ctypes.data // 64) * 64
        # `.ctypes.data` costs a microsecond a column
        places = [(c.strides[0], c.__array_interface__["data"][0]) for c in columns]
        blocks = _blocks(places, self.rows * ROW, self.width)
        ahead = _ahead(places, self.sections)
        targets = np.array([result.ctypes.data for result in results], dtype=np.int64)
        run = self.module.function("wrenches", *[ctypes.c_int64] * 6)
        tables = (blocks.ctypes.data, blocks.size, targets.ctypes.data)
        run(*tables, aligned, ahead.ctypes.data, count)
        return results


def compile_wrenches(tree: Tree, gravity: Sequence[float] | None) -> WrenchKernel:
    """Return the kernel of all sensors of `tree`; `gravity` None where the contact moves."""
    trace = Trace()
    inputs = 3 * len(tree.joints) + (9 if gravity is None else 0)
    base, joints = arguments(tree, gravity, [trace.input(k) for k in range(inputs)])
    readings = wrenches(tree, base, joints, trace.sin_cos, trace.next_section)
    outputs: list[Number] = [number for reading in readings for number in reading]
    program = Program(trace, outputs, jit.vector_width())
    module = jit.compile_ir(program.text())
    return WrenchKernel(len(readings), program.rows, len(program.sections), program.width, module)


def _blocks(places: Sequence[tuple[int, int]], spare: int, width: int) -> Int[Array, "B words"]:
    """Return what is copied together: signals (stride, address) that lie within `width` numbers.

    A row says address, stride, numbers to read, and where in the scratch each goes; numbers
    between two signals that nobody asked for go to a `spare` row.
    """
    blocks: list[list[int]] = []
    order = sorted((*place, k) for k, place in enumerate(places))
    for stride, source, k in order:
        lane = (source - blocks[-1][0]) // 8 if blocks and blocks[-1][1] == stride else width
        if lane >= width or (source - blocks[-1][0]) % 8 or blocks[-1][BLOCK_HEAD + lane] != spare:
            blocks.append([source, stride, 0, *[spare] * width])
            lane = 0
        blocks[-1][2] = lane + 1
        blocks[-1][BLOCK_HEAD + lane] = k * ROW
    return np.array(blocks, dtype=np.int64)


def _ahead(places: Sequence[tuple[int, int]], sections: int) -> Int[Array, "words"]:
    """Return what each section asks the memory for while it works: lines of the next tile.

    First `sections + 1` bounds, then pairs (address, stride): one for each 64 bytes in a row of
    samples, not one for each signal. Counted in words from the start of the table.
    """
    lines: list[tuple[int, int]] = []
    for stride, source in sorted(places):
        if not lines or lines[-1][1] != stride or source // 64 != lines[-1][0] // 64:
            lines.append((source, stride))
    start = sections + 1
    bounds = [start + 2 * (len(lines) * k // sections) for k in range(sections + 1)]
    return np.array([*bounds, *(word for line in lines for word in line)], dtype=np.int64)
