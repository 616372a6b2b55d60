"""Orientation of the inertial sensor in a fit: of the settings, of the recording, or found from the run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from tms_bag import Recording, RecordingError
from tms_bag.imu_mounting import imu_mounting
from tms_bag.samples import RunInfo
from tms_model import ParameterError
from tms_model.bicycle import Array
from tms_model.frames import quaternion

from tms_fit.gyroscopes import orientation_of
from tms_fit.settings import AUTO, Settings


def live_orientation(info: RunInfo | None, settings: Settings) -> Array:
    """Quaternion x, y, z, w (4,), sensor -> rear frame, of the settings, else of the run_info.

    Raises ParameterError for auto, which needs samples that are still to come.
    """
    given = settings.imu_orientation
    if given is None:
        return orientation_of(info)
    if isinstance(given, str):
        raise ParameterError(
            f"imu orientation: expected ROLL,PITCH,YAW [deg], found {AUTO}, which needs a whole recording;"
            " 'tms bag check BAG' prints the angles"
        )
    return quaternion(*np.radians(given))


def with_orientation(recording: Recording, settings: Settings) -> Recording:
    """The recording with the sensor's orientation of the settings in its run_info.

    A warning states what auto has found, or, without the option, that the run shows another orientation.
    Raises RecordingError where auto finds none.
    """
    info, given = recording.run_info, settings.imu_orientation
    stated = orientation_of(info)
    if given is None or given == AUTO:
        try:
            found = imu_mounting(recording.imu, recording.speed, stated)
        except RecordingError as error:
            if given is None:
                return recording
            raise RecordingError(
                f"{recording.path}: imu orientation {AUTO}: {error} by --imu-orientation ROLL,PITCH,YAW"
            ) from error
        if given is None:
            if not (found.tilted or found.turned):
                return recording
            warning = (
                f"gravity and strikes show the orientation of the sensor as {found.text} deg, not as it is"
                f" stated ({found.evidence}); use {found.flag}"
            )
            return replace(recording, warnings=(*recording.warnings, warning))
        chosen = stated if found.as_stated else found.quaternion
        warning = f"orientation of the sensor {found.text} deg: {found.evidence}"
        recording = replace(recording, warnings=(*recording.warnings, warning))
    else:
        chosen = live_orientation(info, settings)
    if info is None:
        info = RunInfo(start_ns=int(recording.imu.time_ns[0]))
    return replace(recording, run_info=replace(info, imu_orientation=chosen))
