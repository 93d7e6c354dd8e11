"""Balances that take on what is believed of the model, with a column for all that is suspected.

What `all_sensors.balanced` is to a job that suspects nothing. A joint zero is put into the log, so
that transforms and h follow; all else is linear in h, and added to it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ftcal.all_sensors import WholeBody
from ftcal.balanced_take import BalancedTake
from ftcal.bench import Bench
from ftcal.config import Job, RecordingSection
from ftcal.pairing import FtChannel
from ftcal.recording import Finding, Recording
from ftcal.robot import Robot
from ftcal.suspects import Changes, Suspect, shifted


@dataclass(frozen=True, slots=True, eq=False)
class Suspicion:
    """Balances with a column for everything suspected: what `all_sensors.balanced` is without."""

    suspects: tuple[Suspect, ...]
    believed: Mapping[str, float]
    """What the balances take on already, by error, in its standard deviations; the others none."""
    fit: WholeBody
    """Its laws give the readings."""

    def balanced(
        self,
        job: Job,
        robot: Robot,
        channels: Sequence[FtChannel],
        section: RecordingSection,
        recording: Recording,
        findings: Sequence[Finding],
    ) -> BalancedTake:
        """Return the balances of one recording; arguments and errors are those of `balanced`."""
        zeros = dict(self._zeros())
        log = shifted(recording, zeros) if zeros else recording
        bench = Bench(job, robot, channels, section, log, findings, self.fit)
        columns: Changes = {}
        in_the_log = {name for suspect in self.suspects for name in suspect.zeros.values()}
        for suspect in self.suspects:
            columns |= suspect.changes(bench)
        found = []
        for one in bench.take.balances:
            mine = {name: by_model[one.sub_model] for name, by_model in columns.items()}
            required = one.required - sum(
                (self.believed.get(name, 0.0) * change for name, change in mine.items()
                 if name not in in_the_log),
                np.zeros_like(one.required),
            )  # fmt: skip
            taken = {name: self.believed[name] for name in mine if name in self.believed}
            found.append(replace(one, required=required, model_errors=mine, taken_on=taken))
        return replace(bench.take, balances=tuple(found))

    def _zeros(self) -> Iterator[tuple[str, float]]:
        """Yield the joints whose zero is believed to be off, with the angle to add [rad]."""
        for suspect in self.suspects:
            sd = {error.name: error.sd for error in suspect.errors}
            for joint, name in suspect.zeros.items():
                if name in self.believed:
                    yield joint, sd[name] * self.believed[name]
