"""What ends a step of a ride early: a wheel that begins or ends to slide, or a bicycle that goes too far.

All of it is linear in the state, its rate of change and the speed times the state, and the speed is linear in
time: in a step it is a polynomial in time as the state is, of one power more.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tms_model.bicycle import Array
from tms_model.response import LEAN, STEER

from tms_sim.contact import MARGIN, STILL, Contacts, Mode
from tms_sim.plant import ONE, PULSE, SIZE, SPEEDS, TURN, Plant
from tms_sim.steps import ORDER

ACROSS = math.pi / 2.0  # [rad] of steer; handlebars that stand across end a ride as a fall does
PRECISION = 1e-12  # [s] of the instant that is found
_TERMS = ORDER + 2
_LOOKS = np.vander(np.linspace(0.0, 1.0, 9), _TERMS, increasing=True).T
_CLOSER = np.linspace(0.0, 1.0, 33)
_POWERS = np.arange(_TERMS)


@dataclass(frozen=True, eq=False)
class Watch:
    """j values of the state z, and how far each may go: changing z' + steady z + v moving z."""

    changing: Array  # (j, SIZE)
    steady: Array  # (j, SIZE)
    moving: Array  # (j, SIZE)
    ways: Array  # (j, 1): 1 or -1: beyond its limit to this side only, 0: to either
    limits: Array  # (j, 1)

    def first(
        self, terms: Array, speeds: Array, acceleration: float, lengths: Array
    ) -> tuple[int, float] | None:
        """The first of k steps with a value beyond its limit, and the time in it [s]; None: there is none.

        Each step is looked at nine times, and then closer until the time is known to PRECISION.
        terms: (k, ORDER + 1, SIZE), powers of the state since a step's begin; speeds: (k,) [m/s] at the
        begins; acceleration: [m/s^2]; lengths: (k,) [s].
        """
        polynomials = self._polynomials(terms, speeds, acceleration)
        scaled = polynomials * lengths[:, None, None] ** _POWERS
        beyond = self._beyond(scaled @ _LOOKS)
        if not beyond.any():
            return None
        k = int(beyond.any(axis=1).argmax())
        look = int(beyond[k].argmax())
        length = float(lengths[k])
        low, high = length * max(look - 1, 0) / 8.0, length * look / 8.0
        while high - low > PRECISION:
            within = low + (high - low) * _CLOSER
            beyond = self._beyond(polynomials[k] @ np.vander(within, _TERMS, increasing=True).T)
            beyond[-1] = True
            place = max(int(beyond.argmax()), 1)
            if within[place] - within[place - 1] >= high - low:
                break
            low, high = float(within[place - 1]), float(within[place])
        return k, high

    def _polynomials(self, terms: Array, speeds: Array, acceleration: float) -> Array:
        """The values in each step as powers of the time since its begin (k, j, ORDER + 2)."""
        found = np.zeros((len(terms), len(self.limits), _TERMS))
        powers = np.swapaxes(terms, 1, 2)
        found[..., :-1] = self.steady @ powers
        found[..., :-2] += self.changing @ (powers[..., 1:] * _POWERS[1:-1])
        moving = self.moving @ powers
        found[..., :-1] += speeds[:, None, None] * moving
        found[..., 1:] += acceleration * moving
        return found

    def _beyond(self, values: Array) -> NDArray[np.bool_]:
        """Where any of the values (..., j, s) is beyond its limit (..., s)."""
        sided = np.where(self.ways, self.ways * values, np.abs(values))
        beyond: NDArray[np.bool_] = np.logical_or.reduce(sided > self.limits, axis=-2)
        return beyond


def watch(plant: Plant, mode: Mode, lean_limit: float, strike: Array) -> Watch:
    """What ends a step in a mode of the contacts: leaning too far [rad], handlebars across, and the wheels.

    strike: (4,) on the rows of tms_model.sliding, per unit of the pulse.
    """
    changing, steady, moving = (np.zeros((4, SIZE)) for _ in range(3))
    steady[0, LEAN] = steady[1, STEER] = 1.0
    ways, limits = np.zeros((4, 1)), np.full((4, 1), np.inf)
    limits[:2, 0] = lean_limit, ACROSS
    if plant.contacts is not None:
        forces, slips = _forces(plant.contacts, plant.moments, strike), _slips(plant.contacts)
        for wheel, slides in enumerate(mode):
            row = 2 + wheel
            chosen = slips if slides else forces
            changing[row], steady[row], moving[row] = (part[wheel] for part in chosen)
            # A slide ends where it has turned around.
            ways[row] = -slides
            limits[row] = 0.5 * STILL if slides else plant.contacts.limits[wheel] * (1.0 + MARGIN)
    return Watch(changing, steady, moving, ways, limits)


def _forces(contacts: Contacts, moments: Array, strike: Array) -> tuple[Array, Array, Array]:
    """Lateral forces [N] on the rear and the front wheel: what is before z', z and v z, (2, SIZE) each."""
    e, order = contacts.equations, list(SPEEDS)
    changing, steady, moving = (np.zeros((2, SIZE)) for _ in range(3))
    changing[:, order] = e.mass[:2]
    steady[:, order], steady[:, :2] = e.damping[:2], e.stiffness[:2]
    steady[:, PULSE], steady[:, ONE] = -strike[:2], -moments[:2]
    moving[:, order] = e.gyroscopic[:2]
    moving[:, TURN] += e.mass[:2, 0]  # u' + v r
    share = np.array([[1.0, -1.0 / e.contacts[1, 1]], [0.0, 1.0 / e.contacts[1, 1]]])
    return share @ changing, share @ steady, share @ moving


def _slips(contacts: Contacts) -> tuple[Array, Array, Array]:
    """Lateral velocities [m/s] of both contacts over the floor, likewise."""
    changing, steady, moving = (np.zeros((2, SIZE)) for _ in range(3))
    steady[:, list(SPEEDS)] = contacts.equations.contacts
    moving[1, STEER] = -contacts.equations.heading
    return changing, steady, moving
