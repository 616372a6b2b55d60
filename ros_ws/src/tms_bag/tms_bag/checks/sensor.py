"""Checks of a sensor's numbers: units, range, dead axes, bias at rest."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tms_bag.checks.finding import ERROR, NOTE, WARNING, Finding
from tms_bag.checks.survey import Survey
from tms_bag.reading_limits import RATE_LIMIT, measured
from tms_bag.samples import FloatArray

GRAVITY = 9.81  # [m/s^2]
STILL_RATE, STILL_FORCE = 0.02, 0.15  # [rad/s], [m/s^2] standard deviation within a second of rest
LARGEST_BIAS = 0.01  # [rad/s]
LARGEST_LEAN = 2.0  # [rad] that a rate may add up to within ten seconds, from lowest to highest
_AXES = "xyz"


def no_gyroscope(survey: Survey) -> Iterator[Finding]:
    """Numbers that are no angular velocity."""
    if survey.imu is None:
        return
    known = np.isfinite(measured(survey.imu.angular_velocity, RATE_LIMIT))
    if not known.any():
        yield Finding(
            ERROR,
            survey.imu_topic or "",
            f"all angular velocities are NaN, beyond {RATE_LIMIT:g} rad/s, or marked as absent"
            " (angular_velocity_covariance[0] = -1)",
            "there is no lean rate: nothing can be fitted",
            "switch the gyroscope on in the sensor's driver, and check its unit: rad/s",
        )
        return
    for axis, share in zip(_AXES, known.mean(axis=0), strict=True):
        if 0.0 < share < 1.0:
            yield Finding(
                WARNING,
                survey.imu_topic or "",
                f"{100 * (1 - share):.2f} % of the angular velocities about {axis} are not finite or beyond"
                f" {RATE_LIMIT:g} rad/s",
                "these samples are left out",
                "look for the cause in the sensor's driver",
                values={"axis": axis, "share": 1.0 - float(share)},
            )


def dead_axis(survey: Survey) -> Iterator[Finding]:
    """A number that never changes."""
    if survey.imu is None or survey.imu.time_ns.size < 100:
        return
    for name, values in _quantities(survey):
        for axis, column in zip(_AXES, values.T, strict=True):
            column = column[np.isfinite(column)]
            if column.size > 100 and np.ptp(column) == 0.0:
                yield Finding(
                    WARNING,
                    survey.imu_topic or "",
                    f"the {name} along {axis} is {column[0]:g} in all messages",
                    "the sensor doesn't measure it, or isn't asked to",
                    "a driver should give NaN for what isn't measured; check its settings and the cable",
                    values={"axis": axis, "value": float(column[0])},
                )


def saturation(survey: Survey) -> Iterator[Finding]:
    """Readings that stay at the end of the range."""
    if survey.imu is None or survey.imu.time_ns.size < 100:
        return
    for name, values in _quantities(survey):
        for axis, column in zip(_AXES, values.T, strict=True):
            finite = np.abs(column[np.isfinite(column)])
            if finite.size < 100 or np.ptp(finite) == 0.0:
                continue
            limit = float(finite.max())
            there = finite >= limit * (1.0 - 1e-9)
            if np.count_nonzero(there[1:] & there[:-1]) >= 2 and np.median(finite) < 0.9 * limit:
                unit = "rad/s" if name == "angular velocity" else "m/s^2"
                yield Finding(
                    WARNING,
                    survey.imu_topic or "",
                    f"the {name} along {axis} stays at its largest value, {limit:.4g} {unit}, for several"
                    " samples"
                    f" ({int(there.sum())} in all)",
                    "pushes are cut off: the lean rate that a fit finds is too small",
                    "set a larger range in the sensor's driver (2 g and 250 deg/s are too small for a"
                    " strike)",
                    values={"axis": axis, "limit": limit, "samples": int(there.sum())},
                )
    if survey.lean_yaw is not None and survey.lean_yaw.saturation.any():
        count = int(np.count_nonzero(survey.lean_yaw.saturation))
        yield Finding(
            WARNING,
            survey.imu_topic or "",
            f"{count} messages of the sensor's summary are marked as saturated",
            "pushes are cut off: the lean rate that a fit finds is too small",
            "set a larger range in the sensor's driver",
            values={"samples": count},
        )


def force_units(survey: Survey) -> Iterator[Finding]:
    """Specific force in g, in mg, or of another size than gravity."""
    if survey.imu is None:
        return
    size = np.linalg.norm(survey.imu.specific_force, axis=1)
    size = size[np.isfinite(size)]
    if size.size < 10:
        return
    found = float(np.median(size))
    for unit, factor in (("g", 1.0), ("mg", 1e-3), ("cm/s^2", 0.01 / GRAVITY)):
        if 0.9 < found * factor < 1.1:
            yield Finding(
                ERROR,
                survey.imu_topic or "",
                f"the specific force is {found:.4g} at the median: gravity in {unit}, not in m/s^2",
                "REP-145 asks for m/s^2; whoever reads it as such is wrong by a factor of"
                f" {GRAVITY * factor:.4g}",
                f"multiply by {GRAVITY * factor:.6g} in the driver; for a CSV log say unit: {unit}"
                " in the mapping",
                values={"median": found, "unit": unit},
            )
            return
    if found < 0.5:
        yield Finding(
            WARNING,
            survey.imu_topic or "",
            f"the specific force is {found:.3g} m/s^2 at the median: gravity isn't in it",
            "the sensor's orientation can't be checked, and nobody else's program expects this",
            "switch the driver's removal of gravity off (REP-145: +9.81 upwards at rest)",
            values={"median": found},
        )
    elif abs(found - GRAVITY) > 0.5:
        yield Finding(
            WARNING,
            survey.imu_topic or "",
            f"the specific force is {found:.3f} m/s^2 at the median, gravity is {GRAVITY}",
            "scale or bias of the accelerometer are off by"
            f" {100 * abs(found / GRAVITY - 1):.1f} %, or the unit is another one",
            "calibrate the accelerometer (six poses at rest), check its unit",
            values={"median": found},
        )


def rate_units(survey: Survey) -> Iterator[Finding]:
    """Angular velocities in degrees per second: a bicycle that leant as far would have fallen over."""
    if survey.imu is None or survey.imu.time_ns.size < 100:
        return
    ranges = [
        _largest_range(survey.seconds, survey.imu.angular_velocity[:, axis]) for axis in _level_axes(survey)
    ]
    largest = max((value for value in ranges if np.isfinite(value)), default=0.0)
    if largest <= LARGEST_LEAN:
        return
    yield Finding(
        ERROR if largest > 2 * np.pi else WARNING,
        survey.imu_topic or "",
        f"the lean rate adds up to {largest:.1f} rad ({np.degrees(largest):.0f} deg) within ten seconds,"
        " its mean"
        " taken off: no bicycle leans that far. In deg/s it would be"
        f" {largest:.1f} deg",
        "all rates are 57 times too large, if they are deg/s",
        "convert to rad/s in the driver (REP-145, REP-103); for a CSV log say unit: deg/s in the mapping",
        values={"lean_range": largest},
    )


def gyro_bias(survey: Survey) -> Iterator[Finding]:
    """What the gyroscope shows when nothing turns."""
    if survey.imu is None or survey.imu.time_ns.size < 100:
        return
    still = at_rest(survey)
    rates = survey.imu.angular_velocity
    if still.any():
        with np.errstate(invalid="ignore"):
            bias = np.nanmean(rates[still][:, np.isfinite(rates[still]).any(axis=0)], axis=0)
        worst = float(np.abs(bias).max()) if bias.size else 0.0
        text = ", ".join(f"{value:+.4f}" for value in bias)
        yield Finding(
            WARNING if worst > LARGEST_BIAS else NOTE,
            survey.imu_topic or "",
            f"at rest ({still.sum()} samples) it shows {text} rad/s",
            "a bias of the lean rate is taken for lean that grows"
            if worst > LARGEST_BIAS
            else "none to speak of",
            "calibrate the gyroscope at rest, or let the fit find it" if worst > LARGEST_BIAS else "nothing",
            f"./tms fit run {survey.path} --free initial_lean_rate,initial_steer_rate,lean_rate_bias"
            if worst > LARGEST_BIAS
            else "",
            {"bias": [float(value) for value in bias], "samples": int(still.sum())},
        )
        return
    axis = _level_axes(survey)[0]
    known = rates[:, axis][np.isfinite(rates[:, axis])]
    seconds = float(survey.seconds[-1])
    if known.size and abs(float(np.mean(known))) * seconds > 1.5:
        mean = float(np.mean(known))
        yield Finding(
            WARNING,
            survey.imu_topic or "",
            f"the lean rate is {mean:+.4f} rad/s on the average of {seconds:.0f} s: the bicycle would"
            " have leant by"
            f" {mean * seconds:+.1f} rad",
            "the gyroscope has a bias of about this size, or the lean axis is another one",
            "keep the bicycle still for five seconds before the run; let the fit find the bias",
            f"./tms fit run {survey.path} --free initial_lean_rate,initial_steer_rate,lean_rate_bias",
            {"bias": mean},
        )


def at_rest(survey: Survey) -> NDArray[np.bool_]:
    """Samples (n,) within whole seconds in which nothing moves."""
    imu = survey.imu
    if imu is None or imu.time_ns.size < 100:
        return np.zeros(0 if imu is None else imu.time_ns.size, bool)
    second = np.floor(survey.seconds).astype(np.int64)
    starts = np.flatnonzero(np.diff(second, prepend=-1))
    still = np.ones(starts.size, bool)
    enough = False
    for values, limit in ((imu.angular_velocity, STILL_RATE), (imu.specific_force, STILL_FORCE)):
        for column in values.T:
            if np.isfinite(column).all():
                enough = True
                still &= _spread(column, starts) < limit
    found = still[np.searchsorted(starts, np.arange(second.size), side="right") - 1] & enough
    if survey.speed is not None and survey.speed.time_ns.size:
        place = np.searchsorted(survey.speed.time_ns, imu.time_ns, side="right") - 1
        speed = np.abs(survey.speed.speed[np.clip(place, 0, None)])
        found &= ~(speed > 0.1)
    return np.asarray(found)


def _spread(column: FloatArray, starts: NDArray[np.int64]) -> FloatArray:
    """Standard deviation in each of the stretches that begin at `starts`."""
    count = np.diff(np.append(starts, column.size))
    centred = column - np.median(column)
    mean = np.add.reduceat(centred, starts) / count
    square = np.add.reduceat(centred**2, starts) / count
    return np.asarray(np.sqrt(np.maximum(square - mean**2, 0.0)))


def _largest_range(seconds: FloatArray, rates: FloatArray) -> float:
    """Largest range of the integrated rate within ten seconds [rad]; NaN if it isn't known."""
    known = np.isfinite(rates)
    if np.count_nonzero(known) < 100:
        return float("nan")
    time, rate = seconds[known], rates[known]
    largest = 0.0
    # Only stretches that hold samples: one wrong stamp may lie decades before the others.
    edges = [0, *(np.flatnonzero(np.diff(np.floor(time / 10.0))) + 1).tolist(), len(time)]
    for first, last in pairwise(edges):
        if last - first < 50:
            continue
        part, when = rate[first:last], time[first:last]
        steps = np.minimum(np.diff(when), 0.1)
        angle = np.cumsum((part[1:] - np.mean(part)) * steps)
        largest = max(largest, float(np.ptp(angle)))
    return largest


def _level_axes(survey: Survey) -> tuple[int, ...]:
    """Axes of the sensor about which a bicycle may lean, by where gravity shows; x if it can't be told."""
    if survey.imu is None:
        return (0,)
    force = survey.imu.specific_force
    if not np.isfinite(force).all(axis=0).all():
        return (0,)
    up = int(np.argmax(np.abs(np.median(force, axis=0))))
    return tuple(axis for axis in range(3) if axis != up)


def _quantities(survey: Survey) -> list[tuple[str, FloatArray]]:
    assert survey.imu is not None
    return [
        ("angular velocity", survey.imu.angular_velocity),
        ("specific force", survey.imu.specific_force),
    ]
