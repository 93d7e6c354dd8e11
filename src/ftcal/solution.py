"""What a fit of all sensors says, by name: the E of every sensor, the inertia, and the offsets.

Offsets change from recording to recording. In one that was not trained on they are fitted anew, all
else held: what is judged there is the matrices.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ftcal.law import Law
from ftcal.terms import MODEL, Frame, Segment, Terms
from ftcal.unknowns import Group, GroupNoise, Normal, Unknowns, offsets_alone
from ftcal.whole_body import FIRST_MEMORY, FIRST_SD

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """The unknowns of a fit by name."""

    entries: dict[str, Float[Array, "6 P"]]
    """E of every sensor, fractions of full scale."""
    inertia: dict[str, Float[Array, "4"]]
    """Mass and centre of mass of every sub-model, in standard deviations of their prior."""
    offsets: dict[tuple[str, Segment], Float[Array, "6"]]
    """Offset o' of every sensor and segment, fractions of full scale."""

    @staticmethod
    def of(unknowns: Unknowns, theta: Float[Array, "U"]) -> Solution:
        """Return what a vector of unknowns stands for."""
        return Solution(
            {name: theta[place].reshape(6, -1) for name, place in unknowns.entries.items()},
            {name: theta[unknowns.model(name)] for name in unknowns.models},
            {key: theta[place] for key, place in unknowns.places.items()},
        )

    def completed(
        self,
        terms: Sequence[Terms],
        frames: Mapping[str, Frame],
        noise: Mapping[Group, GroupNoise],
    ) -> Solution:
        """Return the solution with the offsets that `terms` need and it lacks, fitted to them."""
        lacking = [
            one
            for one in terms
            if any(k not in self.offsets for k in zip(one.sensors, one.segments, strict=True))
            and set(one.sensors) <= self.entries.keys()
        ]
        if not lacking:
            return self
        unknowns = Unknowns.of(lacking, frames)
        normal = Normal.of(lacking, unknowns)
        theta = np.zeros(unknowns.count)
        for name, place in unknowns.entries.items():
            theta[place] = self.entries[name].ravel()
        for name in unknowns.models:
            theta[unknowns.model(name)] = self.inertia.get(name, np.zeros(MODEL))
        for key in unknowns.places.keys() & self.offsets.keys():
            theta[unknowns.places[key]] = self.offsets[key]
        usual = {g: noise.get(g, GroupNoise(FIRST_SD[g[1] == "torque"], FIRST_MEMORY))
                 for g in normal.products}  # fmt: skip
        found = Solution.of(unknowns, offsets_alone(normal, usual, theta, self.offsets))
        return replace(self, offsets={**self.offsets, **found.offsets})

    def law(self, sensor: str, frame: Frame, segment: Segment, reference: Float[Array, "P"]) -> Law:
        """Return the law of a sensor in a segment of a recording; `reference` is r0."""
        C = frame.coefficients(self.entries[sensor])
        o = frame.workbench.full_scale * self.offsets[sensor, segment]
        return Law(C, o - C @ reference)
