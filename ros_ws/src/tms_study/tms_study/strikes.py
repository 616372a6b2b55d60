"""How well strikes are found: simulated runs by the hundred, whose true strikes are known.

A strike counts as found when one of those found lies within 0.3 s of the end of its impulse; what is found
elsewhere is false. The bounds are those of Cramer and Rao for the end of an impulse of unknown size, its
length hardly or not at all known, in white noise on both rates, the bicycle known.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from tms_fit.recording_fit import fit_recording
from tms_fit.settings import Settings
from tms_fit.strike_fit import StrikeFit
from tms_fit.strikes.detector import StrikeDetector
from tms_model import LinearSystem, linear_system, load_bicycle, response
from tms_model.bicycle import Array
from tms_sim.run import SimulatedRun, simulate
from tms_sim.scenario import load_scenario, scenario_names
from tqdm import tqdm

BELONGS = 0.3  # [s] between a true strike and the one found, at most
CLOSE = 0.010  # [s]
DENSITY = 0.002  # [rad/s/sqrt(Hz)] of the gyroscope's noise, as of the grade pi_node
RIDE = 600.0  # [s] on a treadmill
KICK = 0.05  # [rad/s] by which a joint of the belt changes the lean rate
LENGTH = 0.02  # [s], standard deviation of what is known beforehand of an impulse's length
FINE = 1e-3  # [s] of the grid that a response is told on
CELLS = 20  # parts of an impulse
UNTOLD = 0.1  # [s]; a larger bound says that no sample within the impulse tells its length
PHASES = 8  # places between two samples
SHIMMY = 0.05  # [rad/s] of the lean rate on the treadmill


@dataclass(frozen=True)
class Case:
    """Runs that differ in nothing but their seed."""

    topic: str
    scenario: str
    changes: Mapping[str, Any] = field(default_factory=dict)
    limit: float = math.inf  # [rad/s] at which each gyroscope is clipped
    by_hand: bool = False  # pushes, of which the fit sees the last part as free: by how much is it off?
    sloppy: bool = False  # struck anywhere between two samples, so that no instant is special


@dataclass(frozen=True)
class Score:
    """What was found in the runs of one case."""

    topic: str
    runs: int
    strikes: int  # true ones
    found: int
    false: int
    errors: Array  # (found,) [s] of the impulses' ends
    off: Array  # (k,) of the initial lean rate from the true one at the start found, as a share of it
    bound: float = math.nan  # [s] standard deviation of the end, at least; NaN: not asked for
    bound_unknown: float = math.nan  # [s] the same if nothing is known of the length beforehand

    @property
    def close(self) -> float:
        """Share of the strikes that were found whose end is known to 10 ms."""
        return float(np.mean(np.abs(self.errors) <= CLOSE)) if len(self.errors) else math.nan


def cases() -> list[Case]:
    """What `study strikes` runs."""
    return [
        *(Case(name, name) for name in scenario_names()),
        *_weak(),
        Case("clipped at 0.4 rad/s", "tms_strike", {"strike.lean_rate": 0.8}, limit=0.4, sloppy=True),
        *_hand_pushes(),
    ]


def _weak() -> Iterator[Case]:
    for rate in (50.0, 100.0, 400.0, 1000.0):
        for duration in (0.005, 0.02, 0.05):
            for change in (0.2, 0.3):
                yield _struck(change, duration, rate, {}, "")
    shaken = {"effects.shimmy": True, "shimmy.amplitude_deg": 0.5}
    for change in (0.2, 0.3):
        yield _struck(change, 0.02, 100.0, shaken, ", shimmy")
        yield _struck(change, 0.02, 100.0, {"imu.errors": "all"}, ", all sensor errors")


def _struck(change: float, duration: float, rate: float, more: Mapping[str, Any], text: str) -> Case:
    topic = f"{change:g} rad/s in {1e3 * duration:.0f} ms at {rate:.0f} Hz{text}"
    changes = {"strike.lean_rate": change, "strike.duration": duration, "imu.rate": rate, "duration": 4.0}
    return Case(topic, "tms_strike", {**changes, **more}, sloppy=True)


def _hand_pushes() -> Iterator[Case]:
    for speed in (2.5, 3.5, 4.5, 5.0):
        changes = {
            "speed": speed,
            "steer_torque.lean_rate_gain": 2.0 * (6.5 - speed),
            "strike.time": (1.5, 4.5, 8.0),
            "strike.lean_rate": (-1.2, 0.8, -0.7),
            "strike.duration": 0.2,
            "duration": 11.0,
        }
        topic = f"pushes of 0.2 s at {speed:g} m/s"
        yield Case(topic, "delft_push", changes, sloppy=True, by_hand=True)


def judge(case: Case, rng: np.random.Generator, runs: int) -> Score:
    """Score of some runs of a case."""
    offset = load_scenario(case.scenario).number("wireless.clock_offset")
    strikes = found = false = 0
    errors: list[float] = []
    off: list[float] = []
    for _ in range(runs):
        run = _run(case, rng)
        fits = _fits(run)
        ends = _true_ends(run, offset)
        starts = np.array([(one.strike.end_ns - run.info.start_ns) / 1e9 for one in fits])
        strikes += len(ends)
        taken = set()
        for end in ends:
            near = int(np.argmin(np.abs(starts - end))) if len(starts) else -1
            if near < 0 or abs(starts[near] - end) > BELONGS or near in taken:
                continue
            taken.add(near)
            errors.append(float(starts[near] - end))
            off.extend(_off(run, fits[near], offset) if case.by_hand else [])
        found, false = found + len(taken), false + len(fits) - len(taken)
    return Score(case.topic, runs, strikes, found, false, np.array(errors), np.array(off), *_bounds(case))


def _run(case: Case, rng: np.random.Generator) -> SimulatedRun:
    changes = dict(case.changes)
    if case.sloppy:
        times = load_scenario(case.scenario, changes).numbers("strike.time")
        shift = rng.random() / load_scenario(case.scenario, changes).number("imu.rate")
        changes["strike.time"] = tuple(time + shift for time in times)
    scenario = load_scenario(case.scenario, {**changes, "seed": int(rng.integers(2**31))})
    run = simulate(scenario, np.random.default_rng(scenario.integer("seed")))
    clipped = np.clip(run.imu.angular_velocity, -case.limit, case.limit)
    return replace(run, imu=replace(run.imu, angular_velocity=clipped))


def _fits(run: SimulatedRun) -> tuple[StrikeFit, ...]:
    settings = Settings(estimators=("least_squares",), noise="white")
    return fit_recording(run.recording(), load_bicycle(run.info.bicycle), settings).strikes


def _true_ends(run: SimulatedRun, offset: float) -> list[float]:
    """Ends of the impulses [s since the start] by the sensor's clock, which is `offset` ahead."""
    return [one.time + one.duration + offset for one in run.trajectory.events if one.kind == "strike"]


def _off(run: SimulatedRun, fit: StrikeFit, offset: float) -> list[float]:
    estimate = fit.estimates[0]
    if estimate.status != "ok":
        return []
    start = (fit.start_ns - run.info.start_ns) / 1e9 - offset
    truth = float(run.trajectory.at(np.array([start])).lean_rate[0])
    return [(estimate.parameters["initial_lean_rate"] - truth) / truth]


def _bounds(case: Case) -> tuple[float, float]:
    """Bounds [s] of the end of an impulse, its length hardly and not at all known; NaN: not asked for."""
    if "imu.rate" not in case.changes or len(case.changes) > 4:
        return math.nan, math.nan
    change, duration, rate = (
        float(case.changes[f]) for f in ("strike.lean_rate", "strike.duration", "imu.rate")
    )
    system = linear_system(load_bicycle("tms_eq_10_1"), 3.6)
    hardly, unknown = (end_bound(system, change, duration, rate, length) for length in (LENGTH, math.inf))
    return hardly, unknown if unknown < UNTOLD else math.nan


def end_bound(
    system: LinearSystem, change: float, duration: float, rate: float, length: float = LENGTH
) -> float:
    """Cramer-Rao bound [s] of the end of an impulse [rad/s, s] in both rates, sampled at `rate` [Hz].

    Unknown: end, size, initial state, biases, and the length, but for a standard deviation `length` [s] that
    is known beforehand. Noise of `DENSITY`. The median over where between two samples the impulse ends.
    """
    after = after_a_change(system)
    phases = (np.arange(PHASES) + 0.5) / PHASES / rate
    return float(np.median([_bound_at(system, after, change, duration, rate, length, e) for e in phases]))


def _bound_at(
    system: LinearSystem, after: Array, change: float, duration: float, rate: float, length: float, end: float
) -> float:
    time = np.arange(-1.0, 1.5, 1.0 / rate)
    base, step = (
        np.array([end, duration, change]),
        np.array([0.05 * duration, 0.05 * duration, 0.05 * change]),
    )
    columns = []
    for move in np.diag(step):
        both = [pulse(after, time, *(base + sign * move)) for sign in (1.0, -1.0)]
        columns.append((both[0] - both[1]) / (2.0 * move.sum()))
    moving = response(system, np.eye(4), time - time[0])
    columns.extend(rates_of(system, moving[:, :, k]) for k in range(4))
    columns.extend(np.broadcast_to(bias, (len(time), 2)) for bias in np.eye(2))
    matrix = np.stack([column.ravel() for column in columns], axis=1)
    information = matrix.T @ matrix / (DENSITY**2 * rate)
    information[1, 1] += 1.0 / length**2
    size = np.sqrt(np.diag(information))
    inverse = np.linalg.pinv(information / np.outer(size, size), hermitian=True, rcond=1e-13)
    return float(np.sqrt(inverse[0, 0])) / float(size[0])


def rates_of(system: LinearSystem, states: Array) -> Array:
    """Lean rate and yaw rate (n, 2) of states (n, 4)."""
    return np.stack([states[:, 2], states @ system.yaw], axis=1)


def after_a_change(system: LinearSystem) -> Array:
    """Both rates (m, 2) after a unit change of the lean rate, each `FINE`."""
    fine = np.arange(round(2.6 / FINE), dtype=np.float64) * FINE
    return rates_of(system, response(system, np.array([0.0, 0.0, 1.0, 0.0]), fine))


def pulse(after: Array, time: Array, end: float, duration: float, change: float) -> Array:
    """Both rates (n, 2) under half a sine of force that ends at `end` and would bring the lean rate `change`.

    after (m, 2): what follows a unit change, each `FINE`. Its step is taken exactly, the rest in `CELLS`
    parts.
    """
    fine = np.arange(len(after)) * FINE
    edges = np.linspace(0.0, 1.0, CELLS + 1)
    shares = np.diff(0.5 * (1.0 - np.cos(np.pi * edges)))
    inside = np.clip((time - end) / duration + 1.0, 0.0, 1.0)
    moved = 0.5 * (1.0 - np.cos(np.pi * inside))[:, None] * after[0]
    for share, edge in zip(shares, edges, strict=False):
        since = time - end + duration * (1.0 - edge - 0.5 / CELLS)
        rest = [np.interp(since, fine, one - one[0], left=0.0) for one in after.T]
        moved = moved + share * np.stack(rest, axis=1)
    return np.asarray(change * moved)


def false_on_a_treadmill(rng: np.random.Generator, speed: float, rate: float = 100.0) -> int:
    """Strikes found in 10 minutes without any: noise, shimmy, and a joint of the belt every two seconds."""
    gain = 2.0 * (6.5 - speed)
    system = linear_system(load_bicycle("delft_sbw"), speed, gain)
    time = np.arange(round(RIDE * rate)) / rate
    phase = 40.0 * math.pi * time + 0.7 * np.cumsum(rng.standard_normal(len(time))) / math.sqrt(rate)
    lean_rate = DENSITY * math.sqrt(rate) * rng.standard_normal(len(time)) + SHIMMY * np.sin(phase)
    kick = KICK * response(system, np.array([0.0, 0.0, 1.0, 0.0]), np.arange(round(6.0 * rate)) / rate)[:, 2]
    for first in rng.integers(0, len(time) - len(kick), round(RIDE / 2.0)):
        lean_rate[first : first + len(kick)] += rng.choice([-1.0, 1.0]) * kick
    detector = StrikeDetector()
    stamps = np.round(time * 1e9).astype(np.int64).tolist()
    return sum(
        detector.push(stamp, value) is not None
        for stamp, value in zip(stamps, lean_rate.tolist(), strict=True)
    )


def study(rng: np.random.Generator, runs: int, only: str = "") -> list[Score]:
    """Scores of all cases and of four rides on a treadmill; or of the cases whose names hold a text."""
    chosen = [case for case in cases() if only in case.topic]
    scores = [judge(case, rng, runs) for case in tqdm(chosen, desc="strikes", leave=False, disable=None)]
    nothing = np.empty(0)
    for speed in () if only else (2.5, 3.5, 4.6, 5.0):
        false = false_on_a_treadmill(rng, speed)
        scores.append(Score(f"treadmill, 10 min at {speed:g} m/s", 1, 0, 0, false, nothing, nothing))
    return scores
