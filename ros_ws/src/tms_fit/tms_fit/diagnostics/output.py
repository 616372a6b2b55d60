"""What else can be said of a strike: residuals, rival hypotheses, error budget; JSON and text."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Any

from tms_fit.diagnostics.error_budget import Budget, error_budget
from tms_fit.diagnostics.hypothesis_tests import HypothesisTest, run_hypothesis_tests
from tms_fit.diagnostics.residual_tests import diagnose_residuals
from tms_fit.diagnostics.stated_noise import StatedNoise
from tms_fit.estimate import Estimate
from tms_fit.settings import Settings
from tms_fit.streaming.online import StrikeFit
from tms_fit.window import Window


def scrutiny_json(fit: StrikeFit, settings: Settings, asked: Collection[str]) -> dict[str, Any]:
    """What makes the first estimate doubtful, and what is asked, by name; null: nothing to say."""
    about = fit.doubt
    found: dict[str, Any] = {
        "doubt": {"parameter": about.parameter or None, "sentence": about.sentence} if about else None
    }
    if "hypotheses" in asked:
        told = run_hypothesis_tests(fit.window, settings) if fit.window else ()
        found["hypotheses"] = [_verdict(one) for one in told]
    if "budget" in asked:
        budget = _budget_of(fit, settings)
        found["error_budget"] = _budget(budget) if budget else None
    return found


def scrutiny_lines(
    fit: StrikeFit, settings: Settings, asked: Collection[str], stated: StatedNoise | None
) -> list[str]:
    """The same as lines of text, and how large the residuals are for the noise that somebody states."""
    lines: list[str] = []
    if fit.window is None:
        return lines
    if fit.estimates[0].chosen:
        lines.append(f"chosen: {'; '.join(fit.estimates[0].chosen)}")
    about = fit.doubt
    if about:
        lines.append(about.sentence)
    criticism = diagnose_residuals(fit.window, fit.estimates[0], stated)
    if fit.estimates[0].names:
        lines.append(criticism.size)
    if "hypotheses" in asked:
        lines.append(criticism.verdict)
        lines.extend(verdict.sentence for verdict in run_hypothesis_tests(fit.window, settings))
    budget = _budget_of(fit, settings) if "budget" in asked else None
    if budget:
        lines.extend(_budget_lines(budget))
    return lines


def criticism_json(window: Window, estimate: Estimate, stated: StatedNoise | None) -> dict[str, Any]:
    """What the residuals say about the model."""
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


def _verdict(one: HypothesisTest) -> dict[str, Any]:
    """One hypothesis; null where the data say nothing."""
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


def _budget_of(fit: StrikeFit, settings: Settings) -> Budget | None:
    for estimate in fit.estimates:
        if fit.window is not None and estimate.estimator == "least_squares":
            return error_budget(fit.window, settings, estimate)
    return None


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _budget(budget: Budget) -> dict[str, Any]:
    """Statistical and model error of the initial lean rate, and what each thing taken as known has in it."""
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
        else "unknown: nobody states how sure the bicycle is"
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
