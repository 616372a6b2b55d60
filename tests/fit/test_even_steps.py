"""A bicycle that slows down evenly: curve over the speed and products in blocks are each step, one by one."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tms_fit.parameters import INITIAL
from tms_fit.response.discretization import discretize
from tms_fit.response.even_steps import even_transitions
from tms_fit.response.prediction import predictor
from tms_model import ParameterError, bicycle_names, load_bicycle
from tms_model.varying_speed import varying_response, varying_system, varying_yaw_rate

LOSS = {"rolling_resistance": 0.05, "speed": 5.0}


@pytest.mark.parametrize("name", bicycle_names())
@pytest.mark.parametrize("step", [0.04, 0.01, 0.001])
@pytest.mark.quick_for(name=["benchmark", "tms_table_8_1", "tms_eq_10_1", "counterexample_7_rear_steering"])
def test_the_curve_over_the_speed_is_every_transition(name: str, step: float) -> None:
    bicycle = load_bicycle(name)
    speeds = 5.0 - 0.5 * step * np.arange(round(1.5 / step) + 41)
    times = step * np.arange(len(speeds))
    try:
        expected = varying_system(bicycle, times, speeds)
    except ParameterError as error:  # such a deceleration lifts a wheel of this one
        with pytest.raises(ParameterError, match=str(error)[:40].replace("(", r"\(")):
            even_transitions(bicycle, speeds[:-1], -0.5, step, "rolling")
        return
    found = even_transitions(bicycle, speeds[:-1], -0.5, step, "rolling")
    assert found is not None
    # 1e-10: the differences of speeds that `varying_system` is given are rounded.
    for one, other in ((found[:, :4, :4], expected.transitions), (found[:, :4, 4], expected.torque_steps)):
        np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-10 * np.abs(other).max())


def test_what_the_curve_does_not_hold_is_left_to_each_step() -> None:
    bicycle = load_bicycle("tms_eq_10_1")
    assert even_transitions(bicycle, np.full(100, 3.0), 0.0, 0.01, "rolling") is None  # constant
    assert even_transitions(bicycle, np.linspace(4.0, 3.9, 12), -0.5, 0.01, "rolling") is None  # few
    assert even_transitions(bicycle, np.linspace(40.0, 1.0, 100), -0.5, 0.4, "rolling") is None  # long steps


@pytest.mark.parametrize("count", [41, 150, 163, 400])
@pytest.mark.parametrize("delay", [0.0, 0.0031])
def test_predictions_are_those_of_one_step_after_the_other(
    make_run: Any, fit_run: Any, count: int, delay: float
) -> None:
    (strike,) = fit_run(make_run("tms_strike", strike__time=1.5037, duration=6.0), window=4.0)
    window = strike.window
    assert window is not None
    rows = slice(0, count)
    window = replace(
        window,
        time=np.arange(count) / 100.0,
        lean_rate=window.lean_rate[rows],
        yaw_rate=window.yaw_rate[rows],
        delay=delay,
    )
    moved = discretize(window, LOSS)
    times = np.append(-delay, window.time) if delay else window.time
    speeds = np.append(5.0, moved.speeds) if delay else moved.speeds
    system = varying_system(window.bicycle, times, speeds)
    states = varying_response(system, np.eye(4))
    expected = np.stack([states[:, 2], varying_yaw_rate(system, states)], axis=1)[-count:]
    found = predictor(window, LOSS).columns[:, :, : len(INITIAL)]
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-11 * np.abs(expected).max())
