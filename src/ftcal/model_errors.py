"""Errors of the robot's model as hypotheses: tried one by one, believed where the data say so.

Each `suspects.Suspect` is fitted beside the sensors and beside what is believed already. It is
believed where the evidence grows by more than `DECISIVE`, one of its numbers is `DISTINCT` standard
deviations from zero, and stretches that were left out are not foretold worse. The most probable of
them comes first; the others must then say something beside it. Balances are made anew with what is
believed, and all is asked again until it no longer changes: noise falls, and other zeros of joints
are other balances.

Noise is what the fit left over, with the number of samples that it says are independent: an error
of the model that is not believed yet counts as noise, which errs to the side of no claim.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from ftcal.all_sensors import WholeBody, calibrate_all
from ftcal.config import Job
from ftcal.elimination import INERTIA, Eliminated, inertia_names
from ftcal.pairing import FtChannel
from ftcal.progress import Steps, silent
from ftcal.recording import Finding, Recording
from ftcal.robot import Robot
from ftcal.suspects import ModelError, Suspect, suspects
from ftcal.suspicion import Suspicion
from ftcal.terms import ModelPrior, Terms
from ftcal.unknowns import Normal, Unknowns
from ftcal.whole_body import held_out, robust_weights, stretches_of

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

DECISIVE = 5.0
"""Growth of the log evidence [nats] from which on a suspect is believed."""

DISTINCT = 3.0
"""Standard deviations from zero that one of its numbers must be."""

ROUNDS = 4
"""Times at most that balances are made anew."""

SETTLED = 0.1
"""Change of a number, in its standard deviations, that no longer matters."""

LEAST_SCALE = 0.01
"""Scale of all sensors at least; less is none."""

UNSEEN = 0.99
"""Share of its prior's standard deviation from which on the data say nothing of a number."""

Word = Literal["believed", "no evidence", "always"]
"""What becomes of a suspect."""


ALL_ZEROS = "all joint zeros"
"""Suspected together too: encoders are zeroed one after the other by the same hands."""

MILLI = {"rad": "mrad", "m": "mm", "kg": "g", "kg m": "g m"}
"""Thousandths of the units."""


@dataclass(frozen=True, slots=True)
class Number:
    """One number of the model as the data have it."""

    error: ModelError
    value: float
    """In its unit, as `sd`."""
    sd: float

    def __str__(self) -> str:
        """Return it in thousandths of its unit, to the second digit of its standard deviation."""
        value, sd = 1e3 * self.value, 1e3 * self.sd
        places = max(0, 1 - int(np.floor(np.log10(sd)))) if sd > 0.0 else 0
        unit = MILLI[self.error.unit]
        return f"{value:.{places}f} ± {sd:.{places}f} {unit}"


@dataclass(frozen=True, slots=True)
class Move:
    """The entry of the E of a sensor that moves most with a suspect."""

    sensor: str
    row: int
    column: int
    percent: float
    """Of full scale, where one of its numbers is off by one standard deviation of its prior."""


@dataclass(frozen=True, slots=True)
class Tried:
    """What became of one suspect, beside all that is believed."""

    words: str
    numbers: tuple[Number, ...]
    gain: float
    """Growth of the log evidence by it [nats]."""
    held_out: float
    """Change of the RMS residual of stretches left out, as a share; NaN with fewer than two."""
    moves: tuple[Move, ...]
    """A sensor each, the largest first."""
    word: Word
    rivals: tuple[str, ...]
    """Suspects that explain as well what is explained by this one."""

    @property
    def seen(self) -> bool:
        """Whether the data say anything of it."""
        return any(number.sd < UNSEEN * number.error.sd for number in self.numbers)


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """The numbers of the model after all stretches, and after all but one."""

    all_of_them: Eliminated
    folds: tuple[tuple[tuple[Terms, ...], Eliminated], ...]
    """Stretches left out, and what the others say."""
    fit: WholeBody

    @staticmethod
    def of(terms: Sequence[Terms], fit: WholeBody) -> Trial:
        """Return the trial of all suspects that some terms have columns for."""
        posterior = fit.posterior

        def eliminated(some: Sequence[Terms]) -> Eliminated:
            normal = Normal.of(some, Unknowns.of(some, fit.frames))
            noise = {group: posterior.noise[group] for group in normal.products}
            return Eliminated.of(normal, noise, posterior.kappa)

        stretches = list(stretches_of(terms).values())
        folds = [
            (tuple(held), eliminated([one for one in terms if all(one is not h for h in held)]))
            for held in stretches
            if len(stretches) > 1
        ]
        return Trial(eliminated(terms), tuple(folds), fit)

    def gain(self, free: Sequence[str], beside: Sequence[str]) -> float:
        """Return the growth of the log evidence by numbers `beside` those that are free anyway."""
        return self.all_of_them.gain([*beside, *free]) - self.all_of_them.gain(beside)

    def worse(self, free: Sequence[str], beside: Sequence[str]) -> float:
        """Return the change of the RMS residual of stretches left out, their geometric mean.

        As a share of what the sensors read: a part whose weight is free no longer anchors their
        scale, and all matrices shrunk together leave less.
        """
        found = []
        for held, rest in self.folds:
            new, old = (beyond(rest, some) for some in ([*beside, *free], beside))
            left = [held_out(held, rest.unknowns, theta, self.fit.posterior.noise)
                    for theta in (new, old)]  # fmt: skip
            if min(left) > 0.0:
                shrunk = common_scale(rest.unknowns, new) / common_scale(rest.unknowns, old)
                found.append(0.5 * np.log(left[0] / left[1]) - np.log(shrunk))
        return float(np.expm1(np.mean(found))) if found else float("nan")

    def numbers(self, errors: Sequence[ModelError], beside: Sequence[str]) -> tuple[Number, ...]:
        """Return the numbers of one suspect; those that no balance has stay at their prior."""
        free = list(dict.fromkeys([*beside, *(error.name for error in errors)]))
        free = [name for name in free if name in self.all_of_them.order]
        found, covariance = self.all_of_them.estimate(free)
        known = {n: (v, c**0.5) for n, v, c in zip(free, found, np.diag(covariance), strict=True)}
        return tuple(
            Number(error, *(error.sd * float(x) for x in known.get(error.name, (0.0, 1.0))))
            for error in errors
        )

    def moves(self, errors: Iterable[ModelError], beside: Sequence[str]) -> tuple[Move, ...]:
        """Return the largest move of every sensor, the largest first."""
        found = []
        follows = [self.all_of_them.follows(error.name, beside) for error in errors
                   if error.name in self.all_of_them.order]  # fmt: skip
        for sensor, place in self.all_of_them.unknowns.entries.items():
            size = np.abs([theta[place].reshape(6, -1) for theta in follows]).max(axis=0)
            row, column = np.unravel_index(np.argmax(size), size.shape)
            found.append(Move(sensor, int(row), int(column), 100.0 * float(size.max())))
        return tuple(sorted(found, key=lambda move: -move.percent))


def beyond(rest: Eliminated, free: Sequence[str]) -> Float[Array, "U"]:
    """Return the unknowns as the terms want them: beyond what the balances take on."""
    theta = rest.fitted(free)
    for name, taken in rest.unknowns.model_errors.items():
        theta[rest.unknowns.model_error(name)] -= taken
    return theta


def common_scale(unknowns: Unknowns, theta: Float[Array, "U"]) -> float:
    """Return how much the matrices of all sensors read of what their Workbenches do."""
    bends = [along @ theta / 3**0.5 for _, along in unknowns.scales()]
    return max(1.0 + float(np.mean(bends)), LEAST_SCALE) if bends else 1.0


Accused = Mapping[str, Sequence[ModelError]]
"""Suspects by their words, with their numbers."""


def verdicts(trial: Trial, accused: Accused, always: Accused) -> tuple[Tried, ...]:
    """Return what becomes of every suspect, `always` those that the fit has anyway first.

    Those that no balance trained on knows are left out: the tilt in a recording held out whole.
    """
    accused = {words: errors for words, errors in accused.items()
               if any(error.name in trial.all_of_them.order for error in errors)}  # fmt: skip
    base = [error.name for errors in always.values() for error in errors]
    names = {words: [error.name for error in errors] for words, errors in accused.items()}

    def apart(words: str, beside: Sequence[str]) -> bool:
        new = [error for error in accused[words] if error.name not in beside]
        return distinct(trial.numbers(new, beside))

    believed: dict[str, tuple[str, ...]] = {}
    while True:
        beside = [*base, *(name for words in believed for name in names[words])]
        gains = {words: trial.gain(names[words], beside)
                 for words in accused if words not in believed}  # fmt: skip
        sure = [words for words in sorted(gains, key=lambda w: -gains[w])
                if gains[words] > DECISIVE and apart(words, beside)
                and trial.worse(names[words], beside) <= 0.0]  # fmt: skip
        if not sure:
            break
        best = sure[0]
        after = [*beside, *names[best]]
        believed[best] = tuple(
            words
            for words in gains
            if set(names[words]).isdisjoint(names[best])
            and gains[words] > gains[best] - DECISIVE
            and trial.gain(names[words], after) < DECISIVE
        )
    return tuple(_tried(trial, accused, always, base, believed))


def distinct(numbers: Iterable[Number]) -> bool:
    """Return whether one of some numbers is far from zero."""
    return any(abs(number.value) > DISTINCT * number.sd for number in numbers)


def _tried(
    trial: Trial,
    accused: Accused,
    always: Accused,
    base: Sequence[str],
    believed: Mapping[str, tuple[str, ...]],
) -> Iterator[Tried]:
    """Yield every suspect, each beside all that is free but itself."""
    free = [*base, *(error.name for words in believed for error in accused[words])]
    for words, errors in {**always, **accused}.items():
        own = [error.name for error in errors]
        guilty: Word = "believed" if set(own) <= set(free) else "no evidence"
        beside = [name for name in free if guilty == "no evidence" or name not in own]
        yield Tried(
            words,
            trial.numbers(errors, beside),
            trial.gain(own, beside),
            trial.worse(own, beside),
            trial.moves(errors, beside),
            "always" if words in always else guilty,
            believed.get(words, ()),
        )


def calibrate_suspecting(
    job: Job,
    robot: Robot,
    channels: Sequence[FtChannel],
    recordings: Sequence[Recording],
    findings: Sequence[Sequence[Finding]],
    steps: Steps,
) -> tuple[WholeBody, tuple[Tried, ...]]:
    """Return the fit of all sensors with the errors that are believed, and what was tried.

    Nothing is tried where the job suspects nothing. Raises as `calibrate_all`, and `RobotError`
    for joints and links that are not there.
    """
    accused = suspects(job, robot, recordings)
    fit = calibrate_all(job, robot, channels, recordings, findings, steps)
    if not accused:
        return fit, ()
    model = ModelPrior(mass=job.whole_body.mass, com=job.whole_body.com)
    weight = {one.name: sum(robot.links[link].mass for link in one.links)
              for one in robot.sub_models([channel.sensor for channel in channels])}  # fmt: skip
    always = {f"inertia of {name}": inertia_errors(name, weight[name], model)
              for name in fit.posterior.unknowns.models}  # fmt: skip
    numbers = {one.words: one.errors for one in accused}
    zeros = tuple(error for one in accused if one.zeros for error in one.errors)
    if len(zeros) > 1:
        numbers[ALL_ZEROS] = zeros
    believed: dict[str, float] = {}
    tried: tuple[Tried, ...] = ()
    guilty: tuple[Suspect, ...] = ()
    for _ in range(ROUNDS):
        terms: list[Terms] = []
        for given in zip(job.recordings, recordings, findings, strict=True):
            weights = None
            if job.fit.robust:
                known = Suspicion(guilty, believed, fit).balanced(job, robot, channels, *given)
                known_terms = known.terms(known.train, fit.frames, model)
                weights = robust_weights(known_terms, fit.posterior)
            take = Suspicion(accused, believed, fit).balanced(job, robot, channels, *given)
            terms += take.terms(take.train, fit.frames, model, weights)
        tried = verdicts(Trial.of(terms, fit), numbers, always)
        said = [number for one in tried if one.word == "believed" for number in one.numbers]
        if settled(said, believed):
            break
        believed = {number.error.name: number.value / number.error.sd for number in said}
        guilty = tuple(one for one in accused if one.errors[0].name in believed)
        balancing = Suspicion(guilty, believed, fit).balanced
        fit = calibrate_all(
            job, robot, channels, recordings, findings, Steps(silent, 0), balancing=balancing
        )
    return fit, tried


def settled(said: Sequence[Number], believed: Mapping[str, float]) -> bool:
    """Return whether what the data say is what the balances take on."""
    if {number.error.name for number in said} != set(believed):
        return False
    return all(
        abs(number.value - number.error.sd * believed[number.error.name]) <= SETTLED * number.sd
        for number in said
    )


def inertia_errors(sub_model: str, mass: float, model: ModelPrior) -> tuple[ModelError, ...]:
    """Return mass and centre of mass of a sub-model of some `mass` [kg]: always fitted."""
    sizes = (("kg", mass * model.mass), *[("m", model.com)] * (len(INERTIA) - 1))
    return tuple(
        ModelError(name, *size) for name, size in zip(inertia_names(sub_model), sizes, strict=True)
    )
