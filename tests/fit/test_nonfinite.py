"""Readings that are no numbers, or none that a sensor gives, count as missing, offline and live."""

from __future__ import annotations

import json
import math
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tms_bag import Record, Recording, conversion, read_recording, recording_from_arrays, topics
from tms_bag.reading_limits import RATE_LIMIT, SPEED_LIMIT, measured_rates, without_impossible
from tms_bag.samples import SpeedSamples, selected
from tms_fit import fit_window
from tms_fit.messages import estimate_records
from tms_fit.recording_fit import RecordingFit, fit_recording
from tms_fit.settings import Settings
from tms_fit.streaming.live_fit import LiveFit
from tms_fit.streaming.live_run import LiveRun
from tms_fit.window import Window
from tms_model import load_bicycle
from tms_model.frames import imu_to_rear_frame
from tms_model.imu import lean_and_yaw_rate
from tms_sim.run import SimulatedRun

CASES = Path(__file__).parents[1] / "data" / "cases"
IMPOSSIBLE = (math.nan, math.inf, -math.inf, 1e300, -1e300, float(2**62), -float(10**18))
STREAMS = ("gyroscope", "gyroscope variance", "speed", "speed variance", "torque", "flags")
SINGLE_FIT = Settings(estimators=("least_squares",))

Change = tuple[str, float, int, float]  # stream, place as a share of it, axis, value
changes = st.lists(
    st.tuples(
        st.sampled_from(STREAMS),
        st.floats(0.0, 1.0, exclude_max=True),
        st.integers(0, 2),
        st.sampled_from(IMPOSSIBLE),
    ),
    min_size=1,
    max_size=8,
)


@pytest.fixture(scope="module")
def run(make_run: Any) -> SimulatedRun:
    """A push with a known steer torque, and a speed whose variance is stated."""
    found: SimulatedRun = make_run("delft_push", strike__time=1.0037, duration=3.0)
    variance = np.full(found.speed.time_ns.size, 1e-4)
    return replace(found, speed=SpeedSamples(found.speed.time_ns, found.speed.speed, variance))


@pytest.fixture(scope="module")
def clean(run: SimulatedRun) -> RecordingFit:
    return fit_recording(run.recording(), load_bicycle(run.info.bicycle), SINGLE_FIT)


def spoilt(run: SimulatedRun, made: list[Change]) -> tuple[Recording, dict[int, np.ndarray]]:
    """The recording with changed readings, and by row the changed variances (3,) of its IMU messages."""
    assert run.steer_torque is not None
    assert run.lean_yaw is not None
    rates, variances = run.imu.angular_velocity.copy(), {}
    speed, speed_variance = run.speed.speed.copy(), run.speed.variance.copy()
    torque, flags = run.steer_torque.steer_torque.copy(), run.lean_yaw.saturation.copy()
    for stream, place, axis, value in made:
        row = int(place * len(rates))
        if stream == "gyroscope":
            rates[row, axis] = value
        elif stream == "gyroscope variance":
            variances.setdefault(row, run.imu.angular_velocity_variance.copy())[axis] = value
        elif stream == "speed":
            speed[int(place * len(speed))] = value
        elif stream == "speed variance":
            speed_variance[int(place * len(speed))] = value
        elif stream == "torque":
            torque[int(place * len(torque))] = value
        else:
            flags[int(place * len(flags))] |= 8 << axis
    imu = replace(run.imu, angular_velocity=rates)
    if 0 in variances:  # a recording has one variance, that of the first message
        imu = replace(imu, angular_velocity_variance=variances[0])
    recording = replace(
        run.recording(),
        imu=imu,
        speed=SpeedSamples(run.speed.time_ns, speed, speed_variance),
        steer_torque=replace(run.steer_torque, steer_torque=torque),
        lean_yaw=replace(run.lean_yaw, saturation=flags),
    )
    return recording, variances


def messages(recording: Recording, variances: dict[int, np.ndarray]) -> list[Record]:
    """All inputs of a live fit, in the order of their stamps."""
    assert recording.speed is not None
    assert recording.steer_torque is not None
    assert recording.lean_yaw is not None
    assert recording.run_info is not None
    imu = list(conversion.imu_records(recording.imu))
    for row, variance in variances.items():
        one = replace(selected(recording.imu, slice(row, row + 1)), angular_velocity_variance=variance)
        imu[row] = next(conversion.imu_records(one))
    samples = [
        *conversion.speed_covariance_records(recording.speed),
        *conversion.steer_torque_records(recording.steer_torque),
        *conversion.lean_yaw_records(recording.lean_yaw),
        *imu,
    ]
    return [
        *conversion.run_info_records(recording.run_info),
        *sorted(samples, key=lambda record: record.time_ns),
    ]


def live_estimates(order: list[Record]) -> list[tuple[int, bytes]]:
    fit = LiveFit(SINGLE_FIT, preview_period=0.0)
    found = [one for record in order for one in fit.process(record.topic.removeprefix("/"), record.data)]
    return [(one.time_ns, one.data) for one in [*found, *fit.finish()] if one.topic == "/estimate"]


@settings(max_examples=12, deadline=None, derandomize=True)
@given(made=changes)
def test_impossible_readings_change_no_answer(
    run: SimulatedRun, clean: RecordingFit, made: list[Change]
) -> None:
    recording, variances = spoilt(run, made)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fit = fit_recording(recording, load_bicycle(run.info.bicycle), SINGLE_FIT)
        live = live_estimates(messages(recording, variances))
    assert live == [(one.time_ns, one.data) for strike in fit.strikes for one in estimate_records(strike)]
    assert len(fit.strikes) == len(clean.strikes) == 1
    found, expected = fit.strikes[0].estimates[0], clean.strikes[0].estimates[0]
    if found.status == "ok":
        one, other = found["initial_lean_rate"], expected["initial_lean_rate"]
        assert abs(one.value - other.value) < 3.0 * other.std
        assert one.std < 1.5 * other.std


@pytest.mark.parametrize("value", IMPOSSIBLE)
def test_an_impossible_reading_is_a_missing_one_to_the_byte(run: SimulatedRun, value: float) -> None:
    made = [(stream, place, 0, value) for stream in STREAMS[:-1] for place in (0.0, 0.31, 0.5)]
    one, _ = spoilt(run, made)
    other, _ = spoilt(run, [(stream, place, axis, math.nan) for stream, place, axis, _ in made])
    bicycle = load_bicycle(run.info.bicycle)
    left, right = (fit_recording(recording, bicycle, SINGLE_FIT) for recording in (one, other))
    assert left.recording.warnings == right.recording.warnings
    for strike, same in zip(left.strikes, right.strikes, strict=True):
        assert [r.data for r in estimate_records(strike)] == [r.data for r in estimate_records(same)]


def test_one_infinite_sample_gives_the_answer_of_one_nan(command: Any) -> None:
    documents = []
    for name in ("imu_one_inf", "imu_one_nan"):
        answer = command("tms_fit", "run", CASES / f"{name}.mcap", "--json")
        assert answer.code == 0
        assert "RuntimeWarning" not in answer.err
        documents.append(json.loads(answer.out))
    for document in documents:
        document.pop("bag")
    assert documents[0] == documents[1]
    (strike,) = documents[0]["strikes"]
    assert strike["estimates"][0]["parameters"]["initial_lean_rate"]["value"] == pytest.approx(
        0.50175, abs=1e-3
    )
    assert [text for text in documents[0]["warnings"] if "linear equations" not in text] == [
        "1 of 801 gyroscope samples is not finite or beyond 1000 rad/s, and counts as missing"
    ]


def test_a_reading_at_its_limit_is_none() -> None:
    below = math.nextafter(RATE_LIMIT, 0.0)
    assert measured_rates((below, -below, 0.0)) == (below, -below, 0.0)
    assert np.isnan(measured_rates((RATE_LIMIT, -RATE_LIMIT, 0.0))).tolist() == [True, True, False]


def test_each_stream_says_how_many_of_its_readings_are_missing() -> None:
    time = np.arange(4) / 100.0
    rates = np.zeros((4, 3))
    rates[:, 1] = math.nan  # an axis that is never measured is absent, not missing
    rates[1, 0], rates[1, 2], rates[3, 0] = math.inf, 1e300, math.nan
    recording = recording_from_arrays(
        time, rates, (time, [1.0, 2.0 * SPEED_LIMIT, 1.0, 1.0]), steer_torque=(time, [0.0, 0.0, 1.0, 2.0])
    )
    found = without_impossible(recording)
    assert found.warnings == (
        "2 of 4 gyroscope samples are not finite or beyond 1000 rad/s, and count as missing",
        "1 of 4 speeds is not finite or beyond 1000 m/s, and counts as missing",
    )
    assert np.isnan(found.imu.angular_velocity[:, 0]).tolist() == [False, True, False, True]


def test_live_run_counts_samples_that_lack_an_axis(run: SimulatedRun) -> None:
    live = LiveRun(load_bicycle(run.info.bicycle), SINGLE_FIT, run.info.imu_orientation, 3.0)
    for row, rates in enumerate([(0.0, math.nan, 0.0), (math.inf, math.nan, 0.0), (0.0, math.nan, 1e300)]):
        live.add_imu(row * 10_000_000, rates, (math.nan,) * 3)
        live.add_saturation(row * 10_000_000, 2**70)  # no flag
    live.finish()
    assert dict(live.counts) == {"missing": 2}


def test_messages_and_arrays_are_read_alike(tmp_path: Path, run: SimulatedRun) -> None:
    recording, variances = spoilt(run, [(STREAMS[0], n / 10, n % 3, IMPOSSIBLE[n]) for n in range(7)])
    order = [one for one in messages(recording, variances) if one.topic == "/" + topics.IMU]
    table = conversion.imu_samples(order)
    for row, record in enumerate(order):
        np.testing.assert_array_equal(conversion.imu_reading(record)[1], table.angular_velocity[row])
    assert not np.isinf(table.angular_velocity).any()
    assert np.isfinite(read_recording(CASES / "imu_one_inf.mcap").imu.angular_velocity).sum() == 3 * 801 - 1


@pytest.mark.parametrize("value", [math.inf, -math.inf, 1e300])
def test_frames_and_windows_take_an_infinite_reading_for_an_absent_one(value: float) -> None:
    turned = imu_to_rear_frame(np.array([[value, 1.0, 2.0]]), np.array([0.0, 0.0, 0.0, 1.0]))
    if math.isinf(value):
        np.testing.assert_array_equal(turned, [[math.nan, -1.0, -2.0]])
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            _, yaw_rate = lean_and_yaw_rate(np.array([[0.1, value, 0.2]]), np.array([0.0]))
        assert yaw_rate[0] == 0.2
    time = np.arange(150) / 100.0
    rates = np.random.default_rng(1).normal(0.0, 0.01, (2, 150)) + 0.3 * np.exp(-time)
    estimates = []
    for one in (value, math.nan):
        rates[:, 70] = one
        window = Window.from_arrays(time, *rates, speed=4.6, bicycle="tms_eq_10_1")
        estimates.append(fit_window(window))
    np.testing.assert_array_equal(estimates[0].values, estimates[1].values)
