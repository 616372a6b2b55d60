"""Which wheels roll and which slide: Coulomb friction at both contacts of the linear bicycle.

A wheel rolls as long as the lateral force it needs is within the friction; beyond it slides, and the floor
pushes with all its friction against the sliding, until the wheel stands still across the floor and the force
it then needs is within the friction again. In each of the nine modes the equations are linear.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import product

import numpy as np
from tms_model.bicycle import Array
from tms_model.sliding import SlidingEquations

Mode = tuple[int, int]  # rear and front wheel: 0 rolls, 1 slides to the right, -1 slides to the left
ROLLING: Mode = (0, 0)
MODES: tuple[Mode, ...] = tuple(
    sorted(product((0, 1, -1), (0, 1, -1)), key=lambda mode: abs(mode[0]) + abs(mode[1]))
)
STILL = 1e-9  # [m/s]; below this a wheel counts as standing across the floor
# Relative; a force that passes the limit by this much makes a wheel slide, by half of it lets it roll on.
MARGIN = 1e-6


@dataclass(frozen=True, eq=False)
class Contacts:
    """The two contacts: their equations, and the largest lateral force of each."""

    equations: SlidingEquations
    limits: Array  # (2,) [N], infinite: never slides
    acceleration: float  # v' [m/s^2]
    _solvers: dict[Mode, tuple[Array, Array]] = field(default_factory=dict, repr=False)

    def solver(self, mode: Mode) -> tuple[Array, Array]:
        """Inverse (6, 6) of the equations for u' + v r, r', lean'', steer'' and both forces; friction (2,).

        Right-hand side: the forces on the four rows, then what each contact's row says.
        """
        if mode not in self._solvers:
            self._solvers[mode] = self._solver(mode)
        return self._solvers[mode]

    def _solver(self, mode: Mode) -> tuple[Array, Array]:
        e = self.equations
        matrix = np.zeros((6, 6))
        matrix[:4, :4], matrix[:4, 4:] = e.mass, -e.contacts.T
        friction = np.zeros(2)
        for wheel, slides in enumerate(mode):
            if slides:
                matrix[4 + wheel, 4 + wheel] = 1.0
                friction[wheel] = -slides * self.limits[wheel]
            else:
                matrix[4 + wheel, :4] = e.contacts[wheel]
        inverse = np.asarray(np.linalg.inv(matrix), dtype=float)
        return inverse, friction

    def solve(
        self, mode: Mode, speed: float, angles: Array, speeds: Array, pushes: Array
    ) -> tuple[Array, Array]:
        """Forces (2,) [N] of the floor and rate of change (2,) of both slips [m/s^2] in a mode.

        angles: (2,) lean, steer; speeds: (4,) u, yaw rate, lean rate, steer rate; pushes: (4,) on the rows.
        """
        e = self.equations
        inverse, friction = self.solver(mode)
        right = np.empty(6)
        right[:4] = pushes - (speed * e.gyroscopic + e.damping) @ speeds
        right[:4] -= (e.stiffness + speed**2 * e.stiffness2) @ angles
        for wheel, slides in enumerate(mode):
            right[4 + wheel] = friction[wheel] if slides else self._turning(wheel, speed, angles, speeds)
        found = inverse @ right
        turning = np.array([self._turning(wheel, speed, angles, speeds) for wheel in range(2)])
        return found[4:], e.contacts @ found[:4] - turning

    def _turning(self, wheel: int, speed: float, angles: Array, speeds: Array) -> float:
        """What J (u' + v r, r', lean'', steer'') is when this wheel's slip does not change."""
        turning = speed * speeds[1]
        if wheel == 1:
            turning += self.equations.heading * (speed * speeds[3] + self.acceleration * angles[1])
        return float(turning)

    def choose(self, speed: float, angles: Array, speeds: Array, pushes: Array) -> Mode:
        """The mode in which the motion goes on from a state."""
        slip = self.equations.slip(speed, float(angles[1]), speeds)
        moving = [int(np.sign(s)) if abs(s) > STILL else 0 for s in slip]
        forced: Mode = (moving[0], moving[1])
        for mode in MODES:
            if any(m and m != now for m, now in zip(moving, mode, strict=True)):
                continue
            forces, changes = self.solve(mode, speed, angles, speeds, pushes)
            if all(
                self._holds(wheel, now, moving[wheel], forces[wheel], changes[wheel])
                for wheel, now in enumerate(mode)
            ):
                return mode
        return forced

    def _holds(self, wheel: int, now: int, moving: int, force: float, change: float) -> bool:
        if now == 0:
            return bool(abs(force) <= self.limits[wheel] * (1.0 + 0.5 * MARGIN))
        return moving != 0 or now * change > 0.0
