"""Axes that `imu/lean_yaw` marks as saturated count neither live nor offline, nor for the running filter."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tms_bag import BagWriter, read_recording, topics
from tms_bag.record import Record
from tms_fit.gyroscopes import Gyroscopes, X, Y, Z
from tms_fit.messages import estimate_records
from tms_fit.recording_fit import fit_recording
from tms_fit.settings import Settings
from tms_fit.streaming.live_fit import INPUTS, LiveFit
from tms_fit.streaming.synchronizer import WAITING_FLAGS_LIMIT, SampleSynchronizer
from tms_model import load_bicycle
from tms_model.frames import quaternion
from tms_sim.run import SimulatedRun

LIMIT = 0.4  # [rad/s], of the gyroscopes; the strike makes 0.6
LEVEL = quaternion(0.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def limited(make_run: Any) -> SimulatedRun:
    """A struck run whose gyroscopes stop at a limit, and say so in `imu/lean_yaw`."""
    run = make_run("tms_strike", strike__time=1.5037, strike__lean_rate=0.6, duration=4.5)
    full = np.abs(run.imu.angular_velocity) >= LIMIT
    assert 5 < full[:, 0].sum() < 100
    imu = replace(run.imu, angular_velocity=np.clip(run.imu.angular_velocity, -LIMIT, LIMIT))
    flags = (full @ [X, Y, Z]).astype(np.uint8)
    return replace(run, imu=imu, lean_yaw=replace(run.lean_yaw, saturation=flags))


def unmarked(run: SimulatedRun) -> SimulatedRun:
    return replace(run, lean_yaw=replace(run.lean_yaw, saturation=np.zeros_like(run.lean_yaw.saturation)))


def messages(run: SimulatedRun) -> list[Record]:
    return [record for record in run.records() if record.topic.removeprefix("/") in INPUTS]


def live(records: list[Record], settings: Settings | None = None) -> tuple[list[bytes], LiveFit]:
    """All answers but previews, as bytes."""
    fit = LiveFit(settings or Settings(), preview_period=0.0)
    answers = [one for record in records for one in fit.process(record.topic.removeprefix("/"), record.data)]
    return [one.data for one in answers + fit.finish()], fit


def test_a_marked_axis_is_as_one_that_stands_at_a_known_limit(limited: SimulatedRun, fit_run: Any) -> None:
    (told,) = fit_run(limited)
    (known,) = fit_run(unmarked(limited), gyroscope_range=LIMIT)
    (neither,) = fit_run(unmarked(limited), estimators=("least_squares",))
    (used,) = fit_run(limited, saturation="use", estimators=("least_squares",))
    for one, other in zip(told.estimates, known.estimates, strict=True):
        assert one.sample_count == other.sample_count
        np.testing.assert_array_equal(one.values, other.values)
    for one, other in zip(used.estimates, neither.estimates, strict=True):
        np.testing.assert_array_equal(one.values, other.values)
    assert abs(told.estimates[0].values[0] - 0.6) < 0.02
    assert neither.estimates[0].values[0] < 0.55


def test_live_replayed_and_offline_agree_on_them(limited: SimulatedRun, tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        for record in limited.records():
            bag.write(record)
    recording = read_recording(tmp_path / "bag")
    offline = fit_recording(recording, load_bicycle("tms_eq_10_1"), Settings())
    expected = [record.data for strike in offline.strikes for record in estimate_records(strike)]
    answers, fit = live(messages(limited))
    assert [one for one in answers if one in expected] == expected
    assert fit.diagnostics["saturated"] == np.count_nonzero(limited.lean_yaw.saturation)
    # Whatever their order within the reorder window.
    told, *rest = messages(limited)
    late = np.array([record.time_ns for record in rest]) + np.random.default_rng(1).uniform(0, 9e7, len(rest))
    shaken = [told, *(rest[row] for row in np.argsort(late, kind="stable"))]
    assert live(shaken)[0] == answers


@pytest.mark.long
def test_the_running_filter_leaves_them_out(limited: SimulatedRun) -> None:
    told, _ = live(messages(limited))
    known, _ = live(messages(unmarked(limited)), Settings(gyroscope_range=LIMIT))
    assert told == known
    assert told != live(messages(unmarked(limited)))[0]


@pytest.mark.long
def test_marks_that_come_too_late_are_counted(limited: SimulatedRun) -> None:
    first = [record for record in messages(limited) if record.topic != f"/{topics.LEAN_YAW}"]
    late = [record for record in messages(limited) if record.topic == f"/{topics.LEAN_YAW}"]
    fit = LiveFit(Settings(estimators=("least_squares",)), preview_period=0.0)
    for record in first + late:
        fit.process(record.topic.removeprefix("/"), record.data)
    marked = np.count_nonzero(limited.lean_yaw.saturation)
    waiting = np.count_nonzero(limited.lean_yaw.saturation[-50:])  # may still be on time
    assert marked - waiting <= fit.diagnostics["late_flags"] <= marked
    assert "saturated" not in fit.diagnostics


def test_marks_without_samples_are_forgotten() -> None:
    aligned = SampleSynchronizer(Gyroscopes(LEVEL, None), 0.0, 3.6)
    for stamp in range(1, WAITING_FLAGS_LIMIT + 3):
        aligned.add_flags(stamp, X)
    assert aligned.counts["late_flags"] == 2
    for stamp in (2, WAITING_FLAGS_LIMIT + 2):
        aligned.add_imu(stamp, (1.0, 2.0, 3.0), (0.0, 0.0, 0.0))
    first, last = aligned.ready(finished=True)
    assert (first.flagged, last.flagged) == ((False, False, False), (True, False, False))


def test_what_a_tilted_sensor_loses() -> None:
    # Rolled by a quarter turn, z of the sensor points along y (left) of the rear frame, -y along z (up).
    turned = Gyroscopes(quaternion(math.pi / 2.0, 0.0, 0.0), 2.0)
    np.testing.assert_allclose(turned.in_rear_frame((0.1, 0.2, 0.3)), (0.1, 0.3, -0.2), atol=1e-15)
    assert turned.unsaturated((0.1, 0.2, 0.3), 0) is None
    assert np.isnan(turned.unsaturated((0.1, 0.2, 0.3), X)).tolist() == [True, False, False]
    assert np.isnan(turned.unsaturated((0.1, 2.0, 0.3), 0)).tolist() == [False, False, True]
    assert turned.flagged(Y) == (False, False, True)
    # Pitched by a little, x and z enter each other; flags of accelerometers say nothing about gyroscopes.
    pitched = Gyroscopes(quaternion(0.0, 0.1, 0.0), None)
    assert pitched.flagged(X) == pitched.flagged(Z) == (True, False, True)
    assert pitched.unsaturated((0.1, 9.0, 0.3), 7) is None
    assert math.isnan(pitched.in_rear_frame((0.1, 0.2, math.nan))[0])
