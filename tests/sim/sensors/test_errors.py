"""Each error of a sensor is as large as its parameter says, found by the Allan deviation or by hand."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tms_sim.imu_grade import ERRORS, ImuGrade, SensorErrors, imu_names, load_imu
from tms_sim.sensors.errors import measure

RATE = 100.0


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


def allan_deviation(values: np.ndarray, count: int) -> float:
    """Allan deviation (all axes together) of means over `count` samples, not overlapping (IEEE Std 952)."""
    blocks = values[: len(values) // count * count].reshape(-1, count, values.shape[1]).mean(axis=1)
    return float(np.sqrt(0.5 * np.mean(np.diff(blocks, axis=0) ** 2)))


@pytest.mark.parametrize("triad", ["gyroscope", "accelerometer", "magnetometer"])
@pytest.mark.parametrize("name", sorted(set(imu_names()) - {"ideal"}))
def test_allan_deviation_of_white_noise(name: str, triad: str) -> None:
    errors = SensorErrors(noise_density=getattr(load_imu(name), triad).noise_density)
    values = measure(np.zeros((200_000, 3)), errors, RATE, rng()).values
    for count in (1, 10, 100):
        blocks = 3 * len(values) / count
        # Of m differences, neighbours correlated by -1/2: relative error sqrt(3 / 4 / m); five of it.
        expected = errors.noise_density / math.sqrt(count / RATE)
        assert allan_deviation(values, count) == pytest.approx(expected, rel=5.0 * math.sqrt(0.75 / blocks))


@pytest.mark.parametrize("triad", ["gyroscope", "accelerometer"])
@pytest.mark.parametrize("name", sorted(set(imu_names()) - {"ideal"}))
def test_allan_deviation_of_the_random_walk(name: str, triad: str) -> None:
    errors = SensorErrors(random_walk=getattr(load_imu(name), triad).random_walk)
    values = measure(np.zeros((400_000, 3)), errors, RATE, rng()).values
    for count in (50, 500):
        blocks = 3 * len(values) / count
        # Means over `count` samples of a walk in steps: K sqrt(T / 3) with the factor 1 + 1 / (2 count^2).
        expected = errors.random_walk * math.sqrt(count / RATE / 3.0) * math.sqrt(1.0 + 0.5 / count**2)
        assert allan_deviation(values, count) == pytest.approx(expected, rel=5.0 * math.sqrt(0.75 / blocks))


def test_bias_scale_and_misalignment_are_drawn_once_a_run() -> None:
    errors = SensorErrors(bias=0.2, scale=0.03, misalignment=0.01)
    drawn = [measure(np.eye(3), errors, RATE, rng(seed)).imperfection for seed in range(2000)]
    biases, matrices = np.array([d.bias for d in drawn]), np.array([d.matrix for d in drawn]) - np.eye(3)
    five = 5.0 / math.sqrt(2 * 2000)
    np.testing.assert_allclose(biases.std(axis=0), 0.2, rtol=five)
    for row in range(3):
        for column in range(3):
            expected = 0.03 if row == column else 0.01
            np.testing.assert_allclose(matrices[:, row, column].std(), expected, rtol=five)
    truth = rng().standard_normal((50, 3))
    reading = measure(truth, errors, RATE, rng(3))
    np.testing.assert_allclose(
        reading.values, truth @ drawn[3].matrix.T + drawn[3].bias, atol=1e-14
    )  # the same at every sample, by the matrix product


def test_rounding_by_hand() -> None:
    reading = measure(np.array([[0.12, -0.13, 0.049]]), SensorErrors(resolution=0.1), RATE, rng())
    np.testing.assert_allclose(reading.values, [[0.1, -0.1, 0.0]], atol=1e-15)


def test_cut_off_by_hand() -> None:
    truth = np.array([[0.5, -2.0, 3.0], [1.0, -1.0, 0.0]])
    reading = measure(truth, SensorErrors(limit=1.0), RATE, rng())
    np.testing.assert_array_equal(reading.values, [[0.5, -1.0, 1.0], [1.0, -1.0, 0.0]])
    # At the limit counts as cut: the sensor can't tell.
    np.testing.assert_array_equal(reading.cut, [[False, True, True], [True, True, False]])


@pytest.mark.parametrize("seed", [1, 2])
def test_share_of_cut_samples_is_that_of_the_normal_distribution(seed: int) -> None:
    # Noise of deviation 1 about 0.3, limit 1.5: P(|x| >= 1.5) = Phi(-1.2) + Phi(-1.8) = 0.1151 + 0.0359.
    errors = SensorErrors(noise_density=0.1, limit=1.5)
    cut = measure(np.full((100_000, 3), 0.3), errors, RATE, rng(seed)).cut
    assert cut.mean() == pytest.approx(0.1510, abs=5.0 * math.sqrt(0.151 * 0.849 / cut.size))


SIZES = st.floats(0.0, 2.0)


@settings(max_examples=100, deadline=None)
@given(
    errors=st.builds(
        SensorErrors, SIZES, SIZES, SIZES, st.floats(0.0, 0.1), st.floats(0.0, 0.1),
        st.sampled_from([0.0, 0.01, 0.3]), st.floats(0.1, 5.0) | st.just(math.inf),
    ),
    seed=st.integers(0, 2**32),
)  # fmt: skip
def test_flags_stand_exactly_where_a_reading_is_cut(errors: SensorErrors, seed: int) -> None:
    truth = 3.0 * rng(seed).standard_normal((40, 3))
    cut = measure(truth, errors, RATE, rng(seed))
    free = measure(truth, dataclasses.replace(errors, limit=math.inf), RATE, rng(seed))
    assert np.isfinite(cut.values).all()
    np.testing.assert_array_equal(cut.cut, np.abs(free.values) >= errors.limit)
    np.testing.assert_array_equal(cut.values[~cut.cut], free.values[~cut.cut])
    np.testing.assert_array_equal(
        cut.values[cut.cut], errors.limit * np.sign(free.values[cut.cut]) if cut.cut.any() else []
    )


def test_without_errors_the_reading_is_the_truth() -> None:
    truth = rng().standard_normal((100, 3))
    for errors in (SensorErrors(), *(getattr(load_imu("ideal"), t) for t in ("gyroscope", "magnetometer"))):
        reading = measure(truth, errors, RATE, rng())
        np.testing.assert_array_equal(reading.values, truth)
        assert not reading.cut.any()


@pytest.mark.parametrize("error", ERRORS)
def test_errors_are_switched_one_by_one_and_leave_the_others_draws_alone(error: str) -> None:
    node = load_imu("pi_node")
    alone = node.only([error]).accelerometer
    assert getattr(alone, error) == getattr(node.accelerometer, error)
    assert all(getattr(alone, other) == getattr(SensorErrors(), other) for other in ERRORS if other != error)
    truth = np.zeros((30, 3))
    linear = ("noise_density", "random_walk", "bias")
    parts = {name: measure(truth, node.only([name]).gyroscope, RATE, rng()).values for name in linear}
    whole = measure(truth, node.only(linear).gyroscope, RATE, rng()).values
    np.testing.assert_allclose(whole, sum(parts.values()), atol=1e-15)


@pytest.mark.parametrize("name", imu_names())
def test_every_grade_loads(name: str) -> None:
    sensor = load_imu(name)
    assert isinstance(sensor, ImuGrade)
    assert sensor.update_rate > 0.0
    assert sensor.only(ERRORS) == sensor
