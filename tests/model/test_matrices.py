"""What the matrices of every bicycle must be, whatever its numbers."""

from __future__ import annotations

import math
from dataclasses import asdict, replace

import numpy as np
import pytest
from tms_model import (
    Bicycle,
    ParameterError,
    SteerElements,
    WhippleParameters,
    assemble,
    bicycle_names,
    eigenvalues,
    load_bicycle,
)

ASSEMBLED = [name for name in bicycle_names() if load_bicycle(name).parameters is not None]


def parameters(name: str) -> WhippleParameters:
    found = load_bicycle(name).parameters
    assert found is not None
    return found


@pytest.mark.parametrize("name", bicycle_names())
def test_mass_and_gravity_matrices_are_symmetric(name: str) -> None:
    bicycle = load_bicycle(name)
    np.testing.assert_allclose(bicycle.mass, bicycle.mass.T, rtol=1e-14)
    np.testing.assert_allclose(bicycle.stiffness0, bicycle.stiffness0.T, rtol=1e-14)
    assert np.linalg.eigvalsh(bicycle.mass).min() > 0.0


@pytest.mark.parametrize("name", bicycle_names())
def test_lean_alone_turns_no_corner(name: str) -> None:
    # An upright bicycle that leans without steering runs straight: no speed-dependent stiffness, no damping
    # of lean by lean.
    bicycle = load_bicycle(name)
    np.testing.assert_array_equal(bicycle.stiffness2[:, 0], 0.0)
    assert bicycle.damping[0, 0] == 0.0


@pytest.mark.parametrize("name", ASSEMBLED)
def test_twice_the_mass_moves_the_same(name: str) -> None:
    heavy = {
        key: 2.0 * value if "mass" in key or "inertia" in key else value
        for key, value in asdict(parameters(name)).items()
    }
    light, doubled = load_bicycle(name), assemble("heavy", WhippleParameters(**heavy))
    for letter, matrix in light.canonical.items():
        np.testing.assert_allclose(doubled.canonical[letter], 2.0 * matrix, rtol=1e-13, atol=1e-15)


@pytest.mark.parametrize("name", ASSEMBLED)
def test_four_times_the_size_moves_at_half_the_pace(name: str) -> None:
    # Under the same gravity, lengths times 4 make times and speeds twice as long (a pendulum of 4 m swings
    # half as fast as one of 1 m): inertias times 16, speed times 2, eigenvalues times 1/2.
    def scaled(key: str, value: float) -> float:
        if "inertia" in key:
            return 16.0 * value
        return value if "mass" in key or key in ("gravity", "steer_axis_tilt") else 4.0 * value

    large = {key: scaled(key, value) for key, value in asdict(parameters(name)).items()}
    small = load_bicycle(name)
    # Torque per angle goes with weight times length, times 4; torque per angular rate once more with time,
    # times 8.
    elements = SteerElements(
        steer_spring=4.0 * small.steer_elements.steer_spring,
        steer_damper=8.0 * small.steer_elements.steer_damper,
        lean_gain=4.0 * small.steer_elements.lean_gain,
        lean_rate_gain=8.0 * small.steer_elements.lean_rate_gain,
    )
    bicycle = assemble("large", WhippleParameters(**large), steer_elements=elements)
    for speed in (1.0, 3.6, 7.3):
        np.testing.assert_allclose(
            2.0 * eigenvalues(bicycle, 2.0 * speed),
            eigenvalues(small, speed),
            rtol=1e-9,
            atol=1e-9,
        )


def lumped(p: WhippleParameters) -> WhippleParameters:
    """The same bicycle, the mass and diametral inertia of each wheel given to its frame (parallel axes)."""

    def together(body: str, wheel: str, wheel_x: float) -> dict[str, float]:
        v = asdict(p)
        m_1, x_1, z_1 = v[f"{body}_mass"], v[f"{body}_x"], v[f"{body}_z"]
        m_2, x_2, z_2 = v[f"{wheel}_mass"], wheel_x, -v[f"{wheel}_radius"]
        m = m_1 + m_2
        x, z = (m_1 * x_1 + m_2 * x_2) / m, (m_1 * z_1 + m_2 * z_2) / m
        wheel_inertia = v[f"{wheel}_inertia_xx"]  # about any diameter
        return {
            f"{body}_mass": m,
            f"{body}_x": x,
            f"{body}_z": z,
            f"{body}_inertia_xx": v[f"{body}_inertia_xx"]
            + wheel_inertia
            + m_1 * (z_1 - z) ** 2
            + m_2 * (z_2 - z) ** 2,
            f"{body}_inertia_zz": v[f"{body}_inertia_zz"]
            + wheel_inertia
            + m_1 * (x_1 - x) ** 2
            + m_2 * (x_2 - x) ** 2,
            f"{body}_inertia_xz": v[f"{body}_inertia_xz"]
            - m_1 * (x_1 - x) * (z_1 - z)
            - m_2 * (x_2 - x) * (z_2 - z),
            f"{wheel}_mass": 0.0,
            f"{wheel}_inertia_xx": 0.0,
        }

    return replace(
        p, **together("rear_frame", "rear_wheel", 0.0), **together("front_frame", "front_wheel", p.wheelbase)
    )


@pytest.mark.parametrize("name", ASSEMBLED)
def test_bodies_that_move_together_count_as_one(name: str) -> None:
    # But for its spin, a wheel moves with its frame.
    whole, parts = assemble("lumped", lumped(parameters(name))), load_bicycle(name)
    for letter, matrix in parts.canonical.items():
        np.testing.assert_allclose(whole.canonical[letter], matrix, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("name", ASSEMBLED)
def test_mass_at_the_contact_points_does_not_matter(name: str) -> None:
    # SOM chapter 7: "an extra point mass can be added exactly at either contact point with no effect". At the
    # rear one for any bicycle; a point mass at height 0 and x = 0 joins the rear frame.
    p = parameters(name)
    m, extra = p.rear_frame_mass, 5.0
    share = m / (m + extra)
    x, z = share * p.rear_frame_x, share * p.rear_frame_z
    heavier = replace(
        p,
        rear_frame_mass=m + extra,
        rear_frame_x=x,
        rear_frame_z=z,
        rear_frame_inertia_xx=p.rear_frame_inertia_xx + m * (p.rear_frame_z - z) ** 2 + extra * z**2,
        rear_frame_inertia_zz=p.rear_frame_inertia_zz + m * (p.rear_frame_x - x) ** 2 + extra * x**2,
        rear_frame_inertia_xz=p.rear_frame_inertia_xz
        - m * (p.rear_frame_x - x) * (p.rear_frame_z - z)
        - extra * x * z,
    )
    for letter, matrix in load_bicycle(name).canonical.items():
        np.testing.assert_allclose(
            assemble("heavier", heavier).canonical[letter], matrix, rtol=1e-12, atol=1e-13
        )


def test_spin_of_the_front_wheel_by_hand() -> None:
    # A front wheel of spin inertia 0.28 and radius 0.35 at v: angular momentum 0.28 v / 0.35 = 0.8 v, to the
    # right. Steering right at rate 1 about a steer axis tilted by lambda turns it: lean moment 0.8 v
    # cos(lambda) in C1; leaning turns it back on the steering with the same number. Trail, which adds (c / w)
    # cos(lambda) of the whole bicycle, is set to zero.
    p = replace(parameters("benchmark"), trail=0.0, rear_wheel_inertia_yy=0.0)
    with_spin, without = assemble("a", p), assemble("b", replace(p, front_wheel_inertia_yy=0.0))
    difference = with_spin.damping - without.damping
    expected = 0.8 * math.cos(math.radians(18.0))
    np.testing.assert_allclose(difference, [[0.0, expected], [-expected, 0.0]], rtol=1e-12, atol=1e-14)


def test_negative_spin_is_a_counter_rotating_flywheel() -> None:
    # One that turns the other way as fast undoes the wheel: as good as none.
    p = parameters("tms_table_8_1")
    undone = replace(p, rear_wheel_inertia_yy=-1.8e-5, front_wheel_inertia_yy=0.0)
    still = replace(p, rear_wheel_inertia_yy=0.0, front_wheel_inertia_yy=0.0)
    assert undone.rear_spin == -parameters("tms_table_8_1").front_spin
    # S_T enters K2 of lean alone when S_F = 0 and the trail is 0.
    difference = (
        assemble("a", replace(undone, trail=0.0)).stiffness2
        - assemble("b", replace(still, trail=0.0)).stiffness2
    )
    assert difference[0, 1] == pytest.approx(-1.8e-5 / 0.05 / 0.75 * math.cos(math.radians(7.0)), rel=1e-9)


@pytest.mark.parametrize(
    "changes",
    [
        {"front_frame_mass": 0.0},  # nothing at the steering: steer alone moves no mass
        {"rear_frame_z": 0.0, "front_frame_z": 0.0},  # all mass on the ground line
    ],
    ids=["massless steering", "mass on the ground"],
)
def test_singular_mass_is_refused(changes: dict[str, float]) -> None:
    with pytest.raises(ParameterError, match="positive definite"):
        assemble("singular", replace(parameters("tms_table_7_1"), **changes))


def test_matrices_with_swapped_coordinates_are_refused() -> None:
    good = load_bicycle("tms_eq_10_1")
    swapped = {key: matrix[::-1, ::-1] for key, matrix in good.canonical.items()}
    with pytest.raises(ParameterError, match="K2"):
        Bicycle(
            "swapped",
            swapped["M"],
            swapped["C1"],
            swapped["K0"],
            swapped["K2"],
            good.wheelbase,
            good.trail,
            good.steer_axis_tilt,
            good.gravity,
        )
