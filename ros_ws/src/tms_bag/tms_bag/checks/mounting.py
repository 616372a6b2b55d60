"""Checks of how the sensor sits on the bicycle: by gravity and strikes during the run, and by poses at rest.

A pose says which axis of the bicycle (REP-103: x forward, y left, z up) pointed up while nothing moved. The
rotation from the sensor to the bicycle is that which brings the readings closest to these axes: G. Wahba,
SIAM Review 7 (1965) 409, doi:10.1137/1007077, solved by a singular value decomposition (F. L. Markley, J.
Astronautical Sciences 36 (1988) 245).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from tms_model.frames import matrix_quaternion, quaternion, rotation_matrix

from tms_bag.checks.finding import ERROR, NOTE, WARNING, Finding
from tms_bag.checks.poses import AXES, RestPose, direction
from tms_bag.checks.run import onwards
from tms_bag.checks.sensor import GRAVITY
from tms_bag.checks.survey import Survey
from tms_bag.errors import RecordingError
from tms_bag.imu_mounting import ImuMounting, imu_mounting
from tms_bag.samples import FloatArray

LEVEL = 5.0  # [deg] that a sensor may be off before it's worth a word
UNSURE_POSE = 10.0  # [deg] that a pose may be off the others


@dataclass(frozen=True, eq=False)
class Alignment:
    """How the sensor sits, by poses at rest."""

    quaternion: FloatArray  # (4,) x, y, z, w: sensor -> rear_frame, REP-103
    misfit: FloatArray  # [rad] of each pose
    mirrored: bool  # the readings fit only with an axis flipped
    complete: bool  # poses in two directions or more: also the heading is known


def aligned(poses: Sequence[RestPose]) -> Alignment:
    """Rotation that brings the readings to the axes that pointed up."""
    up = np.array([direction(pose.up) for pose in poses])
    seen = np.array([pose.force / np.linalg.norm(pose.force) for pose in poses])
    left, sizes, right = np.linalg.svd(up.T @ seen)
    handed = np.linalg.det(left @ right)
    rotation = left @ np.diag([1.0, 1.0, np.sign(handed)]) @ right
    cosine = np.clip(np.sum(up * (seen @ rotation.T), axis=1), -1.0, 1.0)
    # With three directions the third singular value says whether a mirror image would fit better.
    return Alignment(
        quaternion=matrix_quaternion(rotation),
        misfit=np.arccos(cosine),
        mirrored=bool(handed < 0.0 and sizes[2] > 0.1),
        complete=bool(sizes[1] > 0.1),
    )


def gravity_direction(survey: Survey) -> Iterator[Finding]:
    """Where the specific force points on the average: upwards, if the sensor sits as run_info says."""
    if survey.imu is None:
        return
    known = np.isfinite(survey.imu.specific_force).all(axis=1)
    if np.count_nonzero(known) < 100:
        return
    force = np.median(survey.imu.specific_force[known], axis=0)
    size = float(np.linalg.norm(force))
    if not size > 0.5:
        return
    info = survey.run_info
    said = info is not None and abs(float(np.linalg.norm(info.imu_orientation)) - 1.0) < 1e-6
    up = force / size
    if info is not None and said:
        up = rotation_matrix(info.imu_orientation) @ up
    tilt = float(np.degrees(np.arccos(np.clip(up[2], -1.0, 1.0))))
    where = ", ".join(f"{axis} {value:+.2f}" for axis, value in zip(AXES, size * up, strict=True))
    sits = "with the mounting of run_info" if said else "taken as level, since nobody says how it sits"
    evidence = f"the specific force is {where} m/s^2 at the median, {sits}"
    values = {"up": [float(value) for value in up], "tilt": float(np.radians(tilt))}
    if tilt > 150.0:
        yield Finding(
            ERROR,
            survey.imu_topic or "",
            f"{evidence}: upside down",
            "the signs of lean and yaw rate are wrong, or the driver gives gravity instead of its reaction",
            "say how the sensor sits (imu_mounting of run_info; imu_orientation in a mapping), or let"
            " the driver give"
            " +9.81 upwards at rest (REP-145)",
            _command(survey),
            values,
        )
    elif tilt > 30.0:
        axis = AXES[int(np.argmax(np.abs(up)))]
        sign = "-" if up[int(np.argmax(np.abs(up)))] < 0 else ""
        yield Finding(
            ERROR,
            survey.imu_topic or "",
            f"{evidence}: {sign}{axis} points up, not z ({tilt:.0f} deg off)",
            "what is taken for the lean rate is another rate",
            "say how the sensor sits (imu_mounting of run_info; imu_orientation in a mapping); poses at"
            " rest tell it",
            _command(survey),
            values,
        )
    elif tilt > LEVEL:
        yield Finding(
            WARNING,
            survey.imu_topic or "",
            f"{evidence}: z is {tilt:.1f} deg off the vertical",
            f"{100 * np.sin(np.radians(tilt)):.0f} % of the yaw rate show in the lean rate",
            "say how the sensor sits (imu_mounting of run_info; imu_orientation in a mapping); poses at"
            " rest tell it",
            _command(survey),
            values,
        )


def strike_axis(survey: Survey) -> Iterator[Finding]:
    """Whether sudden changes of the angular velocity are about x, with the right sign of yaw against lean."""
    found = _found(survey)
    if found is None or not found.turned:
        return
    degrees = float(np.degrees(found.heading))
    backwards = abs(degrees) > 160.0
    values = {
        "imu_orientation": found.quaternion.tolist(),
        "heading": found.heading,
        "heading_std": found.heading_std,
        "changes": found.change_count,
    }
    yield Finding(
        ERROR,
        survey.imu_topic or "",
        f"{found.change_count} sudden changes of the angular velocity and the sign of yaw against lean show x"
        f" {abs(degrees):.0f} deg to the {'left' if degrees > 0.0 else 'right'} of where it"
        f" {'is stated' if survey.run_info is not None else 'is assumed, since the recording states none'}"
        f"{': the sensor faces backwards' if backwards else ''}",
        "the lean rate has the wrong sign against the yaw rate"
        if backwards
        else "what is taken for the lean rate is in part or wholly another rate: strikes are missed",
        f"state roll, pitch, yaw of the sensor as found, {found.text} deg: {found.evidence}",
        f"{onwards(survey)} {found.flag}",
        values,
    )


def _found(survey: Survey) -> ImuMounting | None:
    """How the sensor sits, by gravity and strikes; None where the run doesn't show it."""
    if survey.imu is None:
        return None
    info = survey.run_info
    said = info is not None and abs(float(np.linalg.norm(info.imu_orientation)) - 1.0) < 1e-6
    stated = info.imu_orientation if info is not None and said else quaternion(0.0, 0.0, 0.0)
    try:
        return imu_mounting(survey.imu, survey.speed, stated)
    except RecordingError:
        return None


def _command(survey: Survey) -> str:
    """The fit with the orientation that gravity and strikes show, else the check with poses at rest."""
    found = _found(survey)
    if found is not None and found.tilted:
        return f"{onwards(survey)} {found.flag}"
    return f"./tms bag check {survey.path} --rest-pose z=UPRIGHT --rest-pose x=FRONT_WHEEL_UP"


def alignment(survey: Survey) -> Iterator[Finding]:
    """How the sensor sits, by the poses at rest that were given."""
    poses = survey.poses
    if not poses:
        return
    found = aligned(poses)
    sizes = [float(np.linalg.norm(pose.force)) for pose in poses]
    worst = float(np.degrees(found.misfit.max()))
    turn = [float(value) for value in found.quaternion]
    text = ", ".join(f"{value:.4f}" for value in turn)
    fits = ", ".join(
        f"{pose.name} {np.degrees(off):.1f} deg, {size:.2f} m/s^2"
        for pose, off, size in zip(poses, found.misfit, sizes, strict=True)
    )
    values = {"imu_orientation": turn, "misfit": found.misfit.tolist(), "gravity": sizes}
    if found.mirrored:
        yield Finding(
            ERROR,
            survey.imu_topic or "",
            f"the poses fit a mirrored sensor only (off by {fits})",
            "no mounting can be told",
            "an axis is flipped, or the driver gives gravity instead of its reaction (REP-145: +9.81"
            " upwards at rest),"
            " or a pose was named by the axis that points down",
            values=values,
        )
        return
    known = "" if found.complete else "; its heading is a guess: add a pose with another axis up"
    yield Finding(
        WARNING if worst > UNSURE_POSE or not found.complete else NOTE,
        survey.imu_topic or "",
        f"by {len(poses)} poses at rest the sensor sits as imu_orientation [{text}] (x, y, z, w){known};"
        f" poses off by {fits}",
        "with this mounting the lean rate is that of the bicycle"
        if worst <= UNSURE_POSE
        else f"poses that disagree by {worst:.0f} deg leave as much of one rate in another",
        "give it as imu_mounting in run_info, or as imu_orientation in the mapping of a CSV log",
        values=values,
    )
    scale = max(abs(size / GRAVITY - 1.0) for size in sizes)
    if scale > 0.02:
        yield Finding(
            WARNING,
            survey.imu_topic or "",
            f"gravity is {', '.join(f'{size:.2f}' for size in sizes)} m/s^2 in the poses",
            f"scale or bias of the accelerometer are off by up to {100 * scale:.1f} %",
            "calibrate it with six poses, each axis up and down",
            values={"gravity": sizes},
        )
