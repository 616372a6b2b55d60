"""The steering's own oscillation of about 20 Hz: phenomenological, not derived from the contact.

    p' = s p - 2 pi f q - b (p^2 + q^2) p,   q' = s q + 2 pi f p - b (p^2 + q^2) q

the normal form of the Hopf bifurcation: below the onset speed it dies out, above it grows to a limit cycle of
the amplitude root(s / b). It acts on the bicycle as a steer torque that swings the steering by p radians
where inertia alone resists; the bicycle doesn't act back on it. What is assumed is chosen for what chapter 11
of the supplement (doi 10.1126/science.1201959) tells of the real one: it begins at walking speed on every
floor, is small and always about the same, whatever floor, load or counter-wheel; but damping of the steering
ends it, and so does taking away the front frame's mass. So its growth rate is

    s = growth (m_A u_A / that of table 8.1 - onset speed / speed) - steer damping / (2 M_dd)

with m_A u_A the front assembly's first moment about the steer axis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from tms_model import Bicycle, load_bicycle
from tms_model.acceleration import parameters_under_acceleration
from tms_model.bicycle import Array
from tms_model.sliding import front_moment

LEAST = 1e-15  # [rad]; what is dying out stays above, so that it can grow anew


@dataclass(frozen=True)
class Shimmy:
    """The oscillator on one bicycle."""

    frequency: float  # f [Hz]
    amplitude: float  # [rad], root(growth / b)
    onset_speed: float  # [m/s]
    growth: float  # [1/s]
    moment: float  # m_A u_A by that of table 8.1
    damping: float  # [1/s] of growth that the steering's damping takes

    def growth_rate(self, speed: float) -> float:
        """The rate s [1/s] at a speed [m/s]."""
        ratio = self.onset_speed / speed if speed > 0.0 else math.inf
        return max(self.growth * (self.moment - ratio) - self.damping, -1000.0)

    def steps(self, size: float, speeds: Array, lengths: Array) -> Array:
        """Rates (k,) [1/s] at which the amplitude changes in steps, from `size` [rad] at the first.

        speeds: (k,) [m/s] in the middle of the steps; lengths: (k,) [s]. Each rate gives the amplitude at the
        step's end as the normal form at the middle's speed does.
        """
        if size <= 0.0 or self.amplitude == 0.0:
            return np.zeros(len(speeds))
        inverse, rates = 1.0 / size**2, np.empty(len(speeds))
        limit = self.growth / self.amplitude**2
        for k, (speed, length) in enumerate(zip(speeds.tolist(), lengths.tolist(), strict=True)):
            s = self.growth_rate(speed)
            fade = math.exp(-2.0 * s * length)
            gain = -math.expm1(-2.0 * s * length) / s if s else 2.0 * length
            after = min(inverse * fade + limit * gain, 1.0 / LEAST**2)
            rates[k] = -0.5 * math.log(after / inverse) / length
            inverse = after
        return rates


def shimmy_of(
    bicycle: Bicycle, scrub: float, frequency: float, amplitude: float, onset_speed: float, growth: float
) -> Shimmy:
    """The oscillator of a bicycle; scrub: of its front wheel [N m s/rad]. Raises ParameterError."""
    p, _ = parameters_under_acceleration(bicycle)
    resisting = bicycle.steer_elements.steer_damper + scrub * math.cos(bicycle.steer_axis_tilt) ** 2
    return Shimmy(
        frequency=frequency,
        amplitude=amplitude,
        onset_speed=onset_speed,
        growth=growth,
        moment=front_moment(p) / _tested_moment(),
        damping=resisting / (2.0 * float(bicycle.mass[1, 1])),
    )


def torque_per_angle(bicycle: Bicycle, frequency: float) -> float:
    """Steer torque [N m/rad] that swings the steering at a frequency [Hz] where only inertia resists."""
    return float((2.0 * math.pi * frequency) ** 2 / np.linalg.inv(bicycle.mass)[1, 1])


@lru_cache
def _tested_moment() -> float:
    parameters, _ = parameters_under_acceleration(load_bicycle("tms_table_8_1"))
    return front_moment(parameters)
