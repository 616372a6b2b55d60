"""SOM chapter 7: the two-mass skate in closed form, against the general algorithm; chapter 2."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from tms_model import ParameterError, assemble, linear_system, load_bicycle, response, stability, yaw_rate
from tms_model.characteristic import NAMES, coefficients
from tms_model.response import STEER, STEER_RATE
from tms_model.supplement.support_line import STEERINGS, support_line, support_line_of
from tms_model.supplement.two_mass_skate import (
    TwoMassSkate,
    closed_form_coefficients,
    matrices,
    two_mass_skate,
    x2_as_printed,
)

PUBLISHED = yaml.safe_load((Path(__file__).parents[1] / "data" / "two_mass_skate.yaml").read_text())
THEORETICAL = ("tms_table_7_1", "tms_table_7_2")


def random_skates(count: int) -> list[TwoMassSkate]:
    """Skates of any kind: either tilt, masses in front of and behind the wheel and the steer axis."""
    rng = np.random.default_rng(71)
    return [
        TwoMassSkate(
            wheelbase=rng.uniform(0.5, 1.5),
            steer_axis_tilt=rng.uniform(-0.6, 0.6),
            rear_mass=rng.uniform(0.5, 90.0),
            rear_x=rng.uniform(-0.3, 1.6),
            rear_z=-rng.uniform(0.05, 1.5),
            front_mass=rng.uniform(0.1, 20.0),
            front_x=rng.uniform(0.1, 2.0),
            front_z=-rng.uniform(0.05, 1.5),
        )
        for _ in range(count)
    ]


SKATES = [two_mass_skate(load_bicycle(name)) for name in THEORETICAL] + random_skates(40)


@pytest.mark.parametrize("skate", SKATES, ids=range(len(SKATES)))
def test_closed_forms_are_the_general_algorithm(skate: TwoMassSkate) -> None:
    bicycle = assemble("skate", skate.parameters)
    for letter, matrix in matrices(skate).items():
        largest = np.abs(matrix).max()
        np.testing.assert_allclose(bicycle.canonical[letter], matrix, rtol=1e-12, atol=1e-15 * largest)
    general, closed = coefficients(bicycle), closed_form_coefficients(skate)
    assert tuple(closed) == NAMES
    # X2 and C0 are sums that may cancel: to 1e-12 of what is summed.
    sizes = closed_form_sizes(skate)
    for name in NAMES:
        assert general[name] == pytest.approx(closed[name], rel=1e-12, abs=1e-12 * sizes.get(name, 0.0)), name


def closed_form_sizes(skate: TwoMassSkate) -> dict[str, float]:
    """What the sums of C0, E0 and X2 have for terms: the same skate with all terms of one sign, roughly."""
    c = closed_form_coefficients(skate)
    g, m_b, m_h = skate.gravity, skate.rear_mass, skate.front_mass
    length = max(map(abs, (skate.rear_x, skate.rear_z, skate.front_x, skate.front_z, skate.wheelbase)))
    scale = g * m_h * abs(skate.front_arm) * (m_b + m_h) * length**2
    most = abs(c["B1"] * scale * c["D1"]) + abs(c["A0"]) * c["D1"] ** 2 + scale * g / length * c["B1"] ** 2
    return {"C0": scale, "E0": scale * g / length, "X2": most}


@pytest.mark.parametrize("name", THEORETICAL)
def test_printed_x2_is_a_misprint(name: str) -> None:
    # What (7.5) prints, and what (7.1)-(7.4) give: not even the signs agree on table 7.2.
    skate = two_mass_skate(load_bicycle(name))
    printed, true = PUBLISHED["x_2_as_printed"][name], PUBLISHED["x_2"][name]
    assert x2_as_printed(skate) == pytest.approx(printed, abs=0.51e-5)
    assert closed_form_coefficients(skate)["X2"] == pytest.approx(true, rel=5e-4)
    assert coefficients(load_bicycle(name))["X2"] == pytest.approx(true, rel=5e-4)
    # With the printed one, the onset of stability X2 + X4 v^2 = 0 would be elsewhere than the text says.
    x4 = closed_form_coefficients(skate)["X4"]
    onset = math.sqrt(-true / x4)
    assert round(onset, 1) == PUBLISHED["onset"]["printed"][name]
    assert -x2_as_printed(skate) / x4 < 0.0 or abs(math.sqrt(-x2_as_printed(skate) / x4) - onset) > 2.0


@pytest.mark.parametrize("name", THEORETICAL)
def test_e0_vanishes_at_the_lowest_tilt(name: str) -> None:
    # (7.6), and that it is the bound: E0 changes its sign there, all else kept.
    skate = two_mass_skate(load_bicycle(name))
    for offset, sign in ((1e-6, 1.0), (-1e-6, -1.0)):
        tilted = replace(skate, steer_axis_tilt=skate.lowest_tilt + offset)
        assert closed_form_coefficients(tilted)["E0"] * sign * np.sign(tilted.front_arm) > 0.0


def test_lowest_tilt_by_hand() -> None:
    # Table 7.1: 1 kg * 0.02 m / (10 kg * 0.4 m) = 0.005: 0.2865 degrees.
    skate = two_mass_skate(load_bicycle("tms_table_7_1"))
    assert math.degrees(skate.lowest_tilt) == pytest.approx(0.2865, abs=0.5e-4)
    # m_H,max: 10 kg * 0.4 m * tan(5 deg) / 0.02 m = 4 * 0.0874887 / 0.02 = 17.4977 kg.
    (limit,) = skate.most_front_mass(np.array([1.02]))
    assert limit == pytest.approx(17.4977, abs=0.5e-4)
    for mass, sign in ((limit * 1.001, -1.0), (limit * 0.999, 1.0)):
        assert sign * closed_form_coefficients(replace(skate, front_mass=mass))["E0"] > 0.0
    # Behind the front contact there is no limit.
    assert skate.most_front_mass(np.array([0.9]))[0] == math.inf


@pytest.mark.parametrize("name", THEORETICAL)
@pytest.mark.quick_for(name=["tms_table_7_1"])
def test_allowed_regions_are_where_a_bicycle_is_stable(name: str) -> None:
    # Figure 7.3: a light front mass inside the region makes the bicycle self-stable at all high speeds;
    # outside, or too heavy, at none.
    skate = two_mass_skate(load_bicycle(name))
    rng = np.random.default_rng(73)
    inside = outside = heavy = 0
    for x, z in zip(rng.uniform(0.05, 1.6, 400), -rng.uniform(0.02, 1.0, 400), strict=True):
        allowed = all(bool(mask) for mask in skate.conditions(np.array(x), np.array(z)).values())
        limit = float(skate.most_front_mass(np.array(x)))
        mass = min(1.0, 0.5 * limit)
        ranges = stability(
            assemble("tried", replace(skate, front_mass=mass, front_x=x, front_z=z).parameters)
        )
        if allowed:
            inside += 1
            assert math.isinf(ranges.stable_speed_ranges[-1][1])
            if math.isfinite(limit):
                heavy += 1
                fat = replace(skate, front_mass=1.5 * limit, front_x=x, front_z=z)
                assert stability(assemble("heavy", fat.parameters)).stable_speed_ranges == ()
        else:
            outside += 1
            assert ranges.stable_speed_ranges == ()
    assert min(inside, outside, heavy) > 10


def test_vertical_steer_axis_is_never_stable() -> None:
    # SOM chapter 7: 'a theoretical two-mass-skate bicycle with vertical steer axis can never be self-stable'.
    for skate in random_skates(200):
        upright = replace(skate, steer_axis_tilt=0.0)
        assert closed_form_coefficients(upright)["E0"] < 0.0
        assert stability(assemble("upright", upright.parameters)).stable_speed_ranges == ()


def test_conditions_of_chapter_7_follow_from_the_signs() -> None:
    # The geometry of each condition in words is the sign of its coefficient in (7.5).
    for skate in random_skates(200):
        closed = closed_form_coefficients(skate)
        conditions = skate.conditions(np.array(skate.front_x), np.array(skate.front_z))
        for name in ("B1", "C2", "D1"):
            assert bool(conditions[name]) == (closed[name] > 0.0)
        if closed["E0"] > 0.0:
            assert conditions["E0"]
        positive = all(closed[name] > 0.0 for name in ("B1", "C2", "D1"))
        if positive:
            assert closed["X4"] > 0.0  # 'this is assured if B1, D1, and C2 are positive'


@pytest.mark.parametrize("name", ["benchmark", "tms_table_8_1", "tms_eq_10_1"])
def test_only_skates_are_skates(name: str) -> None:
    with pytest.raises(ParameterError, match=r"two-mass skate|matrices only"):
        two_mass_skate(load_bicycle(name))


W, V = 1.1, 4.0


def test_support_line_by_hand() -> None:
    # 4 m/s, wheelbase 1.1 m: v^2 / w = 16 / 1.1 = 14.5455; v / 2 = 2.
    both, parallel, front, rear = (support_line(*STEERINGS[kind], W, V) for kind in STEERINGS)
    assert (both.per_steer, both.per_steer_rate) == (pytest.approx(2 * 14.5455, abs=1e-4), 0.0)  # (2.1)
    assert (parallel.per_steer, parallel.per_steer_rate) == (0.0, 4.0)  # (2.2)
    assert (front.per_steer, front.per_steer_rate) == (pytest.approx(14.5455, abs=5e-5), 2.0)  # (2.3)
    assert (rear.per_steer, rear.per_steer_rate) == (pytest.approx(14.5455, abs=5e-5), -2.0)  # (2.4)


def test_moving_backward_is_steering_the_rear_wheel() -> None:
    # (2.4): 'on a backward-moving bicycle, or equivalently a rear-wheel-steered bicycle'.
    backward = support_line(*STEERINGS["front"], W, -V)
    rear = support_line(*STEERINGS["rear"], W, V)
    assert backward.per_steer == pytest.approx(rear.per_steer)
    assert backward.per_steer_rate == pytest.approx(rear.per_steer_rate)


@pytest.mark.parametrize("kind", STEERINGS)
def test_support_line_along_a_path(kind: str) -> None:
    # Both contacts' paths by numerical integration of where the wheels point; M's acceleration by
    # differences.
    front, rear = STEERINGS[kind]
    step, rate, start = 1e-3, 0.7, 0.02

    def steer(t: float) -> float:
        return start + rate * t

    yaw, y_rear = 0.0, 0.0
    midpoints = []
    for k in range(-2, 4):
        midpoints.append(y_rear + 0.5 * W * yaw)
        middle = steer((k + 0.5) * step)
        yaw_step = step * V * (front - rear) * middle / W
        y_rear += step * V * (yaw + 0.5 * yaw_step + rear * middle)
        yaw += yaw_step
    acceleration = (midpoints[3] - 2.0 * midpoints[2] + midpoints[1]) / step**2
    line = support_line(front, rear, W, V)
    # The path starts at yaw 0: near t = 0 the yaw's own part of v yaw_rate is what c_1 counts.
    assert acceleration == pytest.approx(line.per_steer * start + line.per_steer_rate * rate, abs=2e-3)


@pytest.mark.parametrize("name", ["benchmark", "delft_sbw", "tms_table_8_1"])
def test_support_line_of_a_bicycle_is_that_of_its_motion(name: str) -> None:
    # The rear contact moves sideways with v yaw, the front one is w yaw - c cos(lambda) steer beside it.
    bicycle, speed = load_bicycle(name), 3.6
    line, system = support_line_of(bicycle, speed), linear_system(bicycle, speed)
    states = response(system, np.array([0.02, 0.01, 0.3, -0.2]), np.array([0.0, 1e-4, 2e-4]))
    rates = yaw_rate(system, states)
    sweep = bicycle.trail * math.cos(bicycle.steer_axis_tilt)
    # a_M = v yaw rate + (w yaw'' - c cos(lambda) steer'') / 2
    yaw_acceleration = (rates[2] - rates[0]) / 2e-4
    steer_acceleration = (states[2, STEER_RATE] - states[0, STEER_RATE]) / 2e-4
    measured = speed * rates[1] + 0.5 * (bicycle.wheelbase * yaw_acceleration - sweep * steer_acceleration)
    predicted = line.per_steer * states[1, STEER] + line.per_steer_rate * states[1, STEER_RATE]
    assert predicted == pytest.approx(measured, rel=1e-4)
