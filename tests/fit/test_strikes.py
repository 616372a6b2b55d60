"""Strikes: found where there are some, not found in noise, in swings or across gaps."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tms_fit.settings import Settings
from tms_fit.streaming.live_run import LiveRun
from tms_fit.strike_fit import StrikeFit
from tms_fit.strikes.detector import Strike, StrikeDetector
from tms_model import LinearSystem, bicycle_names, linear_system, load_bicycle, response, stability, yaw_rate
from tms_model.frames import flip_axes, quaternion

START_NS = 1_700_000_000_000_000_000
LEVEL = quaternion(0.0, 0.0, 0.0)


def detected(time: np.ndarray, lean_rate: np.ndarray) -> list[Strike]:
    """Strikes in a stream of lean rates; times in seconds."""
    detector = StrikeDetector()
    stamps = START_NS + np.round(time * 1e9).astype(np.int64)
    found = [
        detector.push(stamp, rate) for stamp, rate in zip(stamps.tolist(), lean_rate.tolist(), strict=True)
    ]
    return [strike for strike in found if strike is not None]


def found_by_the_fit(
    name: str, speed: float, time: np.ndarray, states: np.ndarray, noise: float
) -> list[StrikeFit]:
    """Strikes in what a level sensor says of a motion (n, 4)."""
    rng = np.random.default_rng(7)
    yaw = yaw_rate(linear_system(load_bicycle(name), speed), states)
    body = np.stack([states[:, 2], yaw * np.sin(states[:, 0]), yaw * np.cos(states[:, 0])], axis=1)
    readings = flip_axes(body) + noise * rng.standard_normal(body.shape)
    settings = Settings(estimators=("least_squares",))
    online = LiveRun(load_bicycle(name), settings, LEVEL, speed)
    for stamp, reading in zip(
        (START_NS + np.round(time * 1e9).astype(np.int64)).tolist(), readings, strict=True
    ):
        online.add_imu(stamp, reading, np.full(3, np.nan))
    online.finish()
    return [result for result in online.results() if isinstance(result, StrikeFit)]


def after(time_ns: int) -> float:
    return (time_ns - START_NS) / 1e9


@pytest.mark.parametrize("rate", [50.0, 100.0, 400.0])
@pytest.mark.parametrize("noise", [0.0, 0.002, 0.02, 0.1])
@pytest.mark.quick_for(rate=[100.0])
def test_noise_is_no_strike(rate: float, noise: float) -> None:
    time = np.arange(round(15.0 * rate)) / rate
    assert detected(time, noise * np.random.default_rng(3).standard_normal(len(time))) == []


STABLE = [
    (name, low + share * (min(high, 8.0) - low))
    for name in bicycle_names()
    for low, high in stability(load_bicycle(name)).stable_speed_ranges
    for share in (0.05, 0.8)
]


@pytest.mark.parametrize(
    ("name", "speed"), STABLE, ids=lambda value: value if isinstance(value, str) else f"{value:.2f}"
)
@pytest.mark.parametrize("phase", [0.4, 2.0])
@pytest.mark.quick_for(name=["benchmark", "tms_table_8_1", "tms_eq_10_1"])
def test_free_weave_is_no_strike(name: str, speed: float, phase: float) -> None:
    # A recording that begins somewhere in a weave oscillation of 0.6 rad/s, and shows nothing else.
    system = linear_system(load_bicycle(name), speed)
    values, vectors = np.linalg.eig(system.a)
    time = np.arange(400) * 0.01
    for index in np.flatnonzero(values.imag > 0.1):
        mode = vectors[:, index] / np.abs(vectors[2, index])
        states = response(system, 0.6 * np.real(mode * np.exp(1j * phase)), time)
        found = found_by_the_fit(name, speed, time, states, noise=0.01)
        assert [(after(one.strike.time_ns), one.strike.change) for one in found] == []


@pytest.mark.parametrize(
    ("name", "speed"), STABLE, ids=lambda value: value if isinstance(value, str) else f"{value:.2f}"
)
@pytest.mark.parametrize("change", [0.3, -1.0])
@pytest.mark.quick_for(name=["benchmark", "tms_table_8_1", "tms_eq_10_1"])
def test_one_strike_is_one_strike(
    make_run: Any, fit_run: Any, name: str, speed: float, change: float
) -> None:
    # However the bicycle rings on after it.
    run = make_run(bicycle=name, speed=speed, strike__lean_rate=change, strike__time=1.5037, duration=6.0)
    (strike,) = (one.strike for one in fit_run(run, estimators=("least_squares",)))
    assert strike.sharp
    assert (strike.time_ns, strike.before_ns) == (
        run.info.start_ns + 1_510_000_000,
        run.info.start_ns + 1_500_000_000,
    )
    assert strike.onset_ns == strike.before_ns
    assert strike.change == pytest.approx(change, abs=0.25)
    assert strike.noise == pytest.approx(0.02, rel=0.5)


def pushed(
    system: LinearSystem, bicycle: str, begin: float, duration: float, peak: float, time: np.ndarray
) -> np.ndarray:
    """Motion under a lean torque in the shape of half a sine, strong enough for about `peak` rad/s."""
    mass = load_bicycle(bicycle).mass
    column = np.concatenate([np.zeros(2), np.linalg.solve(mass, [1.0, 0.0])])
    strength = peak * math.pi / (2.0 * duration) / column[2]

    def change(now: float, state: np.ndarray) -> np.ndarray:
        inside = begin < now < begin + duration
        torque = strength * math.sin(math.pi * (now - begin) / duration) if inside else 0.0
        return system.a @ state + column * torque

    found = solve_ivp(
        change, (0.0, time[-1]), np.zeros(4), "RK45", time, rtol=1e-8, atol=1e-10, max_step=0.01
    )
    return np.asarray(found.y.T)


@pytest.mark.parametrize(
    ("bicycle", "speed", "gain"),
    [("tms_eq_10_1", 3.6, 0.0), ("benchmark", 5.0, 0.0), ("delft_sbw", 3.0, 7.0), ("delft_sbw", 5.0, 0.0)],
)
@pytest.mark.parametrize("peak", [0.5, -1.2])
@pytest.mark.parametrize("duration", [0.1, 0.2])
@pytest.mark.quick_for(peak=[0.5])
def test_push_by_hand_starts_the_free_response_at_its_peak_or_its_end(
    bicycle: str, speed: float, gain: float, peak: float, duration: float
) -> None:
    # What lasts 0.2 s is a push, known by its peak; what lasts 0.1 s may be told as an impulse, by its end.
    time = np.arange(0.0, 5.0, 0.01)
    states = pushed(linear_system(load_bicycle(bicycle), speed, gain), bicycle, 2.0, duration, peak, time)
    lean_rate = states[:, 2] + 0.02 * np.random.default_rng(5).standard_normal(len(time))
    first = detected(time, lean_rate)[0]
    extremum = time[np.argmax(np.sign(peak) * states[:, 2])]
    if first.kind == "push":
        assert abs(after(first.time_ns) - extremum) < 0.05
        assert first.change == pytest.approx(states[:, 2][np.argmax(np.sign(peak) * states[:, 2])], rel=0.15)
    else:
        assert duration == 0.1
        assert abs(after(first.end_ns) - 2.1) < 0.03
    assert 1.95 <= after(first.onset_ns) <= 2.0 + 0.6 * duration
    assert not first.sharp


@pytest.mark.parametrize("gap", [1.2, 2.0, 3.0])
def test_two_strikes_are_two(make_run: Any, fit_run: Any, gap: float) -> None:
    one = make_run("tms_strike", strike__time=1.5037, duration=8.0, seed=1)
    two = make_run("tms_strike", strike__time=1.5037 + gap, duration=8.0, seed=1, strike__lean_rate=-0.7)
    # Linear motion adds up; so do the noise-free readings of two runs, near upright.
    quiet = make_run("tms_strike", strike__time=7.99, strike__lean_rate=0.0, duration=8.0, seed=1)
    both = one.imu.angular_velocity + two.imu.angular_velocity - quiet.imu.angular_velocity
    run = replace(one, imu=replace(one.imu, angular_velocity=both))
    first, second = fit_run(run, estimators=("least_squares",))
    start = run.info.start_ns + 1_000_000_000
    assert first.strike.time_ns == start + 510_000_000
    assert second.strike.time_ns == start + 510_000_000 + round(gap * 1e9)
    assert first.end_ns <= second.strike.onset_ns  # what the second one moves is not used for the first
    assert first.end_ns - first.strike.time_ns == min(1_500_000_000, round(gap * 1e9) - 10_000_000)


def test_a_step_across_a_gap_is_no_strike() -> None:
    # Half a second is missing; the lean rate may have changed slowly meanwhile.
    time = np.concatenate([np.arange(0.0, 2.0, 0.01), np.arange(2.5, 5.0, 0.01)])
    lean_rate = np.where(time < 2.2, 0.0, 0.6) + 0.01 * np.random.default_rng(1).standard_normal(len(time))
    assert detected(time, lean_rate) == []


def test_missing_samples_do_not_hide_a_strike(make_run: Any) -> None:
    run = make_run("tms_strike", strike__time=2.0037)
    time = (run.imu.time_ns - run.info.start_ns) / 1e9
    lean_rate = run.imu.angular_velocity[:, 0].copy()
    rng = np.random.default_rng(4)
    lean_rate[rng.random(len(time)) < 0.2] = np.nan
    (strike,) = detected(time, lean_rate)
    assert after(strike.before_ns) < 2.0037 < after(strike.time_ns)
    assert after(strike.time_ns) - after(strike.before_ns) < 0.06
    # The same without the samples at all.
    good = np.isfinite(lean_rate)
    assert detected(time[good], lean_rate[good]) == [strike]


def test_strike_after_a_gap_is_found(make_run: Any) -> None:
    run = make_run("tms_strike", strike__time=4.0)
    time = (run.imu.time_ns - run.info.start_ns) / 1e9
    kept = (time < 2.0) | (time > 3.0)
    (strike,) = detected(time[kept], run.imu.angular_velocity[kept, 0])
    assert after(strike.time_ns) == 4.0


def test_nothing_measured_is_no_strike() -> None:
    assert detected(np.arange(0.0, 3.0, 0.01), np.full(300, np.nan)) == []


@pytest.mark.parametrize("time", [0.35, 1.0, 2.0, 7.0])
@pytest.mark.quick_for(time=[0.35, 7.0])
def test_strike_anywhere_in_the_record(make_run: Any, fit_run: Any, time: float) -> None:
    # From the first third of a second on, up to a second before the end.
    (found,) = fit_run(make_run("tms_strike", strike__time=time), estimators=("least_squares",))
    assert found.strike.time_ns == 1_000_000_000 + round(time * 1e9)
    assert found.estimates[0].status == "ok"
