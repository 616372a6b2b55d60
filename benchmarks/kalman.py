"""Speed of the Kalman filters and smoothers against filterpy and statsmodels. See benchmarks/README.md."""

from __future__ import annotations

import argparse
import math
import re
import sys

import numpy as np
from filterpy.kalman import KalmanFilter
from measure import Timing, by_processor, in_turn, print_machine
from numpy.typing import NDArray
from tms_fit.kalman.batch import filter_batch, smooth_start
from tms_fit.kalman.ekf import ExtendedKalmanFilter
from tms_fit.kalman.rts import smooth
from tms_fit.kalman.state_space import STATES, StateSpace, bicycle_space
from tms_model import linear_system, load_bicycle

try:
    from statsmodels.tsa.statespace.kalman_filter import KalmanFilter as TheirFilter
except ImportError:
    sys.exit("benchmarks/kalman.py needs statsmodels: pip install statsmodels")

Array = NDArray[np.float64]
RATE, NOISE = 100.0, 0.02  # [Hz], [rad/s]
STD = np.array([0.0, 0.0, 0.1, 0.0, 0.05, 0.05])  # initial lean rate and biases are unknown


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few repeats and small sizes: does it run?")
    quick = parser.parse_args().quick
    runs, samples, repeats = (50, 50, 3) if quick else (10_000, 400, 5)
    print_machine(("numpy", "filterpy", "statsmodels"))
    print(
        f"processor time, medians of {repeats} repeats, quartiles in brackets; {samples} samples of two"
        " channels, six states"
    )
    system = linear_system(load_bicycle("tms_eq_10_1"), 3.6)
    space = bicycle_space(system, np.arange(samples) / RATE, (NOISE, NOISE), np.zeros(STATES), STD)
    rng = np.random.default_rng(1)
    measured = NOISE * rng.standard_normal((runs, samples, 2))
    few = runs // 10
    gaps = np.where(rng.random((few, samples, 2)) < 0.02, np.nan, measured[:few])
    timings = in_turn(
        {
            "filterpy, one run": lambda: by_filterpy(space, measured[0]),
            "statsmodels, one run": lambda: by_statsmodels(space, measured[0]),
            "tms_fit, sample by sample": lambda: by_step(measured[0], parameter_states=False),
            "tms_fit, sample by sample, parameter states": lambda: by_step(
                measured[0], parameter_states=True
            ),
            "tms_fit, one run, all states smoothed": lambda: smooth(space, measured[0]),
            f"tms_fit, {runs} runs": lambda: filter_batch(space, measured),
            f"tms_fit, {runs} runs, filter and smoother": lambda: smooth_start(
                filter_batch(space, measured), [2, 4, 5]
            ),
            f"tms_fit, {few} runs": lambda: filter_batch(space, measured[:few]),
            f"tms_fit, {few} runs, each with gaps of its own": lambda: filter_batch(space, gaps),
        },
        repeats,
    )
    timings = by_processor(timings)
    print_per_sample(timings, samples)
    ours, theirs = filter_batch(space, measured[:1]), by_filterpy(space, measured[0])
    print(f"largest difference between tms_fit and filterpy: {np.abs(ours.state[0] - theirs).max():.1e}")
    ours_ll, their_ll = ours.log_likelihood[0], by_statsmodels(space, measured[0])
    print(f"relative difference of the log-likelihood to statsmodels': {abs(ours_ll / their_ll - 1.0):.1e}")


def by_filterpy(space: StateSpace, measured: Array) -> Array:
    """State (s,) at the last sample."""
    kalman = KalmanFilter(dim_x=STATES, dim_z=2)
    kalman.x, kalman.P = space.mean.reshape(-1, 1), space.covariance.copy()
    noise = np.diag(space.noise[0])
    for k, sample in enumerate(measured):
        kalman.predict(F=space.transitions[k], Q=0.0)
        kalman.update(sample.reshape(-1, 1), R=noise, H=space.rows[k])
    state: Array = kalman.x[:, 0]
    return state


def by_step(measured: Array, parameter_states: bool) -> Array:
    """State (4,) at the last sample by the filter that runs along, speed and C_r estimated or not."""
    running = ExtendedKalmanFilter(load_bicycle("tms_eq_10_1"), NOISE, parameter_states)
    unknown = (math.nan, math.nan, math.nan)
    for k, (lean_rate, yaw_rate) in enumerate(measured.tolist()):
        time_ns = round(k * 1e9 / RATE)
        step = running.step(time_ns, (lean_rate, math.nan, yaw_rate), unknown, 3.6, 0.0)
    return step.state


def by_statsmodels(space: StateSpace, measured: Array) -> float:
    """Log-likelihood; the model is that of one sample interval, as fast as statsmodels can have it."""
    theirs = TheirFilter(k_endog=2, k_states=STATES)
    theirs.bind(np.asfortranarray(measured.T))
    theirs["design"], theirs["obs_cov"] = space.rows[0], np.diag(space.noise[0])
    theirs["transition"] = space.transitions[-1]
    theirs.tolerance = 0
    theirs.initialize_known(space.mean, space.covariance)
    return float(theirs.filter().llf_obs.sum())


def print_per_sample(timings: dict[str, Timing], samples: int) -> None:
    """One line for each way: time for each sample of each run, and how many times faster than filterpy's."""
    reference = timings["filterpy, one run"].median / samples
    for timing in timings.values():
        ours = re.search(r", (\d+) runs", timing.name)
        count = samples * (int(ours[1]) if ours else 1)
        low, high = timing.quartiles
        print(
            f"  {timing.name:44} {1e3 * timing.median:10.3f} ms  ({1e3 * low:.3f} to {1e3 * high:.3f})"
            f"  {1e6 * timing.median / count:8.3f} us a sample  {reference * count / timing.median:8.1f} x"
        )


if __name__ == "__main__":
    main()
