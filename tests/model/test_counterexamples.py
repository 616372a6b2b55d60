"""SOM chapter 6: every claim on a counterexample, and that each is its parent but for the stated changes."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from tms_model import (
    Bicycle,
    WhippleParameters,
    assemble,
    bicycle_names,
    eigenvalues,
    load_bicycle,
    stability,
    with_parameters,
)
from tms_model.catalogue import FOLDER
from tms_model.characteristic import coefficients

CLAIMS = yaml.safe_load((Path(__file__).parents[1] / "data" / "counterexamples.yaml").read_text())["claims"]
CHILDREN = [name for name in bicycle_names() if name.startswith("counterexample_")]


def parameters(name: str) -> WhippleParameters:
    found = load_bicycle(name).parameters
    assert found is not None
    return found


def sign(value: float) -> str:
    return "positive" if value > 0.0 else "negative" if value < 0.0 else "zero"


@pytest.mark.parametrize("name", CLAIMS)
def test_claims(name: str) -> None:
    claim, bicycle, p = CLAIMS[name], load_bicycle(name), parameters(name)
    ranges = stability(bicycle).stable_speed_ranges
    assert bool(ranges) == claim["stable"]
    for key, speed in (("from", ranges[0][0] if ranges else 0.0), ("to", ranges[0][1] if ranges else 0.0)):
        if key in claim:
            digits = 1 if isinstance(claim[key], float) and math.isfinite(claim[key]) else 0
            assert round(speed, digits) == claim[key] if math.isfinite(speed) else claim[key] == math.inf
    # By the eigenvalues themselves, at speeds from 0 to 30 m/s.
    stable = [(eigenvalues(bicycle, float(v)).real < 0.0).all() for v in np.arange(0.013, 30.0, 0.05)]
    assert any(stable) == claim["stable"]
    assert sign(p.steer_axis_tilt) == claim["tilt"]
    assert {sign(p.rear_spin), sign(p.front_spin)} == {claim["gyro"]}
    if "trail" in claim:
        assert sign(p.trail) == claim["trail"]


def test_all_counterexamples_are_claimed_or_ours() -> None:
    assert {name for name in CLAIMS if name.startswith("counterexample")} == set(CHILDREN) - {
        "counterexample_5_saddle"
    }
    cases = [str(claim["case"]) for claim in CLAIMS.values()]
    assert cases == ["A", "B", "1", "2", "3", "4a", "4b", "5", "6", "7"]


@pytest.mark.parametrize("name", CHILDREN)
def test_children_differ_from_their_parents_as_stated(name: str) -> None:
    document: dict[str, Any] = yaml.safe_load((FOLDER / f"{name}.yaml").read_text())
    parent, child = load_bicycle(document["parent"]).numbers, load_bicycle(name).numbers
    stated = {key.removesuffix("_deg") for key in document["changes"]}
    assert {key for key in child if child[key] != parent.get(key, 0.0)} == stated


def nearly(bicycle: Bicycle, **changes: float) -> bool:
    return bool(stability(with_parameters(bicycle, changes)).stable_speed_ranges)


def test_1_is_lost_by_both_wheels_gyro_alone() -> None:
    # 'The benchmark bicycle entirely loses its stability if it is only changed by the removal of the gyro
    # terms.'
    child = load_bicycle("counterexample_1_no_gyro")
    assert nearly(child, rear_wheel_inertia_yy=0.12, front_wheel_inertia_yy=0.28)
    assert coefficients(child)["E2"] == pytest.approx(0.0, abs=1e-9)


def test_2_moves_the_steer_axis_only() -> None:
    # Wheel contacts and masses stay; the axis meets the ground c behind the front contact's front.
    child, parent = load_bicycle("counterexample_2_negative_trail"), load_bicycle("benchmark")
    np.testing.assert_array_equal(child.mass[0, 0], parent.mass[0, 0])
    assert child.wheelbase == parent.wheelbase
    assert nearly(child, trail=0.08)


def test_3_is_the_mass_of_the_fork() -> None:
    # The fork's mass is in front of the steer axis at 0.9 m, behind it at 0.7 m.
    for name, side in (("benchmark", 1.0), ("counterexample_3_mass_behind_axis", -1.0)):
        p = parameters(name)
        arm = (p.front_frame_x - p.wheelbase - p.trail) * math.cos(p.steer_axis_tilt)
        arm -= p.front_frame_z * math.sin(p.steer_axis_tilt)
        assert arm * side > 0.0
    assert nearly(load_bicycle("counterexample_3_mass_behind_axis"), front_frame_x=0.9)


def test_4_a_needs_its_mass_and_its_tilt_4_b_its_spring() -> None:
    a = load_bicycle("counterexample_4a_negative_trail")
    answer = stability(a)
    assert answer.stable_speed_ranges == (
        (answer.weave_speed, answer.capsize_speed),
    )  # as Figure 6.4 marks it
    assert not nearly(a, front_frame_mass=4.0)
    assert not nearly(a, steer_axis_tilt_deg=18.0)
    assert math.degrees(parameters(a.name).steer_axis_tilt) == pytest.approx(90.0 - 65.0)
    b = load_bicycle("counterexample_4b_decentering_spring")
    answer = stability(b)
    assert answer.stable_speed_ranges == ((answer.weave_speed, answer.capsize_speed),)  # as Figure 6.5
    assert b.steer_elements.steer_spring == -10.0
    assert not nearly(b, steer_spring=0.0)


@pytest.mark.parametrize("mass", [5.0, 8.0, 15.0, 29.0])
def test_4_a_does_not_hang_on_the_mass_we_chose(mass: float) -> None:
    assert nearly(load_bicycle("counterexample_4a_negative_trail"), front_frame_mass=mass)


@pytest.mark.parametrize("trail", [-0.005, -0.02, -0.05])
def test_4_b_does_not_hang_on_the_trail_we_chose(trail: float) -> None:
    assert nearly(load_bicycle("counterexample_4b_decentering_spring"), trail=trail)


def test_5_and_the_signs_the_text_gives_it() -> None:
    # SOM 6.5 says E_0 < 0 and E_2 > 0. On table 7.1 with negative gyro, front mass at 0.2 m as it says, E_0
    # is +1.18, for by (7.5) gyro doesn't enter it. The other entry has the signs.
    as_told = coefficients(load_bicycle("counterexample_5_negative_gyro"))
    assert as_told["E0"] == pytest.approx(1.18, abs=0.005)
    assert as_told["E2"] > 0.0
    assert parameters("counterexample_5_negative_gyro").front_frame_z == -0.2
    saddle = coefficients(load_bicycle("counterexample_5_saddle"))
    assert saddle["E0"] < 0.0 < saddle["E2"]
    p = parameters("counterexample_5_saddle")
    assert (p.front_frame_z, p.front_spin) == (-0.2, p.rear_spin)
    assert p.front_spin < 0.0
    ((low, high),) = stability(load_bicycle("counterexample_5_saddle")).stable_speed_ranges
    assert high - low > 5.0  # 'a large stable forward speed range'
    assert (
        np.linalg.det(load_bicycle("counterexample_5_saddle").stiffness0) < 0.0
    )  # potential energy: a saddle


def test_6_has_the_head_angle_of_the_text() -> None:
    assert 90.0 - math.degrees(parameters("counterexample_6_reverse_tilt").steer_axis_tilt) == pytest.approx(
        95.0
    )


def test_7_is_steered_at_the_rear() -> None:
    p = parameters("counterexample_7_rear_steering")
    axis = p.wheelbase + p.trail  # where the vertical steer axis stands
    assert 0.0 < axis < 0.2 * p.wheelbase  # just in front of the rear wheel
    assert p.front_frame_x > p.wheelbase  # heavy front assembly, its mass in front of the front wheel
    assert p.front_frame_mass > 20.0 * p.rear_frame_mass
    assert p.steer_axis_tilt == 0.0


def test_7_by_its_mirror_image() -> None:
    # The same bicycle told from the other end: frames and wheels exchanged, the steering assembly in front,
    # moving backward. Its eigenvalues at -v are those of the rear-steered bicycle at v.
    p = parameters("counterexample_7_rear_steering")
    swapped = {}
    for one, other in (("rear", "front"), ("front", "rear")):
        for name in ("radius", "mass", "inertia_xx", "inertia_yy"):
            swapped[f"{one}_wheel_{name}"] = getattr(p, f"{other}_wheel_{name}")
        for name in ("z", "mass", "inertia_xx", "inertia_yy", "inertia_zz"):
            swapped[f"{one}_frame_{name}"] = getattr(p, f"{other}_frame_{name}")
        swapped[f"{one}_frame_x"] = p.wheelbase - getattr(p, f"{other}_frame_x")
        swapped[f"{one}_frame_inertia_xz"] = -getattr(p, f"{other}_frame_inertia_xz")
    trail = -p.wheelbase - p.trail  # the axis stays where it is
    mirrored = assemble(
        "mirrored",
        WhippleParameters(p.wheelbase, trail, -p.steer_axis_tilt, p.gravity, **swapped),
    )
    for speed in (1.0, 3.0, 6.0):
        np.testing.assert_allclose(
            eigenvalues(mirrored, -speed),
            eigenvalues(load_bicycle("counterexample_7_rear_steering"), speed),
            rtol=1e-9,
        )
