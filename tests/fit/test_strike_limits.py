"""What the detector claims: any sample rate, impulses that last, shimmy, clipping, strikes close together."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tms_fit.strikes.detector import StrikeDetector
from tms_fit.strikes.edge import fit_edge, shimmy_frequency
from tms_fit.strikes.strike import Strike
from tms_model import linear_system, load_bicycle, response

RATES = [25.0, 100.0, 400.0, 1000.0, 4000.0]
DENSITY = 0.002  # [rad/s/sqrt(Hz)] of the lean rate's noise: 0.02 rad/s at 100 Hz


def detected(time: np.ndarray, lean_rate: np.ndarray) -> list[Strike]:
    """Strikes in a stream of lean rates; times in seconds."""
    detector = StrikeDetector()
    stamps = np.round(time * 1e9).astype(np.int64).tolist()
    found = [detector.push(stamp, rate) for stamp, rate in zip(stamps, lean_rate.tolist(), strict=True)]
    return [strike for strike in found if strike is not None]


def struck(time: np.ndarray, end: float, duration: float, change: float) -> np.ndarray:
    """Lean rate of the bicycle under half a sine of force that ends at `end`: a sum of small impulses."""
    system = linear_system(load_bicycle("tms_eq_10_1"), 3.6)
    count = max(1, round(duration / 0.002))
    weights = np.sin(np.pi * (np.arange(count) + 0.5) / count)
    lean_rate = np.zeros(len(time))
    for k, weight in enumerate(weights / weights.sum()):
        when = end - duration + duration * (k + 0.5) / count if duration else end
        after = time >= when
        start = np.array([0.0, 0.0, change * weight, 0.0])
        lean_rate[after] += response(system, start, time[after] - when)[:, 2]
    return lean_rate


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize(
    ("duration", "change"), [(0.0, 0.25), (0.0, -0.8), (0.02, 0.5), (0.02, -0.8), (0.05, 0.8)]
)
@pytest.mark.quick_for(rate=[25.0, 100.0, 400.0], change=[0.25, -0.8, 0.8])
def test_end_of_an_impulse_at_any_sample_rate(rate: float, duration: float, change: float) -> None:
    # Within 10 ms, or half a sample where samples are further apart than that.
    rng = np.random.default_rng(round(rate))
    for _ in range(3):
        time = np.arange(round(3.0 * rate)) / rate
        end = 1.5 + rng.random() / rate
        noise = DENSITY * np.sqrt(rate) * rng.standard_normal(len(time))
        (strike,) = detected(time, struck(time, end, duration, change) + noise)
        assert abs(strike.end_ns / 1e9 - end) < max(0.010, 0.6 / rate)
        assert strike.kind == "strike"
        assert strike.change == pytest.approx(change, abs=0.15 + 0.15 * abs(change))


@pytest.mark.parametrize("rate", [100.0, 400.0, 1000.0])
@pytest.mark.parametrize("change", [0.2, -0.3])
@pytest.mark.quick_for(rate=[100.0])
def test_weak_impulses_of_20_ms_are_dated_by_their_end_not_by_a_peak(rate: float, change: float) -> None:
    rng = np.random.default_rng(round(rate))
    errors = []
    for _ in range(10):
        time = np.arange(round(3.0 * rate)) / rate
        end = 1.5 + rng.random() / rate
        noise = DENSITY * np.sqrt(rate) * rng.standard_normal(len(time))
        found = detected(time, struck(time, end, 0.02, change) + noise)
        errors.append(abs(found[0].end_ns / 1e9 - end) if found else np.inf)
    # 10 ms are less than two standard deviations of the bound at 0.2 rad/s (docs/estimation.md).
    assert np.mean(np.array(errors) < 0.010) >= 0.8
    assert np.median(errors) < 0.006


@pytest.mark.parametrize("change", [0.3, -0.4])
def test_a_shimmy_at_50_hz_hides_no_strike(change: float) -> None:
    # 2.5 samples a period: a mean of whole samples would leave a fifth of it.
    rng = np.random.default_rng(5)
    time = np.arange(150) / 50.0
    for _ in range(5):
        end = 1.5 + 0.02 * rng.random()
        wave = 0.1 * np.sin(2.0 * np.pi * (20.0 * time + rng.random()))
        noise = DENSITY * np.sqrt(50.0) * rng.standard_normal(len(time))
        found = detected(time, struck(time, end, 0.0, change) + wave + noise)
        assert [abs(strike.end_ns / 1e9 - end) < 0.020 for strike in found] == [True]


@pytest.mark.parametrize("shimmy", [0.05, 0.15])
@pytest.mark.parametrize("duration", [0.0, 0.02])
def test_shimmy_does_not_move_the_end(shimmy: float, duration: float) -> None:
    rng = np.random.default_rng(4)
    time = np.arange(400) / 100.0
    for frequency in (17.0, 20.0, 22.5):
        wave = shimmy * np.sin(2.0 * np.pi * (frequency * time + rng.random()))
        end = 2.0 + 0.01 * rng.random()
        noise = 0.02 * rng.standard_normal(len(time))
        (strike,) = detected(time, struck(time, end, duration, 0.5) + wave + noise)
        assert abs(strike.end_ns / 1e9 - end) < 0.010
        assert "shimmy" in strike.why


def test_edge_without_noise_is_exact() -> None:
    # A parabola, a jump of 0.4 over 30 ms that ends at -3 ms, another parabola: just what the fit assumes.
    time = np.arange(-0.3, 0.3, 0.004)
    since = time + 0.003
    share = np.clip(since / 0.03 + 1.0, 0.0, 1.0)
    rate = 0.1 - 0.3 * since + 0.5 * since**2 + 0.2 * (1.0 - np.cos(np.pi * share))
    rate += np.where(since > 0.0, -0.7 * since + 2.0 * since**2, 0.0)
    edge = fit_edge(time, rate)
    assert edge is not None
    assert edge.end == pytest.approx(-0.003, abs=0.0015)
    assert edge.rise == pytest.approx(0.03, abs=0.003)
    assert edge.change == pytest.approx(0.4, abs=0.01)
    assert edge.shimmy == 0.0


def test_shimmy_is_recognised_and_nothing_else() -> None:
    time, rng = np.arange(100) / 100.0, np.random.default_rng(1)
    noise = 0.02 * rng.standard_normal(100)
    assert shimmy_frequency(time, noise + 0.05 * np.sin(2.0 * np.pi * 20.4 * time)) == pytest.approx(
        20.4, abs=0.5
    )
    assert shimmy_frequency(time, noise + 0.5 * np.sin(2.0 * np.pi * 2.0 * time)) == 0.0
    found = [shimmy_frequency(time, 0.02 * rng.standard_normal(100)) for _ in range(200)]
    assert np.mean(np.array(found) > 0.0) < 0.05


@pytest.mark.parametrize("rate", [25.0, 100.0])
@pytest.mark.parametrize("shimmy", [0.0, 0.1])
@pytest.mark.quick_for(rate=[25.0], shimmy=[0.1])
def test_ten_minutes_at_constant_speed_hold_no_strike(rate: float, shimmy: float) -> None:
    # A joint kicks by 0.05 rad/s every two seconds, the shimmy's frequency wanders about 20 Hz.
    rng = np.random.default_rng(7)
    time = np.arange(round(600.0 * rate)) / rate
    wander = 0.7 * np.cumsum(rng.standard_normal(len(time))) / np.sqrt(rate)
    lean_rate = DENSITY * np.sqrt(rate) * rng.standard_normal(len(time))
    lean_rate += shimmy * np.sin(2.0 * np.pi * 20.0 * time + wander)
    kick = struck(np.arange(round(8.0 * rate)) / rate, 0.0, 0.0, 0.05)
    for first in rng.integers(0, len(time) - len(kick), 300):
        lean_rate[first : first + len(kick)] += rng.choice([-1.0, 1.0]) * kick
    assert [strike.why for strike in detected(time, lean_rate)] == []


@pytest.mark.parametrize("rate", [25.0, 100.0, 1000.0])
@pytest.mark.parametrize("second", [-0.7, 0.5, -0.35])
@pytest.mark.parametrize("gap", [0.35, 0.5, 0.7, 1.0])
@pytest.mark.quick_for(rate=[100.0], second=[-0.7, 0.5])
def test_two_strikes_less_than_a_second_apart(rate: float, second: float, gap: float) -> None:
    time = np.arange(round(5.0 * rate)) / rate
    noise = DENSITY * np.sqrt(rate) * np.random.default_rng(3).standard_normal(len(time))
    lean_rate = struck(time, 1.5037, 0.0, 0.5) + struck(time, 1.5037 + gap, 0.0, second) + noise
    ends = [strike.end_ns / 1e9 - 1.5037 for strike in detected(time, lean_rate)]
    assert ends == pytest.approx([0.0, gap], abs=max(0.010, 0.6 / rate))


@pytest.mark.parametrize("limit", [0.3, 0.6])
def test_a_clipped_strike_is_found(limit: float) -> None:
    time = np.arange(400) / 100.0
    noise = 0.02 * np.random.default_rng(2).standard_normal(len(time))
    lean_rate = np.clip(struck(time, 2.0037, 0.0, 2.0) + noise, -limit, limit)
    first = detected(time, lean_rate)[0]
    assert abs(first.end_ns / 1e9 - 2.0037) < 0.010


def test_one_outlier_is_no_strike() -> None:
    rng = np.random.default_rng(11)
    for size in (0.3, 1.0, 5.0):
        time = np.arange(400) / 100.0
        lean_rate = 0.02 * rng.standard_normal(len(time))
        lean_rate[200] += size
        assert [strike.why for strike in detected(time, lean_rate)] == []


@pytest.mark.parametrize("speed", [4.0, 4.289, 4.6])
@pytest.mark.parametrize("kick", [-0.6, -1.2])
@pytest.mark.quick_for(speed=[4.289])
def test_free_response_to_a_steer_kick_is_no_push(
    make_run: Any, fit_run: Any, speed: float, kick: float
) -> None:
    # The lean rate goes on growing for 0.3 s after the strike, steeply.
    run = make_run(
        bicycle="counterexample_4a_negative_trail",
        speed=speed,
        strike__lean_rate=0.3,
        strike__steer_rate=kick,
        strike__time=1.5037,
        duration=6.0,
    )
    found = [one.strike.time_ns - run.info.start_ns for one in fit_run(run, estimators=("least_squares",))]
    assert found == [1_510_000_000]


def test_length_of_an_impulse_is_no_longer_in_the_estimate(make_run: Any, fit_run: Any) -> None:
    # The instant of a strike that is not sharp comes with its uncertainty into the window.
    run = make_run(strike__time=1.5, duration=4.5, imu__rate=1000.0)
    (strike,) = fit_run(run, estimators=("least_squares",), free=("initial_lean_rate",))
    assert strike.window is not None
    assert not strike.strike.sharp
    assert strike.window.delay_std == strike.strike.end_std > 0.0
    assert strike.window.start_ns == strike.strike.end_ns
    plain = replace(strike.window, delay_std=0.0)
    assert plain.start_ns == strike.start_ns
