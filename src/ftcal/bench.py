"""The balances of one recording, and what they would be of another robot, log or gravity.

On it errors of the model are tried: what the readings of a fit add up to, less h, before and after.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ftcal.all_sensors import WholeBody
from ftcal.balanced_take import BalancedTake, balanced
from ftcal.balances import Balance
from ftcal.config import Job, RecordingSection
from ftcal.pairing import FtChannel
from ftcal.recording import Finding, Recording
from ftcal.robot import Robot

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array


@dataclass(frozen=True, eq=False)
class Bench:
    """One recording on which suspects are tried."""

    job: Job
    robot: Robot
    channels: Sequence[FtChannel]
    section: RecordingSection
    recording: Recording
    """The log, joint zeros corrected by what is believed of them."""
    findings: Sequence[Finding]
    fit: WholeBody
    """Its laws give the readings."""

    @cached_property
    def take(self) -> BalancedTake:
        """The balances as the model is believed."""
        return balanced(
            self.job, self.robot, self.channels, self.section, self.recording, self.findings
        )

    @cached_property
    def sums(self) -> dict[str, Float[Array, "N 6"]]:
        """By sub-model: what its readings add up to, less h [N, Nm]."""
        return self._sums(self.take)

    def sums_with(
        self,
        *,
        robot: Robot | None = None,
        section: RecordingSection | None = None,
        recording: Recording | None = None,
    ) -> dict[str, Float[Array, "N 6"]]:
        """Return `sums` of another robot, under another gravity or with another log of joints."""
        return self._sums(
            balanced(
                self.job,
                robot or self.robot,
                self.channels,
                section or self.section,
                recording or self.recording,
                self.findings,
            )
        )

    def _sums(self, take: BalancedTake) -> dict[str, Float[Array, "N 6"]]:
        return {one.sub_model: one.residual(self._read(take, one)) for one in take.balances}

    def _read(self, take: BalancedTake, balance: Balance) -> dict[str, Float[Array, "N 6"]]:
        """Return what every sensor reads; nothing where its offset is not known."""
        solution, found = self.fit.whole_body, {}
        for name, inputs in balance.inputs.items():
            found[name] = np.zeros((len(inputs), 6))
            for segment in take.segments[name]:
                if (name, segment) in solution.offsets:
                    first, last = np.searchsorted(balance.time, [segment.start, segment.stop])
                    law = solution.law(name, self.fit.frames[name], segment, take.references[name])
                    found[name][first:last] = law.read(inputs[first:last])
        return found
