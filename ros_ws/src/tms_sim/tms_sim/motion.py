"""The true motion of a simulated bicycle at any instants: what every sensor measures, each by its own clock.

A motion is stored as polynomials in time, one set for each short step, as the equations of motion give them;
between the steps it has no interpolation error worth speaking of. It jumps only where a strike or a joint of
the floor without duration says so.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from tms_model import ParameterError
from tms_model.bicycle import Array

# Phases, the constants of tms_msgs/BicycleState.
FREE, RUN_UP, SETTLING, STRIKE, RESPONSE, CAUGHT, FALLEN = range(7)
PHASES = ("free", "run-up", "settling", "strike", "response", "caught", "fallen")

CHANNELS = ("lean", "steer", "yaw", "rear_slip", "speed")
_LEAN, _STEER, _YAW, _SLIP, _SPEED = range(5)
_GAUSS = ((0.5 - np.sqrt(0.15), 5.0 / 18.0), (0.5, 8.0 / 18.0), (0.5 + np.sqrt(0.15), 5.0 / 18.0))


@dataclass(frozen=True)
class Event:
    """Something that happens in a run and that an experimenter would not see in the samples by itself."""

    time: float  # [s since the start], when it begins
    kind: str  # phase, strike, slip, joint, fault, ...; docs/conventions.md lists them
    text: str  # one plain sentence
    duration: float = 0.0  # [s], 0: an instant
    figures: Mapping[str, float] = field(default_factory=dict)  # by name with unit, such as lean_rate_rad_s


@dataclass(frozen=True, eq=False)
class Motion:
    """True motion at n instants; each field (n,) unless said. SAE signs: x forward, y right, z down."""

    time: Array  # [s since the start]
    phase: NDArray[np.uint8]  # what the experimenter does, constants of tms_msgs/BicycleState
    speed: Array  # [m/s] of the rear contact along the heading
    acceleration: Array  # [m/s^2], rate of change of the speed
    lean: Array  # [rad]
    steer: Array  # [rad]
    lean_rate: Array  # [rad/s]
    steer_rate: Array  # [rad/s]
    lean_acceleration: Array  # [rad/s^2]
    steer_acceleration: Array  # [rad/s^2]
    yaw: Array  # [rad], heading of the rear frame, 0 at the start
    yaw_rate: Array  # [rad/s]
    yaw_acceleration: Array  # [rad/s^2]
    rear_contact: Array  # (n, 2) [m] on the floor: x along the heading at the start, y to its right
    front_contact: Array  # (n, 2) [m]
    rear_slip: Array  # [m/s], lateral velocity of the rear contact over the floor, to the right positive
    rear_slip_acceleration: Array  # [m/s^2], its rate of change
    front_slip: Array  # [m/s], lateral velocity of the front contact over the floor
    steer_torque: Array  # [N m], commanded and by hand, positive steers to the right


@dataclass(frozen=True, eq=False)
class ContactGeometry:
    """Where the front contact is, from the rear frame's point of view."""

    wheelbase: float  # w [m]
    trail: float  # c [m]
    steer_axis_tilt: float  # lambda_s [rad]
    rolls: bool = False  # its wheel rolls at any angle, which the first order of `front_slip` doesn't show


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A whole motion, from 0 to `end`."""

    starts: Array  # (k,) [s], begin of each step, ascending, the first 0
    coefficients: Array  # (5, k, m), of CHANNELS: powers of the time since the step's begin, constant first
    end: float  # [s]
    geometry: ContactGeometry
    phase_starts: Array  # (p,) [s], the first 0
    phases: NDArray[np.uint8]  # (p,)
    torque: SteerTorque
    events: tuple[Event, ...]  # in the order of their times
    ended_by: str  # "duration", "caught", "fallen" or "stopped"
    corners: Array = field(init=False)  # (k, 2) [m], rear contact at the begin of each step

    def __post_init__(self) -> None:
        lengths = np.diff(self.starts, append=self.end)
        moves = self._moves(np.arange(len(self.starts)), lengths)
        corners = np.zeros((len(self.starts), 2))
        corners[1:] = np.cumsum(moves[:-1], axis=0)
        object.__setattr__(self, "corners", corners)

    def at(self, time: Array) -> Motion:
        """The motion at instants (n,) [s], ascending, from 0 to `end`.

        At a jump it is the motion right after it. Raises ParameterError for instants outside.
        """
        time = np.asarray(time, dtype=float)
        if time.size and not (time[0] >= 0.0 and time[-1] <= self.end + 1e-9):
            raise ParameterError(
                f"time: expected instants from 0 to {self.end:g} s, found {time[0]:g} to {time[-1]:g} s"
            )
        step = np.maximum(np.searchsorted(self.starts, time, side="right") - 1, 0)
        since = time - self.starts[step]
        lean, steer, yaw = (self._derivatives(channel, step, since) for channel in (_LEAN, _STEER, _YAW))
        slip, speed = (self._derivatives(channel, step, since) for channel in (_SLIP, _SPEED))
        rear = self.corners[step] + self._moves(step, since)
        phase = self.phases[np.maximum(np.searchsorted(self.phase_starts, time, side="right") - 1, 0)]
        front, front_slip = self._front(lean, steer, yaw, slip, speed, rear)
        return Motion(
            time=time,
            phase=phase,
            speed=speed[0],
            acceleration=speed[1],
            lean=lean[0],
            steer=steer[0],
            lean_rate=lean[1],
            steer_rate=steer[1],
            lean_acceleration=lean[2],
            steer_acceleration=steer[2],
            yaw=yaw[0],
            yaw_rate=yaw[1],
            yaw_acceleration=yaw[2],
            rear_contact=rear,
            front_contact=front,
            rear_slip=slip[0],
            rear_slip_acceleration=slip[1],
            front_slip=front_slip,
            steer_torque=self.torque.at(time, lean[1]),
        )

    def _derivatives(self, channel: int, step: NDArray[np.int64], since: Array) -> tuple[Array, Array, Array]:
        """Value, first and second derivative of a channel, by Horner's scheme."""
        coefficients = self.coefficients[channel]
        value, rate, half = (np.zeros(len(since)) for _ in range(3))
        for power in range(coefficients.shape[1] - 1, -1, -1):
            half = half * since + rate
            rate = rate * since + value
            value = value * since + coefficients[step, power]
        return value, rate, 2.0 * half

    def _value(self, channel: int, step: NDArray[np.int64], since: Array) -> Array:
        coefficients = self.coefficients[channel]
        value = np.zeros(len(since))
        for power in range(coefficients.shape[1] - 1, -1, -1):
            value = value * since + coefficients[step, power]
        return value

    def _moves(self, step: NDArray[np.int64], since: Array) -> Array:
        """Way of the rear contact (n, 2) since the begin of each step; Gauss's rule of order six."""
        moves = np.zeros((len(since), 2))
        for place, weight in _GAUSS:
            yaw, slip, speed = (
                self._value(channel, step, place * since) for channel in (_YAW, _SLIP, _SPEED)
            )
            sin, cos = np.sin(yaw), np.cos(yaw)
            moves[:, 0] += weight * since * (speed * cos - slip * sin)
            moves[:, 1] += weight * since * (speed * sin + slip * cos)
        return moves

    def _front(
        self, lean: tuple[Array, ...], steer: tuple[Array, ...], yaw: tuple[Array, ...],
        slip: tuple[Array, ...], speed: tuple[Array, ...], rear: Array,
    ) -> tuple[Array, Array]:  # fmt: skip
        """Front contact (n, 2) and its lateral velocity (n,) over the floor, to first order in steer."""
        w, cos_tilt = self.geometry.wheelbase, np.cos(self.geometry.steer_axis_tilt)
        aside = -self.geometry.trail * cos_tilt
        sin, cos = np.sin(yaw[0]), np.cos(yaw[0])
        front = rear + np.stack([w * cos - aside * steer[0] * sin, w * sin + aside * steer[0] * cos], axis=1)
        if self.geometry.rolls:
            return front, np.zeros(len(front))
        return front, slip[0] + w * yaw[1] + aside * steer[1] - speed[0] * cos_tilt * steer[0]


@dataclass(frozen=True)
class SteerTorque:
    """What turns the steering on purpose: feedback of the lean rate, and a hand that holds it in a strike."""

    lean_rate_gain: float  # [N m s/rad]
    holds: tuple[
        tuple[float, float, float], ...
    ] = ()  # begin [s], duration [s], impulse [N m s]: half a sine

    def at(self, time: Array, lean_rate: Array) -> Array:
        """Torque (n,) [N m] at times (n,) [s]; an instant impulse is in none of them."""
        torque = self.lean_rate_gain * lean_rate
        for begin, duration, impulse in self.holds:
            if duration > 0.0:
                share = (time - begin) / duration
                inside = (share >= 0.0) & (share <= 1.0)
                torque = torque + inside * impulse * np.pi / (2.0 * duration) * np.sin(np.pi * share)
        return torque
