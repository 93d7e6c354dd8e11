"""Words and numbers as a person reads them in the report."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from ftcal.fit import Fit

DASH = "–"
"""Stands where there is no number."""

MARKS = {"ACCEPT": "✓", "PARTIAL": "◐", "REFUSE": "✗"}
"""A verdict's sign: colour alone says nothing to one reader in twelve, nor on a grey print."""

WHISKER_WIDTH = 150
"""Pixels from 0 to `WHISKER_END` percent."""
WHISKER_END = 200.0
"""Percent of the Workbench's error at the right end of a whisker."""


def strength(fit: Fit) -> str:
    """Return how strongly the Workbench was believed."""
    if fit.kappa is None:
        return f"the paper's lambda = {fit.penalty:g} (given by the job)"
    how = "given by the job"
    if fit.choice is not None:
        how = "chosen by blocked cross-validation"
        if fit.choice.chosen in (fit.choice.kappas[0], fit.choice.kappas[-1]):
            how += ", at the end of those tried"
    return (
        f"kappa = {fit.kappa[0]:.3g}: entries of the secondary matrix are believed to lie within"
        f" {100 * fit.kappa[0]:.2g} % of full scale of the Workbench ({how})"
    )


def figures(value: float | None, digits: int = 3) -> str:
    """Return a number with `digits` significant digits, a dash where there is none."""
    if value is None or not math.isfinite(value):
        return DASH
    if 10**digits <= abs(value) < 1e6:
        return f"{value:.0f}".replace("-", "−")
    return f"{value:#.{digits}g}".removesuffix(".").replace("-", "−")


def fixed(value: float, places: int = 2) -> str:
    """Return a number with a fixed number of decimals, a dash where it is not finite."""
    if not math.isfinite(value):
        return DASH
    rounded = round(value, places) + 0.0  # never −0
    return f"{rounded:.{places}f}".replace("-", "−")


def signed(value: float, places: int = 2) -> str:
    """Return a number with a fixed number of decimals and its sign, which zero has not."""
    shown = fixed(value, places)
    return f"+{shown}" if round(value, places) > 0 else shown


def percent(fraction: float) -> str:
    """Return a fraction in percent, two digits where it is small."""
    if not math.isfinite(fraction):
        return DASH
    value = 100.0 * fraction
    return f"{value:.2g}\u00a0%" if abs(value) < 10 else f"{value:.0f}\u00a0%"


def moment(stamp: str) -> str:
    """Return an ISO 8601 stamp as a person writes it: `2026-11-21 23:20:11 UTC`."""
    return stamp.replace("T", " ").replace("+00:00", " UTC")


def span(interval: tuple[float, float]) -> str:
    """Return a range of loads: `−31.2 … 4.05`, which breaks after its dots alone."""
    return f"{figures(interval[0])}\u00a0… {figures(interval[1])}"


def ends(interval: tuple[float, float]) -> str:
    """Return an interval of percentages, with a decimal where both ends are small: `0.8–1.1`."""
    places = 1 if interval[1] < 10 else 0
    return f"{interval[0]:.{places}f}–{interval[1]:.{places}f}"


def mark(word: str) -> str:
    """Return the sign of a verdict."""
    return MARKS[word]


def whisker(value: float) -> float:
    """Return the place of a percentage on the whisker's scale [pixel], clipped at its end."""
    if not math.isfinite(value):
        return float(WHISKER_WIDTH)
    return round(WHISKER_WIDTH * min(max(value, 0.0), WHISKER_END) / WHISKER_END, 1)


TEXT_FILTERS: dict[str, Callable[..., Any]] = {
    "figures": figures,
    "fixed": fixed,
    "signed": signed,
    "percent": percent,
    "moment": moment,
    "span": span,
    "ends": ends,
    "mark": mark,
    "whisker": whisker,
}
"""What the templates call these by."""
