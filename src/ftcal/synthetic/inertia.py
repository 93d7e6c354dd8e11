"""A robot whose links weigh a little other than its description says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ftcal.robot import Link, Robot


def perturbed(
    robot: Robot, generator: np.random.Generator, *, mass: float = 0.0, com: float = 0.0
) -> Robot:
    """Return `robot` with other masses and centres of mass, its geometry and its digest kept.

    Masses are multiplied by `exp(mass z)`, and inertias with them: both stay positive. Each
    coordinate of a centre of mass moves by `com z` [m]; z is standard normal. Without either it is
    `robot` itself, for which compiled code is kept.
    """
    if not (mass or com):
        return robot

    def changed(link: Link) -> Link:
        factor = float(np.exp(mass * generator.normal()))
        moved = link.com + com * generator.normal(size=3)
        return replace(link, mass=factor * link.mass, com=moved, inertia=factor * link.inertia)

    links = {name: changed(link) for name, link in robot.links.items()}
    return replace(robot, links=links)
