"""The impulse by the bicycle's equations: when it ended, how large it was, and on what it acted."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tms_fit.recording_fit import fit_recording
from tms_fit.settings import Settings
from tms_fit.streaming.live_run import LiveRun
from tms_fit.strike_fit import StrikeFit
from tms_fit.strikes.impulse import fit_impulse
from tms_model import linear_system, load_bicycle, response, yaw_rate
from tms_model.frames import flip_axes, quaternion

BICYCLE = load_bicycle("tms_eq_10_1")
SYSTEM = linear_system(BICYCLE, 3.6)
NOISE = 0.02  # [rad/s] in a sample at 100 Hz
LEVEL = quaternion(0.0, 0.0, 0.0)


def moved(time: np.ndarray, end: float, duration: float, change: np.ndarray) -> np.ndarray:
    """Both rates (n, 2) under half a sine until `end`, as a sum of small changes (lean rate, steer rate)."""
    count = max(1, round(duration / 0.0005))
    weights = np.sin(np.pi * (np.arange(count) + 0.5) / count)
    states = np.zeros((len(time), 4))
    for k, weight in enumerate(weights / weights.sum()):
        when = end - duration * (1.0 - (k + 0.5) / count)
        after = time >= when
        states[after] += response(SYSTEM, np.array([0.0, 0.0, *change]) * weight, time[after] - when)
    return np.stack([states[:, 2], yaw_rate(SYSTEM, states)], axis=1)


@pytest.mark.parametrize("duration", [0.02, 0.05, 0.2])
@pytest.mark.parametrize("steer", [0.0, -0.9])
def test_impulse_without_noise_is_exact(duration: float, steer: float) -> None:
    time = np.arange(-0.5, 0.5, 0.01)
    rates = moved(time, 0.003, duration, np.array([0.3, steer]))
    rates += np.array([0.01, -0.02])  # biases
    middle = 0.003 - duration / 2.0
    found = fit_impulse(time, rates, SYSTEM, (middle - 0.05, middle + 0.05))
    assert found is not None
    assert found.end == pytest.approx(0.003, abs=0.001)
    assert found.length == pytest.approx(duration, abs=0.002)
    assert found.lean_rate == pytest.approx(0.3, abs=0.002)
    assert found.steer_rate == pytest.approx(steer, abs=0.02)
    assert found.misfit < 0.002
    assert not found.sharp
    assert found.push_share == pytest.approx(float(duration > 0.14), abs=1e-6)


@pytest.mark.parametrize("rate", [100.0])
@pytest.mark.parametrize("shaken", [0.0, 0.1])
@pytest.mark.quick_for(shaken=[0.1])
@pytest.mark.long
def test_standard_deviations_are_those_of_the_answers(rate: float, shaken: float) -> None:
    rng = np.random.default_rng(3)
    time = np.arange(-0.5, 0.35, 1.0 / rate)
    off = []
    for _ in range(25):
        end = 0.01 * rng.random()
        rates = moved(time, end, 0.04, np.array([0.3, 0.0]))
        for kick in rng.uniform(-0.4, 0.3, 4) if shaken else ():
            rates += moved(time, kick, 0.0, np.array([0.0, 4.0 * shaken * rng.standard_normal()]))
        rates += NOISE * np.sqrt(rate / 100.0) * rng.standard_normal(rates.shape)
        found = fit_impulse(time, rates, SYSTEM, (-0.07, 0.04), 3.0 * shaken)
        assert found is not None
        off.append([(found.end - end) / found.end_std, (found.lean_rate - 0.3) / found.lean_rate_std])
    spread = np.sqrt(np.mean(np.square(off), axis=0))
    assert (spread > 0.5).all()
    assert (spread < 1.5).all()


def test_without_a_yaw_rate_the_lean_rate_alone_will_do() -> None:
    time = np.arange(-0.5, 0.5, 0.01)
    rates = moved(time, 0.0, 0.03, np.array([0.4, 0.0]))
    rates[:, 1] = np.nan
    rates[::11, 0] = np.nan
    found = fit_impulse(time, rates, SYSTEM, (-0.06, 0.04))
    assert found is not None
    assert found.end == pytest.approx(0.0, abs=0.003)
    assert np.isnan(found.steer_rate)
    assert fit_impulse(time, np.full((100, 2), np.nan), SYSTEM, (-0.06, 0.04)) is None
    assert fit_impulse(time[:8], rates[:8], SYSTEM, (-0.48, -0.45)) is None


def ridden(rates: np.ndarray, time: np.ndarray, seed: int) -> LiveRun:
    """A level sensor's readings of both rates, fed to the fit."""
    rng = np.random.default_rng(seed)
    body = np.stack([rates[:, 0], np.zeros(len(time)), rates[:, 1]], axis=1)
    readings = flip_axes(body) + NOISE * rng.standard_normal(body.shape)
    online = LiveRun(BICYCLE, Settings(estimators=("least_squares",), noise="white"), LEVEL, 3.6)
    for stamp, reading in zip(np.round(1e9 * time).astype(np.int64).tolist(), readings, strict=True):
        online.add_imu(stamp, reading, np.full(3, np.nan))
    online.finish()
    return online


def found_in(online: LiveRun) -> list[StrikeFit]:
    return [one for one in online.results() if isinstance(one, StrikeFit)]


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("impulse", [0.004, -0.003])  # [N m s] about the steer axis: 1.4 and 1 rad/s
@pytest.mark.quick_for(seed=[1])
def test_a_kick_of_the_steering_is_no_strike(impulse: float, seed: int) -> None:
    # Forces of the floor have no lever about the line on which the bicycle leans: M q' = (0, impulse). A lean
    # rate of 0.3 to 0.6 rad/s follows within 0.2 s all the same.
    time = np.arange(0.0, 3.5, 0.01)
    rates = moved(time, 1.5, 0.0, np.linalg.solve(BICYCLE.mass, [0.0, impulse]))
    assert np.ptp(rates[:, 0]) > 0.3
    online = ridden(rates, time, seed)
    assert found_in(online) == []
    assert any("the steering was kicked" in one.why for one in online.rejected)


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.quick_for(seed=[1])
def test_a_strike_that_turns_the_steering_too_is_one(seed: int) -> None:
    # Weak on the lean, 0.2 rad/s, while the steering it turns brings most of what is seen.
    time = np.arange(0.0, 3.5, 0.01)
    rates = moved(time, 1.503, 0.005, np.array([0.2, -1.0]))
    (found,) = found_in(ridden(rates, time, seed))
    assert found.strike.kind == "strike"
    assert abs(found.strike.end_ns / 1e9 - 1.503) < 0.010


def test_an_end_between_two_samples_stays_there_unless_the_equations_exclude_it() -> None:
    # Struck just after a sample: without one within the impulse its length is a guess, and with it the end.
    # In these three of 40 runs the equations alone say 9 to 11 ms too late, which they hold for possible.
    time = np.arange(0.0, 3.0, 0.01)
    rates = moved(time, 1.5007, 0.0005, np.array([0.5, 0.0]))
    for seed in (9, 10, 39):
        (found,) = found_in(ridden(rates, time, seed))
        assert abs(found.start_ns / 1e9 - 1.5007) < 0.005


def test_real_pushes_stay_pushes(make_run: Any) -> None:
    # 0.2 s of a hand, with a yaw rate beside it that the equations explain.
    run = make_run("delft_push", strike__time=2.0, strike__duration=0.2, strike__lean_rate=-0.8)
    settings = Settings(estimators=("least_squares",), noise="white")
    (found,) = fit_recording(run.recording(), load_bicycle(run.info.bicycle), settings).strikes
    assert found.strike.kind == "push"
    assert 2.1 < (found.strike.time_ns - run.info.start_ns) / 1e9 < 2.2
    # Upright at the peak of a push is the wrong model: what it leaves is large, and still gives a covariance.
    (estimate,) = found.estimates
    assert np.linalg.eigvalsh(estimate.covariance).min() > 0.0


@pytest.mark.parametrize("begin", [0.12, 0.25])
@pytest.mark.parametrize("duration", [0.04, 0.2])
def test_what_strikes_early_in_a_recording_is_found(begin: float, duration: float) -> None:
    # The lean rate alone could be that of a recording that begins in mid-swing; both rates tell.
    time = np.arange(0.0, 2.5, 0.01)
    rates = moved(time, begin + duration, duration, np.array([0.8, 0.0]))
    first = found_in(ridden(rates, time, 4))[0].strike
    assert first.kind == ("strike" if duration < 0.1 else "push")
    # A push is dated by the peak of the lean rate, which is not its end.
    assert abs(first.end_ns / 1e9 - begin - duration) < (0.01 if first.kind == "strike" else 0.05)
