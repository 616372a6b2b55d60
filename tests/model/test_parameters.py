"""Parameters that no bicycle has are refused, those that a strange one may have are not."""

from __future__ import annotations

import math
from dataclasses import asdict

import pytest
from tms_model import ParameterError, WhippleParameters, assemble, load_bicycle
from tms_model.parameters import MAY_BE_UNKNOWN, PARAMETER_NAMES


def benchmark(**changes: float) -> WhippleParameters:
    parameters = load_bicycle("benchmark").parameters
    assert parameters is not None
    return WhippleParameters(**{**asdict(parameters), **changes})


NOT_FINITE = [
    (name, value)
    for name in PARAMETER_NAMES
    for value in (math.nan, math.inf, -math.inf)
    if not (math.isnan(value) and name in MAY_BE_UNKNOWN)  # NaN says there that it isn't known
]


@pytest.mark.parametrize(("name", "value"), NOT_FINITE)
def test_every_parameter_must_be_finite(name: str, value: float) -> None:
    with pytest.raises(ParameterError, match=f"{name}: expected a finite number, found {value}"):
        benchmark(**{name: value})


@pytest.mark.parametrize("name", ["wheelbase", "gravity"])
@pytest.mark.parametrize("value", [0.0, -1.0])
def test_wheelbase_and_gravity_must_be_positive(name: str, value: float) -> None:
    with pytest.raises(ParameterError, match=f"{name}: expected a positive number, found {value}"):
        benchmark(**{name: value})


NOT_NEGATIVE = [
    name
    for name in PARAMETER_NAMES
    if name.endswith(("_mass", "_radius", "_inertia_xx", "_inertia_zz"))
    or name in ("rear_frame_inertia_yy", "front_frame_inertia_yy")
]


@pytest.mark.parametrize("name", NOT_NEGATIVE)
def test_masses_radii_and_inertias_are_not_negative(name: str) -> None:
    with pytest.raises(ParameterError, match=f"{name}: expected zero or more, found -0.1"):
        benchmark(**{name: -0.1})


@pytest.mark.parametrize(
    "name", ["trail", "steer_axis_tilt", "rear_frame_inertia_xz", "front_frame_x", "rear_wheel_inertia_yy"]
)
def test_what_may_be_negative(name: str) -> None:
    assemble("odd", benchmark(**{name: -0.01}))


def test_tilt_stays_below_a_right_angle() -> None:
    with pytest.raises(
        ParameterError, match="steer_axis_tilt: expected less than 90 deg either way, found 90 deg"
    ):
        benchmark(steer_axis_tilt=math.pi / 2)


@pytest.mark.parametrize("wheel", ["rear_wheel", "front_wheel"])
def test_a_wheel_without_radius_has_no_spin(wheel: str) -> None:
    with pytest.raises(ParameterError, match=f"{wheel}_radius: expected a positive radius, found 0"):
        benchmark(**{f"{wheel}_radius": 0.0})
    skate = benchmark(**{f"{wheel}_radius": 0.0, f"{wheel}_inertia_yy": 0.0})
    assert getattr(skate, wheel.replace("wheel", "spin")) == 0.0


def test_spin_by_hand() -> None:
    # 0.12 kg m^2 on 0.3 m: 0.4 kg m; 0.28 on 0.35: 0.8.
    assert benchmark().rear_spin == pytest.approx(0.4, rel=1e-15)
    assert benchmark().front_spin == pytest.approx(0.8, rel=1e-15)
