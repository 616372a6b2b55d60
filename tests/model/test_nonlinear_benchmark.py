"""The nonlinear bicycle against table 1 of Basu-Mandal, Chatterjee and Papadopoulos 2007.

Proc. R. Soc. A 463, doi 10.1098/rspa.2007.1849. The numbers as the public DynamicistToolKit repeats them
(dtk/bicycle.py, basu_table_one_input and _output). The paper's axes: z up, x backwards; its angles
theta (yaw), psi (from the ground to the frame), phi (pitch, pi when level), psi_f (steer), beta_r and beta_f
(wheels, forward rolling positive), in terms of ours: yaw = -theta, lean = pi/2 - psi, pitch = pi - phi,
steer = -psi_f.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from tms_model import load_bicycle
from tms_model.nonlinear import Motion, motion, whipple_parameters
from tms_model.rolling import LEAN_RATE, PITCH_RATE, STEER_RATE, YAW_RATE

PSI, PHI, PSI_F = 0.9501292851472, 3.1257073014894, 0.2311385135743
RATES = {
    "x": -2.8069345714545,
    "y": -0.1480982396001,
    "z": 0.1058778746261,
    "theta": 0.7830033527065,
    "psi": 0.6068425835418,
    "phi": -0.0119185528069,
    "psi_f": 0.4859824687093,
    "beta_r": 8.9129896614890,
    "beta_f": 8.0133620584155,
}
ACCELERATIONS = {
    "x": -0.5041626315047,
    "y": -0.3449706619454,
    "z": -1.4604528332980,
    "theta": 0.8353281706379,
    "psi": -7.8555281128244,
    "phi": 0.1205543897884,
    "psi_f": -4.6198904039403,
    "beta_r": 1.8472554144217,
    "beta_f": 2.4548072904550,
}


@pytest.fixture(scope="module")
def benchmark() -> Motion:
    p = whipple_parameters(load_bicycle("benchmark"))
    # The rear contact runs along its track as fast as the wheel turns in the leaning, not pitching, axes.
    speed = p.rear_wheel_radius * (RATES["beta_r"] + RATES["phi"])
    state = np.array([math.pi / 2 - PSI, -PSI_F, -RATES["psi"], -RATES["psi_f"], speed])
    return motion(p, state)


def in_the_papers_signs(moving: Motion, rates: np.ndarray, wheels: np.ndarray) -> dict[str, float]:
    return {
        "theta": -rates[YAW_RATE],
        "psi": -rates[LEAN_RATE],
        "phi": -rates[PITCH_RATE],
        "psi_f": -rates[STEER_RATE],
        "beta_r": -wheels[0],
        "beta_f": -wheels[1],
    }


def test_the_front_wheel_touches_at_the_published_pitch(benchmark: Motion) -> None:
    assert benchmark.pitch == pytest.approx(math.pi - PHI, abs=1e-12)


def test_the_dependent_rates_are_the_published_ones(benchmark: Motion) -> None:
    found = in_the_papers_signs(benchmark, benchmark.rates, benchmark.wheel_rates)
    x, y, z = benchmark.posture.moving[0] @ benchmark.rates
    found |= {"x": -x, "y": y, "z": -z}
    assert found == pytest.approx(RATES, abs=1e-12, rel=0.0)


def test_all_nine_accelerations_are_the_published_ones(benchmark: Motion) -> None:
    found = in_the_papers_signs(benchmark, benchmark.accelerations, benchmark.wheel_accelerations)
    x, y, z = benchmark.rear_centre_acceleration
    found |= {"x": -x, "y": y, "z": -z}
    # The inputs are printed to 13 decimals; that leaves the accelerations 6e-13.
    assert found == pytest.approx(ACCELERATIONS, abs=2e-12, rel=0.0)
