"""Plateaus: a channel rests at an extreme of its own, as a clipped one does.

A quiet quantised channel also rests, but not at an extreme that it meets five times as often as the
value next to it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ftcal.blocks import Block
from ftcal.stretches import NONE, Runs, stretches_of

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray as Array

PLATEAU_VALUES = 50
"""Distinct values a channel must show before its extreme can be called a plateau."""

OFTEN = 5
"""Times by which the extreme is met more often than the value next to it."""

SOME = 64
"""Step between the samples of a block that give a first idea of its channel."""


@dataclass(slots=True)
class _Bottom:
    """The least value of a channel, the one next to it, and where the channel rests at the least.

    Both are known exactly after every block: of all samples the two least are among the two least
    of any part that holds them.
    """

    least: int
    """Samples of the shortest rest."""
    times: dict[float, int] = field(default_factory=dict)
    """The two least values → samples."""
    runs: Runs = field(init=False)

    def __post_init__(self) -> None:
        self.runs = Runs(self.least)

    def see(self, block: Block, channel: Float[Array, "M"], bound: float) -> None:
        """Take note of the samples of a block of its own, whose two least are within `bound`."""
        places = np.flatnonzero(channel <= min(bound, self.above))
        places = places[np.isfinite(channel[places])]
        if not len(places):
            return
        values = channel[places]
        lowest, known = float(values.min()), min(self.times, default=np.inf)
        higher = values[values > lowest]
        met = {lowest: len(values) - len(higher)}
        if len(higher):
            second = float(higher.min())
            met[second] = int(np.count_nonzero(higher == second))
        two = sorted({*self.times, *met})[:2]
        self.times = {value: self.times.get(value, 0) + met.get(value, 0) for value in two}
        if lowest < known:
            self.runs = Runs(self.least)
        if lowest <= known:
            resting = places[values == lowest] + block.before
            at_border = resting[0] == block.before or resting[-1] == len(block.stamps) - 1
            # too few, and none of them may grow into the next block
            if at_border or len(resting) >= self.least:
                self.runs.add(stretches_of(block, resting))

    @property
    def above(self) -> float:
        """A value above which nothing is news; infinity while there are not two."""
        return max(self.times) if len(self.times) > 1 else np.inf

    def stretches(self) -> Int[Array, "S 4"]:
        """Return where the channel rests at its least value, if that is a plateau."""
        own, near = (self.times[value] for value in sorted(self.times))
        return self.runs.stretches() if own >= self.least and own > OFTEN * near else NONE


@dataclass(slots=True)
class Plateaus:
    """The extremes of every channel of a signal."""

    least: int
    """Samples of the shortest rest."""
    channels: int
    distinct: list[Float[Array, "D"]] = field(init=False)
    """Values of each channel, while they are fewer than `PLATEAU_VALUES`."""
    bottoms: list[_Bottom] = field(init=False)
    """Of all channels, then of all channels upside down."""
    above: Float[Array, "2K"] = field(init=False)
    """Values above which a block has no news for them."""

    def __post_init__(self) -> None:
        self.distinct = [np.empty(0) for _ in range(self.channels)]
        self.bottoms = [_Bottom(self.least) for _ in range(2 * self.channels)]
        self.above = np.full(2 * self.channels, np.inf)

    def see(self, block: Block, low: Float[Array, "K"], high: Float[Array, "K"]) -> None:
        """Take note of a block; `low` and `high` are the extremes of its own samples, or NaN."""
        for k, known in enumerate(self.distinct):
            if len(known) < PLATEAU_VALUES and not (low[k] == high[k] and low[k] in known):
                self.distinct[k] = _more(known, block.own[k])
        news = ~(np.concatenate([low, -high]) > self.above)  # NaN: some sample may be finite
        if not news.any():
            return
        few = block.own[:, ::SOME]
        bounds = np.concatenate([_second(few), _second(-few)])
        for i in np.flatnonzero(news):
            channel = block.own[i % self.channels]
            self.bottoms[i].see(block, channel if i < self.channels else -channel, bounds[i])
            self.above[i] = self.bottoms[i].above

    def stretches(self) -> Int[Array, "S 4"]:
        """Return where a channel is clipped; those of different channels overlap."""
        rich = [len(distinct) == PLATEAU_VALUES for distinct in self.distinct]
        found = [b.stretches() for b, some in zip(self.bottoms, rich * 2, strict=True) if some]
        return np.concatenate([NONE, *found])


def _second(few: Float[Array, "K M"]) -> Float[Array, "K"]:
    """Return the second least value of every channel; infinity where there is none or doubt.

    The two least of a block are no more than the two least of a few of its samples.
    """
    higher = few > few.min(axis=1, keepdims=True)
    second = np.where(higher, few, np.inf).min(axis=1)
    return np.where(np.isfinite(few).all(axis=1), second, np.inf)


def _more(known: Float[Array, "D"], channel: Float[Array, "M"]) -> Float[Array, "E"]:
    """Return the distinct values with those of a channel, up to `PLATEAU_VALUES` of them."""
    for samples in (channel[::SOME], channel):  # a lively channel shows enough in a few
        if len(known) < PLATEAU_VALUES:
            known = np.union1d(known, samples[np.isfinite(samples)])
    return known[:PLATEAU_VALUES]
