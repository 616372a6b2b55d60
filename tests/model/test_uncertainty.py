"""Uncertain parameters: first order against derivatives known otherwise, Monte Carlo against first order."""

from __future__ import annotations

import math
from dataclasses import asdict

import numpy as np
import pytest
from tms_model import (
    Bicycle,
    ParameterError,
    WhippleParameters,
    assemble,
    eigenvalues,
    load_bicycle,
    stability,
)
from tms_model.uncertainty import eigenvalue_uncertainty, sampled, stability_uncertainty

# In the way of a measured bicycle: lengths to a few mm, 0.2 deg, masses to 20 g, inertias to 1 %.
DEVIATIONS = {
    "wheelbase": 0.002,
    "trail": 0.0017,
    "steer_axis_tilt": 0.0035,
    "rear_frame_x": 0.003,
    "front_frame_x": 0.004,
    "front_frame_mass": 0.02,
    "front_wheel_inertia_yy": 0.0028,
    "front_frame_inertia_xz": 0.0002,
}


def uncertain(name: str, deviations: dict[str, float]) -> Bicycle:
    return assemble(name, load_bicycle(name).parameters, standard_deviations=deviations)


def generator() -> np.random.Generator:
    return np.random.default_rng(11)


def test_gravity_alone_worked_by_hand() -> None:
    # Speed goes with the root of gravity: dv / v = dg / (2 g), here 1 %.
    bicycle = uncertain("tms_table_7_1", {"gravity": 0.02 * 9.81})
    onset = stability_uncertainty(bicycle, generator(), 0)["onset_speed"]
    assert onset.value == pytest.approx(2.841008323, rel=1e-9)
    assert onset.std == pytest.approx(0.01 * onset.value, rel=1e-6)
    assert onset.contributions == {"gravity": pytest.approx(onset.std)}
    assert math.isnan(onset.sample_std)
    assert math.isnan(onset.sample_share)


@pytest.mark.parametrize("name", ["benchmark", "delft_sbw"])
def test_first_order_is_the_derivative_of_the_exact_answer(name: str) -> None:
    bicycle = uncertain(name, DEVIATIONS)
    found = stability_uncertainty(bicycle, generator(), 0)
    parameters = asdict(bicycle.parameters)
    for quantity in ("weave_speed", "capsize_speed"):
        for parameter, deviation in DEVIATIONS.items():
            low, high = (
                getattr(
                    stability(
                        assemble(
                            name, WhippleParameters(**{**parameters, parameter: parameters[parameter] + d})
                        )
                    ),
                    quantity,
                )
                for d in (-0.01 * deviation, 0.01 * deviation)
            )
            expected = (high - low) / 0.02
            assert found[quantity].contributions[parameter] == pytest.approx(expected, rel=1e-4), parameter
        squares = sum(part**2 for part in found[quantity].contributions.values())
        assert found[quantity].std == pytest.approx(math.sqrt(squares), rel=1e-12)


def test_samples_agree_with_first_order_when_uncertainties_are_small() -> None:
    # 10,000 samples know a standard deviation to 0.7 %, and the mean to 1 % of it.
    bicycle = uncertain("benchmark", DEVIATIONS)
    for quantity in stability_uncertainty(bicycle, generator()).values():
        assert quantity.sample_share == 1.0
        assert quantity.sample_std == pytest.approx(quantity.std, rel=0.03)
        assert abs(quantity.sample_mean - quantity.value) < 0.1 * quantity.std
        low, high = quantity.interval
        assert high - low == pytest.approx(2.0 * 1.96 * quantity.std, rel=0.05)


@pytest.mark.parametrize("speed", [2.0, 5.0, 8.0])
def test_eigenvalues_by_both_ways(speed: float) -> None:
    bicycle = uncertain("benchmark", DEVIATIONS)
    found = eigenvalue_uncertainty(bicycle, speed, generator())
    roots = np.array([complex(re.value, im.value) for re, im in found])
    np.testing.assert_allclose(roots, eigenvalues(bicycle, speed), rtol=1e-12, atol=1e-13)
    for root, (re, im) in zip(roots, found, strict=True):
        assert re.sample_std == pytest.approx(re.std, rel=0.05)
        if root.imag == 0.0:
            assert (im.std, im.sample_std) == (0.0, 0.0)
        else:
            assert im.sample_std == pytest.approx(im.std, rel=0.05)


def test_first_order_of_an_eigenvalue_against_perturbation_theory() -> None:
    # (M s^2 + v C1 s + g K0 + v^2 K2) q = 0 with left vector p: ds / dg = -p K0 q / p (2 s M + v C1) q.
    bicycle, speed = uncertain("benchmark", {"gravity": 0.01}), 5.0
    for re, im in eigenvalue_uncertainty(bicycle, speed, generator(), 0):
        s = complex(re.value, im.value)
        whole = bicycle.mass * s**2 + bicycle.damping_at(speed) * s + bicycle.stiffness_at(speed)
        left, _, right = np.linalg.svd(whole)
        p, q = left[:, -1].conj(), right[-1].conj()
        slope = -(p @ bicycle.stiffness0 @ q) / (p @ (2.0 * s * bicycle.mass + bicycle.damping_at(speed)) @ q)
        assert re.contributions["gravity"] == pytest.approx(0.01 * slope.real, rel=1e-6, abs=1e-12)
        assert im.contributions["gravity"] == pytest.approx(0.01 * slope.imag, rel=1e-6, abs=1e-12)


def test_a_speed_that_only_some_samples_have() -> None:
    # With its tilt uncertain by 3 degrees, the skate of Table 7.1 may not be stable at any speed.
    bicycle = uncertain("tms_table_7_1", {"steer_axis_tilt": 0.05})
    onset = stability_uncertainty(bicycle, generator())["onset_speed"]
    assert 0.5 < onset.sample_share < 1.0
    assert onset.interval[0] < onset.value < onset.interval[1]


def test_same_seed_same_samples_and_the_bicycle_is_left_as_it_is() -> None:
    bicycle = uncertain("benchmark", DEVIATIONS)
    first, second = (sampled(bicycle, generator(), 5) for _ in range(2))
    for name in DEVIATIONS:
        np.testing.assert_array_equal(first[name], second[name])
    assert bicycle.standard_deviations == DEVIATIONS


def test_what_has_no_uncertainty_is_said() -> None:
    with pytest.raises(ParameterError, match="benchmark: expected standard deviations of its parameters"):
        stability_uncertainty(load_bicycle("benchmark"), generator())
    with pytest.raises(ParameterError, match="samples: expected zero or more, found -1"):
        stability_uncertainty(uncertain("benchmark", DEVIATIONS), generator(), -1)
