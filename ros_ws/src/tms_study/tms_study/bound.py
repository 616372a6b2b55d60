"""What an experiment can tell at best: the Cramer-Rao bound of what is to be found.

No unbiased estimator has a smaller standard deviation than the root of the inverse Fisher information.
For white noise of standard deviation s that is s^2 (J' J)^-1, J the derivatives of both channels by all
that is free (H. Cramer, Mathematical Methods of Statistics, 1946, section 32.6). The bound is that of the
model of the estimator at the scenario's truth (its speed falls as the floor makes it, its strike kicks the
steering if it does in the scenario; slip, shimmy and joints are left out), so that one can choose sample
rate, noise, duration and strength.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from tms_fit.diagnostics.hypothesis_tests import SLIP as SLIP_WINDOW
from tms_fit.parameters import CHANNELS, FRICTION, INITIAL, LINEAR, shaping
from tms_fit.response.prediction import derivative, predictor
from tms_fit.settings import Settings
from tms_fit.speed_profile import SpeedProfile, constant_speed
from tms_fit.window import Window
from tms_model import ParameterError, load_bicycle
from tms_model.acceleration import coasting_loss
from tms_model.bicycle import Array
from tms_sim.conditions import Conditions, Strike, conditions
from tms_sim.imu_grade import load_imu
from tms_sim.intervention import changed_bicycle, load_intervention
from tms_sim.scenario import Scenario

RATES = (25.0, 50.0, 100.0, 200.0, 1000.0)  # [Hz]
NOISES = (0.5, 1.0, 2.0)  # of the scenario's noise density
DURATIONS = (1.0, 1.5, 3.0, 4.0)  # [s]
STRENGTHS = (0.5, 1.0, 2.0)  # of the scenario's strike
STANDING = 0.2  # [s] before it stands, when a linear bicycle means nothing any more


@dataclass(frozen=True)
class Experiment:
    """What an experimenter chooses."""

    rate: float  # [Hz]
    noise_density: float  # [rad/s/sqrt(Hz)] of both channels
    duration: float  # [s] of free response
    lean_rate: float  # [rad/s] right after the strike
    channels: tuple[str, ...] = CHANNELS

    @property
    def noise(self) -> float:
        """Standard deviation of one sample [rad/s]."""
        return self.noise_density * math.sqrt(self.rate)

    @property
    def count(self) -> int:
        """Samples in a window of that duration, the first and the last included as in a fit."""
        return math.floor(self.duration * self.rate * (1.0 + 1e-12)) + 1


@dataclass(frozen=True)
class Bound:
    """Least standard deviations that an experiment allows."""

    experiment: Experiment
    std: dict[str, float]  # by parameter, SI, no bias of an absent channel; empty: can't be told apart


def planned(scenario: Scenario, window: float = Settings.window) -> Experiment:
    """The experiment that a scenario describes, with a free response of `window` [s] used at most."""
    rate = scenario.number("imu.rate")
    # imu/lean_yaw holds every n-th sample as it is, with the noise of one sample of the faster raw topic.
    density = load_imu(scenario.text("imu.grade")).gyroscope.noise_density * math.sqrt(scenario.imu_every)
    left = scenario.number("duration") - scenario.numbers("strike.time")[0]
    return Experiment(
        rate, density, min(left, window, _rolls(scenario)), scenario.numbers("strike.lean_rate")[0]
    )


def _rolls(scenario: Scenario) -> float:
    """How long [s] the bicycle goes on after the first strike before rolling has taken its speed."""
    ride = conditions(scenario, np.random.default_rng(0))
    return ride.stop - ride.strikes[0].time - STANDING


def bound(scenario: Scenario, experiment: Experiment, free: tuple[str, ...]) -> Bound:
    """The bound of one experiment. Raises ParameterError for what can't be predicted."""
    if not experiment.noise > 0.0:
        raise ParameterError(
            f"imu.grade: expected a sensor with noise, found none in {scenario.text('imu.grade')!r}"
        )
    absent = {f"{channel}_bias" for channel in CHANNELS if channel not in experiment.channels}
    free = tuple(name for name in free if name not in absent)
    jacobian = _jacobian(scenario, experiment, free)
    scale = np.linalg.norm(jacobian, axis=0)
    if not scale.all() or np.linalg.matrix_rank(jacobian / scale, tol=1e-7) < len(free):
        return Bound(experiment, {})
    scaled = jacobian / scale
    inverse = np.linalg.inv(scaled.T @ scaled) / np.outer(scale, scale)
    deviations = experiment.noise * np.sqrt(np.diag(inverse))
    return Bound(experiment, dict(zip(free, deviations.tolist(), strict=True)))


def table(scenario: Scenario, free: tuple[str, ...]) -> list[Bound]:
    """The scenario's own experiment, and others that differ from it in one choice each."""
    own, rolls = planned(scenario), _rolls(scenario)
    others = [Experiment(rate, own.noise_density, own.duration, own.lean_rate) for rate in RATES]
    others += [Experiment(own.rate, own.noise_density * k, own.duration, own.lean_rate) for k in NOISES]
    others += [
        Experiment(own.rate, own.noise_density, duration, own.lean_rate)
        for duration in DURATIONS
        if duration < rolls
    ]
    others += [Experiment(own.rate, own.noise_density, own.duration, own.lean_rate * k) for k in STRENGTHS]
    others += [
        Experiment(own.rate, own.noise_density, own.duration, own.lean_rate, (channel,))
        for channel in own.channels
    ]
    return [bound(scenario, one, free) for one in dict.fromkeys([own, *others])]


def to_json(scenario: Scenario, free: tuple[str, ...], rows: list[Bound]) -> dict[str, Any]:
    """The document of `study bound --json`; the first row is the scenario's own experiment."""
    return {
        "scenario": scenario.name,
        "free": list(free),
        "bounds": [
            {
                "rate": row.experiment.rate,
                "noise": row.experiment.noise,
                "noise_density": row.experiment.noise_density,
                "duration": row.experiment.duration,
                "lean_rate": row.experiment.lean_rate,
                "channels": list(row.experiment.channels),
                "std": row.std,
            }
            for row in rows
        ],
    }


def to_text(scenario: Scenario, free: tuple[str, ...], rows: list[Bound]) -> str:
    """The table for the terminal."""
    lines = [
        f"{scenario.name}: least standard deviation of what is free (Cramer-Rao, white noise)",
        f"{'rate':>7} {'noise':>8} {'window':>7} {'strike':>7}  {'channels':8} "
        + " ".join(f"{name:>19}" for name in free),
        f"{'Hz':>7} {'rad/s':>8} {'s':>7} {'rad/s':>7}",
    ]
    for row in rows:
        one = row.experiment
        seen = "both" if len(one.channels) == 2 else one.channels[0].removesuffix("_rate")
        figures = (
            "  can't be told apart"
            if not row.std
            else " ".join(f"{row.std.get(name, math.nan):19.3g}" for name in free).replace("nan", "  -")
        )
        lines.append(
            f"{one.rate:7g} {one.noise:8.4f} {one.duration:7g} {one.lean_rate:7.3g}  {seen:8} {figures}"
        )
    return "\n".join(lines)


def _jacobian(scenario: Scenario, experiment: Experiment, free: tuple[str, ...]) -> Array:
    """Derivatives (m, p) of all samples used by what is free, at the scenario's truth."""
    ride = conditions(scenario, np.random.default_rng(0))  # nothing used here is drawn
    window = _window(scenario, ride, np.arange(experiment.count) / experiment.rate)
    falling = -ride.plant.acceleration
    truth = {
        "initial_lean_rate": experiment.lean_rate,
        "initial_steer_rate": _steer_rate(scenario, ride.strikes[0], experiment.lean_rate),
    }
    shapes = {"rolling_resistance": falling / coasting_loss(window.bicycle), FRICTION: 0.0}
    nonlinear = shaping({**truth, **{name: value for name, value in shapes.items() if name in free}})
    model = predictor(window, nonlinear)
    columns = [
        model.columns[:, :, LINEAR.index(name)]
        if name in LINEAR and (FRICTION not in free or name not in INITIAL)
        else derivative(window, nonlinear, name).predict(truth)
        for name in free
    ]
    used = [index for index, name in enumerate(CHANNELS) if name in experiment.channels]
    return np.stack(columns, axis=2)[:, used].reshape(-1, len(free))


def _window(scenario: Scenario, ride: Conditions, time: Array) -> Window:
    """The window (n,) after the first strike, nothing measured: bicycle, feedback and speed as they are."""
    speed, acceleration = ride.speed(ride.strikes[0].time), ride.plant.acceleration
    return Window(
        first_ns=0,
        time=time,
        lean_rate=np.zeros(len(time)),
        yaw_rate=np.zeros(len(time)),
        bicycle=changed_bicycle(
            load_bicycle(scenario.text("bicycle")), load_intervention(scenario.text("intervention"))
        ),
        speed=SpeedProfile(np.array([speed, acceleration]), np.zeros((2, 2)))
        if acceleration
        else constant_speed(speed),
        lean_rate_gain=scenario.number("steer_torque.lean_rate_gain"),
        slip_window=SLIP_WINDOW,
    )


def _steer_rate(scenario: Scenario, strike: Strike, lean_rate: float) -> float:
    """Steer rate [rad/s] after a strike of another size: the kick grows with it, a hand's part doesn't."""
    by_hand = scenario.numbers("strike.steer_rate")[0]
    kick = (strike.steer_rate - by_hand) / strike.lean_rate if strike.lean_rate else 0.0
    return by_hand + kick * lean_rate
