"""The bicycle from its right side, to scale: wheels, steer axis, frames, centres of mass with masses."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patches import Circle, Wedge

from tms_model.bicycle import Array, Bicycle
from tms_model.figures.labels import Label, place_labels
from tms_model.parameters import WhippleParameters

# Room for the legend; loc="outside ..." would need a newer matplotlib than Ubuntu 24.04's.
LEGEND_BELOW = (0.0, 0.11, 1.0, 0.89)
GREY, REAR, FRONT = "0.45", "#0072B2", "#D55E00"


def drawing_figure(bicycle: Bicycle) -> Figure:
    """The bicycle to scale, alone."""
    figure = Figure(figsize=(7.0, 5.4), layout=ConstrainedLayoutEngine(rect=LEGEND_BELOW))
    figure.suptitle(bicycle.name, fontweight="bold")
    draw_bicycle(figure.add_subplot(), bicycle)
    return figure


def draw_bicycle(axes: Axes, bicycle: Bicycle, handles: Sequence[Artist] = ()) -> None:
    """Draw it heading to the right, in metres from the rear contact; heights upward, unlike the model's z.

    Of a bicycle given by its matrices only contacts and steer axis are known, and the drawing says so.
    handles: of what else stands in the figure, for the legend below it all; so this is drawn last.
    """
    p = bicycle.parameters
    tilt = math.degrees(bicycle.steer_axis_tilt)
    axes.set_title(
        f"wheelbase {bicycle.wheelbase:.4g} m, trail {1e3 * bicycle.trail:.4g} mm, tilt {tilt:.4g} deg"
    )
    axes.axhline(0.0, color="black", lw=1.0, zorder=1)
    top = _top(p) if p else 0.6 * bicycle.wheelbase
    axis = _steer_axis(bicycle, np.array([-0.12 * top, 1.1 * top]))
    axes.plot(*axis.T, color=GREY, lw=1.2, ls=(0, (6, 2, 1, 2)), label="steer axis", zorder=2)
    contacts = np.array([0.0, bicycle.wheelbase])
    axes.plot(contacts, [0.0, 0.0], "^", color="black", ms=5, zorder=6, label="wheel contact", clip_on=False)
    low, high = _limits(bicycle, axis)
    bottom = -0.16 * top if p else -0.3 * top
    axes.set(xlabel="x, forward [m]", ylabel="height [m]", xlim=(low, high), ylim=(bottom, 1.15 * top))
    axes.set_aspect("equal", adjustable="box")
    if p:
        axes.plot([], [], "o", color="white", mec=GREY, ms=8, label="centre of mass")
        lines = _draw_frames(axes, bicycle, p)
        bodies = [body for body in "BHRF" if _mass(p, body) > 0.0]
        for body in bodies:
            _draw_centre(axes, _centre(p, body), _symbol_radius(p, body), _colour(body))
    else:
        text = "Given by its matrices: wheels, masses and\ntheir places are not given and not drawn."
        axes.text(0.5, 0.06, text, transform=axes.transAxes, ha="center", va="bottom")
    own, _ = axes.get_legend_handles_labels()
    columns = 6 if handles else 3
    axes.figure.legend(handles=[*handles, *own], loc="lower center", ncols=columns, frameon=False)
    if p:
        place_labels(
            axes, [_label(p, body) for body in bodies], [*lines, axis, np.array([[low, 0.0], [high, 0.0]])]
        )


def _steer_axis(bicycle: Bicycle, heights: Array) -> Array:
    """Points (n, 2) of the steer axis at heights [m]; it meets the ground a trail ahead of the contact."""
    ahead = bicycle.wheelbase + bicycle.trail
    return np.stack([ahead - heights * math.tan(bicycle.steer_axis_tilt), heights], axis=1)


def _top(p: WhippleParameters) -> float:
    return max(-p.rear_frame_z, -p.front_frame_z, 2.0 * p.rear_wheel_radius, 2.0 * p.front_wheel_radius)


def _limits(bicycle: Bicycle, axis: Array) -> tuple[float, float]:
    p, w = bicycle.parameters, bicycle.wheelbase
    reach = [0.0, w, *axis[:, 0]]
    if p:
        reach += [-p.rear_wheel_radius, w + p.front_wheel_radius, p.rear_frame_x, p.front_frame_x]
    margin = 0.12 * (max(reach) - min(reach))
    return min(reach) - margin, max(reach) + margin


def _centre(p: WhippleParameters, body: str) -> tuple[float, float]:
    """Centre of mass of body R, B, H or F as x and height [m]."""
    return {
        "R": (0.0, p.rear_wheel_radius),
        "B": (p.rear_frame_x, -p.rear_frame_z),
        "H": (p.front_frame_x, -p.front_frame_z),
        "F": (p.wheelbase, p.front_wheel_radius),
    }[body]


def _mass(p: WhippleParameters, body: str) -> float:
    return {
        "R": p.rear_wheel_mass,
        "B": p.rear_frame_mass,
        "H": p.front_frame_mass,
        "F": p.front_wheel_mass,
    }[body]


def _symbol_radius(p: WhippleParameters, body: str) -> float:
    """Grows with the cube root of the mass, as a ball's does [m]."""
    largest = max(_mass(p, other) for other in "RBHF")
    size = 0.05 * max(p.wheelbase, _top(p))
    return float(size * max(0.35, (_mass(p, body) / largest) ** (1.0 / 3.0)))


def _colour(body: str) -> str:
    return FRONT if body in "HF" else REAR


def _label(p: WhippleParameters, body: str) -> Label:
    text = f"{body} {_mass(p, body):.4g} kg"
    return Label(text, *_centre(p, body), _symbol_radius(p, body), _colour(body))


def _draw_frames(axes: Axes, bicycle: Bicycle, p: WhippleParameters) -> list[Array]:
    """Wheels, and each frame as lines that join its wheel, its centre of mass and the steer axis.

    Returns what was drawn as lines (n, 2).
    """
    drawn = []
    turn = np.linspace(0.0, 2.0 * math.pi, 61)
    for radius, x, colour in ((p.rear_wheel_radius, 0.0, REAR), (p.front_wheel_radius, p.wheelbase, FRONT)):
        axes.add_patch(Circle((x, radius), radius, fill=False, color=colour, lw=2.0, zorder=3))
        drawn.append(np.stack([x + radius * np.cos(turn), radius + radius * np.sin(turn)], axis=1))
    rear, body, handlebar, front = (np.array(_centre(p, letter)) for letter in "RBHF")
    feet = _foot(bicycle, handlebar), _foot(bicycle, front)
    lower, upper = sorted(feet, key=lambda point: float(point[1]))
    middle = 0.5 * (lower + upper)
    frames = {
        FRONT: ((handlebar, feet[0]), (lower, upper), (front, feet[1])),
        REAR: ((rear, body), (body, middle), (rear, lower)),
    }
    for colour, lines in frames.items():
        for line in lines:
            axes.plot(*np.transpose(line), color=colour, lw=1.6, alpha=0.55, zorder=3, solid_capstyle="round")
            drawn.append(np.array(line))
    return drawn


def _foot(bicycle: Bicycle, point: Array) -> Array:
    """The point of the steer axis nearest to `point` (x, height)."""
    along = np.array([-math.sin(bicycle.steer_axis_tilt), math.cos(bicycle.steer_axis_tilt)])
    ground = np.array([bicycle.wheelbase + bicycle.trail, 0.0])
    return np.asarray(ground + along * float(along @ (point - ground)))


def _draw_centre(axes: Axes, centre: tuple[float, float], radius: float, colour: str) -> None:
    """The quartered circle of a centre of mass."""
    axes.add_patch(Circle(centre, radius, facecolor="white", edgecolor=colour, lw=1.4, zorder=4))
    for start in (0.0, 180.0):
        axes.add_patch(Wedge(centre, radius, start, start + 90.0, color=colour, lw=0, zorder=5))
