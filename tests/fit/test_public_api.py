"""The public API of tms_fit: arrays and recordings in, parameters by name out."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tms_bag import Recording, read_recording, recording_from_arrays
from tms_fit import (
    Estimate,
    FitResult,
    Parameter,
    Settings,
    Status,
    Window,
    find_strikes,
    fit,
    fit_recording,
    fit_window,
)
from tms_fit.estimate import Estimates
from tms_model import ParameterError, linear_system, load_bicycle, response, yaw_rate
from tms_model.frames import imu_to_rear_frame, quaternion

BAG = Path(__file__).parents[2] / "bags" / "tms_strike"


@pytest.fixture(scope="module")
def recording() -> Recording:
    return read_recording(BAG)


@pytest.fixture(scope="module")
def result(recording: Recording) -> FitResult:
    return fit_recording(recording)


def arrays(recording: Recording) -> tuple[Any, Any, Any]:
    """Times [s], angular velocities (n, 3) in the sensor's axes, and (times, values) of the speed."""
    assert recording.speed is not None
    start = recording.imu.time_ns[0]
    speed = ((recording.speed.time_ns - start) / 1e9, recording.speed.speed)
    return (recording.imu.time_ns - start) / 1e9, recording.imu.angular_velocity, speed


def test_a_recording_is_fitted_as_on_the_command_line(result: FitResult) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tms_fit", "run", str(BAG), "--json"],
        check=True,
        capture_output=True,
        text=True,
    )
    assert json.loads(done.stdout) == json.loads(json.dumps(result.to_dict()))


def test_arrays_give_what_their_recording_gives(recording: Recording, result: FitResult) -> None:
    time, rates, speed = arrays(recording)
    assert recording.run_info is not None
    mounted = fit(
        time, rates, speed=speed, bicycle="tms_eq_10_1", orientation=recording.run_info.imu_orientation
    )
    (one,), (other,) = mounted, result
    for name in other:
        assert one[name].value == pytest.approx(other[name].value, abs=1e-3 * other[name].std)
        assert one[name].std == pytest.approx(other[name].std, rel=1e-3)


def test_axes_of_the_rear_frame_are_rep_103(recording: Recording) -> None:
    # The same rates, turned into the rear frame beforehand, with the signs of x forward, y left, z up.
    time, rates, speed = arrays(recording)
    turn = quaternion(0.1, -0.2, 0.7)
    sae = imu_to_rear_frame(rates, turn)
    in_frame = sae * [1.0, -1.0, -1.0]
    (one,) = fit(time, rates, speed=speed, bicycle="benchmark", orientation=turn, strike_times=[2.0])
    (other,) = fit(time, in_frame, speed=speed, bicycle="benchmark", strike_times=[2.0])
    assert one["initial_lean_rate"].value == pytest.approx(other["initial_lean_rate"].value, rel=1e-6)


def test_a_number_as_speed_is_known_unless_it_is_free(recording: Recording) -> None:
    time, rates, _ = arrays(recording)
    known = fit(time, rates, speed=3.6, bicycle="tms_eq_10_1")
    assert known.settings.fixed == {"speed": 3.6}
    free = ("initial_lean_rate", "lean_rate_bias", "yaw_rate_bias", "speed")
    (found,) = fit(time, rates, speed=3.5, bicycle="tms_eq_10_1", free=free, noise="white")
    assert found["speed"].unit == "m/s"
    assert found["speed"].ci95[0] < 3.6 < found["speed"].ci95[1]


def test_parameters_are_looked_up_by_name(result: FitResult) -> None:
    strike = result[0]
    estimate = strike.estimates["least_squares"]
    assert strike.estimates[0] is estimate
    assert strike["initial_lean_rate"] == estimate["initial_lean_rate"]
    for name, value, std, ci95 in zip(
        estimate.names, estimate.values, estimate.std, estimate.ci95, strict=True
    ):
        assert estimate[name].value == value
        assert estimate[name].std == std
        assert estimate[name].ci95 == tuple(ci95)
    assert list(strike) == list(estimate.names)
    assert "initial_lean_rate" in strike
    assert "speed" not in strike
    with pytest.raises(KeyError, match="speed: not estimated; expected of initial_lean_rate"):
        _ = strike["speed"]
    with pytest.raises(KeyError, match="som2011: expected of least_squares, kalman_rts"):
        _ = strike.estimates["som2011"]


def test_a_result_is_a_sequence_that_prints(result: FitResult) -> None:
    assert len(result) == len(result[:1]) == len(list(result)) == 1
    with pytest.raises(IndexError):
        _ = result[1]
    assert "initial lean rate [rad/s]" in str(result)
    assert repr(result).startswith("<FitResult of")
    assert repr(result[0]).count("initial_lean_rate=") == 2
    assert "initial_lean_rate" in str(result[0])
    assert len(repr(result)) < 1000


def test_a_table_has_a_row_for_each_parameter(result: FitResult) -> None:
    pytest.importorskip("pandas", reason="pandas is optional")
    table = result.to_pandas()
    assert len(table) == sum(len(one.names) for one in result[0].estimates)
    row = table[(table.estimator == "kalman_rts") & (table.parameter == "initial_lean_rate")].iloc[0]
    found = result[0].estimates["kalman_rts"]["initial_lean_rate"]
    assert (row.value, row["std"], row.low, row.high) == (found.value, found.std, *found.ci95)


def test_without_pandas_the_error_says_what_to_do(result: FitResult, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match="needs pandas, which isn't installed: pip install pandas"):
        result.to_pandas()


def test_a_figure_shows_both_rates(result: FitResult) -> None:
    labels = [axes.get_ylabel() for axes in result.plot(0).axes]
    assert labels == ["lean rate [rad/s]", "yaw rate [rad/s]"]


def test_strikes_are_found_without_a_fit(recording: Recording, result: FitResult) -> None:
    found, _ = find_strikes(recording)
    assert [one.time_ns for one in found] == [one.strike.time_ns for one in result]


def test_a_window_of_arrays_is_fitted() -> None:
    system, time = linear_system(load_bicycle("benchmark"), 5.0), np.arange(150) / 100.0
    states = response(system, np.array([0.0, 0.0, 0.5, 0.0]), time)
    noise = np.random.default_rng(3).normal(0.0, 0.01, (2, 150))
    window = Window.from_arrays(
        time + 7.0,
        states[:, 2] + noise[0],
        yaw_rate(system, states) + noise[1],
        speed=5.0,
        bicycle="benchmark",
    )
    free = ("initial_lean_rate", "lean_rate_bias", "yaw_rate_bias")
    for estimator in ("least_squares", "kalman_rts"):
        estimate = fit_window(window, estimator=estimator, free=free, noise="white")
        assert estimate.status is Status.OK
        assert estimate["initial_lean_rate"].value == pytest.approx(
            0.5, abs=4.0 * estimate["initial_lean_rate"].std
        )
    with pytest.raises(ParameterError, match="estimator: unknown 'guess'"):
        fit_window(window, estimator="guess")
    with pytest.raises(ParameterError, match=r"of one length, found shapes \(150,\), \(149,\)"):
        Window.from_arrays(time, states[:-1, 2], noise[1], speed=5.0, bicycle="benchmark")


def test_settings_and_options_go_together(recording: Recording) -> None:
    settings = Settings(window=1.0, estimators=("least_squares",))
    found = fit_recording(recording, settings=settings, noise="white")
    assert found.settings == replace(settings, noise="white")
    with pytest.raises(ParameterError, match="unknown option 'windows'; expected of free, fixed"):
        fit_recording(recording, windows=1.0)


def test_a_status_equals_its_word_and_carries_a_text() -> None:
    assert [one.value for one in Status] == ["ok", "not_converged", "not_observable", "too_short"]
    for one in Status:
        assert one == one.value == str(one) == f"{one}" == json.loads(json.dumps(one))
        assert Status(one.value) is one
        assert " " in one.text


def test_a_parameter_prints_with_its_unit_and_interval() -> None:
    assert str(Parameter(0.5, 0.01, (0.48, 0.52), "rad/s")) == "0.5 ± 0.01 rad/s (95 % 0.48 to 0.52)"
    assert str(Parameter(0.05, 0.01, (0.0, float("inf")), "1")) == "0.05 ± 0.01 (95 % 0 to inf)"


def test_an_estimate_without_parameters_says_why() -> None:
    estimate = Estimate("least_squares", Status.TOO_SHORT, "expected 20 samples, found 3")
    assert str(estimate) == "least_squares: expected 20 samples, found 3"
    assert repr(Estimates([estimate])) == "Estimates(<Estimate least_squares too_short>)"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"time": [0.0, 0.0, 0.1]}, "time: expected ascending times, found 0 s in row 1"),
        ({"time": [0.0, float("nan"), 0.1]}, "time: expected finite times"),
        ({"time": [[0.0], [0.1], [0.2]]}, "time: expected finite times"),
        ({"time": [0.0, 1e12, 2e12]}, "time: expected seconds"),
        (
            {"angular_velocity": np.zeros((3, 2))},
            r"angular_velocity: expected shape \(3, 3\), found \(3, 2\)",
        ),
        ({"speed": ([0.0, 1.0], [4.0])}, "speed: expected 2 values, one for each time"),
        ({"speed": ([1.0, 0.0], [4.0, 4.0])}, "speed: times: expected ascending"),
        ({"orientation": [0.0, 0.0, 0.0]}, "orientation: expected a unit quaternion"),
        ({"orientation": [0.0, 0.0, 0.0, 2.0]}, "orientation: expected a unit quaternion"),
    ],
)
def test_arrays_are_checked_at_the_door(changes: dict[str, Any], message: str) -> None:
    good: dict[str, Any] = {"time": [0.0, 0.1, 0.2], "angular_velocity": np.zeros((3, 3)), "speed": 4.0}
    assert recording_from_arrays(**good).imu.time_ns.tolist() == [0, 100_000_000, 200_000_000]
    with pytest.raises(ParameterError, match=message):
        recording_from_arrays(**{**good, **changes})
