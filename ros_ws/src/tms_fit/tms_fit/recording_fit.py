"""The fit of a recording: the same samples through the same class as a live run."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tms_bag import Recording, RecordingError
from tms_bag.samples import RunInfo
from tms_model import Bicycle, ParameterError, bicycle_names, load_bicycle
from tms_model.bicycle import Array
from tms_model.frames import quaternion
from tms_model.stated_bicycle import bicycle_from_numbers
from tqdm import tqdm

from tms_fit.settings import Settings
from tms_fit.streaming.gyroscopes import FLAGS
from tms_fit.streaming.online import OnlineFit, StrikeFit
from tms_fit.strikes.strike import NANOSECONDS, Rejected


@dataclass(frozen=True, eq=False)
class RecordingFit:
    """All strikes of a recording."""

    recording: Recording
    bicycle: Bicycle
    settings: Settings
    strikes: tuple[StrikeFit, ...]
    rejected: tuple[Rejected, ...] = ()  # changes that were looked at and not taken for strikes


def bicycle_of(recording: Recording, name: str | None) -> Bicycle:
    """The bicycle asked for, by name or file, else the one that the recording states.

    Raises ParameterError, and RecordingError where the recording states none.
    """
    if name:
        return load_bicycle(name)
    info = recording.run_info
    try:
        return stated_bicycle(info)
    except ParameterError as error:
        raise RecordingError(
            f"{recording.path}: expected a run_info that names a bicycle of the catalogue, or has all of its"
            f" numbers; found {f'{info.bicycle!r}, {error}' if info and info.bicycle else 'none'};"
            " use --bicycle NAME or FILE"
        ) from error


def stated_bicycle(info: RunInfo | None) -> Bicycle:
    """The bicycle of the catalogue that a run_info names, else one of the numbers that it states.

    Another name may not have a file opened. Raises ParameterError where it states none.
    """
    if info is None or not info.bicycle:
        raise ParameterError("expected a run_info that names a bicycle, found none")
    if info.bicycle in bicycle_names():
        return load_bicycle(info.bicycle)
    return bicycle_from_numbers(info.bicycle, info.parameters)


Progress = Callable[[float, int], None]  # share of the samples used, strikes fitted so far


def fit_recording(
    recording: Recording,
    bicycle: Bicycle,
    settings: Settings,
    strike_times: tuple[float, ...] = (),
    progress: Progress | None = None,
) -> RecordingFit:
    """Find the strikes of a recording and fit each. Raises RecordingError without a speed or a lean rate.

    strike_times: starts of the free responses that somebody states [s since the recording's first stamp], in
    place of those found. Raises RecordingError where there are no samples at one of them. `progress` is
    called now and then; what it raises ends the fit.
    """
    info = recording.run_info
    nominal = info.speed if info else float("nan")
    if recording.speed is None and not np.isfinite([settings.stated_speed, nominal]).any():
        raise RecordingError(
            f"{recording.path}: expected a topic bicycle/speed, found none; use --fix speed=V [m/s], or"
            " --prior speed=MEAN,STD where it is to be found"
        )
    if (
        recording.speed is not None
        and "speed" not in settings.fixed
        and not (recording.speed.speed > 0.0).any()
    ):
        raise RecordingError(
            f"{recording.path}: expected a positive forward speed, found at most"
            f" {np.fmax.reduce(recording.speed.speed):g} m/s;"
            " if the sign or the topic is wrong, use --speed-topic NAME or --fix speed=V"
        )
    given = tuple(_stamp(recording, time) for time in sorted(set(strike_times)))
    online = OnlineFit(bicycle, settings, orientation_of(info), nominal, False, given)
    feed(online, recording, progress)
    if not any(np.isfinite(recording.imu.angular_velocity[:, axis]).any() for axis in range(3)):
        raise RecordingError(
            f"{recording.path}: expected gyroscope readings in the IMU topic, found only NaN"
        )
    strikes = [result for result in online.results() if isinstance(result, StrikeFit)]
    return RecordingFit(recording, bicycle, settings, tuple(strikes), tuple(online.rejected))


def first_stamp(recording: Recording) -> int:
    """Earliest header stamp of the samples [ns]; log times may follow another clock."""
    series = (recording.imu, recording.speed, recording.steer_torque, recording.lean_yaw)
    stamps = [int(one.time_ns[0]) for one in series if one is not None and len(one.time_ns)]
    return min(stamps + ([recording.run_info.start_ns] if recording.run_info else []))


def _stamp(recording: Recording, time: float) -> int:
    """Stamp [ns] of a time since the start [s]. Raises RecordingError outside the IMU's samples."""
    start_ns, stamps = first_stamp(recording), recording.imu.time_ns
    low, high = ((int(stamp) - start_ns) / NANOSECONDS for stamp in (stamps[0], stamps[-1]))
    if not low <= time < high:
        raise RecordingError(
            f"{recording.path}: strike: expected a time inside the IMU's samples, {low:.3f} to {high:.3f} s,"
            f" found {time:g}"
        )
    return start_ns + round(time * NANOSECONDS)


def orientation_of(info: RunInfo | None) -> Array:
    """Quaternion of the imu in the rear frame, the identity when nobody says."""
    if info is not None and np.isfinite(info.imu_orientation).all():
        return info.imu_orientation
    return quaternion(0.0, 0.0, 0.0)


def feed(online: OnlineFit, recording: Recording, progress: Progress | None = None) -> None:
    """Give all samples of a recording to `online`, in time order, and finish it."""
    times, kinds, rows = _merged(recording)
    imu, speed, torque, flags = recording.imu, recording.speed, recording.steer_torque, recording.lean_yaw
    every = max(len(times) // 100, 1)
    for number, (time_ns, kind, row) in enumerate(
        zip(
            tqdm(times.tolist(), desc="fit", unit=" samples", leave=False, disable=not sys.stderr.isatty()),
            kinds.tolist(),
            rows.tolist(),
            strict=True,
        )
    ):
        if progress is not None and number % every == 0:
            progress(number / len(times), online.strike_count)
        if kind == 3:
            online.add_imu(time_ns, imu.angular_velocity[row], imu.angular_velocity_variance)
        elif kind == 2 and flags is not None:
            online.add_saturation(time_ns, int(flags.saturation[row]))
        elif kind == 1 and torque is not None:
            online.add_steer_torque(time_ns, float(torque.steer_torque[row]))
        elif speed is not None:
            online.add_speed(time_ns, float(speed.speed[row]), float(speed.variance[row]))
    online.finish()


def _merged(recording: Recording) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Times, kinds (0 speed, 1 torque, 2 saturation, 3 imu) and rows of all samples, in time order.

    At equal times in the order of the kinds. Of the saturation only what says something.
    """
    series = (recording.speed, recording.steer_torque, recording.lean_yaw, recording.imu)
    stamps = [np.asarray(one.time_ns) if one is not None else np.empty(0, np.int64) for one in series]
    listed = [np.arange(len(one)) for one in stamps]
    if recording.lean_yaw is not None:
        listed[2] = np.flatnonzero(recording.lean_yaw.saturation & FLAGS)
        stamps[2] = stamps[2][listed[2]]
    times = np.concatenate(stamps)
    kinds = np.repeat(np.arange(4), [len(one) for one in stamps])
    rows = np.concatenate(listed)
    order = np.lexsort((kinds, times))
    return times[order], kinds[order], rows[order]
