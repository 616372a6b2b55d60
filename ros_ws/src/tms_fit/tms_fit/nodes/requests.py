"""Settings of service and action requests."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from tms_model import ParameterError

from tms_fit.settings import Settings
from tms_fit.settings_parser import each_once


def asked_for(base: Settings, request: Any) -> Settings:
    """Settings of a request (tms_msgs/srv/Refit, action/FitRecording goal); base replaces empty fields.

    Raises ParameterError.
    """
    if len(request.fixed_names) != len(request.fixed_values):
        raise ParameterError(
            f"fixed_values: expected {len(request.fixed_names)}, one for each of fixed_names, found"
            f" {len(request.fixed_values)}"
        )
    return replace(
        base,
        free=tuple(request.free) or base.free,
        fixed=each_once(zip(request.fixed_names, request.fixed_values, strict=True), "fixed_names")
        or base.fixed,
        estimators=tuple(request.estimators) or base.estimators,
        window=request.window or base.window,
    )
