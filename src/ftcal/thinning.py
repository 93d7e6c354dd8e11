"""Every so-manieth row of a table that passes by: the first, and then at equal steps.

What is kept does not depend on how many rows come at a time: where room runs out, every other row
is let go.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array


@dataclass(slots=True, eq=False)
class Thinning:
    """Rows of D columns."""

    most: int
    """Kept at most."""
    count: int = 0
    """Rows that passed."""
    step: int = 1
    """One in so many is kept."""
    kept: list[Float[Array, "M D"]] = field(default_factory=list)

    def add(self, *columns: Float[Array, "N ..."]) -> None:
        """Take in the next rows, given as some of their columns each."""
        some = slice(-self.count % self.step, None, self.step)
        # a copy: a view would keep alive all that came with it
        self.kept.append(np.column_stack([part[some] for part in columns]))
        self.count += len(columns[0])
        if sum(map(len, self.kept)) > self.most + self.most // 4:
            self.kept = [self.rows()]

    def rows(self) -> Float[Array, "M D"]:
        """Return what is kept; `ValueError` before the first rows."""
        rows = self.kept[0] if len(self.kept) == 1 else np.concatenate(self.kept)
        while len(rows) > self.most:
            rows, self.step = rows[::2], 2 * self.step
        self.kept = [np.ascontiguousarray(rows)]
        return self.kept[0]


def thinning_step(count: int, most: int) -> int:
    """Return the least power of two that leaves `most` of `count` rows at most."""
    step = 1
    while -(-count // step) > most:
        step *= 2
    return step
