"""The experiment from the first push to the catch: run-up, release, strikes, free response, and how it ends.

Procedure of Kooijman et al. 2011, supplement chapter 10, doi 10.1126/science.1201959: the handlebars are held
straight while the bicycle is brought up to speed, it is released, its lateral motion dies out, it is struck,
and caught before it falls or when it has lost its speed.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from tms_model.bicycle import Array
from tms_model.response import LEAN, LEAN_RATE, STEER, STEER_RATE

from tms_sim.conditions import Conditions, Joint, Strike, conditions
from tms_sim.motion import (
    CAUGHT,
    FALLEN,
    FREE,
    PHASES,
    RUN_UP,
    SETTLING,
    ContactGeometry,
    Event,
    SteerTorque,
    Trajectory,
)
from tms_sim.nonlinear_ride import departure
from tms_sim.plant import SIDE, TURN, YAW
from tms_sim.ride import Ride, initial_state
from tms_sim.scenario import Scenario
from tms_sim.steps import ORDER, bridge, shifted

FALLEN_LEAN = 1.0  # [rad]; beyond it linear theory means nothing and the run ends
GRIP = 0.15  # [s] from the catch until hands hold the bicycle upright and straight
HELD_STEP = 0.02  # [s] of the motion in the experimenter's hands


def ride(scenario: Scenario, rng: np.random.Generator) -> Trajectory:
    """The motion of a scenario; rng is drawn from for what differs from run to run.

    Raises ParameterError for names that are unknown and effects that need more of a bicycle than is known.
    """
    if not scenario.switch("effects.nonlinear"):
        return _ride(scenario, rng)
    linear = replace(scenario, values={**scenario.values, "effects.nonlinear": False})
    other = _ride(linear, copy.deepcopy(rng))  # from the same release
    trajectory = _ride(scenario, rng)
    return replace(trajectory, events=(departure(trajectory, other), *trajectory.events))


def _ride(scenario: Scenario, rng: np.random.Generator) -> Trajectory:
    now = conditions(scenario, rng)
    under_way = Ride(now, _lean_limit(scenario), now.release, initial_state(now))
    if now.release > 0.0:
        _run_up(scenario, under_way)
    under_way.phases.append((now.release, SETTLING if now.release > 0.0 else FREE))
    until, reason = _until(scenario, now)
    for when in _schedule(now, until):
        under_way.span(min(when.time, until))
        if under_way.over or when.time >= until:
            break
        if isinstance(when, Strike):
            under_way.strike(when)
        else:
            under_way.joint(when)
    under_way.span(until)
    if under_way.over:
        reason = "caught" if scenario.number("catch.lean_deg") else "fallen"
        reason = "stopped" if under_way.stopped else reason
    under_way.finish()
    end = under_way.time
    if reason == "caught":
        end = _catch(scenario, under_way)
    elif reason == "fallen":
        under_way.phases.append((end, FALLEN))
    return _trajectory(scenario, under_way, end, reason)


def _lean_limit(scenario: Scenario) -> float:
    caught = math.radians(scenario.number("catch.lean_deg"))
    return min(caught or FALLEN_LEAN, FALLEN_LEAN)


def _until(scenario: Scenario, now: Conditions) -> tuple[float, str]:
    """When the run ends at the latest, and what ends it then."""
    duration, slowest = scenario.number("duration"), scenario.number("catch.speed")
    slows = now.plant.acceleration < 0.0
    caught = now.release + (slowest - now.launch_speed) / now.plant.acceleration if slows else math.inf
    ends = {
        duration: "duration",
        max(caught, now.release) if slowest else math.inf: "caught",
        now.stop: "stopped",
    }
    first = min(ends)
    return first, ends[first]


def _schedule(now: Conditions, until: float) -> Iterator[Strike | Joint]:
    """Strikes and joints in the order of their times; a joint met during a strike is left out."""
    whole: list[Strike | Joint] = [*now.strikes, *now.joints]
    busy = 0.0
    for when in sorted(whole, key=lambda one: one.time):
        struck = any(s.time <= when.time < s.time + s.duration for s in now.strikes)
        if when.time >= until or when.time < busy or (struck and isinstance(when, Joint)):
            continue
        busy = when.time + (when.duration if isinstance(when, Strike) else 0.0)
        yield when


def _run_up(scenario: Scenario, under_way: Ride) -> None:
    """Hand-held from the start to the release: straight ahead, the speed rising to the launch speed."""
    now = under_way.conditions
    slope, T = now.plant.acceleration, now.release
    start = np.array([[0.0, 0.0, 0.0], [scenario.number("run_up.speed"), 0.0, 0.0]])
    end = np.array([[now.lean, now.lean_rate, 0.0], [now.launch_speed, slope, 0.0]])
    lean, speed = bridge(start, end, T)
    _hand_held(under_way, 0.0, T, {LEAN_CHANNEL: lean, SPEED_CHANNEL: speed})
    under_way.phases.append((0.0, RUN_UP))


def _catch(scenario: Scenario, under_way: Ride) -> float:
    """Bring the bicycle upright and to a stand by hand; returns when it stands, or the record ends."""
    now, T, state = under_way.conditions, scenario.number("catch.duration"), under_way.state
    speed_now = np.array([now.speed(under_way.time)])
    rates = now.plant.generators(under_way.mode, np.zeros(4), speed_now)[0][0] @ state
    rows = np.array(
        [
            [state[LEAN], state[LEAN_RATE], rates[LEAN_RATE]],
            [state[STEER], state[STEER_RATE], rates[STEER_RATE]],
            [state[TURN], rates[TURN], 0.0],
            [state[SIDE], rates[SIDE], 0.0],
            [now.speed(under_way.time), now.plant.acceleration, 0.0],
        ]
    )
    grip = min(GRIP, T)
    lean, steer, turn, side = bridge(rows[:4], np.zeros((4, 3)), grip)
    (speed,) = bridge(rows[4:], np.zeros((1, 3)), T)
    yaw = np.concatenate([[state[YAW]], turn / np.arange(1, 7)])
    begin = under_way.time
    end = min(begin + T, scenario.number("duration"))
    gripped = min(begin + grip, end)
    if gripped > begin:
        channels = dict(enumerate((lean, steer, yaw, side, speed)))
        _hand_held(under_way, begin, gripped, channels)
    if end > gripped:
        heading = np.array([float(grip ** np.arange(len(yaw)) @ yaw)])
        rest = {YAW_CHANNEL: heading, SPEED_CHANNEL: shifted(speed, grip)}
        _hand_held(under_way, gripped, end, rest)
    under_way.phases.append((begin, CAUGHT))
    return end


LEAN_CHANNEL, YAW_CHANNEL, SPEED_CHANNEL = 0, 2, 4  # of tms_sim.motion.CHANNELS


def _hand_held(under_way: Ride, begin: float, end: float, channels: dict[int, Array]) -> None:
    """Keep polynomials in the time since `begin`, in steps."""
    count = max(1, math.ceil((end - begin) / HELD_STEP))
    begins = begin + (end - begin) / count * np.arange(count, dtype=float)
    kept = np.zeros((5, count, ORDER + 1))
    for channel, polynomial in channels.items():
        whole = np.broadcast_to(polynomial, (count, len(polynomial)))
        kept[channel, :, : len(polynomial)] = shifted(whole, begins - begin)
    under_way.starts.append(begins)
    under_way.coefficients.append(kept)


def _trajectory(scenario: Scenario, under_way: Ride, end: float, reason: str) -> Trajectory:
    now = under_way.conditions
    bicycle = now.plant.bicycle
    phases = sorted(under_way.phases, key=lambda one: one[0])
    begins = [*[time for time, _ in phases[1:]], end]
    told = [
        Event(time, "phase", PHASES[phase], until - time)
        for (time, phase), until in zip(phases, begins, strict=True)
    ]
    final = Event(end, "end", f"the run ends: {reason}", 0.0, {"heading_rad": float(under_way.state[YAW])})
    return Trajectory(
        starts=np.concatenate(under_way.starts),
        coefficients=np.concatenate(under_way.coefficients, axis=1),
        end=end,
        geometry=ContactGeometry(
            bicycle.wheelbase, bicycle.trail, bicycle.steer_axis_tilt, rolls=now.load is not None
        ),
        phase_starts=np.array([time for time, _ in phases]),
        phases=np.array([phase for _, phase in phases], np.uint8),
        torque=SteerTorque(
            scenario.number("steer_torque.lean_rate_gain"),
            tuple((s.time, s.duration, s.hold) for s in now.strikes),
        ),
        events=tuple(sorted([*told, *under_way.events, final], key=lambda one: one.time)),
        ended_by=reason,
    )
