"""Checks of the run itself: what is there at all, how long, how fast, and whether there was a push."""

from __future__ import annotations

import shlex
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from tms_bag.checks.finding import ERROR, NOTE, WARNING, Finding
from tms_bag.checks.survey import Survey
from tms_bag.reading_limits import SPEED_LIMIT, measured

SHORTEST = 2.0  # [s] half a second of quiet before a strike and 1.5 s of free response
UNEVEN_SPEED = 0.1  # of the median
FAST = 12.0  # [m/s] faster than anybody lets a bicycle roll without a rider
PUSH = 6.0  # times the usual change of the lean rate within a tenth of a second


def unfinished(survey: Survey) -> Iterator[Finding]:
    """Files that weren't closed."""
    for warning in survey.warnings:
        yield Finding(
            WARNING,
            "",
            warning,
            "the last second or more may be missing; other tools may refuse the file",
            "read it as it is, or make a clean bag of it",
            f"./tms bag repair {shlex.quote(str(survey.path))}"
            + (" -o NEW" if survey.path.is_file() else ""),
        )


def unreadable(survey: Survey) -> Iterator[Finding]:
    """Topics whose messages can't be decoded."""
    for topic, why in survey.unreadable.items():
        yield Finding(
            WARNING if topic not in (*survey.imu_topics, *survey.speed_topics) else ERROR,
            topic,
            why,
            "nothing of this topic can be used",
            "source the workspace that has its type, or record it anew",
        )


def no_imu(survey: Survey) -> Iterator[Finding]:
    """No inertial sensor, or one of an unusual name."""
    if survey.imu_topic is None:
        there = ", ".join(f"{stream.name} ({stream.type})" for stream in survey.streams.values())
        yield Finding(
            ERROR,
            "",
            f"no topic of type sensor_msgs/msg/Imu; there are: {there or 'none with messages'}",
            "nothing can be fitted",
            "record the sensor's topic; a CSV log becomes a bag with `./tms bag import-csv`",
        )
    elif not survey.imu_topic.endswith("/imu/data_raw") or len(survey.imu_topics) > 1:
        yield Finding(
            NOTE,
            survey.imu_topic,
            f"the sensor's topic is {survey.imu_topic}"
            + (f", of {', '.join(survey.imu_topics)}" if len(survey.imu_topics) > 1 else ""),
            "the fit asks which one to take, unless there is only one imu/data_raw",
            "name it",
            onwards(survey),
        )


def mixed_frames(survey: Survey) -> Iterator[Finding]:
    """More than one frame_id on the sensor's topic."""
    stream = survey.streams.get(survey.imu_topic or "")
    if stream is not None and len(stream.frame_ids) > 1:
        yield Finding(
            WARNING,
            stream.name,
            f"messages come from the frames {', '.join(map(repr, stream.frame_ids))}",
            "two sensors on one topic can't be told apart, and sit differently",
            "give each sensor a topic of its own",
            values={"frames": list(stream.frame_ids)},
        )


def too_short(survey: Survey) -> Iterator[Finding]:
    """Not enough for a strike and what follows."""
    stream = survey.streams.get(survey.imu_topic or "")
    if stream is not None and stream.duration < SHORTEST:
        yield Finding(
            ERROR,
            stream.name,
            f"{stream.duration:.2f} s of the sensor",
            f"a strike needs half a second of quiet before it and 1.5 s after it, {SHORTEST:g} s together",
            "record longer",
            values={"duration": stream.duration},
        )


def no_speed(survey: Survey) -> Iterator[Finding]:
    """No forward speed."""
    if survey.speed_topic is None:
        info = survey.run_info
        nominal = info.speed if info is not None else float("nan")
        if np.isfinite(nominal):
            yield Finding(
                NOTE,
                "",
                f"no topic with a speed; run_info says {nominal:.2f} m/s",
                "the fit takes that as constant",
                "give a measured one, if there is",
                f"{onwards(survey)} --fix speed={nominal:.3f}",
            )
            return
        yield Finding(
            ERROR,
            "",
            "no topic with a measured speed (geometry_msgs/msg/TwistStamped), and no run_info that names one",
            "the bicycle's dynamics depend on its speed: nothing can be fitted without",
            "measure the speed, and give it by hand [m/s]",
            f"{onwards(survey)} --fix speed=V",
        )


def speed_topic(survey: Survey) -> Iterator[Finding]:
    """A speed's topic of an unusual name, a choice to make, or a command that is no measurement."""
    found = survey.found_speed
    if not found.remark:
        return
    if found.candidates:
        yield Finding(
            ERROR,
            survey.speed_topic or "",
            found.remark,
            "the fit takes none of them without the flag, and not the nominal speed in their place",
            "name the one that was measured at the rear wheel or the treadmill",
            onwards(survey),
            {"topics": list(found.candidates)},
        )
    elif found.name:
        yield Finding(
            NOTE,
            found.name,
            found.remark,
            "the fit takes it, and says so",
            "make sure that its linear.x is the forward speed in m/s",
            onwards(survey),
        )
    else:
        yield Finding(
            NOTE,
            found.commands[0],
            found.remark,
            "a commanded speed is not what the bicycle rode at",
            "record the measured speed",
            values={"topics": list(found.commands)},
        )


def speed_values(survey: Survey) -> Iterator[Finding]:
    """A speed that is zero, backwards, uneven, or too fast to be in m/s."""
    if survey.speed is None or survey.speed_topic is None:
        return
    there = np.isfinite(measured(survey.speed.speed, SPEED_LIMIT))
    if there.mean() > 0.5:  # else the unit is another one, as the median shows
        yield from _missing_speeds(survey.speed_topic, there)
        speed = survey.speed.speed[there]
    else:
        speed = survey.speed.speed[np.isfinite(survey.speed.speed)]
    usual = float(np.median(speed)) if speed.size else float("nan")
    moving = speed[np.abs(speed) > 0.3]
    if not moving.size:
        yield Finding(
            ERROR,
            survey.speed_topic,
            f"the speed is {usual:g} m/s at the median and never above 0.3 m/s",
            "a bicycle at rest falls over: there is no free response to fit",
            "check the speed sensor, or give the speed by hand",
            f"{onwards(survey)} --fix speed=V",
            {"median": usual},
        )
        return
    usual = float(np.median(moving))
    spread = float(np.std(moving)) / abs(usual)
    if usual < 0.0:
        yield Finding(
            ERROR,
            survey.speed_topic,
            f"the speed is {usual:.2f} m/s at the median: backwards",
            "the fit refuses it",
            "twist.linear.x is positive forwards (REP-103): turn the sign in the driver, or give the"
            " speed by hand",
            f"{onwards(survey)} --fix speed={-usual:.3f}",
            {"median": usual},
        )
    elif usual > FAST:
        yield Finding(
            WARNING,
            survey.speed_topic,
            f"the speed is {usual:.1f} m/s at the median ({3.6 * usual:.0f} km/h); {usual:.1f} km/h would be"
            f" {usual / 3.6:.2f} m/s",
            "if it is in km/h, all predictions are those of a bicycle 3.6 times as fast",
            "give m/s in the driver, or the speed by hand",
            f"{onwards(survey)} --fix speed={usual / 3.6:.3f}",
            {"median": usual},
        )
    elif spread > UNEVEN_SPEED:
        yield Finding(
            NOTE,
            survey.speed_topic,
            f"the speed scatters by {100 * spread:.0f} % around {usual:.2f} m/s while it moves",
            "each strike is fitted with its own speed; within one it is taken as the median",
            "hold the speed for two seconds around each strike",
            values={"median": usual, "std": spread * usual},
        )


def no_bicycle(survey: Survey) -> Iterator[Finding]:
    """Nobody says which bicycle it was."""
    if survey.run_info is None or not survey.run_info.bicycle:
        yield Finding(
            NOTE,
            "",
            "no run_info that names the bicycle",
            "the fit must be told",
            "`./tms model list` shows those that are known; yours is one YAML file",
            onwards(survey),
        )


def _missing_speeds(topic: str, there: NDArray[np.bool_]) -> Iterator[Finding]:
    """Some speeds that are none; there: (n,)."""
    share = 1.0 - float(there.mean())
    if share > 0.0:
        yield Finding(
            WARNING,
            topic,
            f"{100 * share:.2f} % of the speeds are not finite or beyond {SPEED_LIMIT:g} m/s",
            "these speeds are left out",
            "look for the cause in the sensor's driver",
            values={"share": share},
        )


def no_push(survey: Survey) -> Iterator[Finding]:
    """Nothing in the angular velocity that sticks out. Whether it is a strike, `fit run` decides."""
    if survey.imu is None or survey.imu.time_ns.size < 100 or survey.seconds[-1] < SHORTEST:
        return
    step = float(np.median(np.diff(survey.seconds)))
    lag = max(round(0.1 / step), 1) if step > 0.0 else 1
    best = 0.0
    for column in survey.imu.angular_velocity.T:
        known = column[np.isfinite(column)]
        if known.size > 10 * lag:
            change = np.abs(known[lag:] - known[:-lag])
            usual = float(np.median(change))
            best = max(best, float(change.max()) / usual if usual > 0.0 else 0.0)
    if 0.0 < best < PUSH:
        yield Finding(
            WARNING,
            survey.imu_topic or "",
            f"no angular velocity changes within 0.1 s by more than {best:.1f} times what is usual",
            "there seems to be no strike, or it drowns in noise or in other motion",
            "push harder, sideways, at the rear frame; `fit run` looks more closely",
            onwards(survey),
            {"ratio": best},
        )


def onwards(survey: Survey) -> str:
    """The command line to go on with."""
    words = ["./tms", "fit", "run", str(survey.path)]
    if survey.run_info is None or not survey.run_info.bicycle:
        words += ["--bicycle", "NAME"]
    if survey.imu_topic and (not survey.imu_topic.endswith("/imu/data_raw") or len(_raw(survey)) > 1):
        words += ["--imu-topic", survey.imu_topic]
    found = survey.found_speed
    if survey.speed_topic and (found.candidates or found.chosen):
        words += ["--speed-topic", survey.speed_topic]
    return shlex.join(words)


def _raw(survey: Survey) -> list[str]:
    return [name for name in survey.imu_topics if name.endswith("/imu/data_raw")]
