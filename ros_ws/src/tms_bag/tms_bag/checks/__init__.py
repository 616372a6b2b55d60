"""What a colleague would tell about a recording before it is trusted.

A check is a function that looks at a survey and yields findings; it knows nothing of the others. To add one:
write it, and name it in CHECKS.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from tms_bag.checks import mounting, run, sensor, timing
from tms_bag.checks.finding import ERROR, NOTE, SEVERITIES, WARNING, Finding
from tms_bag.checks.survey import Survey, survey

__all__ = ["CHECKS", "ERROR", "NOTE", "SEVERITIES", "WARNING", "Finding", "Survey", "findings", "survey"]

CHECKS: dict[str, Callable[[Survey], Iterable[Finding]]] = {
    "unfinished": run.unfinished,
    "unreadable": run.unreadable,
    "no_imu": run.no_imu,
    "no_bicycle": run.no_bicycle,
    "no_speed": run.no_speed,
    "speed_topic": run.speed_topic,
    "speed_values": run.speed_values,
    "mixed_frames": run.mixed_frames,
    "too_short": run.too_short,
    "no_push": run.no_push,
    "unstamped": timing.unstamped,
    "rate": timing.rate,
    "gaps": timing.gaps,
    "jitter": timing.jitter,
    "duplicates": timing.duplicates,
    "out_of_order": timing.out_of_order,
    "clock_jumps": timing.clock_jumps,
    "clock_offset": timing.clock_offset,
    "no_gyroscope": sensor.no_gyroscope,
    "dead_axis": sensor.dead_axis,
    "saturation": sensor.saturation,
    "force_units": sensor.force_units,
    "rate_units": sensor.rate_units,
    "gyro_bias": sensor.gyro_bias,
    "gravity_direction": mounting.gravity_direction,
    "strike_axis": mounting.strike_axis,
    "alignment": mounting.alignment,
}


def findings(survey: Survey) -> list[tuple[str, Finding]]:
    """All findings with the names of their checks, the gravest first."""
    found = [(name, finding) for name, check in CHECKS.items() for finding in check(survey)]
    return sorted(found, key=lambda entry: SEVERITIES.index(entry[1].severity))
