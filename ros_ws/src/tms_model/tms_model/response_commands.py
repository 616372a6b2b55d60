"""The commands `response` and `linearity`: motions of one bicycle, linear and nonlinear, at any v(t)."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from typing import Any

import numpy as np

from tms_model.acceleration import parameters_under_acceleration, resistance_load
from tms_model.bicycle import Array, Bicycle
from tms_model.command_line import print_json
from tms_model.errors import ParameterError
from tms_model.linearity import DEVIATIONS, linearity
from tms_model.nonlinear import whipple_parameters
from tms_model.nonlinear_response import NONLINEAR_STATE, OK, SPEED, nonlinear_response
from tms_model.response import LEAN_RATE, STATE, linear_system, response, yaw_rate
from tms_model.varying_speed import varying_response, varying_system, varying_yaw_rate


def respond(bicycle: Bicycle, arguments: argparse.Namespace) -> None:
    """Print the free response to an initial lean rate."""
    times = _times(arguments)
    for name in ("lean_rate", "gain", "deceleration"):
        if not np.isfinite(getattr(arguments, name)):
            raise ParameterError(
                f"{name.replace('_', '-')}: expected a finite number, found {getattr(arguments, name):g}"
            )
    elements = bicycle.steer_elements
    gain = elements.lean_rate_gain + elements.steer_torque_gain * arguments.gain
    acting = replace(bicycle, steer_elements=replace(elements, lean_rate_gain=gain))
    solve = _nonlinear if arguments.nonlinear else _varying if arguments.deceleration else _constant
    series, notes = solve(acting, arguments, times)
    columns = {"time": times, **series}
    if arguments.json:
        lists = {name: values.tolist() for name, values in columns.items()}
        print_json({"bicycle": bicycle.name, "speed": arguments.speed, **notes, **lists})
        return
    print(" ".join(f"{name:>12}" for name in columns))
    for row in zip(*columns.values(), strict=True):
        if np.isnan(row).any():
            break
        print(" ".join(f"{value:12.6f}" for value in row))
    source = notes.get("terms_of_changing_speed_from", bicycle.name)
    if source != bicycle.name:
        print(
            f"{bicycle.name} is known by matrices only: terms of the changing speed from {source}",
            file=sys.stderr,
        )
    if notes.get("status", OK) != OK:
        print(f"{bicycle.name}: {notes['status']}: {notes['message']}", file=sys.stderr)


def print_linearity(bicycle: Bicycle, arguments: argparse.Namespace) -> None:
    """Print at which lean angles the nonlinear motion departs from the linear prediction."""
    found = linearity(bicycle, arguments.speed, arguments.deviation or DEVIATIONS, arguments.duration)
    if arguments.json:
        limits = [
            {
                "deviation": one.deviation,
                "status": one.status,
                "message": one.message,
                "lean_rate": one.lean_rate,
                "peak_lean": one.peak_lean,
                "peak_steer": one.peak_steer,
            }
            for one in found
        ]
        print_json(
            {"bicycle": bicycle.name, "speed": arguments.speed, "duration": arguments.duration}
            | {"limits": limits}
        )
        return
    print(f"{bicycle.name} at {arguments.speed:g} m/s, free response of {arguments.duration:g} s:")
    for one in found:
        if one.status != OK:
            print(f"  {100 * one.deviation:g} %: {one.message}")
            continue
        print(
            f"  {100 * one.deviation:g} % off the linear prediction at a peak lean of"
            f" {np.degrees(one.peak_lean):.2f} deg (peak steer {np.degrees(one.peak_steer):.2f} deg,"
            f" initial lean rate {one.lean_rate:.4f} rad/s)"
        )


def _times(arguments: argparse.Namespace) -> Array:
    step, duration = arguments.step, arguments.duration
    if not (step > 0.0 and duration >= step and duration / step <= 1e6):
        raise ParameterError(
            "duration and step: expected a positive step, and 1 to 1000000 of them, found"
            f" {duration:g} s by {step:g} s"
        )
    times: Array = np.arange(round(duration / step) + 1) * step
    return times


def _constant(
    bicycle: Bicycle, arguments: argparse.Namespace, times: Array
) -> tuple[dict[str, Array], dict[str, Any]]:
    system = linear_system(bicycle, arguments.speed)
    states = response(system, _initial(arguments, 4), times)
    return {**_columns(STATE, states), "yaw_rate": yaw_rate(system, states)}, {}


def _varying(
    bicycle: Bicycle, arguments: argparse.Namespace, times: Array
) -> tuple[dict[str, Array], dict[str, Any]]:
    speeds = arguments.speed - arguments.deceleration * times
    system = varying_system(bicycle, times, speeds, arguments.resistance)
    states = varying_response(system, _initial(arguments, 4))
    _, source = parameters_under_acceleration(bicycle)
    notes = {"resistance": arguments.resistance, "deceleration": arguments.deceleration}
    series = {**_columns(STATE, states), "yaw_rate": varying_yaw_rate(system, states), "speeds": speeds}
    return series, {**notes, "terms_of_changing_speed_from": source}


def _nonlinear(
    bicycle: Bicycle, arguments: argparse.Namespace, times: Array
) -> tuple[dict[str, Array], dict[str, Any]]:
    load = resistance_load(whipple_parameters(bicycle), -arguments.deceleration, arguments.resistance)
    initial = _initial(arguments, 5)
    initial[SPEED] = arguments.speed
    found = nonlinear_response(bicycle, initial, times, load)
    series = _columns(NONLINEAR_STATE, found.states)
    series["speeds"] = series.pop("speed")
    notes = {"resistance": arguments.resistance, "deceleration": arguments.deceleration}
    return {**series, "yaw_rate": found.yaw_rate}, {
        "status": found.status,
        "message": found.message,
        **notes,
    }


def _initial(arguments: argparse.Namespace, size: int) -> Array:
    initial = np.zeros(size)
    initial[LEAN_RATE] = arguments.lean_rate
    return initial


def _columns(names: tuple[str, ...], states: Array) -> dict[str, Array]:
    return dict(zip(names, states.T, strict=True))
