"""Floor vibration and padding against the isolator's own formula."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal
from tms_sim.sensors import vibration
from tms_sim.sensors.vibration import Padding, floor_vibration

BARE, PADDED = Padding(0.0, 0.0), Padding(15.0, 0.2)


def transmissibility(frequency: NDArray[np.float64], padding: Padding) -> NDArray[np.complex128]:
    """Sensor's over frame's acceleration (n,) of one mass, spring and damper, for each frequency [Hz]."""
    w, s = 2.0 * math.pi * padding.natural_frequency, 2j * math.pi * frequency
    damping = 2.0 * padding.damping_ratio * w * s
    return (damping + w**2) / (s**2 + damping + w**2)


def test_isolator_by_hand() -> None:
    # At the natural frequency |T| = sqrt(1 + 1 / (2 z)^2); at sqrt(2) times it exactly 1, whatever the
    # damping; at rest 1; far above it falls with 2 z w_n / w.
    ratio = np.abs(transmissibility(np.array([0.0, 15.0, 15.0 * math.sqrt(2.0), 15e4]), PADDED))
    np.testing.assert_allclose(ratio, [1.0, math.sqrt(1.0 + 6.25), 1.0, 0.4e-4], rtol=1e-4)


def test_floor_shakes_the_frame_as_much_as_it_says() -> None:
    felt = floor_vibration(np.full(200_000, 3.6), 4000.0, 2.0, BARE, np.random.default_rng(1))
    assert felt.std() == pytest.approx(2.0, rel=0.03)
    frequency, density = signal.welch(felt, 4000.0, nperseg=4096)
    inside = (frequency > 10.0) & (frequency < 600.0)
    assert density[inside].sum() / density.sum() > 0.97


def test_padding_lets_through_what_its_transmissibility_says() -> None:
    speed = np.full(400_000, 3.6)
    bare, padded = (
        floor_vibration(speed, 4000.0, 2.0, padding, np.random.default_rng(2)) for padding in (BARE, PADDED)
    )
    frequency, cross = signal.csd(bare, padded, 4000.0, nperseg=4096)
    _, density = signal.welch(bare, 4000.0, nperseg=4096)
    shown = (frequency >= 25.0) & (frequency <= 200.0)
    expected = transmissibility(frequency[shown], PADDED)
    # Linear filter of the same noise: the ratio of spectra is the transfer function, but for leakage and the
    # warping of the bilinear transform, (pi f / rate)^2 / 3 < 1 % up to 200 Hz.
    np.testing.assert_allclose(cross[shown] / density[shown], expected, atol=0.02)
    assert padded.std() < 0.4 * bare.std()


def test_vibration_grows_with_the_speed_and_is_absent_at_rest() -> None:
    speed = np.concatenate([np.zeros(4000), np.full(40_000, 7.2)])
    felt = floor_vibration(speed, 4000.0, 1.0, BARE, np.random.default_rng(3))
    assert not felt[:3999].any()
    assert felt[4100:].std() == pytest.approx(2.0, rel=0.05)  # twice the reference speed
    assert not floor_vibration(speed, 100.0, 0.0, PADDED, np.random.default_rng(3)).any()


@pytest.mark.parametrize("rate", [1.0, 30.0, 100.0, 1000.0])
def test_a_slow_sensor_sees_all_of_it_aliased(rate: float) -> None:
    felt = floor_vibration(np.full(4000, 3.6), rate, 2.0, BARE, np.random.default_rng(4))
    assert len(felt) == 4000
    assert felt.std() == pytest.approx(2.0, rel=0.2)


def test_band_lies_where_the_module_says() -> None:
    assert (vibration.LOW, vibration.HIGH) == (20.0, 300.0)
    assert 2.0 * vibration.HIGH < vibration.INNER_RATE
