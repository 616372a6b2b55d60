"""What goes wrong with sensors and their messages: a function for each fault, and one line in FAULTS.

A fault takes a stream, a mask of the messages it hits, its settings and a generator, and gives the stream
that an experimenter finds. Times in settings are seconds; whatever a fault changes begins and ends with the
window.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from tms_bag import topics

from tms_sim.stream import Stream

Mask = NDArray[np.bool_]  # (n,) messages inside the fault's window
Settings = Mapping[str, float | str]
ONE_G = 9.80665  # [m/s^2]

READINGS = (topics.IMU, topics.IMU_ORIENTED)  # where gyroscopes and accelerometers stand
PACKETS = (topics.IMU, topics.IMU_ORIENTED, topics.MAGNETIC, topics.LEAN_YAW)  # what the sensor sends


@dataclass(frozen=True)
class Fault:
    """One kind of fault."""

    apply: Callable[[Stream, Mask, Settings, np.random.Generator], Stream]
    text: str  # what it does, one plain phrase
    topics: tuple[str, ...]  # which it hits unless a topic is chosen
    defaults: dict[str, float | str]  # its settings, in SI units; duration 0: to the end


def dropout(stream: Stream, hit: Mask, settings: Settings, rng: np.random.Generator) -> Stream:
    """Nothing arrives."""
    return stream.rows(~hit)


def loss(stream: Stream, hit: Mask, settings: Settings, rng: np.random.Generator) -> Stream:
    """A share of the messages is lost, each by itself."""
    return stream.rows(~(hit & (rng.random(len(hit)) < number(settings, "share"))))


def stuck(stream: Stream, hit: Mask, settings: Settings, rng: np.random.Generator) -> Stream:
    """The reading stays where it was before."""
    if not hit.any():
        return stream
    held = max(int(np.argmax(hit)) - 1, 0)
    return _changed(stream, hit, settings, lambda values: np.full_like(values, values[held]))


def swapped_axes(stream: Stream, hit: Mask, settings: Settings, rng: np.random.Generator) -> Stream:
    """Two axes stand for each other."""
    quantity, one, two = (text(settings, key) for key in ("quantity", "axis", "other"))
    first, second = (stream.axes(quantity, axis)[0] for axis in (one, two))
    here, there = stream.columns[first], stream.columns[second]
    return stream.with_columns({first: np.where(hit, there, here), second: np.where(hit, here, there)})


def scaled(stream: Stream, hit: Mask, settings: Settings, rng: np.random.Generator) -> Stream:
    """The reading is a multiple of what it should be."""
    return _changed(stream, hit, settings, lambda values: values * number(settings, "factor"))


def shifted(stream: Stream, hit: Mask, settings: Settings, rng: np.random.Generator) -> Stream:
    """The reading jumps and stays off."""
    return _changed(stream, hit, settings, lambda values: values + number(settings, "size"))


def limited(stream: Stream, hit: Mask, settings: Settings, rng: np.random.Generator) -> Stream:
    """The reading stands at a limit that is too low."""
    limit = abs(number(settings, "limit"))
    return _changed(stream, hit, settings, lambda values: np.clip(values, -limit, limit))


def spikes(stream: Stream, hit: Mask, settings: Settings, rng: np.random.Generator) -> Stream:
    """Single readings are far off, to either side."""
    drawn = rng.random((len(hit), 2))
    where = drawn[:, 0] < number(settings, "share")
    sizes = where * np.where(drawn[:, 1] < 0.5, -1.0, 1.0) * number(settings, "size")
    return _changed(stream, hit, settings, lambda values: values + sizes)


def noise(stream: Stream, hit: Mask, settings: Settings, rng: np.random.Generator) -> Stream:
    """White noise comes on top."""
    own = iter(rng.spawn(3))  # one for each axis
    std = number(settings, "std")
    return _changed(
        stream, hit, settings, lambda values: values + std * next(own).standard_normal(len(values))
    )


def absent(stream: Stream, hit: Mask, settings: Settings, rng: np.random.Generator) -> Stream:
    """The reading is NaN: that axis says nothing."""
    return _changed(stream, hit, settings, lambda values: np.full_like(values, np.nan))


def clock_jump(stream: Stream, hit: Mask, settings: Settings, rng: np.random.Generator) -> Stream:
    """The sensor's clock is off; messages arrive as before."""
    return replace(stream, stamp_ns=stream.stamp_ns + hit * round(1e9 * number(settings, "size")))


def clock_drift(stream: Stream, hit: Mask, settings: Settings, rng: np.random.Generator) -> Stream:
    """The sensor's clock runs fast from the window's begin on, and keeps what it has gained."""
    if not hit.any():
        return stream
    inside = stream.stamp_ns[hit]
    since = np.clip(stream.stamp_ns, inside.min(), inside.max()) - inside.min()
    ahead = np.round(number(settings, "drift") * since).astype(np.int64)
    return replace(stream, stamp_ns=stream.stamp_ns + ahead)


def duplicated(stream: Stream, hit: Mask, settings: Settings, rng: np.random.Generator) -> Stream:
    """A share of the messages arrives twice, the second time later."""
    again = np.flatnonzero(hit & (rng.random(len(hit)) < number(settings, "share")))
    chosen = np.sort(np.concatenate([np.arange(len(hit)), again]))
    second = np.concatenate([[False], chosen[1:] == chosen[:-1]])
    twice = stream.rows(chosen)
    return replace(twice, log_ns=twice.log_ns + second * round(1e9 * number(settings, "delay")))


def late(stream: Stream, hit: Mask, settings: Settings, rng: np.random.Generator) -> Stream:
    """A share of the messages arrives later, so that others overtake them."""
    delayed = hit & (rng.random(len(hit)) < number(settings, "share"))
    return replace(stream, log_ns=stream.log_ns + delayed * round(1e9 * number(settings, "delay")))


def number(settings: Settings, key: str) -> float:
    """A setting that is a number."""
    return float(settings[key])


def text(settings: Settings, key: str) -> str:
    """A setting that is a word."""
    return str(settings[key])


def _changed(
    stream: Stream,
    hit: Mask,
    settings: Settings,
    change: Callable[[NDArray[np.float64]], NDArray[np.float64]],
) -> Stream:
    """The chosen quantity, changed where the mask says; one call for each axis."""
    names = stream.axes(text(settings, "quantity"), text(settings, "axis"))
    return stream.with_columns(
        {name: np.where(hit, change(stream.columns[name]), stream.columns[name]) for name in names}
    )


GYROSCOPES: dict[str, float | str] = {"quantity": "angular_velocity", "axis": "all"}
ACCELEROMETERS: dict[str, float | str] = {"quantity": "linear_acceleration", "axis": "all"}
SWAP: dict[str, float | str] = {"axis": "x", "other": "y"}

FAULTS: dict[str, Fault] = {
    "dropout": Fault(dropout, "nothing arrives", PACKETS, {"duration": 0.5}),
    "loss": Fault(loss, "messages are lost at random", PACKETS, {"share": 0.2}),
    "duplicated": Fault(duplicated, "messages arrive twice", PACKETS, {"share": 0.2, "delay": 0.005}),
    "out_of_order": Fault(late, "messages are overtaken", PACKETS, {"share": 0.2, "delay": 0.03}),
    "late": Fault(late, "all messages arrive late", PACKETS, {"share": 1.0, "delay": 0.2}),
    "clock_jump": Fault(clock_jump, "the clock jumps by size [s]", PACKETS, {"size": 0.5}),
    "clock_drift": Fault(clock_drift, "the clock runs fast", PACKETS, {"drift": 1e-3}),
    "stuck": Fault(stuck, "the reading stays where it was", READINGS, GYROSCOPES | {"duration": 0.5}),
    "swapped_axes": Fault(swapped_axes, "two axes stand for each other", READINGS, GYROSCOPES | SWAP),
    "flipped_axis": Fault(scaled, "the sign is wrong", READINGS, GYROSCOPES | {"axis": "x", "factor": -1.0}),
    "scale": Fault(scaled, "the reading is too large", READINGS, GYROSCOPES | {"factor": 1.1}),
    "degrees": Fault(scaled, "gyroscopes read deg/s", READINGS, GYROSCOPES | {"factor": 180.0 / math.pi}),
    "g_units": Fault(scaled, "accelerometers read g", READINGS, ACCELEROMETERS | {"factor": 1.0 / ONE_G}),
    "bias_jump": Fault(shifted, "the bias jumps", READINGS, GYROSCOPES | {"axis": "x", "size": 0.1}),
    "saturation": Fault(limited, "readings stop at a low limit", READINGS, GYROSCOPES | {"limit": 0.3}),
    "spikes": Fault(spikes, "readings are far off", READINGS, GYROSCOPES | {"share": 0.01, "size": 5.0}),
    "noise": Fault(noise, "noise comes on top", READINGS, GYROSCOPES | {"std": 0.1}),
    "missing_axis": Fault(absent, "an axis says nothing", READINGS, GYROSCOPES | {"axis": "y"}),
}
