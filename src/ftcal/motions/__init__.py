"""Invented motions for any robot: where to move so that a sensor feels something.

All are minimum-jerk moves from rest to rest between waypoints (`ftcal.trajectory`): position,
velocity and acceleration are continuous and known exactly at any time. They keep joint limits,
speed limits and a bound on the acceleration; with a sole, balance too. They know nothing of
self-collision: look at a motion in a simulator before a robot runs it.
"""

from __future__ import annotations

from ftcal.limits import Pace
from ftcal.motions.balancing import balancing, extended_balancing
from ftcal.motions.feet import Leg
from ftcal.motions.grid import grid
from ftcal.motions.switching import Walk, switching
from ftcal.posture import Sole, balance_margin
from ftcal.trajectory import MinimumJerk, Trajectory

__all__ = [
    "Leg",
    "MinimumJerk",
    "Pace",
    "Sole",
    "Trajectory",
    "Walk",
    "balance_margin",
    "balancing",
    "extended_balancing",
    "grid",
    "switching",
]
