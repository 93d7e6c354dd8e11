"""The robot on its own scales: what the sensors above whoever touches the world say that it weighs.

The forces on the borders of all untouched sub-models together carry the weight of what is untouched
(readings between two of them cancel); with the links that touch it is the whole robot.
Accelerations are taken to average out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ftcal.balances import Balance, free_sub_models
from ftcal.law import Law
from ftcal.robot import Robot

GRAVITY = 9.80665
"""Size of the gravity acceleration [m/s^2] (BIPM, standard acceleration)."""

LIGHTEST = 0.5
"""Share of the robot's mass that must be untouched for a weighing to be one."""


@dataclass(frozen=True, slots=True)
class Weighing:
    """The mass of the robot as read in one stretch of a recording."""

    recording: str
    start: float
    """Seconds since the start of the recording."""
    stop: float
    """Seconds since the start of the recording, exclusive."""
    touching: tuple[str, ...]
    """Links that touched the world."""
    model: float
    """Mass of the robot description [kg]."""
    workbench: float
    """Mass read with the Workbench matrices [kg]."""
    whole_body: float
    """Mass read with the new ones [kg]."""


def weighed(
    robot: Robot,
    sensors: Sequence[str],
    touching: Sequence[str],
    parts: Sequence[Balance],
    laws: Mapping[str, Law],
) -> float | None:
    """Return the mass of the robot [kg] as `laws` read it in `parts`, balances of one stretch.

    None where too little is untouched, or a balance of an untouched sub-model is missing.
    """
    by_name = {part.sub_model: part for part in parts}
    free = free_sub_models(robot, sensors, touching)
    mass = {m.name: sum(robot.links[link].mass for link in m.links) for m in free}
    if sum(mass.values()) < LIGHTEST * robot.mass or not mass.keys() <= by_name.keys():
        return None
    carried = 0.0
    for name in mass:
        part = by_name[name]
        readings = {s: laws[s].read(inputs) for s, inputs in part.inputs.items()}
        up = part.required[:, :3] / np.linalg.norm(part.required[:, :3], axis=1)[:, None]
        total = (part.residual(readings) + part.required)[:, :3]
        carried += float(np.einsum("ni,ni->n", total, up).mean()) / GRAVITY
    return robot.mass - sum(mass.values()) + carried
