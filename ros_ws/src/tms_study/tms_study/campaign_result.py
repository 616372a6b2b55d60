"""What a campaign says: for each combination how many strikes were found, how right and how honest."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import binomtest
from tms_fit.parameters import DEFAULT_FREE

from tms_study import __version__
from tms_study.bound import bound, planned
from tms_study.campaign import Campaign, Row, told

NOMINAL = 0.95


@dataclass(frozen=True)
class Summary:
    """All runs of one combination."""

    combination: dict[str, Any]
    runs: int
    struck: int  # true strikes
    missed: int
    false: int
    fitted: int  # with an estimate
    bias: float  # [rad/s] mean of estimate less truth
    std: float  # [rad/s] standard deviation of that
    stated: float  # [rad/s] root mean square of the standard errors
    bound: float  # [rad/s] Cramer-Rao bound of the scenario's first strike, NaN: none
    covered: float  # share of 95 % intervals that hold the truth
    covered_low: float  # 95 % interval of that share (Wilson)
    covered_high: float
    vaf: float  # median, lean rate
    doubted: float  # share of the answers that say themselves that the model may be wrong
    sure: int  # answers that don't
    sure_covered: float  # share of those whose interval holds the truth
    sure_low: float  # 95 % interval of that share (Wilson)
    sure_high: float

    @property
    def bias_std(self) -> float:
        """Standard error of the bias [rad/s]."""
        return self.std / math.sqrt(self.fitted) if self.fitted else float("nan")

    @property
    def honest(self) -> bool:
        """Whether 95 % of the intervals hold, as far as one can tell: of answers that raise no doubt."""
        return not self.sure or self.sure_low <= NOMINAL <= self.sure_high


def summarise(campaign: Campaign, rows: list[Row]) -> list[Summary]:
    """A summary per combination, in their order."""
    return [
        _summary(campaign, combination, [r for r in rows if r.combination == told(combination)])
        for combination in campaign.combinations
    ]


def to_json(campaign: Campaign, summaries: list[Summary]) -> dict[str, Any]:
    """The document of `study campaign --json`."""
    return {
        "version": __version__,
        "scenario": campaign.scenario,
        "set": dict(campaign.changes),
        "vary": {key: list(values) for key, values in campaign.varied.items()},
        "seed": campaign.seed,
        "runs": campaign.runs,
        "given": campaign.given,
        "combinations": [{**vars(one), "bias_std": one.bias_std, "honest": one.honest} for one in summaries],
    }


def to_text(campaign: Campaign, summaries: list[Summary]) -> str:
    """The table for the terminal."""
    keys = list(campaign.varied)
    widths = [max(len(key), 8) for key in keys]
    first = " ".join(f"{key:>{width}}" for key, width in zip(keys, widths, strict=True))
    lines = [
        f"{campaign.scenario}: initial lean rate of {campaign.runs} runs each, estimate less truth [rad/s]",
        f"{first} {'struck':>6} {'missed':>6} {'false':>5} {'bias':>18} {'sd':>8} {'stated':>8} {'bound':>8}"
        f" {'95 % hold':>18} {'VAF':>6} {'doubted':>7} {'of the others hold':>18}",
    ]
    for one in summaries:
        own = " ".join(
            f"{value!s:>{width}}" for value, width in zip(one.combination.values(), widths, strict=True)
        )
        bias = f"{one.bias:+.2g} +- {one.bias_std:.1g}"
        hold = _share(one.covered, one.covered_low, one.covered_high)
        others = _share(one.sure_covered, one.sure_low, one.sure_high)
        lines.append(
            f"{own} {one.struck:6} {one.missed:6} {one.false:5} {bias:>18}"
            f" {one.std:8.2g} {one.stated:8.2g} {one.bound:8.2g} {hold:>18} {one.vaf:6.3f}"
            f" {one.doubted:7.2f} {others:>18}" + ("" if one.honest else "  intervals are not 95 %")
        )
    return "\n".join(lines)


def _share(share: float, low: float, high: float) -> str:
    return f"{share:.2f} ({low:.2f}-{high:.2f})" if math.isfinite(share) else "-"


def _covered(rows: list[Row]) -> tuple[float, float, float]:
    """Share of the intervals that hold the truth, and its own 95 % interval; NaN of no rows."""
    if not rows:
        return math.nan, math.nan, math.nan
    hold = sum(row.covered for row in rows)
    interval = binomtest(hold, len(rows)).proportion_ci(method="wilson")
    return hold / len(rows), float(interval.low), float(interval.high)


def _summary(campaign: Campaign, combination: dict[str, Any], rows: list[Row]) -> Summary:
    fitted = [row for row in rows if row.status == "ok" and not math.isnan(row.estimate)]
    sure = [row for row in fitted if not row.doubted]
    error = np.array([row.error for row in fitted])
    nothing = float("nan")
    covered, low, high = _covered(fitted)
    sure_covered, sure_low, sure_high = _covered(sure)
    return Summary(
        combination=combination,
        runs=len({row.seed for row in rows}),
        struck=sum(row.status != "false" for row in rows),
        missed=sum(row.status == "missed" for row in rows),
        false=sum(row.status == "false" for row in rows),
        fitted=len(fitted),
        bias=float(error.mean()) if fitted else nothing,
        std=float(error.std(ddof=1)) if len(fitted) > 1 else nothing,
        stated=math.sqrt(np.mean([row.std**2 for row in fitted])) if fitted else nothing,
        bound=_bound(campaign, combination),
        covered=covered,
        covered_low=low,
        covered_high=high,
        vaf=float(np.median([row.vaf_lean_rate for row in fitted])) if fitted else nothing,
        doubted=1.0 - len(sure) / len(fitted) if fitted else nothing,
        sure=len(sure),
        sure_covered=sure_covered,
        sure_low=sure_low,
        sure_high=sure_high,
    )


def _bound(campaign: Campaign, combination: dict[str, Any]) -> float:
    """The least standard deviation; NaN without noise or strike, or where it can't be told apart."""
    scenario = campaign.scenario_of(combination, campaign.seed)
    experiment = planned(scenario, campaign.settings.window)
    if not (experiment.noise > 0.0 and experiment.duration > 0.0 and experiment.lean_rate):
        return float("nan")
    free = campaign.settings.free or DEFAULT_FREE
    return bound(scenario, experiment, free).std.get("initial_lean_rate", float("nan"))
