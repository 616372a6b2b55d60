"""The settings that a request asks for, in place of those that the estimator was started with."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from tms_model import ParameterError

from tms_fit.settings import FitSettings


def asked_for(base: FitSettings, request: Any) -> FitSettings:
    """Settings of a request (tms_msgs/srv/Refit, action/FitRecording goal); what it leaves empty is base's.

    Raises ParameterError.
    """
    if len(request.fixed_names) != len(request.fixed_values):
        raise ParameterError(
            f"fixed_values: expected {len(request.fixed_names)}, one for each of fixed_names, found"
            f" {len(request.fixed_values)}"
        )
    twice = sorted({name for name in request.fixed_names if request.fixed_names.count(name) > 1})
    if twice:
        raise ParameterError(f"fixed_names: expected each name once, found {', '.join(twice)} twice")
    return replace(
        base,
        free=tuple(request.free) or base.free,
        fixed=dict(zip(request.fixed_names, request.fixed_values, strict=True)) or base.fixed,
        estimators=tuple(request.estimators) or base.estimators,
        window=request.window or base.window,
    )
