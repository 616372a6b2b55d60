"""Figure 3B shows what was fitted: the curves, the band and the samples are the estimate's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from tms_bag import BagWriter, RecordingError, read_recording
from tms_fit.comparison import comparison
from tms_fit.estimators import ESTIMATORS
from tms_fit.figure3b import figure_3b
from tms_fit.recording_fit import RecordingFit, bicycle_of, fit_recording
from tms_fit.settings import Settings
from tms_fit.window import Window
from tms_model import LinearSystem, linear_system, response, yaw_rate


def system_of(window: Window) -> LinearSystem:
    return linear_system(window.bicycle, window.start_speed, window.lean_rate_gain)


@pytest.fixture
def fitted(make_run: Any, tmp_path: Path) -> Any:
    def fit(
        scenario: str = "tms_strike", free: tuple[str, ...] | None = None, **changes: Any
    ) -> RecordingFit:
        run = make_run(scenario, strike__time=1.5037, duration=6.0, **changes)
        with BagWriter(tmp_path / "bag", overwrite=True) as bag:
            for record in run.records():
                bag.write(record)
        recording = read_recording(tmp_path / "bag")
        settings = Settings(free=free, estimators=("least_squares",))
        return fit_recording(recording, bicycle_of(recording, None), settings)

    return fit


def curve(axes: Axes, label: str) -> tuple[np.ndarray, np.ndarray]:
    (line,) = (line for line in axes.get_lines() if line.get_label() == label)
    return np.asarray(line.get_xdata()), np.asarray(line.get_ydata())


def band(axes: Axes) -> tuple[np.ndarray, np.ndarray]:
    """Half width of the band, and where."""
    (collection,) = (
        c for c in axes.collections if isinstance(c, PolyCollection) and c.get_label() == "95 % band"
    )
    points = collection.get_paths()[0].vertices
    where = np.unique(points[:, 0])
    ends = np.array(
        [[y[points[:, 0] == x].min(), y[points[:, 0] == x].max()] for x in where for y in [points[:, 1]]]
    )
    return where, 0.5 * (ends[:, 1] - ends[:, 0])


def test_curves_are_the_prediction_and_dots_the_recording(fitted: Any) -> None:
    fit = fitted()
    upper, lower = figure_3b(fit).axes
    (strike,) = fit.strikes
    (estimate,) = strike.estimates
    time, predicted = curve(upper, "predicted")
    start = np.array([0.0, 0.0, estimate.parameters["initial_lean_rate"], 0.0])
    states = response(system_of(strike.window), start, time)
    np.testing.assert_allclose(predicted, states[:, 2] + estimate.parameters["lean_rate_bias"], atol=1e-9)
    _, yaw = curve(lower, "predicted")
    expected = yaw_rate(system_of(strike.window), states) + estimate.parameters["yaw_rate_bias"]
    np.testing.assert_allclose(yaw, expected, atol=1e-9)
    assert time[-1] == pytest.approx(4.0, abs=0.01)  # beyond what was fitted: there it truly predicts
    dots_time, dots = curve(upper, "simulated")
    rows = np.searchsorted(
        fit.recording.imu.time_ns, strike.start_ns + np.round(dots_time * 1e9).astype(np.int64)
    )
    np.testing.assert_array_equal(dots, fit.recording.imu.angular_velocity[rows, 0])


def test_band_is_the_interval_carried_along(fitted: Any) -> None:
    # With one unknown, the band is its interval times the response to 1 rad/s.
    fit = fitted(free=("initial_lean_rate",))
    (strike,) = fit.strikes
    (estimate,) = strike.estimates
    half = 0.5 * (estimate.ci95[0, 1] - estimate.ci95[0, 0])
    where, width = band(figure_3b(fit).axes[0])
    unit = response(system_of(strike.window), np.array([0.0, 0.0, 1.0, 0.0]), where)
    np.testing.assert_allclose(width, half * np.abs(unit[:, 2]), atol=1e-9)


def test_title_says_what_it_is_and_no_simulation_passes_for_a_measurement(fitted: Any) -> None:
    fit = fitted()
    title = figure_3b(fit).axes[0].get_title()
    value = fit.strikes[0].estimates[0].parameters["initial_lean_rate"]
    assert title.startswith("simulated run bag, strike 1: tms_eq_10_1 at 3.6")
    assert f"initial lean rate {value:.4f} ±" in title
    measured = replace(fit.recording, run_info=replace(fit.recording.run_info, simulated=False))
    upper = figure_3b(replace(fit, recording=measured)).axes[0]
    assert upper.get_title().startswith("measured run")
    assert len(curve(upper, "measured")[0]) > 100
    assert [axes.get_ylabel() for axes in figure_3b(fit).axes] == ["lean rate [rad/s]", "yaw rate [rad/s]"]


def test_absent_channel_is_said(fitted: Any) -> None:
    fit = fitted()
    imu = fit.recording.imu
    lean_only = np.where([True, False, False], imu.angular_velocity, np.nan)
    recording = replace(fit.recording, imu=replace(imu, angular_velocity=lean_only))
    lean = fit_recording(recording, fit.bicycle, fit.settings)
    _, lower = figure_3b(lean).axes
    assert [text.get_text() for text in lower.texts] == ["not measured in this recording"]
    assert len(curve(lower, "predicted")[1]) > 100
    assert set(lean.strikes[0].estimates[0].vaf) == {"lean_rate"}


@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize("scenario", ["tms_strike", "gym_run"])
def test_what_is_shown_is_what_was_fitted(
    make_run: Any, tmp_path: Path, estimator: str, scenario: str
) -> None:
    # som2011, which takes a constant speed and one channel, as much as the others.
    run = make_run(scenario, strike__time=3.0, duration=6.0)
    with BagWriter(tmp_path / "bag") as bag:
        for record in run.records():
            bag.write(record)
    recording = read_recording(tmp_path / "bag")
    both = comparison(
        fit_recording(recording, bicycle_of(recording, None), Settings(estimators=(estimator,)))
    )
    count = len(both.estimate.predicted)
    assert count > 100
    np.testing.assert_allclose(both.predicted[:count], both.estimate.predicted, atol=1e-9)


def test_strikes_are_counted_from_one(fitted: Any) -> None:
    fit = fitted()
    for number in (-1, 0, 2):
        with pytest.raises(RecordingError, match=f"expected a strike number from 1 to 1, found {number}"):
            figure_3b(fit, number)
    with pytest.raises(RecordingError, match="holds no strike"):
        figure_3b(replace(fit, strikes=()))


def test_known_torque_bends_the_curve(fitted: Any) -> None:
    # As an input, not as feedback: the curve is the response to initial lean rate and torque together.
    fit = fitted("delft_push", imu__rate=400.0)
    settings = replace(fit.settings, steer_torque="input")
    as_input = fit_recording(fit.recording, fit.bicycle, settings)
    time, predicted = curve(figure_3b(as_input).axes[0], "predicted")
    dots_time, dots = curve(figure_3b(as_input).axes[0], "simulated")
    near = (time > 0.0) & (time < 1.0)
    assert np.std(dots[near] - predicted[near]) < 0.3 * np.std(dots[near])
    np.testing.assert_array_equal(time, dots_time)
