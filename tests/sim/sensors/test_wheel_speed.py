"""Speed by counting frames, as the supplement did, and by the ticks of an encoder."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tms_sim.sensors.wheel_speed import Camera, camera_speed, count_frames, encoder_speed, rolled

CAMERA = Camera(start=1.0, frame_rate=300.0, diameter=0.1, turns=3)
TIME = np.linspace(0.0, 10.0, 10_001)
START = 10**9


def test_speed_is_the_supplements_formula() -> None:
    # At 3.6 m/s three turns take 3 pi 0.1 / 3.6 = 0.2618 s: 78 or 79 frames, v = 3 pi 0.1 / (n / 300).
    wheel = rolled(TIME, np.full(len(TIME), 3.6))
    for seed in range(20):
        speed = camera_speed(wheel, CAMERA, START, np.random.default_rng(seed))
        (count, middle) = count_frames(wheel, CAMERA, np.random.default_rng(seed)) or (0, 0.0)
        assert count in (78, 79)
        assert speed.speed[0] == pytest.approx(3.0 * math.pi * 0.1 / (count / 300.0), rel=1e-14)
        assert speed.variance[0] == pytest.approx((speed.speed[0] / count) ** 2 / 6.0, rel=1e-14)
        # The first edge comes within a turn (0.087 s) of the start; the middle is 0.131 s later.
        assert speed.time_ns[0] == START + round(1e9 * middle)
        assert 1.0 + 0.131 - 0.004 <= middle <= 1.0 + 0.0873 + 0.131 + 0.004


@pytest.mark.parametrize("true_speed", [1.7, 3.6, 5.1])
def test_stated_uncertainty_is_that_of_counting(true_speed: float) -> None:
    # Over launches of slightly different speed the edges fall at random between the frames.
    rng = np.random.default_rng(1)
    errors, stated = [], []
    for _ in range(1000):
        speed = true_speed * rng.uniform(0.95, 1.05)
        found = camera_speed(rolled(TIME, np.full(len(TIME), speed)), CAMERA, START, rng)
        errors.append(found.speed[0] - speed)
        stated.append(found.variance[0])
    expected = math.sqrt(np.mean(stated))
    assert np.std(errors) == pytest.approx(expected, rel=5.0 / math.sqrt(2000.0))
    assert abs(np.mean(errors)) < 5.0 * expected / math.sqrt(1000.0)
    assert np.abs(errors).max() < 2.6 * expected  # never more than a frame: sqrt(6) standard deviations


def test_mean_speed_of_a_coasting_bicycle_belongs_to_the_middle() -> None:
    # C_r = 0.06: slower by 0.5886 m/s each second.
    speed, errors = 3.6 - 0.5886 * TIME[:6001], []
    wheel = rolled(TIME[:6001], speed)
    for seed in range(500):
        found = camera_speed(wheel, CAMERA, START, np.random.default_rng(seed))
        errors.append(found.speed[0] - (3.6 - 0.5886 * (found.time_ns[0] - START) / 1e9))
    assert abs(np.mean(errors)) < 5.0 * np.std(errors) / math.sqrt(500.0)


def test_a_wheel_that_stops_gives_no_speed() -> None:
    wheel = rolled(TIME, np.where(TIME < 1.1, 3.6, 0.0))
    assert len(camera_speed(wheel, CAMERA, START, np.random.default_rng(1)).speed) == 0


def test_encoder_counts_what_rolled_by() -> None:
    times = np.arange(0, 10 * 10**9 + 1, 20_000_000)
    wheel = rolled(TIME, 3.0 + np.sin(TIME))
    found = encoder_speed(wheel, times, 256, 0.1, START, np.random.default_rng(2))
    tick = math.pi * 0.1 / 256
    counts = found.speed * 0.02 / tick
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
    distance = np.concatenate([[0.0], np.cumsum(found.speed * 0.02)])
    expected = np.interp(times / 1e9, wheel.time, wheel.distance)
    assert np.abs(distance - expected).max() <= tick  # errors of counting don't add up
    np.testing.assert_array_equal(found.time_ns, START + times[:-1] + 10_000_000)
    error = found.speed - (3.0 + np.sin((found.time_ns - START) / 1e9))
    assert error.std() == pytest.approx(math.sqrt(found.variance[0]), rel=5.0 / math.sqrt(2.0 * len(error)))
