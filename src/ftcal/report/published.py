"""What the paper printed: its Tables I, II and III, digit by digit, of the right leg of one iCub.

Here are numbers to look at beside one's own, nothing else: they are of other recordings of a real
robot. Some cells of Table I read like fractions in a table of percent; they stand as printed.
"""

from __future__ import annotations

from collections.abc import Iterable

DATA_SETS = (
    "Balancing",
    "gridMin30",
    "gridMin45",
    "ExtBal1",
    "ExtBal2",
    "fastExtBal",
    "fastExtBal2",
)
"""Data sets in the paper's order."""

ALSO = {"fastExtBal1": "fastExtBal"}
"""Second name of a data set: the caption of the paper's first figure of results has it so."""

PERCENT = {
    "Balancing": (17.29, 110.38, 103.37, 55.09, 57.53, 0.4977, 0.5813),
    "gridMin30": (464.82, 13.19, 18.29, 25.13, 23.69, 0.3311, 0.2426),
    "gridMin45": (532.59, 12.94, 10.99, 22.47, 25.42, 29.68, 25.61),
    "ExtBal1": (102.50, 39.84, 30.20, 25.88, 23.48, 34.70, 25.81),
    "ExtBal2": (128.64, 33.03, 28.02, 28.25, 26.83, 35.26, 25.76),
    "fastExtBal": (107.44, 43.51, 31.65, 28.00, 26.14, 36.57, 26.55),
    "fastExtBal2": (118.52, 33.18, 29.80, 27.87, 24.45, 34.94, 27.34),
}
"""Table I: error [% of the Workbench] on a data set (key) of the matrix of each of `DATA_SETS`."""

MISPRINT = 1.0
"""Percent below which a cell of Table I is a fraction by its looks: all others are above 10."""

LAMBDAS = (0.5, 1.0, 1.5, 2.0, 4.0, 6.0, 8.0, 10.0)
"""Penalties of Table II."""

WORKBENCH_FORCE = 31.3111
"""Table II, row Workbench [N]."""

FORCE = {
    "ExtBal1": (30.7219, 30.7553, 30.7218, 30.7498, 30.7285, 30.7670, 30.7593, 30.7847),
    "ExtBal2": (33.5694, 33.5650, 33.5620, 33.5504, 33.5609, 33.5823, 33.5533, 33.5698),
    "fastExtBal2": (33.8062, 33.8423, 33.8398, 33.8469, 33.8275, 33.8646, 33.8530, 33.8441),
    "gridMin30": (23.5073, 23.5635, 23.6338, 23.7039, 23.9476, 24.1988, 24.4084, 24.6439),
    "gridMin45": (24.2435, 24.2729, 24.3017, 24.3390, 24.4010, 24.4761, 24.5821, 24.6940),
}
"""Table II: mean external force [N] between ankle and hip, by data set, for each of `LAMBDAS`."""

AXES = {
    "fx": ("ExtBal2", 28.43, "ExtBal1, λ 10", 8.13),
    "fy": ("fastExtBal", 14.30, "gridMin30", 14.83),
    "fz": ("ExtBal1", 56.85, "gridMin45", 13.46),
    "tx": ("ExtBal2", 54.62, "fastExtBal2, λ 1.5", 4.60),
    "ty": ("Workbench", 100.0, "Workbench", 0.58),
    "tz": ("Workbench", 100.0, "fastExtBal2, λ 10", 1.88),
}
"""Table III: best set and its error [%] in the first validation, best in the second [N, Nm]."""


def squeezed(name: str) -> str:
    """Return a name without case and separators: `Grid_min-30` is `gridmin30`."""
    return "".join(c for c in name.casefold() if c.isalnum())


def matched(recordings: Iterable[str]) -> dict[str, str]:
    """Return the recordings that are named as data sets of the paper: theirs to ours, in order."""
    ours = {squeezed(name): name for name in recordings}
    for other, name in ALSO.items():
        if squeezed(other) in ours:
            ours.setdefault(squeezed(name), ours[squeezed(other)])
    return {name: ours[squeezed(name)] for name in DATA_SETS if squeezed(name) in ours}


def is_right_leg(sensor: str) -> bool:
    """Return whether a sensor's name says that it is in the right leg, as the paper's is."""
    return squeezed(sensor).startswith(("rleg", "rightleg"))
