"""Orientation of the inertial sensor on the bicycle by gravity, strikes, and the sign of yaw against lean.

The axes of the rear frame (REP-103: x forward, y left, z up) in those of the sensor:

- z is the direction of the median specific force. A bicycle that rides upright or in steady turns feels
  the reaction to gravity along its own z.
- x is the horizontal axis of the sudden changes of the angular velocity: a sideways strike changes the roll
  rate within some 0.1 s. The axis is the mean of axial data, by doubled angles (K. V. Mardia, P. E. Jupp,
  Directional Statistics, Wiley 2000, section 9.4, doi:10.1002/9780470316979); every change has the same
  weight.
- Forward is the end of that axis for which yaw rate and lean have the signs of a body that tips over its
  wheels and is caught by steering into the fall:
  roll acceleration = g / h lean - b yaw rate - c yaw acceleration, with b, c >= 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tms_model.frames import matrix_quaternion, quaternion, roll_pitch_yaw, rotation_matrix

from tms_bag.errors import RecordingError
from tms_bag.reading_limits import RATE_LIMIT, SPEED_LIMIT, measured
from tms_bag.samples import FloatArray, ImuSamples, IntArray, SpeedSamples

GRAVITY = 9.81  # [m/s^2]
LEAST_SAMPLES = 100
FORCE_LIMIT = 1e6  # of a specific force, whatever its unit
LEAST_FORCE = 0.5  # of a specific force that holds gravity, whatever its unit
NEAR_S, FAR_S = 0.03, 0.13  # [s] bounds of the two stretches whose mean rates are compared at an instant
LEAST_CHANGE = 0.15  # [rad/s] of a sudden change, that of a strike (tms_fit.strikes.thresholds)
NOISE_FACTOR = 6.0  # of a sudden change, per median change
APART_S = 1.0  # [s] between sudden changes
TIGHT_TURN = 1.0  # [rad/s] of the yaw rate
SMOOTHING_S = 0.1  # [s] half of the stretch over which the motion between the changes is averaged
LARGEST_DISAGREEMENT = np.radians(30.0)  # [rad] between the axes of the sudden changes and of all motion
LEAST_CONCENTRATION = 0.8  # mean resultant length of the doubled angles
MOVING = 0.3  # [m/s] below which a bicycle stands
AFTER_S, RESPONSE_S = 0.06, 1.5  # [s] bounds of the response to a change, for yaw against lean
SHORTEST_S = 0.3  # [s] of a response
BIN_S = 0.02  # [s] over which its samples are averaged
LARGEST_RATE = 2.5  # [rad/s] of a response; a bicycle that falls down is faster
TIPPING = 10.0  # g / h [1/s^2] of a centre of mass 1 m above the floor
LEAST_EVIDENCE = np.log(3.0)  # logarithm of the ratio of residual sums that one response needs
MOST_EVIDENCE = np.log(10.0)  # that one response counts for at most
LEAN_STD = 0.2  # [rad] of the lean at a strike
STD_FLOOR = np.radians(2.0)  # [rad] of the axis; frames flex, and strikes are not purely sideways
TILT_FLOOR = np.radians(1.0)  # [rad] of the vertical; a bicycle leans on the average
SAME = np.radians(5.0)  # [rad] within which an orientation is that which is stated, or one along the axes
CLEAR = np.radians(20.0)  # [rad] of a departure that is reported


@dataclass(frozen=True, eq=False)
class ImuMounting:
    """Orientation of a sensor as a run shows it, beside the stated one."""

    roll_pitch_yaw_deg: tuple[
        float, float, float
    ]  # [deg] about fixed axes, as imu.orientation_deg of a scenario
    tilt: float  # [rad] between the vertical and the stated z axis
    tilt_std: float  # [rad]
    heading: float  # [rad] about the vertical from the stated orientation to that found, to the left positive
    heading_std: float  # [rad]
    change_count: int  # sudden changes that show the roll axis
    forward_known: (
        bool  # by yaw against lean; else forward is the end of the roll axis nearer to the stated x
    )
    as_stated: bool  # whether the stated orientation is kept

    @property
    def quaternion(self) -> FloatArray:
        """Quaternion x, y, z, w (4,), sensor -> rear frame (REP-103)."""
        return quaternion(*np.radians(self.roll_pitch_yaw_deg))

    @property
    def tilted(self) -> bool:
        """Whether the vertical departs clearly from the stated one."""
        return bool(self.tilt > max(CLEAR, 3.0 * self.tilt_std))

    @property
    def turned(self) -> bool:
        """Whether the heading departs clearly from the stated one; never beyond a tilt of 150 degrees."""
        upright = self.tilt < np.radians(150.0)
        return bool(upright and abs(self.heading) > max(CLEAR, 3.0 * self.heading_std))

    @property
    def flag(self) -> str:
        """Argument of the fit's command line that states the orientation found."""
        return f"--imu-orientation={self.text}"

    @property
    def text(self) -> str:
        """ROLL,PITCH,YAW [deg]."""
        return ",".join(f"{angle:g}" for angle in self.roll_pitch_yaw_deg)

    @property
    def evidence(self) -> str:
        """Uncertainties and what forward rests on, in words."""
        changes = f"{self.change_count} sudden change{'s' if self.change_count > 1 else ''}"
        forward = (
            "forward by the sign of yaw against lean"
            if self.forward_known
            else "forward as stated, since yaw against lean does not show it"
        )
        return (
            f"roll and pitch by gravity, +- {np.degrees(self.tilt_std):.0f} deg, yaw by the axis of"
            f" {changes}, +- {np.degrees(self.heading_std):.0f} deg (standard deviations), {forward}"
        )


def imu_mounting(imu: ImuSamples, speed: SpeedSamples | None, stated: FloatArray) -> ImuMounting:
    """Orientation of the sensor as the run shows it.

    stated: quaternion x, y, z, w (4,), sensor -> rear frame. It is kept where the run shows an orientation
    within 5 degrees of it, or within two standard deviations; else one along the axes is taken in this way.

    Raises RecordingError without gravity, without readings of all three gyroscopes, and where no sudden
    changes show the roll axis.
    """
    up, tilt_std = _vertical(imu)
    tilt_std = float(np.hypot(tilt_std, _acceleration(speed) / GRAVITY))
    time, rates = _rates(imu)
    turn = rotation_matrix(stated)
    basis = _horizontal_basis(up, turn)
    level = rates @ basis.T  # (n, 3) about basis x, basis y and the vertical
    changes, rows, noise = _sudden_changes(time, level, _moving(imu, speed, time))
    angle, heading_std = _roll_axis(changes, noise)
    _check_agreement(time, level[:, :2], angle)
    if np.cos(angle) < 0.0:  # the end nearer to the stated x
        angle = np.arctan2(-np.sin(angle), -np.cos(angle))
    cos, sin = np.cos(angle), np.sin(angle)
    evidence = _forward_evidence(time, level @ np.array([cos, sin, 0.0]), level[:, 2], rows)
    sign = -1.0 if evidence < -1.0 else 1.0
    rotation = (
        np.array([[sign * cos, sign * sin, 0.0], [-sign * sin, sign * cos, 0.0], [0.0, 0.0, 1.0]]) @ basis
    )
    near = max(SAME, 2.0 * max(tilt_std, heading_std))
    as_stated = _angle(rotation @ turn.T) < near
    twist = matrix_quaternion(rotation @ turn.T)
    return ImuMounting(
        roll_pitch_yaw_deg=_in_degrees(turn if as_stated else _along_axes(rotation, near)),
        tilt=float(np.arccos(np.clip((turn @ up)[2], -1.0, 1.0))),
        tilt_std=tilt_std,
        heading=float(_wrapped(2.0 * np.arctan2(twist[2], twist[3]))),
        heading_std=heading_std,
        change_count=len(rows),
        forward_known=abs(evidence) > 1.0,
        as_stated=as_stated,
    )


def _vertical(imu: ImuSamples) -> tuple[FloatArray, float]:
    """Direction (3,) of the median specific force, and its standard deviation [rad] by means of a second."""
    known = np.isfinite(measured(imu.specific_force, FORCE_LIMIT)).all(axis=1)
    force = imu.specific_force[known]
    size = float(np.linalg.norm(np.median(force, axis=0))) if len(force) >= LEAST_SAMPLES else 0.0
    if not size > LEAST_FORCE:
        raise RecordingError(
            "expected gravity in the specific force, to find how the sensor sits, found"
            f" {f'{size:.2g} m/s^2' if len(force) >= LEAST_SAMPLES else 'no readings'}; state its orientation"
        )
    up = np.asarray(np.median(force, axis=0) / size)
    second = (imu.time_ns[known] - imu.time_ns[known][0]) // 1_000_000_000
    starts = np.flatnonzero(np.diff(second, prepend=-1))
    means = np.add.reduceat(force, starts) / np.diff(np.append(starts, len(force)))[:, None]
    across = means - np.outer(means @ up, up)
    scatter = float(np.sqrt(np.mean(across**2) / len(means))) / size
    return up, float(np.hypot(TILT_FLOOR, scatter))


def _acceleration(speed: SpeedSamples | None) -> float:
    """Root mean square of the acceleration [m/s^2] while the bicycle moves, by speeds a second apart.

    It tilts the specific force. 0 where it is unknown.
    """
    if speed is None:
        return 0.0
    values = measured(speed.speed, SPEED_LIMIT)
    known = np.abs(values) > MOVING
    second = speed.time_ns[known] // 1_000_000_000
    starts = np.flatnonzero(np.diff(second, prepend=-1))
    count = np.diff(np.append(starts, second.size))
    means = np.add.reduceat(values[known], starts) / count if starts.size else np.empty(0)
    changes = np.diff(means)[np.diff(second[starts]) == 1]
    return float(np.sqrt(np.mean(changes**2))) if changes.size else 0.0


def _rates(imu: ImuSamples) -> tuple[FloatArray, FloatArray]:
    """Times (n,) [s] and angular velocities (n, 3) [rad/s] of the samples with all three."""
    rates = measured(imu.angular_velocity, RATE_LIMIT)
    known = np.isfinite(rates).all(axis=1)
    if np.count_nonzero(known) < LEAST_SAMPLES:
        raise RecordingError(
            f"expected {LEAST_SAMPLES} or more samples of all three gyroscopes, to find how the sensor sits,"
            f" found {np.count_nonzero(known)}; state its orientation"
        )
    return np.asarray((imu.time_ns[known] - imu.time_ns[0]) / 1e9), rates[known]


def _horizontal_basis(up: FloatArray, stated: FloatArray) -> FloatArray:
    """Two horizontal axes and the vertical in the sensor's axes, rows (3, 3).

    They are the stated orientation turned by the smallest rotation that makes it level.
    """
    z = stated @ up  # the vertical in the stated rear frame
    vertical = np.array([0.0, 0.0, 1.0])
    if z[2] < -1.0 + 1e-9:  # upside down: half a turn about x
        return np.diag([1.0, -1.0, -1.0]) @ stated
    axis = np.cross(z, vertical)
    skew = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    return np.asarray((np.eye(3) + skew + skew @ skew / (1.0 + z[2])) @ stated)


def _moving(imu: ImuSamples, speed: SpeedSamples | None, time: FloatArray) -> NDArray[np.bool_]:
    """Samples (n,) at which the bicycle isn't known to stand."""
    if speed is None or not speed.time_ns.size:
        return np.ones(time.size, bool)
    known = (speed.time_ns - imu.time_ns[0]) / 1e9
    latest = np.abs(speed.speed[np.clip(np.searchsorted(known, time, side="right") - 1, 0, None)])
    return ~(latest < MOVING)


def _stretch_means(time: FloatArray, values: FloatArray, first: float, last: float) -> FloatArray:
    """Means (n, k) of values (n, k) from `first` to `last` [s] after each time; NaN where half lack."""
    sums = np.vstack([np.zeros(values.shape[1]), np.cumsum(values, axis=0)])
    low = np.searchsorted(time, time + first - 1e-6)
    high = np.searchsorted(time, time + last + 1e-6)
    count = high - low
    enough = count > 0.5 * (last - first) / max(float(np.median(np.diff(time))), 1e-6)
    means = (sums[high] - sums[low]) / np.maximum(count, 1)[:, None]
    return np.where(enough[:, None], means, np.nan)


def _sudden_changes(
    time: FloatArray, level: FloatArray, moving: NDArray[np.bool_]
) -> tuple[FloatArray, IntArray, float]:
    """Changes (m, 3) [rad/s] whose horizontal part stands out, their rows, and the usual size of that part.

    level: angular velocity (n, 3), the last about the vertical. The yaw rate of a leaning bicycle is about
    its pitch axis, too: changes in tight turns, and those that are mostly of the yaw rate, are left out.
    """
    before = _stretch_means(time, level, -FAR_S, -NEAR_S)
    change = _stretch_means(time, level, NEAR_S, FAR_S) - before
    size = np.linalg.norm(change[:, :2], axis=1)
    known = np.isfinite(size)
    straight = np.abs(np.where(known, before[:, 2], np.inf)) < TIGHT_TURN
    straight &= np.abs(change[:, 2]) < size
    usual = float(np.median(size[known])) if known.any() else np.inf
    least = max(LEAST_CHANGE, NOISE_FACTOR * usual)
    candidates = np.flatnonzero(straight & moving & (np.where(known, size, 0.0) > least))
    if not candidates.size:
        raise RecordingError(
            "expected sudden changes of the angular velocity, to find how the sensor sits, found none beyond"
            f" {least:.2g} rad/s within 0.1 s; state its orientation"
        )
    taken, found = np.zeros(time.size, bool), []
    for row in candidates[np.argsort(-size[candidates], kind="stable")]:
        if not taken[row]:
            found.append(int(row))
            taken[slice(*np.searchsorted(time, [time[row] - APART_S, time[row] + APART_S]))] = True
    rows = np.array(sorted(found))
    return change[rows], rows, usual


def _roll_axis(changes: FloatArray, noise: float) -> tuple[float, float]:
    """Angle [rad] of the axis of the changes (m, 3) about the vertical, and its standard deviation.

    noise: median size of all changes [rad/s].
    """
    mean = complex(np.mean(np.exp(2j * np.arctan2(changes[:, 1], changes[:, 0]))))
    if abs(mean) < LEAST_CONCENTRATION:
        raise RecordingError(
            "expected sudden changes about one horizontal axis, to find how the sensor sits, found"
            f" {len(changes)} about different axes; state its orientation"
        )
    scatter = 0.5 * np.sqrt(max(-2.0 * np.log(min(abs(mean), 1.0)), 0.0))
    size = np.linalg.norm(changes[:, :2], axis=1)
    expected = np.hypot(
        noise / np.sqrt(2.0 * np.log(2.0)) / size,  # of white noise, by Rayleigh's median
        LEAN_STD * changes[:, 2] / size,  # of yaw about the pitch axis
    )
    std = max(scatter, float(np.sqrt(np.mean(expected**2)))) / np.sqrt(len(changes))
    return float(0.5 * np.angle(mean)), float(np.hypot(STD_FLOOR, std))


def _check_agreement(time: FloatArray, level: FloatArray, angle: float) -> None:
    """Raise RecordingError where all motion is about another axis than the changes, as those by bumps are."""
    smooth = _stretch_means(time, level, -SMOOTHING_S, SMOOTHING_S)
    smooth = smooth[np.isfinite(smooth).all(axis=1)]
    (xx, xy), (_, yy) = np.cov(smooth.T)
    apart = _wrapped(np.arctan2(2.0 * xy, xx - yy) - 2.0 * angle) / 2.0
    if abs(apart) > LARGEST_DISAGREEMENT:
        raise RecordingError(
            "expected sudden changes about the axis of the other motion, to find how the sensor sits, found"
            f" them {np.degrees(abs(apart)):.0f} deg apart; state its orientation"
        )


def _forward_evidence(time: FloatArray, roll: FloatArray, up: FloatArray, rows: IntArray) -> float:
    """Evidence that the roll axis points forward (positive) or backward; beyond 1 it is clear.

    roll, up: (n,) [rad/s] about the axis and the vertical. Each response, from `rows` on, counts by the
    logarithm of the ratio of the residual sums with the axis pointing backward and forward. Sums of m
    responses have sqrt(m) times the scatter of one.
    """
    found = []
    ends = np.minimum(time[rows] + RESPONSE_S, np.append(time[rows[1:]] - FAR_S, np.inf))
    for start, end in zip(time[rows] + AFTER_S, ends, strict=True):
        used = slice(*np.searchsorted(time, [start, end]))
        rates = np.stack([time[used], roll[used], -up[used]], axis=1)  # yaw to the right is positive
        if len(rates) < 10 or end - start < SHORTEST_S or np.abs(rates[:, 1:]).max() > LARGEST_RATE:
            continue
        when, rolling, yaw = _binned(rates).T
        forward, backward = (_tipping_residual(when, sign * rolling, yaw) for sign in (1.0, -1.0))
        if min(forward, backward) < 0.5:
            tiny = 1e-12
            ratio = np.log((backward + tiny) / (forward + tiny))
            found.append(float(np.clip(ratio, -MOST_EVIDENCE, MOST_EVIDENCE)))
    return sum(found) / (LEAST_EVIDENCE * np.sqrt(len(found))) if found else 0.0


def _binned(rows: FloatArray) -> FloatArray:
    """Means (m, k) of rows (n, k), the first column the time, over some 20 ms."""
    count = max(int(BIN_S / max(float(np.median(np.diff(rows[:, 0]))), 1e-6) + 1e-6), 1)
    whole = len(rows) // count * count
    return np.asarray(rows[:whole].reshape(-1, count, rows.shape[1]).mean(axis=1))


def _tipping_residual(time: FloatArray, roll: FloatArray, yaw: FloatArray) -> float:
    """Share of the tipping motion that yaw leaves unexplained, in [0, 1].

    Integrated once: roll rate - g / h (integral of the lean) = - b (heading) - c (yaw rate) + constant +
    slope t, b, c >= 0; constant and slope hold the start and the biases.
    """
    lean, heading = _integral(time, roll), _integral(time, yaw)
    basis, _ = np.linalg.qr(np.stack([np.ones_like(time), time - time[0]], axis=1))
    values = np.stack([roll - TIPPING * _integral(time, lean), -heading, -yaw], axis=1)
    values = values - basis @ (basis.T @ values)
    target, columns = values[:, 0], values[:, 1:]
    total = float(target @ target)
    if not total > 0.0:
        return 1.0
    trials = [columns, columns[:, :1], columns[:, 1:]]
    solved = [(one, np.linalg.lstsq(one, target, rcond=None)[0]) for one in trials]
    sums = [float(np.sum((target - one @ found) ** 2)) for one, found in solved if (found >= 0.0).all()]
    return min([total, *sums]) / total


def _integral(time: FloatArray, values: FloatArray) -> FloatArray:
    """Integral (n,) from the first time by the trapezoidal rule."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(time))])


def _along_axes(rotation: FloatArray, near: float) -> FloatArray:
    """The rotation (3, 3) along the axes within `near` [rad] of one, else that one to whole degrees."""
    along = np.rint(rotation)
    if (
        np.allclose(along @ along.T, np.eye(3))
        and np.linalg.det(along) > 0.0
        and _angle(along @ rotation.T) < near
    ):
        return along
    whole = np.round(np.degrees(roll_pitch_yaw(rotation)))
    return rotation_matrix(quaternion(*np.radians(whole)))


def _angle(rotation: FloatArray) -> float:
    """Angle [rad] of a rotation matrix (3, 3)."""
    return float(np.arccos(np.clip(0.5 * (np.trace(rotation) - 1.0), -1.0, 1.0)))


def _in_degrees(rotation: FloatArray) -> tuple[float, float, float]:
    """Roll, pitch, yaw [deg] of a rotation matrix (3, 3), to a hundredth."""
    roll, pitch, yaw = np.round(np.degrees(roll_pitch_yaw(rotation)), 2).tolist()
    return _half_turn(roll), pitch + 0.0, _half_turn(yaw)


def _half_turn(angle: float) -> float:
    """Angle [deg] with 180 in place of -180, and no negative zero."""
    return 180.0 if angle == -180.0 else angle + 0.0


def _wrapped(angle: float) -> float:
    """Angle [rad] between -pi and pi."""
    return float(np.arctan2(np.sin(angle), np.cos(angle)))
