"""The ride: from the conditions of a run to its whole motion.

The bicycle is linear in each mode of its contacts, so that a ride is a chain of short Taylor series
(`tms_sim.steps`); it is looked at nine times a step for a wheel that begins or ends to slide and for a fall,
and the instant is found to rounding.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from tms_model import ParameterError
from tms_model.bicycle import Array
from tms_model.nonlinear import Load
from tms_model.response import LEAN, LEAN_RATE, STEER, STEER_RATE

from tms_sim.conditions import Conditions, Joint, Strike
from tms_sim.contact import ROLLING, STILL, Mode
from tms_sim.motion import RESPONSE, STRIKE, Event
from tms_sim.nonlinear_ride import free_ride
from tms_sim.plant import COPULSE, ONE, PULSE, QUADRATURE, SHIMMY, SIDE, SIZE, SPEEDS, TURN, YAW
from tms_sim.steps import ORDER, longest_step, series
from tms_sim.watch import ACROSS, Watch, watch

LONGEST = 0.02  # [s]
SOME_LEFT = 0.05  # of the shimmy's amplitude, when the handlebars are let go
_BLOCK = 64  # steps computed at once while both wheels roll; a slide begins with one
_POWERS = np.arange(ORDER + 1)
_CHANNELS = (LEAN, STEER, YAW, SIDE)
_MOST_CHANGES = 20000  # of mode in a run


@dataclass
class Ride:
    """A ride under way: what has been computed so far, and the state where it stands."""

    conditions: Conditions
    lean_limit: float  # [rad], caught or fallen beyond
    time: float
    state: Array  # (SIZE,)
    mode: Mode = ROLLING
    starts: list[Array] = field(default_factory=list)
    coefficients: list[Array] = field(default_factory=list)  # (5, k, ORDER + 1) of tms_sim.motion.CHANNELS
    phases: list[tuple[float, int]] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    over: bool = False  # beyond the lean limit, or the handlebars across
    stopped: bool = False  # stands still before its speed was to end
    _slides: dict[int, tuple[float, float, float, int]] = field(default_factory=dict)
    _changes: int = 0
    _most: int = _BLOCK  # steps computed at once
    _watches: dict[tuple[Mode, bytes], Watch] = field(default_factory=dict)

    def strike(self, strike: Strike) -> None:
        """Go through a strike, from its begin to its end."""
        before = self.state.copy()
        self.phases.append((self.time, STRIKE if strike.duration else RESPONSE))
        if strike.duration:
            rate = math.pi / strike.duration
            self.state[PULSE], self.state[COPULSE] = 0.0, 1.0
            # half a sine with the area one
            self.span(strike.time + strike.duration, strike.rows * rate / 2.0, rate)
            self.state[PULSE] = self.state[COPULSE] = 0.0
            self.phases.append((self.time, RESPONSE))
        else:
            self.kick(strike.rows)
        self.events.append(_strike_event(strike, before, self.state))

    def joint(self, joint: Joint) -> None:
        """Roll over a joint of the floor."""
        before = self.state[STEER_RATE]
        self.kick(np.array([0.0, 0.0, 0.0, joint.impulse]))
        kick = float(self.state[STEER_RATE] - before)
        self.events.append(
            Event(
                self.time, "joint", "a joint of the floor kicks the steering", 0.0, {"steer_kick_rad_s": kick}
            )
        )

    def kick(self, rows: Array) -> None:
        """An impulse (4,) in no time, which no friction can hold a wheel against."""
        plant, state = self.conditions.plant, self.state.copy()
        if plant.contacts is None:
            change = np.linalg.solve(plant.bicycle.mass, plant.projection @ rows)
            state[[LEAN_RATE, STEER_RATE]] += change
            state[TURN] += plant.trail_yaw * change[1]
        else:
            state[list(SPEEDS)] += np.linalg.solve(plant.contacts.equations.mass, rows)
        self.state = state

    def span(self, until: float, strike: Array | None = None, rate: float = 0.0) -> None:
        """Go on until a time, under a strike (4,) that rises and falls at `rate` [rad/s], or none."""
        if strike is None and self.conditions.load is not None:
            self._free_ride(until, self.conditions.load)
            return
        rows = np.zeros(4) if strike is None else strike
        self._choose_mode(rows)
        while not self.over and until - self.time > 1e-12:
            self._block(until, rows, rate)

    def _free_ride(self, until: float, load: Load) -> None:
        """The nonlinear bicycle until a time."""
        c, state = self.conditions, self.state.copy()
        if until - self.time <= 1e-12:
            return
        initial = np.array([*state[:4], c.speed(self.time), state[YAW], 0.0, 0.0])
        free = free_ride(c.plant.bicycle, load, initial, until - self.time, (self.lean_limit, ACROSS))
        self.starts.append(self.time + free.begins)
        self.coefficients.append(free.coefficients)
        self.time = until if not free.over else self.time + free.end
        state[:4], state[YAW], state[TURN] = free.state[:4], free.state[5], free.yaw_rate
        self.state, self.over, self.stopped = state, free.over, free.stopped
        self.conditions = replace(c, launch_speed=float(free.state[4]), release=self.time)

    def finish(self) -> None:
        """Close what is still open at the end."""
        for wheel in list(self._slides):
            self._end_slide(wheel)

    def _block(self, until: float, rows: Array, rate: float) -> None:
        c = self.conditions
        step = self._step_length(rows, rate)
        wanted = max(1, math.ceil((until - self.time) / step - 1e-9))
        count = min(wanted, self._most)
        whole = (until - self.time) if wanted == count else count * step
        lengths: Array = np.full(count, whole / count)
        begins: Array = self.time + lengths * np.arange(count)
        speeds: Array = c.launch_speed + c.plant.acceleration * (begins - c.release)
        generators = self._generators(rows, rate, speeds, lengths)
        terms, end = series(generators, lengths, self.state)
        hit = self._watch(rows).first(terms, speeds, c.plant.acceleration, lengths)
        if hit is None:
            self._keep(begins, terms, speeds)
            self._most = min(2 * self._most, _BLOCK)
            self.time, self.state = (until if wanted == count else self.time + whole), end
            return
        k, inside = hit
        self._keep(begins[: k + 1], terms[: k + 1], speeds[: k + 1])
        self.time = float(begins[k]) + inside
        self.state = inside**_POWERS @ terms[k]
        self.over = abs(self.state[LEAN]) >= self.lean_limit or abs(self.state[STEER]) >= ACROSS
        if not self.over:
            self._choose_mode(rows)

    def _step_length(self, rows: Array, rate: float) -> float:
        c = self.conditions
        constant, _, _ = c.plant.generators(self.mode, rows, np.array([c.speed(self.time)]))
        motion = constant[0][:PULSE, :PULSE].copy()
        motion[:, [ONE, SHIMMY]] = 0.0
        longest = min(LONGEST, longest_step(motion))
        fastest = max(rate, 2.0 * math.pi * c.shimmy.frequency if c.shimmy else 0.0)
        return min(longest, 1.3 / fastest) if fastest else longest

    def _generators(
        self, rows: Array, rate: float, speeds: Array, lengths: Array
    ) -> tuple[Array, Array, Array]:
        c = self.conditions
        constant, linear, square = c.plant.generators(self.mode, rows, speeds)
        constant[:, PULSE, COPULSE], constant[:, COPULSE, PULSE] = rate, -rate
        if c.shimmy:
            size = math.hypot(self.state[SHIMMY], self.state[QUADRATURE])
            middle = speeds + 0.5 * c.plant.acceleration * lengths
            growth = c.shimmy.steps(size, middle, lengths)
            turn = 2.0 * math.pi * c.shimmy.frequency
            constant[:, SHIMMY, SHIMMY] = constant[:, QUADRATURE, QUADRATURE] = growth
            constant[:, SHIMMY, QUADRATURE], constant[:, QUADRATURE, SHIMMY] = -turn, turn
        return constant, linear, square

    def _keep(self, begins: Array, terms: Array, speeds: Array) -> None:
        kept = np.zeros((5, len(begins), ORDER + 1))
        for channel, place in enumerate(_CHANNELS):
            kept[channel] = terms[:, :, place]
        kept[4, :, 0], kept[4, :, 1] = speeds, self.conditions.plant.acceleration
        self.starts.append(begins)
        self.coefficients.append(kept)

    def _watch(self, rows: Array) -> Watch:
        key = (self.mode, rows.tobytes())
        if key not in self._watches:
            self._watches[key] = watch(self.conditions.plant, self.mode, self.lean_limit, rows)
        return self._watches[key]

    def _choose_mode(self, rows: Array) -> None:
        plant, state = self.conditions.plant, self.state.copy()
        if plant.contacts is None:
            return
        self._changes += 1
        if self._changes > _MOST_CHANGES:
            raise ParameterError(
                f"effects.slip: expected wheels that slide or roll, found {_MOST_CHANGES} changes within"
                f" {self.time:.3g} s; take a floor with more friction, or a smaller shimmy"
            )
        e, speed = plant.contacts.equations, self.conditions.speed(self.time)
        slip = e.slip(speed, float(state[STEER]), state[list(SPEEDS)])
        if abs(slip[0]) <= STILL:
            state[SIDE] = 0.0
        if abs(slip[1]) <= STILL:
            at_rest = state[SIDE] + e.contacts[1, 3] * state[STEER_RATE] - speed * e.heading * state[STEER]
            state[TURN] = -at_rest / e.contacts[1, 1]
        pushes = plant.moments + state[PULSE] * rows
        pushes[3] += plant.shimmy_torque * state[SHIMMY]
        mode = plant.contacts.choose(speed, state[:2], state[list(SPEEDS)], pushes)
        self.state = state
        for wheel in range(2):
            self._note_slide(wheel, mode[wheel])
        self.mode = mode
        self._most = _BLOCK if mode == ROLLING else 1

    def _note_slide(self, wheel: int, now: int) -> None:
        open_slide = self._slides.get(wheel)
        if open_slide and open_slide[3] != now:
            self._end_slide(wheel)
            open_slide = None
        if now and not open_slide:
            self._slides[wheel] = (self.time, float(self.state[LEAN]), float(self.state[LEAN_RATE]), now)

    def _end_slide(self, wheel: int) -> None:
        begin, lean, lean_rate, way = self._slides.pop(wheel)
        side, name = ("right" if way > 0 else "left"), ("rear", "front")[wheel]
        figures = {"lean_rad": lean, "lean_rate_rad_s": lean_rate}
        text = f"the {name} wheel slides to the {side}"
        self.events.append(Event(begin, "slip", text, self.time - begin, figures))


def _strike_event(strike: Strike, before: Array, after: Array) -> Event:
    return Event(
        strike.time,
        "strike",
        f"struck to the {'right' if strike.impulse > 0.0 else 'left'}",
        strike.duration,
        {
            "impulse_n_s": strike.impulse,
            "hand_n_m_s": strike.hold,
            "rolling_lean_rate_rad_s": strike.lean_rate,
            "rolling_steer_kick_rad_s": strike.kick,
            "lean_rate_change_rad_s": float(after[LEAN_RATE] - before[LEAN_RATE]),
            "steer_rate_change_rad_s": float(after[STEER_RATE] - before[STEER_RATE]),
            "yaw_rate_change_rad_s": float(after[TURN] - before[TURN]),
        },
    )


def initial_state(conditions: Conditions) -> Array:
    """State (SIZE,) at the release: handlebars straight, the shimmy still small."""
    state = np.zeros(SIZE)
    state[LEAN], state[LEAN_RATE], state[ONE] = conditions.lean, conditions.lean_rate, 1.0
    if conditions.shimmy:
        size = SOME_LEFT * conditions.shimmy.amplitude
        state[SHIMMY], state[QUADRATURE] = (
            size * math.cos(conditions.phase),
            size * math.sin(conditions.phase),
        )
    return state
