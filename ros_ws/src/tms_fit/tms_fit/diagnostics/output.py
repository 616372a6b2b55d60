"""Diagnostics of one strike as JSON and text."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import Any

from tms_fit.diagnostics.error_budget import Budget, error_budget
from tms_fit.diagnostics.hypothesis_tests import HypothesisTest, run_hypothesis_tests
from tms_fit.diagnostics.misspecification import Misspecification
from tms_fit.diagnostics.residual_tests import diagnose_residuals
from tms_fit.diagnostics.stated_noise import StatedNoise
from tms_fit.estimate import Estimate
from tms_fit.settings import Settings
from tms_fit.window import Window


def diagnostics_json(
    window: Window | None,
    estimates: Sequence[Estimate],
    misspecification: Misspecification | None,
    settings: Settings,
    asked: Collection[str],
) -> dict[str, Any]:
    """Misspecification of the first estimate, and the diagnostics asked for, by name; null: none."""
    found: dict[str, Any] = {"doubt": None}
    if misspecification:
        parameter = misspecification.parameter or None
        found["doubt"] = {"parameter": parameter, "sentence": misspecification.sentence}
    if "hypotheses" in asked:
        tests = run_hypothesis_tests(window, settings) if window else ()
        found["hypotheses"] = [_hypothesis_test(one) for one in tests]
    if "budget" in asked:
        budget = _error_budget(window, estimates, settings)
        found["error_budget"] = _budget(budget) if budget else None
    return found


def diagnostics_lines(
    window: Window | None,
    estimates: Sequence[Estimate],
    misspecification: Misspecification | None,
    settings: Settings,
    asked: Collection[str],
    stated: StatedNoise | None,
) -> list[str]:
    """The same as lines of text, and the size of the residuals compared with the stated noise."""
    lines: list[str] = []
    if window is None:
        return lines
    if estimates[0].chosen:
        lines.append(f"chosen: {'; '.join(estimates[0].chosen)}")
    if misspecification:
        lines.append(misspecification.sentence)
    residuals = diagnose_residuals(window, estimates[0], stated)
    if estimates[0].names:
        lines.append(residuals.size)
    if "hypotheses" in asked:
        lines.append(residuals.verdict)
        lines.extend(test.sentence for test in run_hypothesis_tests(window, settings))
    budget = _error_budget(window, estimates, settings) if "budget" in asked else None
    if budget:
        lines.extend(_budget_lines(budget))
    return lines


def residual_tests_json(window: Window, estimate: Estimate, stated: StatedNoise | None) -> dict[str, Any]:
    """Tests of the residuals of one estimate."""
    found = diagnose_residuals(window, estimate, stated)
    return {
        "verdict": found.verdict,
        "fit_percent": found.fit_percent,
        "stated_noise": {"std": stated.std, "by": stated.by} if stated else None,
        "reduced_chi_square": found.reduced_chi_square or None,
        "tests": [
            {
                "name": one.name,
                "channel": one.channel,
                "statistic": one.statistic,
                "p_value": one.p_value,
                "passed": one.passed,
                "sentence": one.sentence,
            }
            for one in found.tests
        ],
    }


def _hypothesis_test(one: HypothesisTest) -> dict[str, Any]:
    """One hypothesis; null where the data can't decide."""
    figures = {
        "value": one.value,
        "std": one.std,
        "assumed": one.assumed,
        "statistic": one.statistic,
        "p_value": one.p_value,
        "delta_aic": one.delta_aic,
        "delta_bic": one.delta_bic,
    }
    return {
        "hypothesis": one.hypothesis,
        "parameter": one.parameter,
        "rejected": one.rejected,
        "sentence": one.sentence,
        **{name: value if math.isfinite(value) else None for name, value in figures.items()},
    }


def _error_budget(window: Window | None, estimates: Sequence[Estimate], settings: Settings) -> Budget | None:
    """Error budget of the least-squares estimate; None where there is none."""
    for estimate in estimates:
        if window is not None and estimate.estimator == "least_squares":
            return error_budget(window, settings, estimate)
    return None


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _budget(budget: Budget) -> dict[str, Any]:
    """Statistical and model error of the initial lean rate, and the contribution of each known value."""
    return {
        "initial_lean_rate": budget.value,
        "statistical_std": budget.statistical,
        "model_std": _number(budget.model),
        "contributions": [
            {
                "name": one.name,
                "value": one.value,
                "sensitivity": _number(one.sensitivity),
                "per_percent": _number(one.per_percent),
                "uncertainty": _number(one.uncertainty),
                "std": _number(one.part),
                "in_statistical_std": one.included,
            }
            for one in budget.contributions
        ],
    }


def _budget_lines(budget: Budget) -> list[str]:
    model = (
        f"{budget.model:.5f}"
        if math.isfinite(budget.model)
        else "unknown: the bicycle file states no parameter uncertainties"
    )
    lines = [
        f"error budget of the initial lean rate {budget.value:+.5f} rad/s: statistical"
        f" {budget.statistical:.5f}, model {model}",
        f"  {'taken as known':24} {'value':>12} {'d estimate / d':>15} {'if 1 % more':>12} {'its std':>10}",
    ]
    for one in budget.contributions:
        part = f"{one.part:10.5f}" if math.isfinite(one.part) else f"{'-':>10}"
        within = " (in the statistical)" if one.included and math.isfinite(one.part) else ""
        lines.append(
            f"  {one.name:24} {one.value:12.5g} {one.sensitivity:15.5g} {one.per_percent:+12.5f}"
            f" {part}{within}"
        )
    return lines
