"""Random postures one after the other, from home and back to it, each move within all limits."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from ftcal.errors import DataError
from ftcal.limits import Pace, least_time
from ftcal.robot import Robot
from ftcal.trajectory import MinimumJerk

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

REST = 1.0
"""Stillness at both ends of every motion [s]: what a smoothing window eats."""

TRIES = 300
"""Draws in a row that cannot be used before a motion is given up."""

Place = Callable[
    ["Float[Array, 'J']", "Float[Array, 'J']", "Float[Array, 'J']"], "Float[Array, 'J'] | None"
]
"""What a robot makes of a drawn posture, coming from the one before, home as it is: the posture it
takes, or None where it cannot, or not get there or home from there."""


def anywhere(
    drawn: Float[Array, "J"], before: Float[Array, "J"], home: Float[Array, "J"]
) -> Float[Array, "J"]:
    """Return the drawn posture: of a robot whose balance is not looked after."""
    return drawn


def wander(
    robot: Robot,
    box: Mapping[str, tuple[float, float]],
    posture: Float[Array, "J"],
    *,
    generator: np.random.Generator,
    duration: float,
    pace: Pace,
    place: Place = anywhere,
) -> MinimumJerk:
    """Return moves between random postures inside `box`, from `posture` and back to it.

    Each is put where `place` says, or drawn again. Raises `DataError` where the duration [s] is too
    short for a single move, or none of `TRIES` draws in a row can be used.
    """
    columns = [robot.moving_joints.index(name) for name in box]
    low, high = np.array(list(box.values())).reshape(-1, 2).T
    times, nodes, tries = [0.0, REST], [posture, posture], 0
    while True:
        drawn = posture.copy()
        drawn[columns] = generator.uniform(low, high)
        node = place(drawn, nodes[-1], posture)
        if node is None:
            tries += 1
            if tries == TRIES:
                raise DataError(
                    f"none of {TRIES} postures drawn about home can be reached in balance and above"
                    " the floor; take a smaller reach or another home"
                )
            continue
        tries = 0
        least = least_time(robot, node - nodes[-1], pace)
        # not always flat out: several speeds tell momentum from weight
        arrival = times[-1] + least * generator.uniform(1.0, 1.8)
        if arrival + least_time(robot, posture - node, pace) + REST > duration:
            break
        times.append(arrival)
        nodes.append(node)
    if len(nodes) == 2:
        raise DataError(f"{duration:g} s are too short for one move there and back; take longer")
    times += [duration - REST, duration]
    nodes += [posture, posture]
    return MinimumJerk(robot.moving_joints, np.array(times), np.array(nodes))
