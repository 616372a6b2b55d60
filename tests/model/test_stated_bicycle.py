"""A bicycle from the numbers that a recording states: all of it comes back; others are refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tms_model import ParameterError, bicycle_names, load_bicycle
from tms_model.stated_bicycle import LONGEST_NAME, bicycle_from_numbers

WHIPPLE = load_bicycle("benchmark").numbers
MATRICES = load_bicycle("tms_eq_10_1").numbers


@pytest.mark.parametrize("name", bicycle_names())
def test_every_bicycle_comes_back_bit_for_bit(name: str) -> None:
    bicycle = load_bicycle(name)
    again = bicycle_from_numbers(name, bicycle.numbers)
    for letter, matrix in bicycle.canonical.items():
        np.testing.assert_array_equal(again.canonical[letter], matrix)
    assert again.steer_elements == bicycle.steer_elements
    assert again.numbers == bicycle.numbers
    assert (again.parameters is None) == (bicycle.parameters is None)


@pytest.mark.parametrize(
    ("numbers", "said"),
    [
        ({}, "missing wheelbase"),
        ({k: v for k, v in WHIPPLE.items() if k != "trail"}, "missing trail"),
        ({k: v for k, v in MATRICES.items() if k != "K2_steer_steer"}, "missing K2_steer_steer"),
        ({**WHIPPLE, "colour": 1.0}, "unknown colour"),
        ({**WHIPPLE, "M_lean_lean": 1.0}, "unknown rear_wheel_radius"),
        ({**WHIPPLE, "trail": math.nan}, "trail: expected a finite number"),
        ({**WHIPPLE, "rear_frame_inertia_yy": math.inf}, "rear_frame_inertia_yy: expected a finite number"),
        ({**WHIPPLE, "steer_damper": math.nan}, "steer_damper: expected a finite number"),
        ({**WHIPPLE, "rear_frame_mass": -1.0}, "rear_frame_mass: expected zero or more"),
        ({**WHIPPLE, "trail": 1e200}, "trail: expected a finite number of at most 1e+30"),
        ({**MATRICES, "wheelbase": 0.0}, "wheelbase: expected a positive number"),
        ({**MATRICES, "gravity": 0.0}, "gravity: expected a positive number"),
        ({**MATRICES, "M_lean_lean": -1.0}, "positive definite"),
        ({**MATRICES, "M_lean_steer": 0.5}, "symmetric"),
        ({**MATRICES, "K2_lean_lean": 1.0}, "zeros in the first column of K2"),
        ({**MATRICES, "steer_axis_tilt": 1.6}, "steer_axis_tilt: expected less than 90 deg"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_what_is_no_bicycle_is_refused(numbers: dict[str, float], said: str) -> None:
    with pytest.raises(ParameterError) as caught:
        bicycle_from_numbers("mine", numbers)
    assert said in str(caught.value)


def test_its_name_is_the_last_part_and_can_be_printed() -> None:
    assert bicycle_from_numbers("/home/me/bikes/tandem.yaml", WHIPPLE).name == "tandem"
    assert bicycle_from_numbers("a\nb\x1b[31m", WHIPPLE).name == "ab[31m"
    assert len(bicycle_from_numbers("x" * 10_000, WHIPPLE).name) == LONGEST_NAME
