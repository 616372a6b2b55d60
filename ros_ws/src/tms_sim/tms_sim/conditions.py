"""A scenario before it moves: the bicycle and all that acts, the speed, the strikes, the joints."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from tms_model import Bicycle, ParameterError, load_bicycle
from tms_model.acceleration import coasting_loss, parameters_under_acceleration
from tms_model.bicycle import Array
from tms_model.nonlinear import Load
from tms_model.sliding import sliding_equations

from tms_sim.contact import Contacts
from tms_sim.floor import Floor, load_floor, load_wheels
from tms_sim.intervention import Intervention, changed_bicycle, load_intervention
from tms_sim.nonlinear_ride import nonlinear_load
from tms_sim.plant import Plant
from tms_sim.scenario import Scenario
from tms_sim.shimmy import Shimmy, shimmy_of, torque_per_angle


@dataclass(frozen=True, eq=False)
class Strike:
    """One strike: an impulse on the frame, and with it what a hand does to the handlebars."""

    time: float  # [s], begin
    duration: float  # [s], half a sine; 0: an instant
    impulse: float  # J [N s], to the right positive
    hold: float  # [N m s] of steer torque by hand
    lean_rate: float  # [rad/s] that it gives to a bicycle whose wheels roll
    steer_rate: float  # [rad/s]
    kick: float  # [rad/s] of steer rate that the impulse alone would give to it
    rows: Array  # (4,) on the rows of tms_model.sliding: [N s, N m s, N m s, N m s]


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint of the floor under the front wheel."""

    time: float  # [s]
    impulse: float  # [N m s] of steer torque


@dataclass(frozen=True, eq=False)
class Conditions:
    """A run before it moves."""

    plant: Plant
    shimmy: Shimmy | None
    launch_speed: float  # [m/s] at the release
    release: float  # [s]
    strikes: tuple[Strike, ...]
    joints: tuple[Joint, ...]
    lean: float  # [rad] at the release
    lean_rate: float  # [rad/s] at the release
    phase: float  # [rad] of the shimmy at the release
    load: Load | None = None  # what slows the nonlinear bicycle; None: the linear one rides

    def speed(self, time: float) -> float:
        """Speed [m/s] after the release."""
        return self.launch_speed + self.plant.acceleration * (time - self.release)

    @property
    def stop(self) -> float:
        """When the bicycle has lost its speed [s]; infinite: never."""
        a = self.plant.acceleration
        return self.release + self.launch_speed / -a if a < 0.0 else math.inf


def conditions(scenario: Scenario, rng: np.random.Generator) -> Conditions:
    """Conditions of a scenario; rng is drawn from for what differs from run to run.

    Raises ParameterError for unknown names, and for effects that need more of a bicycle than is known.
    """
    intervention = load_intervention(scenario.text("intervention"))
    floor = _effective_floor(scenario, intervention)
    bicycle = _bicycle(scenario, intervention)
    acceleration = 0.0
    if floor.rolling_resistance:
        parameters_under_acceleration(bicycle)  # refuses a bicycle that can't tell what that does
        acceleration = -floor.rolling_resistance * coasting_loss(bicycle)
    release = scenario.number("run_up.duration")
    wanted, first = scenario.number("speed_at_strike"), scenario.numbers("strike.time")[0]
    launch = wanted - acceleration * (first - release) if wanted else scenario.number("speed")
    shimmy = _shimmy(scenario, bicycle, floor) if scenario.switch("effects.shimmy") else None
    plant = _plant(scenario, bicycle, floor, acceleration, intervention.vertical_load)
    start = Conditions(
        plant=plant,
        shimmy=shimmy,
        launch_speed=launch,
        release=release,
        strikes=tuple(_strikes(scenario, bicycle)),
        joints=(),
        lean=math.radians(scenario.number("release.lean_deg")) * rng.standard_normal(),
        lean_rate=scenario.number("release.lean_rate") * rng.standard_normal(),
        phase=rng.uniform(0.0, 2.0 * math.pi),
        load=nonlinear_load(scenario, plant) if scenario.switch("effects.nonlinear") else None,
    )
    end = min(scenario.number("duration"), start.stop)
    return replace(start, joints=tuple(_joints(start, floor, end, rng)))


def _effective_floor(scenario: Scenario, intervention: Intervention) -> Floor:
    """The floor under the scenario's wheels, without the effects that are switched off."""
    floor, wheels = load_floor(scenario.text("floor")), load_wheels(scenario.text("wheels"))
    on = {key: scenario.switch(f"effects.{key}") for key in ("rolling_resistance", "slip", "scrub", "joints")}
    resistance = floor.rolling_resistance * wheels.resistance_factor + intervention.added_resistance
    return Floor(
        rolling_resistance=resistance if on["rolling_resistance"] else 0.0,
        lateral_friction=floor.lateral_friction * wheels.friction_factor if on["slip"] else math.inf,
        scrub=floor.scrub + wheels.scrub if on["scrub"] else 0.0,
        joint_spacing=floor.joint_spacing if on["joints"] else math.inf,
        joint_impulse=floor.joint_impulse,
    )


def _bicycle(scenario: Scenario, intervention: Intervention) -> Bicycle:
    """The bicycle after the intervention, with what arrives of the controller's feedback."""
    bicycle = changed_bicycle(load_bicycle(scenario.text("bicycle")), intervention)
    elements = bicycle.steer_elements
    commanded = scenario.number("steer_torque.lean_rate_gain")
    gain = elements.lean_rate_gain + elements.steer_torque_gain * commanded
    return replace(bicycle, steer_elements=replace(elements, lean_rate_gain=gain))


def _plant(
    scenario: Scenario, bicycle: Bicycle, floor: Floor, acceleration: float, vertical_load: float
) -> Plant:
    contacts = None
    if math.isfinite(floor.lateral_friction):
        contacts = _contacts(bicycle, floor, acceleration, vertical_load)
    return Plant(
        bicycle=bicycle,
        acceleration=acceleration,
        scrub=(floor.scrub, floor.scrub),
        moments=_offset_mass(scenario, bicycle, acceleration),
        shimmy_torque=torque_per_angle(bicycle, scenario.number("shimmy.frequency")),
        contacts=contacts,
    )


def _contacts(bicycle: Bicycle, floor: Floor, acceleration: float, vertical_load: float) -> Contacts:
    equations = sliding_equations(bicycle, acceleration)
    cos = equations.heading
    turned = np.array([[0.0, 1.0, 0.0, 0.0], [0.0, 1.0, 0.0, cos]])  # of both wheels, about the vertical
    damping = equations.damping + floor.scrub * turned.T @ turned
    weights = equations.normal_forces
    if (weights <= 0.0).any():
        raise ParameterError(
            f"effects.slip: expected weight on both wheels, found {weights[0]:.3g} N on the rear and"
            f" {weights[1]:.3g} N on the front wheel of {bicycle.name}; switch slip off"
        )
    if np.linalg.cond(equations.mass) > 1e12:
        raise ParameterError(
            f"effects.slip: expected a bicycle with inertia in every motion, found {bicycle.name}, whose"
            " masses are points; switch slip off, or give its frames moments of inertia"
        )
    pressed = weights * (1.0 + vertical_load / weights.sum())
    # What slows a wheel down is no longer there to hold it sideways.
    grip = math.sqrt(max(floor.lateral_friction**2 - floor.rolling_resistance**2, 0.0))
    return Contacts(replace(equations, damping=damping), grip * pressed, acceleration)


def _offset_mass(scenario: Scenario, bicycle: Bicycle, acceleration: float) -> Array:
    """Forces on the four rows by masses beside the plane: weight, and what v' makes of them."""
    rear, front = scenario.number("asymmetry.rear_frame"), scenario.number("asymmetry.front_frame")
    sin, cos = math.sin(bicycle.steer_axis_tilt), math.cos(bicycle.steer_axis_tilt)
    lean = bicycle.gravity * (rear + front)
    steer = bicycle.gravity * sin * front + acceleration * cos * front
    return np.array([0.0, acceleration * (rear + front), lean, steer])


def _strikes(scenario: Scenario, bicycle: Bicycle) -> list[Strike]:
    """The strikes: how large the impulse is, and what a hand adds to it at the handlebars.

    M [lean rate, steer rate] = J [height, x (c/w) cos(lambda_s)] + [0, hold].
    """
    times = scenario.numbers("strike.time")
    rates, extras = (scenario.numbers(f"strike.{key}") for key in ("lean_rate", "steer_rate"))
    rates, extras = (found if len(found) == len(times) else found * len(times) for found in (rates, extras))
    x, height = scenario.number("strike.x"), scenario.number("strike.height")
    trail_yaw = bicycle.trail / bicycle.wheelbase * math.cos(bicycle.steer_axis_tilt)
    arm = np.array([height, x * trail_yaw])
    per_impulse = np.linalg.solve(bicycle.mass, arm)
    found = []
    for time, lean_rate, extra in zip(times, rates, extras, strict=True):
        kick = float(per_impulse[1] / per_impulse[0]) * lean_rate
        steer_rate = extra + (kick if scenario.switch("effects.steer_kick") else 0.0)
        needed = bicycle.mass @ np.array([lean_rate, steer_rate])
        impulse = float(needed[0]) / height
        hold = float(needed[1] - impulse * arm[1])
        rows = np.array([impulse, impulse * x, impulse * height, hold])
        lasts = scenario.number("strike.duration")
        own = float(np.linalg.solve(bicycle.mass, impulse * arm)[1])
        found.append(Strike(time, lasts, impulse, hold, lean_rate, steer_rate, own, rows))
    return found


def _shimmy(scenario: Scenario, bicycle: Bicycle, floor: Floor) -> Shimmy:
    return shimmy_of(
        bicycle,
        floor.scrub,
        frequency=scenario.number("shimmy.frequency"),
        amplitude=math.radians(scenario.number("shimmy.amplitude_deg")),
        onset_speed=scenario.number("shimmy.onset_speed"),
        growth=scenario.number("shimmy.growth"),
    )


def _joints(start: Conditions, floor: Floor, end: float, rng: np.random.Generator) -> list[Joint]:
    """The joints that the front wheel meets between release and end; the first within one spacing."""
    found: list[Joint] = []
    if math.isinf(floor.joint_spacing):
        return found
    way, a, v = floor.joint_spacing * rng.uniform(), start.plant.acceleration, start.launch_speed
    while v * v + 2.0 * a * way > 0.0:
        # way = v t + a t^2 / 2, in the form that holds for a = 0 too
        time = start.release + 2.0 * way / (v + math.sqrt(v * v + 2.0 * a * way))
        if time >= end:
            break
        found.append(Joint(time, floor.joint_impulse * rng.standard_normal()))
        way += floor.joint_spacing
    return found
