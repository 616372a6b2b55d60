"""Estimators by name. A new one: one file here and one line below.

Each is a function (window, settings) -> Estimate.
"""

from __future__ import annotations

from collections.abc import Callable

from tms_fit.estimate import Estimate
from tms_fit.estimators import kalman_rts, least_squares, som2011, strike
from tms_fit.parameters import check_known
from tms_fit.settings import Settings
from tms_fit.window import Window

Estimator = Callable[[Window, Settings], Estimate]

ESTIMATORS: dict[str, Estimator] = {
    "least_squares": least_squares.fit_window,
    "kalman_rts": kalman_rts.estimate,
    "som2011": som2011.estimate,
    "strike": strike.estimate,
}


def check_names(names: tuple[str, ...]) -> None:
    """Raise ParameterError for an unknown estimator."""
    check_known(names, ESTIMATORS, "estimator")
