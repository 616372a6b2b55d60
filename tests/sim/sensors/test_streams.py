"""Sensors as a scenario asks for them: the truth with every error off, and what arrives with all on."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tms_bag import BagWriter, conversion, read_recording, topics
from tms_model import ParameterError
from tms_model.frames import quaternion
from tms_model.imu import ideal_imu
from tms_sim.blind import truth_text
from tms_sim.fault_injection import inject, parse_requests
from tms_sim.imu_grade import load_imu
from tms_sim.run import SimulatedRun, simulate
from tms_sim.scenario import load_scenario
from tms_sim.truth import rear_frame_motion

EVERYTHING: dict[str, Any] = {
    "imu.errors": "all", "imu.misalignment_deg": [1.0, -0.5, 0.8], "fusion.enabled": True,
    "floor_vibration.rms": 3.5, "padding.natural_frequency": 15.0, "wireless.range": 100.0,
    "wireless.loss": 0.02, "wireless.burst_start": 0.005, "wireless.latency": 0.01, "wireless.jitter": 0.006,
    "wireless.duplicates": 0.02, "wireless.clock_offset": 0.05, "wireless.clock_drift": 3e-5,
    "speed_sensor.kind": "camera", "faults": "stuck:time=3; spikes",
}  # fmt: skip


def run(scenario: str = "tms_strike", seed: int = 1, **changes: Any) -> SimulatedRun:
    changes = {key.replace("__", "."): value for key, value in changes.items()}
    return simulate(load_scenario(scenario, changes), np.random.default_rng(seed))


def everything(**changes: Any) -> SimulatedRun:
    return run(**{key.replace(".", "__"): value for key, value in EVERYTHING.items()} | changes)


def test_without_errors_the_samples_are_the_truth() -> None:
    made = run(imu__grade="pi_node", imu__errors="none", fusion__enabled=True, speed_sensor__noise=0.0)
    motion = made.trajectory.at((made.imu.time_ns - made.info.start_ns) / 1e9)
    rates, force = ideal_imu(rear_frame_motion(motion), np.array([0.0, 0.0, -0.15]), 9.81)
    flip = np.array([1.0, -1.0, -1.0])
    np.testing.assert_array_equal(made.imu.angular_velocity, rates * flip)
    np.testing.assert_array_equal(made.imu.specific_force, force * flip)
    np.testing.assert_array_equal(made.speed.speed, made.trajectory.at(np.arange(401) / 50.0).speed)
    assert made.magnetic is not None
    np.testing.assert_allclose(np.linalg.norm(made.magnetic.magnetic_field, axis=1), 49e-6, rtol=1e-12)
    assert not made.lean_yaw.saturation.any()
    assert made.imu_arrival_ns is None  # at their stamps


def test_wrong_mounting_is_stated_nowhere() -> None:
    straight, askew = run(imu__grade="ideal"), run(imu__grade="ideal", imu__misalignment_deg=[0.0, 0.0, 5.0])
    np.testing.assert_array_equal(askew.info.imu_orientation, straight.info.imu_orientation)
    # Yawed by 5 deg to the left, x and y of the sensor see the frame's turned by -5 deg.
    c, s = np.cos(np.radians(5.0)), np.sin(np.radians(5.0))
    turned = straight.imu.angular_velocity @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]).T
    np.testing.assert_allclose(askew.imu.angular_velocity, turned, atol=1e-14)
    stated = run(
        imu__orientation_deg=[10.0, 0.0, 0.0], imu__misalignment_deg=[3.0, 2.0, 1.0]
    ).info.imu_orientation
    np.testing.assert_allclose(stated, quaternion(np.radians(10.0), 0.0, 0.0))


def test_padding_keeps_the_accelerometers_off_their_limit() -> None:
    def share(**changes: float) -> float:
        return float((run(floor_vibration__rms=4.0, **changes).lean_yaw.saturation > 0).mean())

    # Upright, up the frame: 9.81 m/s^2 to spare below 2 g, 2.45 standard deviations: 0.7 % of samples.
    assert share() == pytest.approx(0.0073, abs=5.0 * np.sqrt(0.0073 / 801))
    assert share(padding__natural_frequency=15.0) == 0.0


def test_the_sensors_own_lean_is_told_and_levels_its_yaw_rate() -> None:
    true, own = run(imu__grade="ideal"), run(imu__grade="ideal", fusion__enabled=True)
    assert true.oriented is None
    assert own.oriented is not None
    assert own.oriented.orientation is not None
    np.testing.assert_allclose(np.linalg.norm(own.oriented.orientation, axis=1), 1.0, atol=1e-12)
    np.testing.assert_array_equal(own.imu.angular_velocity, true.imu.angular_velocity)  # the raw ones stay
    error = own.lean_yaw.lean - true.lean_yaw.lean
    assert 0.001 < np.abs(error).max() < 0.1  # turning pulls it off, but not far within these seconds
    assert not np.array_equal(own.lean_yaw.yaw_rate, true.lean_yaw.yaw_rate)
    np.testing.assert_array_equal(own.lean_yaw.lean_rate, true.lean_yaw.lean_rate)


def test_slower_topics_hold_every_tenth_sample_of_the_raw_one() -> None:
    # The sensor works at 1 kHz in both: same noise, same orientation, same losses.
    changes = {"faults": "none", "padding__natural_frequency": 0.0, "steer_torque__lean_rate_gain": 1.0}
    mixed: Any = everything(imu__raw_rate=1000.0, **changes)
    fast: Any = everything(imu__rate=1000.0, **changes)
    assert_same(mixed.imu, fast.imu)
    assert mixed.events == fast.events
    assert mixed.saturation.any()
    assert_same(mixed.steer_torque, fast.steer_torque, slice(None, None, 10))
    sent = np.round((fast.imu.time_ns - 1_050_000_000) / 1e6).astype(int)  # 3e-5 of drift is below 0.5 ms
    kept = np.flatnonzero(sent % 10 == 0)
    assert len(np.unique(sent[kept])) > 700
    assert_same(mixed.oriented, fast.oriented, kept)
    assert_same(mixed.magnetic, fast.magnetic, kept)
    assert_same(mixed.lean_yaw, fast.lean_yaw, kept)
    np.testing.assert_array_equal(mixed.lean_yaw.saturation, mixed.saturation[kept])
    np.testing.assert_array_equal(mixed.arrival_ns, fast.imu_arrival_ns[kept])
    times = [record.time_ns for record in mixed.records() if record.topic == "/imu/lean_yaw"]
    assert times == sorted(mixed.arrival_ns.tolist())


def assert_same(one: Any, other: Any, rows: Any = slice(None)) -> None:
    """Samples, of the other only some rows; variances hold for all rows."""
    for name, value in vars(one).items():
        expected = getattr(other, name)
        if isinstance(value, np.ndarray) and not name.endswith("variance"):
            expected = expected[rows]
        np.testing.assert_array_equal(value, expected, err_msg=name)


def test_a_raw_topic_as_fast_as_the_others_changes_nothing() -> None:
    one, other = everything(), everything(imu__raw_rate=100.0)
    assert_same(one.imu, other.imu)
    assert_same(one.lean_yaw, other.lean_yaw)


@pytest.mark.parametrize("rate", [50.0, 250.0, 100.1])
def test_the_raw_rate_is_a_multiple(rate: float) -> None:
    with pytest.raises(ParameterError, match=r"imu.raw_rate: expected 0, or a whole multiple of imu.rate"):
        run(imu__raw_rate=rate)


def test_everything_on_arrives_as_sent_and_is_read_back(tmp_path: Path) -> None:
    made = everything(faults="none")
    records = list(made.records())
    times = [record.time_ns for record in records]
    assert times == sorted(times)
    raw = [record for record in records if record.topic == "/imu/data_raw"]
    stamps = conversion.imu_samples(raw).time_ns
    assert (np.diff(stamps) < 0).any()  # some were overtaken
    assert len(np.unique(stamps)) < len(stamps)  # some came twice
    lost = sum(int(event.figures["packets"]) for event in made.events if event.kind == "loss")
    assert lost > 0
    assert len(np.unique(stamps)) + lost == 801
    assert [record.publish_time_ns for record in raw] == stamps.tolist()
    # The sensor's clock is 50 ms ahead, more than the link takes: stamps from the host's future.
    assert (stamps > np.array([record.time_ns for record in raw])).any()
    with BagWriter(tmp_path / "bag") as bag:
        for record in records:
            bag.write(record, topics.QOS[record.topic.removeprefix("/")])
    read = read_recording(tmp_path / "bag")
    np.testing.assert_array_equal(read.imu.time_ns, np.unique(stamps))
    assert read.duplicates == len(stamps) - len(np.unique(stamps))
    assert read.speed is not None
    assert read.speed.variance[0] == made.speed.variance[0] > 0.0


def test_same_seed_same_bytes_with_everything_on() -> None:
    first, second = list(everything().records()), list(everything().records())
    assert first == second
    assert first != list(everything(seed=2).records())
    made = everything()
    assert list(made.records()) == list(made.records())


def test_what_happens_later_changes_nothing_before() -> None:
    # A run that goes on longer, and in which the bicycle is struck again, was the same until then.
    short = everything(duration=4.0, faults="spikes; noise; loss")
    long = everything(
        duration=6.0, strike__time=[2.0, 4.5], strike__lean_rate=[0.5, -0.2], faults="spikes; noise; loss"
    )
    ended = 10**9 + 3_900_000_000
    told = ("/run_info", "/bicycle/events")  # they tell what was asked for, and how long a fault lasts

    def until_then(made: SimulatedRun) -> list[Any]:
        records = [r for r in made.records() if r.time_ns < ended and r.topic not in told]
        return [(r.topic, r.time_ns, r.publish_time_ns) for r in records]

    assert until_then(short) == until_then(long)
    known = short.imu.time_ns < ended
    for name in ("time_ns", "angular_velocity", "specific_force"):
        before, after = getattr(short.imu, name)[known], getattr(long.imu, name)[: known.sum()]
        np.testing.assert_allclose(after, before, atol=1e-7)


def test_switching_one_error_leaves_the_noise_of_the_others() -> None:
    noisy = run(imu__errors="noise_density").imu.angular_velocity
    biased = run(
        imu__errors="noise_density, bias", wireless__latency=0.01, fusion__enabled=True
    ).imu.angular_velocity
    offset = biased - noisy
    np.testing.assert_allclose(offset, np.broadcast_to(offset[0], offset.shape), atol=1e-14)
    assert (offset[0] != 0.0).all()


def test_beyond_its_range_the_link_is_silent() -> None:
    made = run(wireless__range=10.0)  # at 3.6 m/s it's there after 2.78 s
    last = (made.imu.time_ns[-1] - made.info.start_ns) / 1e9
    assert last == pytest.approx(10.0 / 3.6, abs=0.02)
    (event,) = (event for event in made.events if event.kind == "loss")
    assert event.figures["packets"] == 801 - len(made.imu.time_ns)


@pytest.mark.parametrize(("kind", "count"), [("camera", 1), ("encoder", 400), ("noise", 401)])
def test_speedometers(kind: str, count: int) -> None:
    made = run(speed_sensor__kind=kind)
    found = made.speed
    assert len(found.speed) == count
    error = found.speed - 3.6
    std = np.sqrt(found.variance) if kind != "noise" else np.full(count, 0.01)
    assert np.abs(error / std).max() < 5.0
    records = [record for record in made.records() if record.topic.startswith("/bicycle/speed")]
    named = {record.topic for record in records}
    assert ("/bicycle/speed_with_covariance" in named) == (kind != "noise")
    assert all(record.time_ns >= (record.publish_time_ns or 0) for record in records)  # known when complete


def test_faults_of_a_scenario_are_those_of_a_recording() -> None:
    asked = "degrees:time=2; swapped_axes:quantity=linear_acceleration; dropout:time=5"
    plain, faulty = run(), run(faults=asked)
    expected, told = inject(plain.records(), parse_requests(asked), 10**9, np.random.default_rng(9))
    found = [record for record in faulty.records() if record.topic != "/bicycle/events"]

    def without_words(
        records: list[Any],
    ) -> list[Any]:  # run_info tells the configuration, and faults are events
        return [r for r in records if r.topic not in ("/run_info", "/bicycle/events")]

    assert without_words(found) == without_words(expected)
    events = [record for record in faulty.records() if record.topic == "/bicycle/events"]
    assert len(events) == len(told) + len(plain.events)


def test_a_blind_runs_truth_tells_its_faults() -> None:
    changes = {"faults": "stuck:time=3", "wireless.loss": 0.01}
    scenario = load_scenario("tms_strike", changes)
    made = simulate(scenario, np.random.default_rng(1))
    told = json.loads(truth_text(made, scenario))["events"]
    assert {"fault", "loss"} <= {event["kind"] for event in told}
    assert [event["time_ns"] for event in told] == sorted(event["time_ns"] for event in told)


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("imu.errors", "noise", "expected 'all', 'none' or some of noise_density"),
        ("speed_sensor.kind", "radar", "expected one of noise, camera, encoder, found 'radar'"),
        ("faults", "moon", "unknown 'moon'"),
        ("wireless.clock_offset", -3.0, "expected stamps after 0"),
        ("wireless.loss", 1.5, "from 0 to 1"),
    ],
)
def test_settings_that_make_no_sense_are_refused(key: str, value: Any, says: str) -> None:
    with pytest.raises(ParameterError, match=says):
        run(**{key: value})


SHARE = st.floats(0.0, 0.9)


@settings(max_examples=25, deadline=None)
@given(
    grade=st.sampled_from(["ideal", "pi_node", "consumer_mems", "tactical"]),
    errors=st.sampled_from(["all", "none", "bias,scale", "noise_density,limit,resolution"]),
    link=st.fixed_dictionaries(
        {
            "wireless.loss": SHARE, "wireless.burst_start": SHARE, "wireless.duplicates": SHARE,
            "wireless.jitter": st.floats(0.0, 0.1), "wireless.clock_offset": st.floats(-0.5, 5.0),
            "wireless.range": st.sampled_from([0.0, 3.0, 100.0]),
        }
    ),
    vibration=st.floats(0.0, 30.0),
    rate=st.sampled_from([33.0, 100.0, 250.0]),
    seed=st.integers(0, 2**31),
)  # fmt: skip
def test_whatever_the_sensors_samples_are_finite_and_flags_true(
    grade: str, errors: str, link: dict[str, float], vibration: float, rate: float, seed: int
) -> None:
    made = run(
        **{
            **link, "imu.grade": grade, "imu.errors": errors, "imu.rate": rate, "duration": 1.5,
            "strike.time": 0.4, "floor_vibration.rms": vibration, "fusion.enabled": True,
        },
        seed=seed,
    )  # fmt: skip
    for samples in (made.imu.angular_velocity, made.imu.specific_force, made.lean_yaw.yaw_rate):
        assert np.isfinite(samples).all()
    sensor = load_imu(grade)
    limit = sensor.accelerometer.limit if errors == "all" or "limit" in errors else np.inf
    beyond = np.abs(made.imu.specific_force) >= limit
    np.testing.assert_array_equal(made.lean_yaw.saturation & 7, beyond @ [1, 2, 4])
    np.testing.assert_array_equal(made.imu.time_ns, made.lean_yaw.time_ns)
    times = [record.time_ns for record in made.records()]
    assert times == sorted(times)
    assert (np.diff(np.unique(made.imu.time_ns)) > 0).all()
