"""What a change of speed adds to the linear equations: M q'' + v C1 q' + (g K0 + v^2 K2 + K') q = f.

The nonlinear Whipple equations, linearised about upright straight motion whose speed v changes at the rate
v', have M, C1, K0 and K2 as at constant speed, and one more stiffness K'. To first order these terms are in
it, and there are no others:

- turn: yaw acceleration is (cos lambda_s / w)(v steer' + v' steer + c steer''); the middle term, which Eq.
  (10.2) implies, acts on the lateral and yaw inertia of the whole bicycle and of the front assembly;
- shift: every mass is accelerated along the track, and stands beside it when the bicycle leans, yaws or
  steers: the front assembly's m_A u_A v' about the steer axis; the whole bicycle's through the trail, which
  yaws it as it steers, and through the pitch that lean and steer cause;
- spin: the wheels' spin changes at v'/r, about axles that lean and steer, and the part of the ground's force
  that spins the front wheel acts where the trail puts its contact;
- force: the force that changes the speed, m_eff v' = -(rear + front), by how it acts (`Resistance`). Load
  transfer enters here, and only here: it sets how the resistance of the ground divides between the wheels.

How it acts matters as much as how large it is, see `tms_model.nonlinear.Load`. `rolling`: the ground resists
by a moment about each wheel's axle. `normal_ahead`: the ground's vertical forces act ahead of the contacts,
which works like less trail: C_r = 0.06 under wheels of 50 mm is 3 mm, beside a trail of -4 mm. `rear_brake`,
`front_brake`: a torque between that wheel and its frame. Yaw rate = (cos lambda_s / w)(v steer + c steer'),
Eq. (10.2), holds for any v(t). As everywhere in the Whipple model the wheels neither slip nor lift off.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from tms_model.bicycle import Array, Bicycle
from tms_model.catalogue import load_bicycle
from tms_model.errors import ParameterError
from tms_model.nonlinear import Load
from tms_model.parameters import WhippleParameters
from tms_model.resistance import RESISTANCES, Resistance

# Bicycles known by their matrices only, and whose parameters stand in for the terms above.
STAND_INS = {"tms_eq_10_1": "tms_unrounded_8_1"}


@dataclass(frozen=True)
class _Totals:
    """Moments of the whole bicycle about its rear contact, and of the front assembly about the steer axis."""

    mass: float  # m_T [kg]
    moment_x: float  # m_T x_T [kg m]
    moment_z: float  # m_T z_T [kg m]
    inertia_xz: float  # I_Txz [kg m^2]
    inertia_zz: float  # I_Tzz [kg m^2]
    front_moment: float  # m_A u_A [kg m]
    front_inertia_z: float  # I_Alz [kg m^2]


def parameters_under_acceleration(bicycle: Bicycle) -> tuple[WhippleParameters, str]:
    """The parameters for the terms in v', and the name of the bicycle they are taken from.

    A bicycle given by matrices only has a stand-in (STAND_INS); without one ParameterError is raised.
    """
    if bicycle.parameters is not None:
        return bicycle.parameters, bicycle.name
    if bicycle.name not in STAND_INS:
        raise ParameterError(
            f"bicycle {bicycle.name}: expected masses and geometry for the terms of a changing speed, found"
            " only the matrices of constant speed; take a bicycle with parameters, or a constant speed"
        )
    return _stand_in(STAND_INS[bicycle.name]), STAND_INS[bicycle.name]


@lru_cache
def _stand_in(name: str) -> WhippleParameters:
    # Read once: an estimator asks thousands of times.
    parameters = load_bicycle(name).parameters
    assert parameters is not None, f"{name} must have parameters to stand in for another bicycle"
    return parameters


def effective_mass(p: WhippleParameters) -> float:
    """Mass [kg] that resists a change of speed: that of the bodies and I/r^2 of the wheels."""
    return (
        _totals(p).mass + _over(p.rear_spin, p.rear_wheel_radius) + _over(p.front_spin, p.front_wheel_radius)
    )


def coasting_loss(bicycle: Bicycle) -> float:
    """Speed that a rolling resistance of C_r = 1 takes in a second [m/s^2]: g m / m_eff.

    For a bicycle of which only matrices are known, and nothing stands in, g: wheels without spin.
    """
    try:
        p, _ = parameters_under_acceleration(bicycle)
    except ParameterError:
        return bicycle.gravity
    return bicycle.gravity * (_totals(p).mass / effective_mass(p))


def resistance_load(p: WhippleParameters, acceleration: float, resistance: Resistance = "rolling") -> Load:
    """The forces that give the upright bicycle this acceleration [m/s^2]; negative decelerates.

    What the ground resists with divides between the wheels as their normal forces do, load transfer included.
    Raises ParameterError if a wheel would have to lift off for that, or for a resistance that is not one of
    RESISTANCES.
    """
    rear, front = (float(force[0]) for force in _forces(p, np.array([acceleration]), resistance))
    return {
        "rolling": Load(rear_rolling=rear, front_rolling=front),
        "normal_ahead": Load(rear_ahead=rear, front_ahead=front),
        "rear_brake": Load(rear_brake=rear),
        "front_brake": Load(front_brake=front),
    }[resistance]


def normal_forces(
    p: WhippleParameters, acceleration: float, resistance: Resistance = "rolling"
) -> tuple[float, float]:
    """Normal forces [N] on the rear and the front wheel at an acceleration [m/s^2], load transfer included.

    Raises ParameterError as `resistance_load` does.
    """
    change = np.array([acceleration])
    rear, front = _forces(p, change, resistance)
    share = float(_front_weight_share(p, change, rear + front)[0])
    weight = p.gravity * _totals(p).mass
    return (1.0 - share) * weight, share * weight


def acceleration_stiffness(
    p: WhippleParameters, acceleration: Array | float, resistance: Resistance = "rolling"
) -> Array:
    """The stiffness K' [N m/rad], rows and columns [lean, steer], of a speed that changes.

    acceleration: v' [m/s^2], negative slows down. (2, 2) for a number, (n, 2, 2) for (n,). Raises
    ParameterError as `resistance_load` does.
    """
    change = np.asarray(acceleration, dtype=float)[..., None, None]
    rear_force, front_force = _forces(p, change, resistance)
    sin, cos = math.sin(p.steer_axis_tilt), math.cos(p.steer_axis_tilt)
    mu = p.trail / p.wheelbase * cos
    yaw = mu + cos  # heading of the front wheel per steer, trail's yaw included
    pitch = -mu * np.array([[0.0, 1.0], [1.0, sin]])
    track = _front_track(p, mu, yaw)
    rear, front = np.zeros((2, 2)), track
    if resistance == "rolling":
        rear = -p.rear_wheel_radius * np.array([[0.0, 0.0], [mu, 0.0]])
        front = track - p.front_wheel_radius * yaw * np.array([[0.0, 0.0], [1.0, sin]])
    elif resistance != "normal_ahead":
        rear = p.rear_wheel_radius * pitch
        front = track - p.front_wheel_radius * yaw * np.array([[0.0, 1.0], [1.0, sin]])
    stiffness: Array = change * _inertial(p, mu, yaw, pitch, track)
    return stiffness + rear_force * rear + front_force * front


def _front_track(p: WhippleParameters, mu: float, yaw: float) -> Array:
    """Length of the front contact's track by lean and steer, second derivatives [m] (2, 2)."""
    cos, sin = math.cos(p.steer_axis_tilt), math.sin(p.steer_axis_tilt)
    across = p.front_wheel_radius * cos + mu * (p.front_wheel_radius - p.rear_wheel_radius)
    return np.array([[0.0, across], [across, yaw * p.trail * cos + across * sin]])


def _inertial(p: WhippleParameters, mu: float, yaw: float, pitch: Array, track: Array) -> Array:
    """Turn, shift and spin of the module's list per unit of v' [kg m] (2, 2).

    pitch, track: second derivatives of the pitch angle and of the front contact's track by lean and steer.
    """
    t, S_R, S_F = _totals(p), p.rear_spin, p.front_spin
    cos, sin = math.cos(p.steer_axis_tilt), math.sin(p.steer_axis_tilt)
    turn = cos / p.wheelbase * np.array([[0.0, t.inertia_xz], [0.0, t.front_inertia_z + mu * t.inertia_zz]])
    shift = (t.moment_z + t.mass * p.rear_wheel_radius) * pitch
    shift += np.array([[0.0, 0.0], [mu * t.moment_z, -yaw * t.front_moment]])
    spin = _over(S_F, p.front_wheel_radius) * track
    spin -= np.array([[0.0, 0.0], [mu * S_R + yaw * S_F, yaw * sin * S_F]])
    return turn + shift + spin


def _forces(p: WhippleParameters, acceleration: Array, resistance: Resistance) -> tuple[Array, Array]:
    """Forces [N] at the rear and the front wheel, each in the shape of acceleration [m/s^2]."""
    if resistance not in RESISTANCES:
        raise ParameterError(f"resistance: expected one of {', '.join(RESISTANCES)}, found {resistance!r}")
    force = -effective_mass(p) * acceleration
    if resistance == "rear_brake":
        return force, np.zeros_like(force)
    if resistance == "front_brake":
        return np.zeros_like(force), force
    share = _front_weight_share(p, acceleration, force)
    lifted = (force != 0.0) & ((share < 0.0) | (share > 1.0))
    if lifted.any():
        raise ParameterError(
            f"acceleration by resistance {resistance}: expected both wheels to carry weight, found"
            f" {100.0 * share[lifted][0]:.0f} % of it on the front wheel at {acceleration[lifted][0]:g}"
            " m/s^2; take rear_brake or front_brake"
        )
    return (1.0 - share) * force, share * force


def _front_weight_share(p: WhippleParameters, acceleration: Array, force: Array) -> Array:
    """Front wheel's share of the normal forces, from the balance of pitch; the ground resists by `force`.

    w N_F = m_T g x_T + v' (m_T z_T - S_R - S_F) - force (r_R N_R + r_F N_F) / (m_T g)
    """
    t, r_R, r_F = _totals(p), p.rear_wheel_radius, p.front_wheel_radius
    moment = p.gravity * t.moment_x + acceleration * (t.moment_z - p.rear_spin - p.front_spin) - force * r_R
    share: Array = moment / (p.wheelbase * p.gravity * t.mass + force * (r_F - r_R))
    return share


def _totals(p: WhippleParameters) -> _Totals:
    x_B, z_B, m_B = p.rear_frame_x, p.rear_frame_z, p.rear_frame_mass
    x_H, z_H, m_H = p.front_frame_x, p.front_frame_z, p.front_frame_mass
    w, c, r_F, m_F = p.wheelbase, p.trail, p.front_wheel_radius, p.front_wheel_mass
    r_R, m_R = p.rear_wheel_radius, p.rear_wheel_mass
    cos, sin = math.cos(p.steer_axis_tilt), math.sin(p.steer_axis_tilt)
    u_H, u_F = (x_H - w - c) * cos - z_H * sin, -c * cos + r_F * sin
    front_zz = p.front_frame_inertia_zz + p.front_wheel_inertia_xx
    return _Totals(
        mass=m_R + m_B + m_H + m_F,
        moment_x=m_B * x_B + m_H * x_H + m_F * w,
        moment_z=-m_R * r_R + m_B * z_B + m_H * z_H - m_F * r_F,
        inertia_xz=p.rear_frame_inertia_xz
        + p.front_frame_inertia_xz
        - (m_B * x_B * z_B + m_H * x_H * z_H - m_F * w * r_F),
        inertia_zz=p.rear_wheel_inertia_xx
        + p.rear_frame_inertia_zz
        + front_zz
        + (m_B * x_B**2 + m_H * x_H**2 + m_F * w**2),
        front_moment=m_H * u_H + m_F * u_F,
        front_inertia_z=m_H * u_H * x_H + m_F * u_F * w + p.front_frame_inertia_xz * sin + front_zz * cos,
    )


def _over(spin: float, radius: float) -> float:
    return spin / radius if spin else 0.0
