"""The part of the report about one strike: sentence, charts, tables, animation."""

from __future__ import annotations

import numpy as np
from tms_model import Bicycle, stability
from tms_model.bicycle import Array

from tms_fit.comparison import Comparison, comparison, first_good, source_of
from tms_fit.diagnostics.error_budget import error_budget
from tms_fit.diagnostics.hypothesis_tests import run_hypothesis_tests
from tms_fit.diagnostics.residual_tests import diagnose_residuals
from tms_fit.diagnostics.stated_noise import stated_noise
from tms_fit.parameters import CHANNELS
from tms_fit.recording_fit import RecordingFit
from tms_fit.report import datasets
from tms_fit.report.animation import animation
from tms_fit.report.budget_table import budget_table, largest_effects
from tms_fit.report.chart import Chart, Columns
from tms_fit.report.charts.budget import budget_chart
from tms_fit.report.charts.eigenvalues import eigenvalue_chart
from tms_fit.report.charts.nis import nis_chart
from tms_fit.report.charts.rates import LEFT_OUT, SLIPPING, Shown, rates_chart
from tms_fit.report.charts.residuals import histogram_chart, residual_chart
from tms_fit.report.charts.speed import speed_chart
from tms_fit.report.charts.whiteness import SHIMMY, autocorrelation_chart, spectrum_chart
from tms_fit.report.element import Element, element
from tms_fit.report.filtered import filter_steps, nis, share_inside
from tms_fit.report.findings import criticism_table, hypotheses_table
from tms_fit.report.motion import Motion, predicted_motion, true_motion
from tms_fit.report.parameters import estimator_table, parameter_table
from tms_fit.report.profiles import profile_charts
from tms_fit.report.rounding import as_sentence
from tms_fit.report.section import Section
from tms_fit.report.sentence import sentence
from tms_fit.report.truth import truth_table
from tms_fit.report.whiteness import autocorrelation, spectrum
from tms_fit.response.discretization import as_ridden, discretize
from tms_fit.strike_fit import StrikeFit


def strike_section(fit: RecordingFit, index: int) -> Section:
    """The section of strike `index`, counted from 0."""
    strike = fit.strikes[index]
    name, title = f"strike-{index + 1}", f"Strike {index + 1}"
    if first_good(strike) is None:
        return Section(name, title, (sentence(fit, index), _why(strike)), tables=(estimator_table(strike),))
    both = comparison(fit, index + 1)
    charts, data = _charts(fit, both)
    settings = both.estimate.settings or fit.settings
    bent, curves = profile_charts(both, settings)
    charts, data = (*charts, *bent), {**data, **curves}
    budget = error_budget(both.used, settings, both.estimate)
    if budget is not None:
        data |= largest_effects(budget)
        charts = (*charts, budget_chart(data["effects"]["name"]))
    motions = _motions(fit, both)
    tables = [parameter_table(both.estimate)]
    judged = criticism_table(
        diagnose_residuals(both.used, both.estimate, stated_noise(fit.recording, settings))
    )
    told = hypotheses_table(run_hypothesis_tests(both.used, settings))
    spent = budget_table(budget) if budget is not None else None
    tables += [one for one in (judged, told, spent) if one is not None]
    if len(strike.estimates) > 1:
        tables.append(estimator_table(strike))
    if fit.recording.state is not None:
        compared = truth_table(fit.recording.state, both)
        tables += [compared] if compared is not None else []
    return Section(
        name,
        title,
        (sentence(fit, index), _why(strike), animation(name, both, "true" in motions)),
        charts,
        tuple(tables),
        data,
        motions,
    )


def _why(strike: StrikeFit) -> Element:
    return element("p", as_sentence(strike.strike.why), class_="why")


def _charts(fit: RecordingFit, both: Comparison) -> tuple[tuple[Chart, ...], dict[str, Columns]]:
    present, compared = _with_values(both.used.measured), _with_values(both.estimate.residual)
    data = {
        "series": datasets.series(both),
        "window": datasets.window(both),
        "residuals": datasets.residuals(both, both.estimate.residual),
        "nis": nis(filter_steps(fit, both), both.strike.start_ns),
    }
    state = fit.recording.state
    if state is not None:
        data["truth"] = datasets.truth(state, both.strike.start_ns, float(both.time[-1]))
        data["slips"] = datasets.slips(state, both.strike.start_ns, float(both.time[-1]))
    slipping = _slipping(both)
    if slipping:
        seconds = both.estimate.settings.slip_window if both.estimate.settings else 0.0
        data["slip_window"] = {"start": [0.0], "end": datasets.column([seconds])}
    with_slip = bool(data.get("slips", {}).get("start"))
    speed, more = _speed(fit, both)
    eigenvalue, rest = _eigenvalues(fit, both)
    charts = (
        rates_chart(Shown(source_of(fit), "yaw_rate" in present, state is not None, with_slip, slipping)),
        speed,
        *_residual_charts(both, compared, data),
        nis_chart(share_inside(data["nis"])),
        eigenvalue,
    )
    return charts, {**data, **more, **rest}


def _residual_charts(
    both: Comparison, present: tuple[str, ...], data: dict[str, Columns]
) -> tuple[Chart, ...]:
    """Charts of the residuals; puts their numbers into `data`."""
    residual, time = both.estimate.residual, both.used.time
    for channel, name in enumerate(CHANNELS):
        if name in present:
            bars, normal = datasets.histogram(residual[:, channel], both.estimate.residual_std)
            data[f"histogram_{name}"], data[f"normal_{name}"] = bars, normal
    data["autocorrelation"] = autocorrelation(time, residual)
    data["spectrum"] = spectrum(time, residual)
    fastest = max(data["spectrum"]["frequency"], default=0.0)
    return (
        residual_chart(present),
        histogram_chart(present),
        autocorrelation_chart(present),
        spectrum_chart(present, fastest > SHIMMY),
    )


def _ridden(fit: RecordingFit, both: Comparison) -> Bicycle:
    return as_ridden(fit.bicycle, _gain(both), both.estimate.complete.get("steer_damper", 0.0))


def _gain(both: Comparison) -> float:
    """Lean-rate feedback on the steer torque [N m s/rad], found or known."""
    return both.estimate.complete.get("lean_rate_gain", both.used.lean_rate_gain)


def _slipping(both: Comparison) -> str:
    """What was made of the time in which the front wheel slips; empty: nobody said that it does."""
    settings = both.estimate.settings
    if settings is None or not settings.slip_window:
        return ""
    return LEFT_OUT if settings.slip == "leave_out" else SLIPPING


def _with_values(columns: Array) -> tuple[str, ...]:
    """Names of the channels, columns of (n, 2), that hold any number."""
    return tuple(name for name, values in zip(CHANNELS, columns.T, strict=True) if np.isfinite(values).any())


def _speed(fit: RecordingFit, both: Comparison) -> tuple[Chart, dict[str, Columns]]:
    last = float(both.time[-1])
    data: dict[str, Columns] = {
        "used_speed": {
            "time": datasets.column(both.time),
            "speed": datasets.column(discretize(both.shown, both.estimate.nonlinear).speeds),
        }
    }
    samples = datasets.speed_samples(fit, both.strike.start_ns, last)
    if samples is not None:
        data["speed"] = samples
    bicycle = _ridden(fit, both)
    edges = [low for low, _ in stability(bicycle).stable_speed_ranges if low > 0.0]
    data["onset"] = {"speed": datasets.column(edges[:1])}
    return speed_chart(samples is not None, bool(edges), fit.recording.state is not None), data


def _eigenvalues(fit: RecordingFit, both: Comparison) -> tuple[Chart, dict[str, Columns]]:
    bicycle = _ridden(fit, both)
    run_speeds = datasets.run_speeds(fit, both)
    curves, names = datasets.eigenvalues(bicycle, run_speeds["high"][0])
    gain = _gain(both)
    feedback = (
        f" with steer torque = {gain:.2f} N m s/rad times lean rate, as found in this run" if gain else ""
    )
    data = {
        "eigenvalues": curves,
        "stable": datasets.stable_ranges(stability(bicycle), max(curves["speed"])),
        "run_speeds": run_speeds,
    }
    return eigenvalue_chart(names, feedback), data


def _motions(fit: RecordingFit, both: Comparison) -> dict[str, Columns]:
    motions = {"predicted": _columns(predicted_motion(both))}
    if fit.recording.state is not None:
        true = true_motion(fit.recording.state, both.strike.start_ns, -0.5, float(both.time[-1]))
        if true is not None:
            motions["true"] = _columns(true)
    return motions


def _columns(motion: Motion) -> Columns:
    return {
        name: datasets.column(getattr(motion, name)) for name in ("time", "lean", "steer", "yaw", "x", "y")
    }
