"""How fast strikes are fitted, against scipy and lmfit in the same run. See benchmarks/README.md."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace

import numpy as np
from measure import by_processor, in_turn, print_machine, print_timings
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares
from tms_fit.estimators.least_squares import fit_window
from tms_fit.response.prediction import predictor
from tms_fit.settings import Settings
from tms_fit.speed_profile import constant_speed
from tms_fit.window import Window
from tms_model import linear_system, load_bicycle
from tms_model.exponential import expm

try:
    import lmfit
except ImportError:
    sys.exit("benchmarks/estimation.py needs lmfit: pip install lmfit")

Array = NDArray[np.float64]
BICYCLE = load_bicycle("tms_eq_10_1")
TRUTH = {"initial_lean_rate": 0.5, "speed": 3.6}
FIRST = np.array([0.4, 3.5])  # where the peers begin: lean rate [rad/s], speed [m/s]
NOISE = 0.02  # [rad/s]
NAIVE, HOISTED, LMFIT = (
    "scipy, solve_ivp in the residual",
    "scipy, hoisted, errors as ours",
    "lmfit, exact model",
)
WINDOW = "tms_fit, fit_window"
SETTINGS = Settings(free=("initial_lean_rate", "speed"), noise="white")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few repeats and small sizes: does it run?")
    parser.add_argument("--samples", type=int, default=400, help="of a run, 100 a second (default 400)")
    arguments = parser.parse_args()
    samples, repeats = (100, 3) if arguments.quick else (arguments.samples, 21)
    print_machine(("numpy", "scipy", "lmfit"))
    print(f"initial lean rate and speed from {samples} samples of two channels")
    print(f"processor time, medians of {repeats} repeats")
    window = clean_window(samples)
    measured = window.measured + NOISE * np.random.default_rng(1).standard_normal((samples, 2))
    compare(replace(window, lean_rate=measured[:, 0], yaw_rate=measured[:, 1]), repeats)


def compare(window: Window, repeats: int) -> None:
    """Print the time of each method, and by how many standard errors the methods differ."""
    time_s, measured = window.time, window.measured
    peers = {
        NAIVE: lambda: by_scipy(time_s, measured),
        HOISTED: lambda: by_hoisted_scipy(time_s, measured),
        LMFIT: lambda: by_lmfit(time_s, measured),
    }
    timings = in_turn({**peers, WINDOW: lambda: fit_window(window, SETTINGS)}, repeats)
    print_timings("initial lean rate and speed", by_processor(timings), NAIVE)
    best = fit_window(window, SETTINGS)
    print("\nlargest difference to fit_window, in standard errors")
    for name, method in peers.items():
        print(f"  {name:44} {np.abs((method() - best.values) / best.std).max():.1e}")


def clean_window(count: int) -> Window:
    """A strike without noise, 100 samples a second."""
    absent = np.full(count, np.nan)
    window = Window(0, np.arange(count) / 100.0, absent, absent, BICYCLE, constant_speed(TRUTH["speed"]))
    rates = predictor(window).predict(TRUTH)
    return replace(window, lean_rate=rates[:, 0], yaw_rate=rates[:, 1])


def by_scipy(time_s: Array, measured: Array) -> Array:
    """As most would write it: matrices and integration in the residual, tolerances a little tightened."""

    def residual(values: Array) -> Array:
        lean_rate, speed = values
        damping = speed * BICYCLE.damping
        stiffness = BICYCLE.gravity * BICYCLE.stiffness0 + speed**2 * BICYCLE.stiffness2

        def slope(_: float, state: Array) -> Array:
            acceleration = np.linalg.solve(BICYCLE.mass, -damping @ state[2:] - stiffness @ state[:2])
            return np.concatenate([state[2:], acceleration])

        start = np.array([0.0, 0.0, lean_rate, 0.0])
        found = solve_ivp(slope, (0.0, time_s[-1]), start, t_eval=time_s, rtol=1e-6, atol=1e-9).y
        turn = np.cos(BICYCLE.steer_axis_tilt) / BICYCLE.wheelbase
        yaw_rate = turn * (speed * found[1] + BICYCLE.trail * found[3])
        return np.concatenate([found[2] - measured[:, 0], yaw_rate - measured[:, 1]])

    return np.asarray(least_squares(residual, FIRST).x)


def by_hoisted_scipy(time_s: Array, measured: Array) -> Array:
    """One matrix per residual, an integrator of high order, errors of the prediction about 1e-9 as ours."""
    target = measured.T.ravel()

    def residual(values: Array) -> Array:
        system = linear_system(BICYCLE, values[1])
        a = system.a
        start = np.array([0.0, 0.0, values[0], 0.0])
        found = solve_ivp(
            lambda _, x: a @ x, (0.0, time_s[-1]), start, "DOP853", t_eval=time_s, rtol=1e-8, atol=1e-10
        ).y
        return np.concatenate([found[2], system.yaw @ found]) - target

    return np.asarray(least_squares(residual, FIRST, x_scale=(0.1, 1.0)).x)


def by_lmfit(time_s: Array, measured: Array) -> Array:
    """lmfit with the exact model: one matrix exponential, then products."""

    def residual(parameters: lmfit.Parameters) -> Array:
        system = linear_system(BICYCLE, parameters["speed"].value)
        step = expm(system.a * time_s[1])
        states = np.empty((len(time_s), 4))
        states[0] = [0.0, 0.0, parameters["lean_rate"].value, 0.0]
        for k in range(1, len(time_s)):
            states[k] = step @ states[k - 1]
        return np.concatenate([states[:, 2] - measured[:, 0], states @ system.yaw - measured[:, 1]])

    parameters = lmfit.create_params(lean_rate=FIRST[0], speed=FIRST[1])
    found = lmfit.minimize(residual, parameters).params
    return np.array([found["lean_rate"].value, found["speed"].value])


if __name__ == "__main__":
    main()
