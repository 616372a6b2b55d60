"""Conversion of estimates and filter states to messages."""

from __future__ import annotations

from typing import Any

import numpy as np
from tms_bag.conversion import REAR_FRAME
from tms_bag.messages import message_type, serialize
from tms_bag.reading.one_message import write_numbers
from tms_bag.record import Record

from tms_fit.estimate import Estimate
from tms_fit.kalman.ekf import FilterStep
from tms_fit.strike_fit import StrikeFit

ESTIMATE, ESTIMATE_TYPE = "estimate", "tms_msgs/msg/Estimate"
FILTER_STATE, FILTER_STATE_TYPE = "filter_state", "tms_msgs/msg/FilterState"
_FILTER_STATE = (
    "state", "covariance", "innovation", "innovation_covariance", "nis", "channel_count", "reset", "speed",
)  # fmt: skip


def estimate_records(fit: StrikeFit) -> list[Record]:
    """Records, one per estimator, on the topic `estimate`, stamped with the start of the free response."""
    return [
        Record(f"/{ESTIMATE}", ESTIMATE_TYPE, fit.start_ns, serialize(estimate_message(fit, one)))
        for one in fit.estimates
    ]


def filter_state_record(step: FilterStep) -> Record:
    """Record of a filter step on the topic `filter_state`."""
    numbers = (
        *step.state.tolist(),
        *step.covariance.ravel().tolist(),
        *step.innovation.tolist(),
        *step.innovation_covariance.ravel().tolist(),
        step.nis,
        step.channel_count,
        step.reset,
        step.speed,
    )
    data = write_numbers(FILTER_STATE_TYPE, _FILTER_STATE, REAR_FRAME, step.time_ns, numbers)
    return Record(f"/{FILTER_STATE}", FILTER_STATE_TYPE, step.time_ns, data)


def estimate_message(fit: StrikeFit, estimate: Estimate) -> Any:
    """Message tms_msgs/Estimate of a strike's estimate."""
    key_value = message_type("diagnostic_msgs/msg/KeyValue")
    diagnostics = {
        "residual_std": estimate.residual_std,
        "residual_autocorrelation": estimate.residual_autocorrelation,
        "start_std": 0.0,
    }
    if fit.window is not None:
        diagnostics["start_std"] = fit.window.delay_std
        diagnostics["speed"] = estimate.complete.get("speed", fit.speed)
        diagnostics["lean_rate_gain"] = fit.window.lean_rate_gain
    texts = {key: repr(float(value)) for key, value in diagnostics.items()}
    if fit.window is not None and fit.window.speed.source:
        texts["speed_source"] = fit.window.speed.source
    return message_type(ESTIMATE_TYPE)(
        header=_header(fit.start_ns),
        window_start=_time(fit.strike.time_ns),
        window_end=_time(fit.end_ns),
        final=fit.final,
        bicycle=fit.bicycle,
        estimator=estimate.estimator,
        status=estimate.status,
        message=estimate.message,
        names=list(estimate.names),
        values=estimate.values,
        covariance=estimate.covariance.ravel(),
        ci95_low=np.ascontiguousarray(estimate.ci95[:, 0]) if estimate.names else np.empty(0),
        ci95_high=np.ascontiguousarray(estimate.ci95[:, 1]) if estimate.names else np.empty(0),
        sample_count=estimate.sample_count,
        channels=list(estimate.vaf),
        vaf=np.array(list(estimate.vaf.values()), dtype=float),
        diagnostics=[key_value(key=key, value=value) for key, value in texts.items()],
    )


def _time(time_ns: int) -> Any:
    return message_type("builtin_interfaces/msg/Time")(
        sec=time_ns // 1_000_000_000, nanosec=time_ns % 1_000_000_000
    )


def _header(time_ns: int) -> Any:
    return message_type("std_msgs/msg/Header")(stamp=_time(time_ns), frame_id=REAR_FRAME)
