"""What makes an answer doubtful: unknowns that can't be as found, and nothing where the model is right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tms_fit.diagnostics.misspecification import find_misspecification
from tms_fit.estimators.least_squares import fit_window
from tms_fit.gyroscopes import saturated
from tms_fit.noise import oscillator
from tms_fit.settings import Settings
from tms_fit.window import Window
from tms_study import trials

SETTINGS = Settings(steer_torque="ignore", estimators=("least_squares",))


def noisy(values: dict[str, float], seed: int = 1) -> Window:
    window = trials.truth(values)
    return trials.with_rates(
        window, window.measured + trials.white(np.random.default_rng(seed), window.time, 1)[0]
    )


@pytest.mark.parametrize("name", ["lean_rate_bias", "yaw_rate_bias"])
def test_a_bias_that_no_gyroscope_has_is_doubted(name: str) -> None:
    window = noisy({name: -0.12})
    found = find_misspecification(window, SETTINGS, fit_window(window, SETTINGS))
    assert found is not None
    assert found.parameter == name
    assert found.sentence.startswith(f"doubtful: {name} -0.1")
    assert "a gyroscope's bias" in found.sentence
    # Who says that this gyroscope is that far off is believed, and a bias that one may have is no matter.
    stated = Settings(steer_torque="ignore", priors={name: (-0.1, 0.05)})
    assert find_misspecification(window, stated, fit_window(window, stated)) is None
    usual = noisy({name: 0.03})
    assert find_misspecification(usual, SETTINGS, fit_window(usual, SETTINGS)) is None


def test_an_angle_beyond_small_ones_is_doubted() -> None:
    free = Settings(
        steer_torque="ignore",
        noise="white",
        free=("initial_lean_rate", "initial_lean", "lean_rate_bias", "yaw_rate_bias"),
    )
    window = noisy({"initial_lean": 0.7})
    found = find_misspecification(window, free, fit_window(window, free))
    assert found is not None
    assert found.parameter == "initial_lean"


@pytest.mark.parametrize("how", ["drop", "censor", "use"])
def test_readings_beyond_a_stated_range_are_doubted(how: str) -> None:
    largest = float(np.abs(noisy({}).measured).max())
    for part, said in ((0.4, True), (1.5, False)):
        settings = Settings(
            steer_torque="ignore", noise="white", saturation=how, gyroscope_range=part * largest
        )
        window = noisy({})
        signs = saturated(window.measured, part * largest) if how != "use" else None
        window = replace(window, saturated=signs)
        found = find_misspecification(window, settings, fit_window(window, settings))
        doubted = found is not None and "larger than the stated gyroscope range" in found.sentence
        assert doubted == (said and how != "use")
    # Readings at the limit are clipped: nothing to find_misspecification.
    clipped = np.clip(noisy({}).measured, -0.7 * largest, 0.7 * largest)
    window = replace(trials.with_rates(noisy({}), clipped), saturated=saturated(clipped, 0.7 * largest))
    settings = Settings(
        steer_torque="ignore", noise="white", saturation="censor", gyroscope_range=0.7 * largest
    )
    assert find_misspecification(window, settings, fit_window(window, settings)) is None


def test_right_answers_and_rounding_raise_no_doubt() -> None:
    for seed in range(20):
        window = noisy({}, seed)
        assert find_misspecification(window, SETTINGS, fit_window(window, SETTINGS)) is None
    # A sensor without noise: what is left remembers, but is rounding.
    window = trials.truth()
    left = 1e-12 * np.sin(3.0 * window.time)[:, None] * np.ones(2)
    ideal = trials.with_rates(window, window.measured + left)
    assert find_misspecification(ideal, SETTINGS, fit_window(ideal, SETTINGS)) is None


def test_no_oscillation_is_slower_than_the_bicycles_own_motion() -> None:
    # 2 Hz over a third of a second, as where the bicycle falls: the grid went down to it from its first 5 Hz.
    time = np.arange(34) / 100.0
    noise = 0.02 * np.random.default_rng(3).standard_normal((34, 2))
    residual = 1.5 * np.sin(2.0 * np.pi * 2.0 * time)[:, None] + noise
    found = oscillator.fit(time, residual, np.zeros((34, 2, 0)))
    told = [value for name, value in found.parameters.items() if name.endswith("_frequency")]
    assert told
    assert min(told) >= oscillator.MIN_FREQUENCY_HZ
