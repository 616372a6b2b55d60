"""ROS parameters of the estimator."""

from __future__ import annotations

from dataclasses import dataclass

from rclpy.node import Node
from tms_bag.nodes.parameters import declare

from tms_fit.nodes.fit_settings import declare_fit_settings
from tms_fit.settings import Settings
from tms_fit.streaming.live_fit import PREVIEW_PERIOD_S, REORDER_WINDOW_S


@dataclass(frozen=True)
class EstimatorParameters:
    """Parameters of the estimator node."""

    fit: Settings
    bicycle: str  # empty: the one that run_info names
    idle: float  # [s] without IMU samples that ends a run
    reorder_window: float  # [s] that a sample may arrive late
    preview_period: float  # [s] between previews of a response, 0: none


def declare_settings(node: Node) -> EstimatorParameters:
    """Declared parameters of the estimator node. Raises ParameterError."""
    return EstimatorParameters(
        fit=declare_fit_settings(node),
        bicycle=declare(
            node, "bicycle", "", "bicycle by name or .yaml file; empty: the one that run_info names"
        ),
        idle=declare(
            node, "idle", 3.0, "without IMU samples for so long, a run counts as ended [s]", 0.5, 3600.0
        ),
        reorder_window=declare(
            node,
            "reorder_window",
            REORDER_WINDOW_S,
            "longest that an IMU sample may come after a later one; answers wait for it [s]",
            0.0,
            5.0,
        ),
        preview_period=declare(
            node,
            "preview_period",
            PREVIEW_PERIOD_S,
            "time between estimates of a response that unfolds, 0: none [s]",
            0.0,
            60.0,
        ),
    )
