"""A recording made of arrays, for measurements that are in no bag."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from tms_model.errors import ParameterError

from tms_bag.recording import Recording
from tms_bag.samples import FloatArray, ImuSamples, IntArray, RunInfo, SpeedSamples, SteerTorqueSamples

Series = tuple[ArrayLike, ArrayLike]  # times (m,) [s] and values (m,)


def recording_from_arrays(
    time: ArrayLike,
    angular_velocity: ArrayLike,
    speed: float | Series,
    *,
    orientation: ArrayLike | None = None,
    steer_torque: Series | None = None,
    bicycle: str = "",
    name: str = "arrays",
) -> Recording:
    """Recording of the readings of a gyroscope and of the forward speed.

    Parameters
    ----------
    time : array_like (n,)
        Ascending times [s]. Stamps are these times since 1970, to the nanosecond.
    angular_velocity : array_like (n, 3)
        Angular velocity [rad/s] in the sensor's axes (REP-103), not finite: not measured.
    speed : float or (times, values)
        Forward speed [m/s]: a number for the whole run, or times (m,) [s] and speeds (m,).
    orientation : array_like (4,), optional
        Quaternion x, y, z, w, sensor -> rear frame (x forward, y left, z up); None: the same axes.
    steer_torque : (times, values), optional
        Times (m,) [s] and known steer torques (m,) [N m], positive steers to the right.
    bicycle : str, optional
        Name in the catalogue, which `fit_recording` takes where it is given no bicycle.
    name : str, optional
        Name of the recording, in tables and figures.

    Raises
    ------
    ParameterError
        For shapes that don't agree and times that don't ascend.

    Examples
    --------
    >>> recording = recording_from_arrays([0.0, 0.01], [[0.0, 0.0, 0.1], [0.0, 0.0, 0.2]], speed=4.6)
    >>> recording.imu.time_ns.tolist()
    [0, 10000000]

    """
    time_ns = _stamps("time", time)
    rates = np.array(angular_velocity, dtype=float)
    if rates.shape != (time_ns.size, 3):
        raise ParameterError(f"angular_velocity: expected shape ({time_ns.size}, 3), found {rates.shape}")
    speeds = torques = None
    nominal = math.nan
    if isinstance(speed, tuple):
        speeds = SpeedSamples(*_series("speed", speed))
    else:
        nominal = float(speed)
    if steer_torque is not None:
        torques = SteerTorqueSamples(*_series("steer_torque", steer_torque))
    mounting = np.array([0.0, 0.0, 0.0, 1.0] if orientation is None else orientation, dtype=float)
    if mounting.shape != (4,) or not np.isclose(np.linalg.norm(mounting), 1.0, atol=1e-3):
        raise ParameterError(
            f"orientation: expected a unit quaternion x, y, z, w, found {np.array2string(mounting)}"
        )
    start_ns = int(time_ns[0])
    return Recording(
        path=Path(name),
        imu=ImuSamples(time_ns, rates, np.full((time_ns.size, 3), np.nan)),
        speed=speeds,
        steer_torque=torques,
        lean_yaw=None,
        state=None,
        run_info=RunInfo(start_ns, bicycle, speed=nominal, imu_orientation=mounting),
        start_ns=start_ns,
        custom_data={},
    )


def _series(what: str, series: Series) -> tuple[IntArray, FloatArray]:
    """Stamps (m,) [ns] and values (m,) of times [s] and values."""
    times, values = series
    time_ns, found = _stamps(f"{what}: times", times), np.array(values, dtype=float)
    if found.shape != time_ns.shape:
        raise ParameterError(
            f"{what}: expected {time_ns.size} values, one for each time, found {found.shape}"
        )
    return time_ns, found


def _stamps(what: str, time: ArrayLike) -> IntArray:
    """Stamps (n,) [ns] of times [s]. Raises ParameterError for times that are none or don't ascend."""
    seconds = np.array(time, dtype=float)
    if seconds.ndim != 1 or not seconds.size or not np.isfinite(seconds).all():
        raise ParameterError(f"{what}: expected finite times (n,) [s], found shape {seconds.shape}")
    if not (np.abs(seconds) < 9e9).all():
        raise ParameterError(f"{what}: expected seconds, found {np.abs(seconds).max():g}")
    time_ns = np.round(seconds * 1e9).astype(np.int64)
    if not (np.diff(time_ns) > 0).all():
        row = int(np.flatnonzero(np.diff(time_ns) <= 0)[0]) + 1
        raise ParameterError(f"{what}: expected ascending times, found {seconds[row]:g} s in row {row}")
    return time_ns
