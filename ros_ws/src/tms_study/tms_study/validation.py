"""The validation of the estimators: runs whose truth is known, and whether the answers are what they say.

The truth of most runs is made with the estimator's own prediction (`tms_study.trials`), so they judge the
statistics and not the mechanics; the runs of the whole pipeline come from the simulator, which moves the
bicycle by its own code.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from tms_fit.diagnostics.hypothesis_tests import impulse_ratio, run_hypothesis_tests
from tms_fit.estimators.least_squares import fit_window
from tms_fit.kalman.batch import filter_batch, smooth_start
from tms_fit.kalman.state_space import bicycle_space
from tms_fit.parameters import DEFAULT_FREE
from tms_fit.recording_fit import fit_recording
from tms_fit.response.prediction import predictor
from tms_fit.settings import Settings
from tms_fit.window import Window
from tms_model import linear_system, load_bicycle
from tms_model.bicycle import Array
from tms_sim.run import simulate
from tms_sim.scenario import load_scenario

from tms_study import trials
from tms_study.bound import Experiment, bound
from tms_study.findings import Finding

SETTINGS = Settings(free=DEFAULT_FREE, steer_torque="ignore", estimators=("least_squares",))
SQUARES = replace(SETTINGS, noise="white", loss="squares")  # what the batch does
INDEX = DEFAULT_FREE.index("initial_lean_rate")


def validate(rng: np.random.Generator, quick: bool) -> list[Finding]:
    """All findings; `quick` makes fewer runs, in the same way."""
    few, some, many = (30, 60, 2000) if quick else (200, 1000, 10_000)
    return [
        *_white(rng, many),
        *_by_noise(rng, some),
        *_spoilt(rng, some),
        *_filter(rng, some),
        *_pipeline(rng, few),
        *_hypotheses(rng, few),
    ]


def _coverage(topic: str, inside: Array, low: float, high: float) -> Finding:
    runs = len(inside)
    spread = 2.0 * math.sqrt(0.05 * 0.95 / runs)
    return Finding(topic, "95 % intervals that hold the truth", float(inside.mean()), low, high, runs, spread)


def _white(rng: np.random.Generator, runs: int) -> list[Finding]:
    """Linear least squares of many runs in one product, which a few single fits must repeat."""
    window = trials.truth()
    columns = predictor(window).select(DEFAULT_FREE).reshape(-1, len(DEFAULT_FREE))
    clean = window.measured.reshape(-1)
    solver = np.linalg.pinv(columns)
    measured = clean + trials.white(rng, window.time, runs).reshape(runs, -1)
    values = measured @ solver.T
    residual = measured - values @ columns.T
    variance = np.sum(residual**2, axis=1) / (columns.shape[0] - columns.shape[1])
    std = np.sqrt(variance * (solver @ solver.T)[INDEX, INDEX])
    error = values[:, INDEX] - trials.LEAN_RATE
    own = [
        fit_window(trials.with_rates(window, one.reshape(-1, 2)), SQUARES)
        for one in measured[: min(20, runs)]
    ]
    apart = max(abs(one.values[INDEX] - values[k, INDEX]) / one.std[INDEX] for k, one in enumerate(own))
    least = _least(window)
    chance = 1.0 / math.sqrt(2.0 * runs)
    return [
        Finding(
            "white noise", "sd / Cramer-Rao bound", float(np.std(error)) / least, 0.98, 1.02, runs, 2 * chance
        ),
        Finding(
            "white noise",
            "bias / sd",
            float(np.mean(error) / np.std(error)),
            -0.1,
            0.1,
            runs,
            2.0 / math.sqrt(runs),
        ),
        _coverage("white noise", np.abs(error) < own[0].quantile * std, 0.945, 0.955),
        Finding(
            "white noise", "single fits off the batch, standard errors", float(apart), 0.0, 1e-6, len(own)
        ),
    ]


def _least(window: Window) -> float:
    """Cramer-Rao bound [rad/s] of the initial lean rate in a window with white noise."""
    experiment = Experiment(
        trials.RATE, trials.NOISE / math.sqrt(trials.RATE), len(window.time) / trials.RATE, trials.LEAN_RATE
    )
    return bound(load_scenario("tms_strike"), experiment, DEFAULT_FREE).std["initial_lean_rate"]


def _fits(window: Window, noise: Array, settings: Settings = SETTINGS) -> tuple[Array, Array]:
    """Errors [rad/s] of the initial lean rate in runs with noise (r, n, 2), and if the interval holds."""
    found = [fit_window(trials.with_rates(window, window.measured + one), settings) for one in noise]
    error = np.array([one.parameters["initial_lean_rate"] - trials.LEAN_RATE for one in found])
    inside = [one.ci95[INDEX, 0] <= trials.LEAN_RATE <= one.ci95[INDEX, 1] for one in found]
    return error, np.array(inside)


def _by_noise(rng: np.random.Generator, runs: int) -> list[Finding]:
    """Whether intervals hold under noise that is not white, with the default settings."""
    window, found = trials.truth(), []
    for topic, make in (
        ("20 Hz shimmy", trials.shimmy),
        ("AR(1), tau 0.05 s", trials.colored_noise(0.05)),
        ("AR(1), tau 0.2 s", trials.colored_noise(0.2)),
    ):
        error, inside = _fits(window, make(rng, window.time, runs))
        found.append(_coverage(topic, inside, 0.93, 0.97))
        found.append(_bias(topic, error))
    return found


def _bias(topic: str, error: Array) -> Finding:
    share, runs = float(np.mean(error) / np.std(error)), len(error)
    return Finding(topic, "bias / sd", share, -0.1, 0.1, runs, 2.0 / math.sqrt(runs))


def _spoilt(rng: np.random.Generator, runs: int) -> list[Finding]:
    """What outliers, lost packets and clipped samples cost."""
    window = trials.truth()
    least, found = _least(window), []
    cases = {
        "2 % outliers": (trials.outliers(rng, window.time, runs), 1.1),
        "20 % packet loss": (trials.lossy(rng, window.time, runs), 1.02 / math.sqrt(0.8)),
    }
    for topic, (noise, aim) in cases.items():
        error, _ = _fits(window, noise)
        share = float(np.std(error)) / least
        found.append(
            Finding(topic, "sd / bound of the whole run", share, 0.9, aim, runs, share / math.sqrt(runs / 2))
        )
        found.append(_bias(topic, error))
    noisy = window.measured + trials.white(rng, window.time, runs)
    clipped = np.where(np.abs(noisy) < 0.4, noisy, np.nan)
    error, _ = _fits(window, clipped - window.measured)
    off = float(np.mean(error)) / trials.LEAN_RATE
    chance = 2.0 * float(np.std(error)) / math.sqrt(runs) / trials.LEAN_RATE
    found.append(
        Finding("clipped at 0.4 rad/s", "bias, share, samples left out", off, -0.008, 0.008, runs, chance)
    )
    return found


def _filter(rng: np.random.Generator, runs: int) -> list[Finding]:
    """Consistency of the Kalman filter and smoother that know the noise (Bar-Shalom, section 5.4)."""
    time = np.arange(400) / trials.RATE
    system = linear_system(load_bicycle(trials.BICYCLE), trials.SPEED)
    std = np.array([0.02, 0.02, 0.5, 0.5, 0.01, 0.01])
    mean = np.array([0.0, 0.0, trials.LEAN_RATE, 0.0, 0.0, 0.0])
    space = bicycle_space(system, time, (trials.NOISE, trials.NOISE), mean, std)
    start = mean + std * rng.standard_normal((runs, 6))
    state, clean = start.copy(), np.empty((runs, len(time), 2))
    for k, (transition, rows) in enumerate(zip(space.transitions, space.rows, strict=True)):
        state = state @ transition.T
        clean[:, k] = state @ rows.T
    filtered = filter_batch(space, clean + trials.white(rng, time, runs))
    smooth = smooth_start(filtered, list(range(6)), prior=True)
    error = smooth.values - start
    nees = np.einsum("rp,rp->r", error, np.linalg.solve(smooth.covariance, error[:, :, None])[:, :, 0])
    nis = filtered.nis.mean()
    return [
        Finding(
            "Kalman filter",
            "mean NIS of two channels",
            float(nis),
            2.0,
            2.0,
            runs,
            6.0 / math.sqrt(runs * 400),
        ),
        Finding(
            "Kalman smoother",
            "mean NEES of six states",
            float(nees.mean()),
            6.0,
            6.0,
            runs,
            3 * math.sqrt(12 / runs),
        ),
    ]


def _pipeline(rng: np.random.Generator, runs: int) -> list[Finding]:
    """Simulated, found and fitted as a user would, the strike anywhere between two samples."""
    inside, found_at, missed = [], [], 0
    for _ in range(runs):
        when = 1.5 + rng.random() / trials.RATE
        changes = {"strike.time": when, "duration": 3.5, "seed": int(rng.integers(2**31))}
        scenario = load_scenario("tms_strike", changes)
        run = simulate(scenario, np.random.default_rng(scenario.integer("seed")))
        settings = replace(SETTINGS, free=None)
        strikes = fit_recording(run.recording(), load_bicycle(trials.BICYCLE), settings).strikes
        missed += len(strikes) != 1
        if strikes:
            estimate = strikes[0].estimates[0]
            low, high = estimate.ci95[estimate.names.index("initial_lean_rate")]
            inside.append(low <= trials.LEAN_RATE <= high)
            found_at.append(abs((strikes[0].start_ns - run.info.start_ns) / 1e9 - when))
    return [
        Finding(
            "the whole pipeline", "runs without exactly one strike, share", missed / runs, 0.0, 0.0, runs
        ),
        Finding(
            "the whole pipeline", "largest error of the strike's instant [s]", max(found_at), 0.0, 0.01, runs
        ),
        _coverage("the whole pipeline", np.array(inside), 0.93, 0.97),
    ]


def _effects() -> dict[str, tuple[str, Window]]:
    """Hypothesis that is wrong -> its parameter in a verdict, and a window where it is wrong."""
    kick = trials.LEAN_RATE * impulse_ratio(load_bicycle(trials.BICYCLE))
    slipping = trials.truth()
    slip = -0.3 * np.exp(-slipping.time / 0.05)
    return {
        "constant speed": ("rolling_resistance", trials.truth({"rolling_resistance": 0.06})),
        "no steer rate": ("initial_steer_rate", trials.truth({"initial_steer_rate": kick})),
        "no slip": ("slip", replace(slipping, yaw_rate=slipping.yaw_rate + slip)),
        "a level sensor": ("mounting_pitch", trials.truth({"mounting_pitch": 0.05})),
        "no steer feedback": ("lean_rate_gain", trials.truth({"lean_rate_gain": 0.005})),
        "no steer damping": ("steer_damper", trials.truth({"steer_damper": 0.005})),
    }


def _hypotheses(rng: np.random.Generator, runs: int) -> list[Finding]:
    """How often wrong hypotheses are rejected, and right ones."""
    found = []
    each = max(3, runs // 8)
    for hypothesis, (parameter, window) in _effects().items():
        seen = 0
        for noise in trials.white(rng, window.time, each):
            told = run_hypothesis_tests(trials.with_rates(window, window.measured + noise), SETTINGS)
            seen += any(one.rejected for one in told if one.parameter == parameter and one.assumed == 0.0)
        found.append(
            Finding("a wrong hypothesis", f"{hypothesis}: rejected, share", seen / each, 1.0, 1.0, each)
        )
    right = trials.truth()
    noises = {f"AR(1), tau {tau:g} s": trials.colored_noise(tau) for tau in (0.05, 0.2)}
    for topic, make in {"white noise": trials.white, **noises}.items():
        alarms, tested = 0, 0
        for noise in make(rng, right.time, each * 2):
            told = run_hypothesis_tests(trials.with_rates(right, right.measured + noise), SETTINGS)
            judged = [one for one in told if one.assumed == 0.0]
            alarms, tested = alarms + sum(one.rejected for one in judged), tested + len(judged)
        found.append(
            Finding(f"no effect, {topic}", "hypotheses rejected, share", alarms / tested, 0.0, 0.05, tested)
        )
    return found
