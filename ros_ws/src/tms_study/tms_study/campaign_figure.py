"""Figure of a campaign: each estimate less its truth, their mean and spread, and what each run stated."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from tms_study.campaign import Campaign, Row, told
from tms_study.campaign_result import Summary

MILLI = 1e3
RUN, MEAN = "0.6", "C0"


def campaign_figure(campaign: Campaign, rows: list[Row], summaries: list[Summary]) -> Figure:
    """Above: errors; below: the share of 95 % intervals that hold the truth. One column per combination."""
    names = ["\n".join(f"{key} = {value}" for key, value in one.combination.items()) for one in summaries]
    figure = Figure(figsize=(max(6.0, 1.5 + 1.1 * len(names)), 5.6), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[3, 1])
    for k, one in enumerate(summaries):
        fitted = [row for row in rows if row.combination == told(one.combination) and np.isfinite(row.error)]
        error = MILLI * np.array([row.error for row in fitted])
        # Spread over the column's width in the order of the seeds, so that no run hides another.
        across = k + np.linspace(-0.3, 0.3, len(error)) if len(error) > 1 else np.full(len(error), float(k))
        label = "a run, and its stated 95 % interval" if k == 0 else None
        reach = MILLI * np.abs(
            np.array([[row.low - row.estimate, row.high - row.estimate] for row in fitted]).reshape(-1, 2)
        )
        above.errorbar(across, error, reach.T, fmt=".", color=RUN, ms=4, lw=0.7, label=label, zorder=1)
        if fitted:
            label = "mean and standard deviation of the runs" if k == 0 else None
            above.errorbar(
                [k],
                [MILLI * one.bias],
                [MILLI * (one.std if np.isfinite(one.std) else 0.0)],
                fmt="s",
                color=MEAN,
                capsize=6,
                lw=2,
                label=label,
                zorder=2,
            )
            below.errorbar(
                [k],
                [one.covered],
                [[one.covered - one.covered_low], [one.covered_high - one.covered]],
                fmt="s",
                color=MEAN,
                capsize=6,
            )
    above.axhline(0.0, color="k", lw=0.8)
    above.set_ylabel("estimate less truth [mrad/s]")
    figure.suptitle(f"{campaign.scenario}: initial lean rate, {campaign.runs} runs each")
    handles, labels = above.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False, fontsize="small")
    below.axhline(0.95, color="k", lw=0.8, ls="--")
    below.set_ylim(-0.05, 1.05)
    below.set_ylabel("share of 95 %\nintervals that hold")
    below.set_xticks(range(len(names)), names)
    return figure
