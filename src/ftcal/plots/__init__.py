"""Figures of a calibration as plain Plotly JSON: `{"data": [...], "layout": {...}}`.

Plain tables, not `plotly.graph_objects`: a report has a dozen figures, and validating them would
cost more than the calibration. The copy of plotly.js inside the report draws them.
"""

from ftcal.plots.figure import POINTS, Figure
from ftcal.plots.health import health_timeline
from ftcal.plots.knowledge import directions, prior_curve, truth_maps
from ftcal.plots.validation import (
    elsewhere_map,
    leftover_in_time,
    matrices_in_space,
    truth_distances,
)
from ftcal.plots.whole_body import Node, share_map, stretch_curve, sub_model_graph
from ftcal.plots.wrench import (
    Piece,
    forces_in_space,
    glimpse_in,
    residual_spread,
    residuals_in_time,
    smoothing_effect,
    wrench_in_time,
)

__all__ = [
    "POINTS",
    "Figure",
    "Node",
    "Piece",
    "directions",
    "elsewhere_map",
    "forces_in_space",
    "glimpse_in",
    "health_timeline",
    "leftover_in_time",
    "matrices_in_space",
    "prior_curve",
    "residual_spread",
    "residuals_in_time",
    "share_map",
    "smoothing_effect",
    "stretch_curve",
    "sub_model_graph",
    "truth_distances",
    "truth_maps",
    "wrench_in_time",
]
