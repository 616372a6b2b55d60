"""A simulated run on one page, like a laboratory notebook's: path, angles, rates, speed, forces."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from tms_bag import BagReader, Recording, RecordingError, read_recording, topics
from tms_bag.event import Event, events
from tms_bag.samples import StateSamples
from tms_model.frames import imu_to_rear_frame

from tms_sim.motion import CAUGHT, FALLEN, FREE, PHASES, RESPONSE, RUN_UP, SETTLING, STRIKE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHADES = {
    FREE: "#ffffff", RUN_UP: "#dfe8f2", SETTLING: "#eef3e2", STRIKE: "#f4c7c3", RESPONSE: "#ffffff",
    CAUGHT: "#e6e0ee", FALLEN: "#d9d9d9",
}  # fmt: skip
TRUE, MEASURED, SECOND, MARKED = "#0072B2", "#888888", "#D55E00", "#CC0000"
G = 9.81
HEADROOM = 0.25  # of an axis, for its legend


@dataclass(frozen=True, eq=False)
class Page:
    """What is drawn: the recording, its truth and what happened."""

    recording: Recording
    state: StateSamples
    events: tuple[Event, ...]

    def seconds(self, time_ns: np.ndarray) -> np.ndarray:
        """Times [s] since the run's first true state."""
        since: np.ndarray = (time_ns - self.state.time_ns[0]) / 1e9
        return since


def read_page(bag: str | os.PathLike[str]) -> Page:
    """A recorded run with its truth. Raises RecordingError where there is none."""
    recording = read_recording(bag)
    if recording.state is None or not len(recording.state.time_ns):
        raise RecordingError(
            f"{bag}: expected a simulated run with its truth (/{topics.STATE}), found none;"
            " a run made with --blind, or a real one, is drawn by `tms fit report`"
        )
    with BagReader(bag) as reader:
        told = events(reader.records(["/" + topics.EVENTS]))
    return Page(recording, recording.state, tuple(told))


def draw(page: Page) -> Figure:
    """The page as a figure."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.3, 11.7), layout="constrained")
    axes = figure.subplots(6, 1, height_ratios=[1.5, 1.0, 1.2, 1.0, 0.8, 1.3])
    _path(axes[0], page)
    _angles(axes[1], page)
    _rates(axes[2], page)
    _steer_rate(axes[3], page)
    _speed(axes[4], page)
    _forces(axes[5], page)
    for one in axes[1:]:
        one.sharex(axes[1])
        _shade(one, page)
        one.axhline(0.0, color="black", lw=0.5)
        low, high = one.get_ylim()
        one.set_ylim(low, high + HEADROOM * (high - low))
        one.legend(loc="upper left", fontsize=7, ncol=4, framealpha=0.8)
        one.tick_params(labelbottom=one is axes[5])
    axes[1].set_xlim(0.0, float(page.seconds(page.state.time_ns)[-1]))
    _name_phases(axes[1], page)
    axes[5].set_xlabel("time [s]")
    info = page.recording.run_info
    what = f"{info.source}, {info.bicycle}, seed {info.seed}" if info else str(page.recording.path)
    figure.suptitle(f"Simulated run: {what}", fontsize=10)
    return figure


def _path(axes: Axes, page: Page) -> None:
    state = page.state
    axes.plot(*state.rear_contact.T, color=TRUE, lw=1.2, label="rear contact")
    axes.plot(*state.front_contact.T, color=SECOND, lw=0.8, label="front contact")
    for event in page.events:
        if event.kind == "strike":
            at = int(np.searchsorted(state.time_ns, event.time_ns))
            axes.plot(*state.rear_contact[min(at, len(state.time_ns) - 1)], "o", color=MARKED, ms=5)
            axes.annotate(event.text, state.rear_contact[min(at, len(state.time_ns) - 1)], (-4, -14),
                          textcoords="offset points", ha="right", fontsize=7, color=MARKED)  # fmt: skip
    axes.set(xlabel="ahead [m]", ylabel="to the right [m]", aspect="equal", adjustable="datalim")
    axes.invert_yaxis()
    axes.legend(loc="lower left", fontsize=7, framealpha=0.8)


def _angles(axes: Axes, page: Page) -> None:
    seconds = page.seconds(page.state.time_ns)
    axes.plot(seconds, np.degrees(page.state.state[:, 0]), color=TRUE, lw=1.2, label="lean")
    axes.plot(seconds, np.degrees(page.state.state[:, 1]), color=SECOND, lw=0.8, label="steer")
    axes.set_ylabel("angle [deg]")


def _rates(axes: Axes, page: Page) -> None:
    lean_yaw, seconds = page.recording.lean_yaw, page.seconds(page.state.time_ns)
    if lean_yaw is not None:
        measured = page.seconds(lean_yaw.time_ns)
        axes.plot(measured, lean_yaw.lean_rate, ".", ms=2, color=MEASURED, label="measured")
        axes.plot(measured, lean_yaw.yaw_rate, ".", ms=2, color=MEASURED)
    axes.plot(seconds, page.state.state[:, 2], color=TRUE, lw=1.0, label="lean rate")
    axes.plot(seconds, page.state.yaw_rate, color=SECOND, lw=1.0, label="yaw rate")
    axes.set_ylabel("rate [rad/s]")


def _steer_rate(axes: Axes, page: Page) -> None:
    seconds = page.seconds(page.state.time_ns)
    axes.plot(seconds, page.state.state[:, 3], color=TRUE, lw=0.8, label="steer rate")
    axes.set_ylabel("steer rate [rad/s]")
    slides = [event for event in page.events if event.kind == "slip"]
    for wheel, color in (("rear", SECOND), ("front", MARKED)):
        spans = [
            (float(page.seconds(np.array(e.time_ns))), max(e.duration, 0.02))
            for e in slides
            if f"the {wheel} wheel" in e.text
        ]
        if spans:
            low, high = axes.get_ylim()
            axes.broken_barh(spans, (low, 0.08 * (high - low)), color=color, label=f"{wheel} wheel slides")


def _speed(axes: Axes, page: Page) -> None:
    speed = page.recording.speed
    if speed is not None:
        size, above = (9, 3) if len(speed.time_ns) < 10 else (2, 2)  # the camera's one is to be seen
        seconds = page.seconds(speed.time_ns)
        axes.plot(seconds, speed.speed, ".", ms=size, color=MEASURED, zorder=above, label="measured")
    axes.plot(page.seconds(page.state.time_ns), page.state.speed, color=TRUE, lw=1.2, label="speed")
    axes.set_ylabel("speed [m/s]")


def _forces(axes: Axes, page: Page) -> None:
    imu, info = page.recording.imu, page.recording.run_info
    seconds = page.seconds(imu.time_ns)
    orientation = info.imu_orientation if info is not None else np.array([0.0, 0.0, 0.0, 1.0])
    force = imu_to_rear_frame(imu.specific_force, orientation) / G
    for axis, (name, color) in enumerate((("ahead", TRUE), ("right", SECOND), ("down", "#009E73"))):
        axes.plot(seconds, force[:, axis], color=color, lw=0.5, label=name)
    lean_yaw = page.recording.lean_yaw
    if lean_yaw is not None:
        cut = page.seconds(lean_yaw.time_ns)[(lean_yaw.saturation & 7) > 0]
        if len(cut):
            bottom = axes.get_ylim()[0]
            label = f"clipped ({len(cut)} samples)"
            axes.plot(cut, np.full(len(cut), bottom), "|", ms=7, color=MARKED, label=label)
    axes.set_ylabel("specific force [g]")


def _phases(page: Page) -> list[tuple[float, float, int]]:
    """Begin and end [s] of each phase."""
    state, seconds = page.state, page.seconds(page.state.time_ns)
    begins = np.flatnonzero(np.diff(state.phase, prepend=255))
    ends = [*seconds[begins[1:]], seconds[-1]]
    return [(float(seconds[b]), float(end), int(state.phase[b])) for b, end in zip(begins, ends, strict=True)]


def _shade(axes: Axes, page: Page) -> None:
    for begin, end, phase in _phases(page):
        axes.axvspan(begin, end, color=SHADES[phase], lw=0, zorder=0)
    for event in page.events:
        if event.kind == "strike":
            axes.axvline(float(page.seconds(np.array(event.time_ns))), color=MARKED, lw=0.8, ls="--")


def _name_phases(axes: Axes, page: Page) -> None:
    length = float(page.seconds(page.state.time_ns)[-1])
    for begin, end, phase in _phases(page):
        if end - begin > 0.05 * length:
            axes.text(0.5 * (begin + end), 1.02, PHASES[phase], transform=axes.get_xaxis_transform(),
                      ha="center", fontsize=7)  # fmt: skip
