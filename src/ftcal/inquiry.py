"""The search for the mistake that explains a log: hypotheses stand against the description.

One sensor's readings, or all of them, are read in another way (`ftcal.hypotheses`), or the masses
of the links are estimated anew; each time the balances of the free parts (`ftcal.misfit`) say what
is left. What has free numbers is judged on blocks of time that did not choose them. Several sensors
may each be wrong in a way of their own: the best hypothesis is taken, and the next looked for
beside it.

The description has the right of the first. A sensor that is merely uncalibrated leaves a misfit of
about 1, spread over all its axes, which no relabelling takes away.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal.bins import KAPPA
from ftcal.hypotheses import (
    AS_DESCRIBED,
    Hypothesis,
    nearest_point,
    nearest_turn,
    reduced_elsewhere,
    signed_axes,
    turned,
)
from ftcal.misfit import INDEPENDENT, LINK_SIZE, Misfit

if TYPE_CHECKING:
    from jaxtyping import Bool, Float
    from numpy import ndarray as Array

MARGIN = 2.0
"""A hypothesis must divide some misfit by this. The error of a bent sensor has 36 entries of equal
size; no relabelling takes away three quarters of their sum of squares."""

TIE = 1.25
"""Misfits nearer than this factor are equal: fifty independent samples tell an RMS to a tenth, and
this is two and a half times that."""

ALARM = 1.0
"""Misfit below which nothing is looked for: that of a sensor bent as usual."""

UNLIKE = 3.0 * KAPPA
"""Masses that change the load by less may be the same robot's: a bent gain looks so."""

STARTS = 3
"""Signed axes from which the search for a rotation begins, best first."""

Masses = Mapping[str, "Float[Array, '4']"]
"""What is added to the mass [kg] and the first moments [kg m] of each link."""


Fitted = Callable[["Float[Array, '36 36']", "Float[Array, '36']"], Hypothesis]
"""The hypothesis that minimises `t'At + 2 b't` in its map."""


@dataclass(frozen=True, slots=True)
class Belief:
    """How the log is read."""

    sensors: Mapping[str, Hypothesis]
    masses: Masses | None = None
    """None: those of the description."""
    instead: tuple[str, ...] = ()
    """Hypotheses that explain as much as the one that was taken last."""

    @property
    def maps(self) -> dict[str, Float[Array, "6 6"]]:
        """What is done to the readings of each sensor."""
        return {name: hypothesis.map for name, hypothesis in self.sensors.items()}


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A next belief, and how it does."""

    belief: Belief
    changed: tuple[str, ...]
    """Sensors read in a new way; all of them where the masses are new."""
    rank: int
    """How far-fetched."""
    words: str
    squares: Float[Array, "P"]
    """Mean square misfit of each part; on held-out blocks where numbers were free."""


@dataclass(frozen=True, slots=True, eq=False)
class Inquiry:
    """The hypotheses, and the parts of the robot that judge them."""

    parts: tuple[Misfit, ...]
    fixed: Mapping[str, tuple[Hypothesis, ...]]
    """Of each sensor, those without free numbers."""

    def described(self) -> Belief:
        """Return the belief that all is as described."""
        return Belief(dict.fromkeys(self.fixed, AS_DESCRIBED))

    def squares(self, belief: Belief, blocks: Iterable[int] | None = None) -> Float[Array, "P"]:
        """Return the mean square misfit of each part."""
        maps, masses = belief.maps, belief.masses
        return np.array([part.square(maps, masses, blocks=blocks) for part in self.parts])

    def borders(self, sensors: Iterable[str]) -> Bool[Array, "P"]:
        """Return which parts have one of `sensors` on their border."""
        some = set(sensors)
        return np.array([bool(some & set(part.sensors)) for part in self.parts])

    def total(self, squares: Float[Array, "P"], where: Bool[Array, "P"] | None = None) -> float:
        """Return the sum of squares of the parts, a sample each `INDEPENDENT` seconds."""
        weighed = squares * [part.seconds / INDEPENDENT for part in self.parts]
        return float(weighed.sum() if where is None else weighed[where].sum())

    def conclude(self) -> tuple[Belief, Candidate | None]:
        """Return what is to be believed, and what would be better still, though not clearly."""
        belief = self.described()
        for _ in self.fixed:
            now = self.squares(belief)
            found = list(self.candidates(belief))
            clear = [c for c in found if self.better(c, now, MARGIN)]
            if not clear or belief.masses is not None:
                break
            belief = self.simplest(clear)
        now = self.squares(belief)
        hints = [c for c in self.candidates(belief) if self.better(c, now, TIE)]
        return belief, min(hints, key=lambda c: (c.rank, self.total(c.squares)), default=None)

    def better(self, candidate: Candidate, now: Float[Array, "P"], margin: float) -> bool:
        """Return whether a hypothesis divides an alarming misfit by `margin` and harms none."""
        where = self.borders(candidate.changed)
        helps = (now > ALARM**2) & (candidate.squares * margin**2 < now)
        harms = candidate.squares > TIE**2 * now
        return bool((helps & where).any() and not (harms & where).any())

    def simplest(self, clear: Iterable[Candidate]) -> Belief:
        """Return the least far-fetched of the hypotheses that explain as much as the best."""
        ordered = sorted(clear, key=lambda c: self.total(c.squares))
        tied = [c for c in ordered if self.as_good(c, ordered[0])]
        first, *others = sorted(tied, key=lambda c: (c.rank, len(c.changed)))
        instead = [c for c in others if c.rank <= first.rank and self.as_good(c, first)]
        words = tuple(c.words for c in instead)
        return Belief(first.belief.sensors, first.belief.masses, words)

    def as_good(self, one: Candidate, other: Candidate) -> bool:
        """Return whether one explains as much as the other of the parts they bear upon."""
        where = self.borders((*one.changed, *other.changed))
        return self.total(one.squares, where) <= TIE**2 * self.total(other.squares, where)

    def candidates(self, belief: Belief) -> Iterator[Candidate]:
        """Yield the hypotheses about each sensor, all sensors, and the masses of the links."""
        yield from self.relabelled(belief)
        for name in self.fixed:
            yield from self.mounted(belief, name)
        yield from self.reweighed(belief)

    def relabelled(self, belief: Belief) -> Iterator[Candidate]:
        """Yield the hypotheses without free numbers."""
        shared: dict[str, dict[str, Hypothesis]] = {}
        for name, hypotheses in self.fixed.items():
            for hypothesis in hypotheses:
                shared.setdefault(hypothesis.words, {})[name] = hypothesis
                yield self.read_as(belief, {name: hypothesis})
        for ways in shared.values():
            if len(ways) == len(self.fixed) > 1:
                yield self.read_as(belief, ways)

    def read_as(self, belief: Belief, ways: Mapping[str, Hypothesis]) -> Candidate:
        """Return the candidate that reads some sensors in other ways."""
        new = Belief({**belief.sensors, **ways}, belief.masses)
        some = next(iter(ways.values()))
        who = "all sensors" if len(ways) == len(self.fixed) > 1 else ", ".join(ways)
        return Candidate(new, tuple(ways), some.rank, f"{who} {some.words}", self.squares(new))

    def mounted(self, belief: Belief, name: str) -> Iterator[Candidate]:
        """Yield the best turn of a sensor's frame, its mirror image, and the best origin."""
        A, b = self.form(belief, name)
        axes = list(signed_axes().values())
        axes.sort(key=lambda Q: _value(A, b, Q))
        for hand in (1.0, -1.0):
            starts = [Q for Q in axes if np.linalg.det(Q) * hand > 0][:STARTS]
            ends = [nearest_turn(A, b, start) for start in starts]
            best = min(ends, key=lambda Q: _value(A, b, Q))
            yield self.held_out(belief, name, _turn_near(best))
        yield self.held_out(belief, name, lambda A, b: reduced_elsewhere(nearest_point(A, b)))

    def form(
        self, belief: Belief, name: str, held: int | None = None
    ) -> tuple[Float[Array, "36 36"], Float[Array, "36"]]:
        """Return A and b of the sum of squares `t'At + 2 b't` in the map of one sensor.

        Without the block of time that is held out.
        """
        A, b = np.zeros((36, 36)), np.zeros(36)
        for part in self.parts:
            if name in part.sensors:
                v, own = part.coefficients(belief.maps, belief.masses), part.entries(name)
                v[own] = 0.0
                gram = part.without(held) * part.seconds
                A += gram[own, own]
                b += gram[own] @ v
        return A, b

    def held_out(
        self,
        belief: Belief,
        name: str,
        fitted: Fitted,
    ) -> Candidate:
        """Return a hypothesis with free numbers, each block judged by what the others fitted."""
        squares = np.zeros(len(self.parts))
        for block in {block for part in self.parts for block in part.grams}:
            other = fitted(*self.form(belief, name, block))
            squares += self.read_squares(belief, {name: other}, block)
        chosen = fitted(*self.form(belief, name))
        new = Belief({**belief.sensors, name: chosen}, belief.masses)
        return Candidate(new, (name,), chosen.rank, f"{name} {chosen.words}", squares)

    def read_squares(
        self, belief: Belief, ways: Mapping[str, Hypothesis], block: int
    ) -> Float[Array, "P"]:
        """Return the squares of one block with some sensors read in other ways."""
        return self.squares(Belief({**belief.sensors, **ways}, belief.masses), [block])

    def reweighed(self, belief: Belief) -> Iterator[Candidate]:
        """Yield the hypothesis that the links have other masses, if those are another robot's."""
        squares = np.zeros(len(self.parts))
        for block in {block for part in self.parts for block in part.grams}:
            other = Belief(belief.sensors, self.masses(belief, block))
            squares += self.squares(other, [block])
        added = self.masses(belief)
        if any(part.unlike(added) > UNLIKE for part in self.parts):
            new = Belief(belief.sensors, added)
            yield Candidate(new, tuple(self.fixed), 9, "other masses", squares)

    def masses(self, belief: Belief, held: int | None = None) -> dict[str, Float[Array, "4"]]:
        """Return what added to the links explains most, each link's own size its prior spread."""
        size = {name: mass for part in self.parts for name, mass in part.links.items()}
        place = {name: slice(4 * k, 4 * k + 4) for k, name in enumerate(size)}
        spread = np.concatenate(
            [mass * np.array([1.0, *3 * [LINK_SIZE]]) for mass in size.values()]
        )
        A, b = np.diag(spread**-2.0), np.zeros(len(spread))
        for part in self.parts:
            v, own = part.coefficients(belief.maps), part.inertial
            where = np.concatenate(
                [np.r_[place[name]] for name in part.links] or [np.empty(0, int)]
            )
            # six equations an independent sample
            gram = part.without(held) * (6.0 * part.seconds / INDEPENDENT)
            A[np.ix_(where, where)] += gram[own, own]
            b[where] += gram[own] @ v
        added = np.linalg.solve(A, b)
        return {name: added[rows] for name, rows in place.items()}


def _value(A: Float[Array, "36 36"], b: Float[Array, "36"], Q: Float[Array, "3 3"]) -> float:
    t = np.kron(np.eye(2), Q).ravel()
    return float(t @ A @ t + 2.0 * b @ t)


def _turn_near(start: Float[Array, "3 3"]) -> Fitted:
    """Return the search for a turn of a frame from `start`."""
    return lambda A, b: turned(nearest_turn(A, b, start))
