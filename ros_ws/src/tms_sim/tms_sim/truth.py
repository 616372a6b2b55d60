"""The truth of a run as samples and events; no experimenter has it, and no estimator may read it."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from tms_bag import event
from tms_bag.samples import StateSamples
from tms_model.imu import RearFrameMotion

from tms_sim.motion import Event, Motion


def true_state(motion: Motion, start_ns: int, time_ns: NDArray[np.int64]) -> StateSamples:
    """Samples of the truth; motion: at the times (n,) [ns since the start]."""
    return StateSamples(
        time_ns=start_ns + time_ns,
        speed=motion.speed,
        state=np.stack([motion.lean, motion.steer, motion.lean_rate, motion.steer_rate], axis=1),
        yaw=motion.yaw,
        yaw_rate=motion.yaw_rate,
        steer_torque=motion.steer_torque,
        phase=motion.phase,
        acceleration=motion.acceleration,
        lean_acceleration=motion.lean_acceleration,
        steer_acceleration=motion.steer_acceleration,
        yaw_acceleration=motion.yaw_acceleration,
        rear_contact=motion.rear_contact,
        front_contact=motion.front_contact,
        rear_slip=motion.rear_slip,
        front_slip=motion.front_slip,
    )


def true_events(events: Iterable[Event], start_ns: int) -> tuple[event.Event, ...]:
    """What happened in a run, in the order of its times."""
    return tuple(
        event.Event(start_ns + round(one.time * 1e9), one.kind, one.text, one.duration, one.figures)
        for one in sorted(events, key=lambda one: one.time)
    )


def rear_frame_motion(motion: Motion) -> RearFrameMotion:
    """What an inertial sensor on the rear frame takes part in."""
    return RearFrameMotion(
        lean=motion.lean,
        lean_rate=motion.lean_rate,
        lean_acceleration=motion.lean_acceleration,
        yaw_rate=motion.yaw_rate,
        yaw_acceleration=motion.yaw_acceleration,
        speed=motion.speed,
        acceleration=motion.acceleration,
        rear_slip=motion.rear_slip,
        rear_slip_acceleration=motion.rear_slip_acceleration,
        yaw=motion.yaw,
    )


def stamps(rate: float, end: float) -> NDArray[np.int64]:
    """Times [ns since the start] of samples at `rate` [Hz], from 0 up to and with `end` [s]."""
    count = math.floor(end * rate + 1e-9) + 1
    return np.round(np.arange(count) * (1e9 / rate)).astype(np.int64)
