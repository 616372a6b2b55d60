"""Response of the linear bicycle to a force of given onset, duration and shape, in closed form.

A force on the lean and steer rows of Eq. (3.1) changes both rates through the inverse mass matrix. Its course
over its duration d is

    f(u) = pi / (2 d) [sin(w u) + a sin(2 w u) + b (sin(3 w u) - sin(w u) / 3)],    w = pi / d,  0 <= u <= d

a half-sine of unit integral, and two modes of zero integral: skewness a and flatness b (a rectangle has
b = 0.27). Each eigenmode of the bicycle responds to a sine in closed form, so onset and duration may lie
anywhere between samples.

Reference: Kooijman et al. 2011, supplement Eq. (3.1), doi 10.1126/science.1201959.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from tms_model import LinearSystem
from tms_model.bicycle import Array
from tms_model.response import LEAN_RATE, STEER_RATE

Complex = NDArray[np.complex128]
SHAPES = 3  # half-sine, skewness, flatness


@dataclass(frozen=True, eq=False)
class ForcedBicycle:
    """Eigenmodes of a linear bicycle, and its responses to initial states and to forces."""

    system: LinearSystem
    pitch: float = 0.0  # [rad] of the sensor, nose up

    @cached_property
    def _modes(self) -> tuple[Complex, Complex, Complex]:
        """Eigenvalues (4,), eigenvectors (4, 4) and their inverse (4, 4)."""
        values, vectors = np.linalg.eig(self.system.a.astype(complex))
        return values, vectors, np.linalg.inv(vectors)

    @cached_property
    def _channels(self) -> Complex:
        """Lean and yaw rate as measured (2, 4) per eigenmode."""
        cos, sin = np.cos(self.pitch), np.sin(self.pitch)
        rates = np.stack([np.eye(4)[LEAN_RATE], self.system.yaw])
        turned = np.array([[cos, -sin], [sin, cos]]) @ rates
        return np.asarray(turned @ self._modes[1])

    def transition(self, times: Array) -> Array:
        """State transition matrices (..., 4, 4) over times (...) [s]."""
        values, vectors, inverse = self._modes
        grown = np.exp(values * times[..., None])
        moved: Array = ((vectors * grown[..., None, :]) @ inverse).real
        return moved

    def free(self, times: Array) -> Array:
        """Lean and yaw rate (n, 2, 4) at times (n,) [s] per unit of the state at time 0."""
        values, _, inverse = self._modes
        grown = np.exp(values * times[:, None])
        rates: Array = ((self._channels * grown[:, None, :]) @ inverse).real
        return rates

    def forced(self, since: Array, duration: Array, shapes: int) -> Array:
        """Lean and yaw rate (..., 2, 2 * shapes) at times since the onset [s] by forces of durations [s].

        Columns: for each shape the force that changes the lean rate by 1 rad/s, and the steer rate.
        """
        return self._response(self._channels, since, duration, shapes)

    def forced_state(self, since: Array, duration: Array, shapes: int) -> Array:
        """State (..., 4, 2 * shapes) at times since the onset [s] by forces of durations [s]."""
        return self._response(self._modes[1], since, duration, shapes)

    def _response(self, rows: Complex, since: Array, duration: Array, shapes: int) -> Array:
        values, _, inverse = self._modes
        modal = _modal(values, since, duration, shapes)  # (..., shapes, 4)
        unit = inverse[:, [LEAN_RATE, STEER_RATE]]  # modal change by a unit change of each rate
        # real part of rows (c, m) * modal (..., k, m) * unit (m, w)
        weights = rows[:, :, None] * unit[None]  # (c, m, w)
        flat = weights.transpose(1, 0, 2).reshape(4, -1)
        found = modal.real @ flat.real - modal.imag @ flat.imag  # (..., k, c * w)
        found = found.reshape(*found.shape[:-1], len(rows), 2)
        found = np.moveaxis(found, -3, -2)  # (..., c, k, w)
        return found.reshape(*found.shape[:-2], 2 * shapes)


def _modal(values: Complex, since: Array, duration: Array, shapes: int) -> Complex:
    """Response (..., shapes, 4) of each eigenmode to a force of unit integral; shapes beyond the first add 0.

    The response to sin(j w u) over 0 <= u <= d is [e^(s t) j w - j w cos(j w t) - s sin(j w t)]
    / (s^2 + j^2 w^2) for an eigenvalue s, at t = min(since, d), and decays freely afterwards.
    """
    since, duration = np.broadcast_arrays(since, duration)
    found = np.zeros((*since.shape, shapes, 4), dtype=complex)
    instant, struck = duration <= 0.0, since >= 0.0
    now = instant & struck
    found[now, 0] = np.exp(values * since[now][:, None])
    now = ~instant & struck
    t, d = since[now][:, None], duration[now][:, None]
    within, after = np.minimum(t, d), np.maximum(t - d, 0.0)
    decayed = np.exp(values * within)
    w = np.pi / d
    scale = np.exp(values * after) * (np.pi / (2.0 * d))

    def sine(j: int) -> Complex:
        frequency = j * w
        top = decayed * frequency - frequency * np.cos(frequency * within)
        return np.asarray((top - values * np.sin(frequency * within)) / (values**2 + frequency**2))

    first = sine(1)
    found[now, 0] = scale * first
    if shapes > 1:
        found[now, 1] = scale * sine(2)
        found[now, 2] = scale * (sine(3) - first / 3.0)
    return found
