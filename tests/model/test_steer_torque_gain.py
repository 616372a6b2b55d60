"""How much of a known steer torque arrives at the fork belongs to the bicycle, as springs and dampers do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tms_model import (
    LinearSystem,
    ParameterError,
    SteerElements,
    linear_system,
    load_bicycle,
    response,
    with_parameters,
)
from tms_model.nonlinear_response import nonlinear_response
from tms_model.varying_speed import varying_response, varying_system

TIMES = np.arange(0.0, 1.0, 0.02)
TORQUE = np.sin(7.0 * TIMES)
START = np.array([0.01, -0.02, 0.1, 0.2])
WEAK = with_parameters(load_bicycle("benchmark"), {"steer_torque_gain": 0.8})


def test_a_command_of_which_a_share_arrives_is_a_smaller_command() -> None:
    weak, whole = (
        linear_system(one, 5.0, gain) for one, gain in ((WEAK, 10.0), (load_bicycle("benchmark"), 8.0))
    )
    np.testing.assert_allclose(weak.a, whole.a, rtol=1e-14)
    np.testing.assert_allclose(weak.b, 0.8 * whole.b, rtol=1e-14)
    np.testing.assert_allclose(
        response(weak, START, TIMES, TORQUE), response(whole, START, TIMES, 0.8 * TORQUE), rtol=1e-12
    )


def test_the_bicycles_own_elements_act_at_the_fork_and_are_not_scaled() -> None:
    elements = SteerElements(-2.0, 0.5, 3.0, 4.0)
    free, scaled = (
        linear_system(replace(load_bicycle("benchmark"), steer_elements=one), 5.0)
        for one in (elements, replace(elements, steer_torque_gain=0.3))
    )
    np.testing.assert_array_equal(free.a, scaled.a)


def test_changing_speed_and_nonlinear_motion_know_it_too() -> None:
    expected = response(linear_system(WEAK, 5.0), START, TIMES, TORQUE)
    system = varying_system(WEAK, TIMES, np.full(len(TIMES), 5.0))
    np.testing.assert_allclose(varying_response(system, START, TORQUE), expected, atol=1e-12)
    small = 1e-5
    whole = nonlinear_response(
        WEAK, np.append(small * START, 5.0), TIMES, steer_torque=small * TORQUE, tolerance=1e-12
    )
    np.testing.assert_allclose(whole.states[:, :4] / small, expected, atol=2e-5)


def test_it_is_one_of_the_numbers_only_where_it_does_something() -> None:
    assert WEAK.numbers["steer_torque_gain"] == 0.8
    assert "steer_torque_gain" not in load_bicycle("benchmark").numbers
    assert not SteerElements().present
    assert SteerElements(steer_torque_gain=0.0).acting == {"steer_torque_gain": 0.0}
    with pytest.raises(ParameterError, match="steer_torque_gain: expected a finite number"):
        SteerElements(steer_torque_gain=float("nan"))
    assert isinstance(linear_system(WEAK, 5.0), LinearSystem)
