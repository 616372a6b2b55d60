"""The bicycle of a run with all that acts on it, as linear equations in each mode of its contacts.

The state of a run is [lean, steer, lean rate, steer rate, u, yaw rate, yaw, 1, p, q, s, c]: u the lateral
velocity of the rear contact; p and q the shimmy; s and c a half-sine impulse.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from tms_model import Bicycle
from tms_model.acceleration import acceleration_stiffness, parameters_under_acceleration
from tms_model.bicycle import Array
from tms_model.response import LEAN_RATE, STEER, STEER_RATE

from tms_sim.contact import ROLLING, Contacts, Mode

SIZE = 12
SIDE, TURN, YAW, ONE, SHIMMY, QUADRATURE, PULSE, COPULSE = range(4, 12)
SPEEDS = (SIDE, TURN, LEAN_RATE, STEER_RATE)


@dataclass(frozen=True, eq=False)
class Plant:
    """What moves and what acts on it, at one rate of change of the speed."""

    bicycle: Bicycle  # feedback and bearing among its steer elements
    acceleration: float  # v' [m/s^2]
    scrub: tuple[float, float]  # [N m s/rad], of the rear and the front wheel, resists turning on the spot
    moments: Array  # (4,) on the rows of tms_model.sliding: what an offset mass does [N, N m, N m, N m]
    shimmy_torque: float  # [N m] of steer torque per unit of p
    contacts: Contacts | None  # None: both wheels roll, whatever it takes
    _cache: dict[tuple[Mode, bytes], tuple[Array, Array, Array]] = field(default_factory=dict, repr=False)

    @property
    def projection(self) -> Array:
        """(2, 4): from the four rows to lean and steer of the rolling bicycle."""
        project = np.zeros((2, 4))
        project[0, 2] = project[1, 3] = 1.0
        project[1, 1] = self.trail_yaw
        return project

    @property
    def yaw_per_steer(self) -> float:
        """cos(lambda_s) / w [1/m]."""
        return math.cos(self.bicycle.steer_axis_tilt) / self.bicycle.wheelbase

    @property
    def trail_yaw(self) -> float:
        """Yaw per steer that the trail makes, (c / w) cos(lambda_s)."""
        return self.bicycle.trail * self.yaw_per_steer

    def generators(self, mode: Mode, strike: Array, speeds: Array) -> tuple[Array, Array, Array]:
        """G0, G1, G2 (k, SIZE, SIZE) of tms_sim.steps in a mode, for steps that begin at `speeds` (k,) [m/s].

        strike: (4,) on the four rows, per unit of s.
        """
        key = (mode, strike.tobytes())
        if key not in self._cache:
            self._cache[key] = self._rolling(strike) if mode == ROLLING else self._sliding(mode, strike)
        a, b, c = self._cache[key]
        v, change = speeds[:, None, None], self.acceleration
        constant = a + v * b + v**2 * c
        linear = change * (b + 2.0 * v * c) if change else np.zeros_like(constant)
        return constant, linear, np.broadcast_to(change**2 * c, constant.shape)

    def _pushes(self, strike: Array) -> Array:
        """What acts on the four rows (4, SIZE) besides the motion."""
        pushes = np.zeros((4, SIZE))
        pushes[:, ONE] = self.moments
        pushes[3, SHIMMY] = self.shimmy_torque
        pushes[:, PULSE] = strike
        return pushes

    def _rolling(self, strike: Array) -> tuple[Array, Array, Array]:
        """z' = (a + v b + v^2 c) z while both wheels roll: Eq. (3.1), K' and what acts."""
        bicycle, cos = self.bicycle, math.cos(self.bicycle.steer_axis_tilt)
        a, b, c = (np.zeros((SIZE, SIZE)) for _ in range(3))
        constant = bicycle.gravity * bicycle.stiffness0 + bicycle.steer_elements.stiffness
        if self.acceleration:
            parameters, _ = parameters_under_acceleration(bicycle)
            constant = constant + acceleration_stiffness(parameters, self.acceleration)
        rear, front = self.scrub
        turned = self.trail_yaw + cos  # of the front wheel about the vertical, per steer
        damper = np.array([[0.0, 0.0], [0.0, rear * self.trail_yaw**2 + front * turned**2]])
        spring = (rear * self.trail_yaw + front * turned) * self.yaw_per_steer  # per speed
        rows = slice(LEAN_RATE, STEER_RATE + 1)
        a[rows, :2] = -constant
        a[rows, rows] = -(bicycle.steer_elements.damping + damper)
        a[rows] += self.projection @ self._pushes(strike)
        b[rows, rows] = -bicycle.damping
        b[STEER_RATE, STEER] = -spring
        c[rows, :2] = -bicycle.stiffness2
        inverse = np.linalg.inv(bicycle.mass)
        for part in (a, b, c):
            part[rows] = inverse @ part[rows]
            part[TURN] = self.trail_yaw * part[STEER_RATE]
        a[TURN, STEER] += self.acceleration * self.yaw_per_steer
        b[TURN, STEER_RATE] += self.yaw_per_steer
        return self._with_kinematics(a), b, c

    def _sliding(self, mode: Mode, strike: Array) -> tuple[Array, Array, Array]:
        """The same when at least one wheel slides."""
        assert self.contacts is not None
        e = self.contacts.equations
        inverse, friction = self.contacts.solver(mode)
        a, b, c = (np.zeros((6, SIZE)) for _ in range(3))
        a[:4, :2] = -e.stiffness
        a[:4, SPEEDS] = -e.damping
        a[:4] += self._pushes(strike)
        b[:4, SPEEDS] = -e.gyroscopic
        c[:4, :2] = -e.stiffness2
        for wheel, slides in enumerate(mode):
            if slides:
                a[4 + wheel, ONE] = friction[wheel]
                continue
            b[4 + wheel, TURN] = 1.0
            if wheel == 1:
                b[5, STEER_RATE] += e.heading
                a[5, STEER] += e.heading * self.acceleration
        whole = [np.zeros((SIZE, SIZE)) for _ in range(3)]
        for part, right in zip(whole, (a, b, c), strict=True):
            part[SPEEDS, :] = (inverse @ right)[:4]
        whole[1][SIDE, TURN] -= 1.0  # u' = (u' + v r) - v r
        return self._with_kinematics(whole[0]), whole[1], whole[2]

    def _with_kinematics(self, a: Array) -> Array:
        a[0, LEAN_RATE] = a[1, STEER_RATE] = a[YAW, TURN] = 1.0
        return a
