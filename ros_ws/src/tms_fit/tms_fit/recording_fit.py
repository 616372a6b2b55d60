"""Fit of a recording: synchronise, detect, window, fit, diagnose.

What is fitted: the measured lean and yaw rate after each strike, by the response of the linearised Whipple
bicycle to an unknown initial lean rate (and what else the settings free), with a bias of each gyroscope.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tms_bag import Recording, RecordingError
from tms_bag.reading_limits import without_impossible
from tms_model import Bicycle, ParameterError, load_bicycle

from tms_fit.estimators import check_names
from tms_fit.gyroscopes import FLAGS, Gyroscopes, orientation_of
from tms_fit.imu_orientation import with_orientation
from tms_fit.run_info import stated_bicycle
from tms_fit.segment import FreeResponse
from tms_fit.settings import Settings
from tms_fit.speed_source import check_speed, nominal_speed
from tms_fit.streaming.samples import Samples
from tms_fit.streaming.synchronizer import SampleSynchronizer
from tms_fit.streaming.tracker import StrikeTracker
from tms_fit.strike_fit import StrikeFit, fit_strike
from tms_fit.strikes.strike import NANOSECONDS, Rejected, Strike

DEFAULTS = Settings()
SPEED, TORQUE, SATURATION, IMU = range(4)  # kinds of samples, at equal times in this order
SYNCHRONISATION_SHARE = 0.2  # of the progress reported, by measurement without strikes
Progress = Callable[[float, int], None]  # share of the recording processed, strikes found so far


@dataclass(frozen=True, eq=False)
class RecordingFit:
    """All strikes of a recording."""

    recording: Recording
    bicycle: Bicycle
    settings: Settings
    strikes: tuple[StrikeFit, ...]
    rejected: tuple[Rejected, ...] = ()  # changes of the lean rate that are no strikes


def fit_recording(
    recording: Recording,
    bicycle: Bicycle | None = None,
    settings: Settings = DEFAULTS,
    strike_times: Iterable[float] = (),
    progress: Progress | None = None,
) -> RecordingFit:
    """Strikes of a recording, each with its fit.

    bicycle: None for the one that the recording states. strike_times: starts of the free responses [s since
    the recording's first stamp], in place of those detected. progress is called now and then; an exception
    that it raises ends the fit.

    Raises RecordingError without a speed, a rotation rate or a bicycle, and for a strike time outside the
    samples; ParameterError for an unknown estimator.
    """
    check_names(settings.estimators)
    recording = with_orientation(without_impossible(recording), settings)
    _check_measurements(recording, settings)
    bicycle = bicycle_of(recording) if bicycle is None else bicycle
    samples = synchronize(recording, settings, progress)
    tracker = StrikeTracker(samples, bicycle, settings, _stamps(recording, strike_times))
    responses = free_responses(samples, tracker, progress)  # detected strikes and where each response ends
    fits = [fit_strike(response, bicycle, settings) for response in responses]  # window, fit, diagnose
    return RecordingFit(recording, bicycle, settings, tuple(fits), tuple(tracker.rejected))


def find_strikes(
    recording: Recording,
    bicycle: Bicycle | None = None,
    settings: Settings = DEFAULTS,
    strike_times: Iterable[float] = (),
) -> tuple[tuple[Strike, ...], tuple[Rejected, ...]]:
    """Strikes of a recording, and the changes of its lean rate that were rejected; see `fit_recording`."""
    recording = with_orientation(without_impossible(recording), settings)
    _check_measurements(recording, settings)
    bicycle = bicycle_of(recording) if bicycle is None else bicycle
    samples = synchronize(recording, settings)
    tracker = StrikeTracker(samples, bicycle, settings, _stamps(recording, strike_times))
    found = [response.strike for response in free_responses(samples, tracker)]
    return tuple(found), tuple(tracker.rejected)


def synchronize(recording: Recording, settings: Settings, progress: Progress | None = None) -> Samples:
    """IMU samples of a recording in the axes of the rear frame, with the speed and torque of their times."""
    info = recording.run_info
    gyroscopes = Gyroscopes(orientation_of(info), settings.gyroscope_range)
    synchronizer = SampleSynchronizer(gyroscopes, 0.0, settings.fixed.get("speed"))
    samples = Samples(synchronizer.speed, nominal_speed(recording, settings))
    imu, speed, torque, flags = recording.imu, recording.speed, recording.steer_torque, recording.lean_yaw
    x, y, z = imu.angular_velocity_variance.tolist()
    times, kinds, rows = _in_time_order(recording)
    for number, (time_ns, kind, row) in enumerate(
        zip(times.tolist(), kinds.tolist(), rows.tolist(), strict=True)
    ):
        if progress is not None and number % _every(times) == 0:
            progress(SYNCHRONISATION_SHARE * number / len(times), 0)
        if kind == IMU:
            p, q, r = imu.angular_velocity[row].tolist()
            synchronizer.add_imu(time_ns, (p, q, r), (x, y, z))
        elif kind == SATURATION and flags is not None:
            synchronizer.add_flags(time_ns, int(flags.saturation[row]))
        elif kind == TORQUE and torque is not None:
            synchronizer.steer_torque.add(time_ns, float(torque.steer_torque[row]))
        elif speed is not None:
            synchronizer.speed.add(time_ns, float(speed.speed[row]), float(speed.variance[row]))
        samples.extend(synchronizer.ready())
    samples.extend(synchronizer.ready(finished=True))
    return samples


def free_responses(
    samples: Samples, tracker: StrikeTracker, progress: Progress | None = None
) -> Iterator[FreeResponse]:
    """Free responses in samples, each as soon as the tracker has seen enough of them."""
    times, lean_rates = samples.time_ns, samples.angular_velocity[:, 0]
    for number, (time_ns, lean_rate) in enumerate(zip(times.tolist(), lean_rates.tolist(), strict=True)):
        if progress is not None and number % _every(times) == 0:
            share = SYNCHRONISATION_SHARE + (1.0 - SYNCHRONISATION_SHARE) * number / len(times)
            progress(share, tracker.strike_count)
        tracker.process(time_ns, lean_rate)
        yield from tracker.completed()
    yield from tracker.finish()


def bicycle_of(recording: Recording, name: str | None = None) -> Bicycle:
    """The bicycle of a name or file; without one, the bicycle that the recording states.

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


def first_stamp(recording: Recording) -> int:
    """Earliest header stamp of the samples [ns]; log times may follow another clock."""
    series = (recording.imu, recording.speed, recording.steer_torque, recording.lean_yaw)
    stamps = [int(one.time_ns[0]) for one in series if one is not None and len(one.time_ns)]
    return min(stamps + ([recording.run_info.start_ns] if recording.run_info else []))


def _check_measurements(recording: Recording, settings: Settings) -> None:
    """Raise RecordingError without a speed or a rotation rate."""
    speed, path = recording.speed, recording.path
    check_speed(recording, settings)
    if speed is not None and "speed" not in settings.fixed and not (speed.speed > 0.0).any():
        raise RecordingError(
            f"{path}: expected a positive forward speed, found at most {np.fmax.reduce(speed.speed):g} m/s;"
            " if the sign or the topic is wrong, use --speed-topic NAME or --fix speed=V"
        )
    if not np.isfinite(recording.imu.angular_velocity).any():
        raise RecordingError(f"{path}: expected gyroscope readings in the IMU topic, found no finite ones")


def _stamps(recording: Recording, strike_times: Iterable[float]) -> tuple[int, ...]:
    """Stamps [ns] of strike times [s since the first stamp], in ascending order."""
    return tuple(_stamp(recording, time) for time in sorted(set(strike_times)))


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


def _every(times: NDArray[np.int64]) -> int:
    """Samples between two reports of the progress."""
    return max(len(times) // 100, 1)


def _in_time_order(recording: Recording) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Times [ns], kinds and rows of all samples in time order; flags only where an axis is saturated."""
    series = (recording.speed, recording.steer_torque, recording.lean_yaw, recording.imu)
    stamps = [np.asarray(one.time_ns) if one is not None else np.empty(0, np.int64) for one in series]
    listed = [np.arange(len(one)) for one in stamps]
    if recording.lean_yaw is not None:
        listed[SATURATION] = np.flatnonzero(recording.lean_yaw.saturation & FLAGS)
        stamps[SATURATION] = stamps[SATURATION][listed[SATURATION]]
    times = np.concatenate(stamps)
    kinds = np.repeat(np.arange(4), [len(one) for one in stamps])
    rows = np.concatenate(listed)
    order = np.lexsort((kinds, times))
    return times[order], kinds[order], rows[order]
