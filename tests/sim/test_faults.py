"""Every fault of FAULTS does what it says, inside its window only, and is told as an event."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tms_bag import BagReader, BagWriter, Record, RecordingError, conversion, read_recording, topics
from tms_bag.event import events
from tms_bag.record import merged
from tms_bag.samples import ImuSamples, LeanYawSamples, SpeedSamples
from tms_model import ParameterError
from tms_sim.fault_injection import inject, parse_request, parse_requests
from tms_sim.faults import FAULTS

Command = Callable[..., Any]
START = 10**9
COUNT = 400
TIMES = START + np.arange(COUNT) * 10**7  # 100 Hz, 4 s


def imu() -> ImuSamples:
    rng = np.random.default_rng(7)
    return ImuSamples(TIMES, rng.standard_normal((COUNT, 3)), rng.standard_normal((COUNT, 3)))


def recording() -> list[Record]:
    zero = np.zeros(COUNT)
    return list(
        merged(
            conversion.speed_records(SpeedSamples(TIMES[::2], np.full(COUNT // 2, 3.6))),
            conversion.imu_records(imu()),
            conversion.lean_yaw_records(LeanYawSamples(TIMES, zero, zero, zero, np.zeros(COUNT, np.uint8))),
        )
    )


def spoilt(asked: str, seed: int = 1) -> list[Record]:
    return inject(recording(), [parse_request(asked)], START, np.random.default_rng(seed))[0]


def on(topic: str, records: list[Record]) -> list[Record]:
    return [record for record in records if record.topic == f"/{topic}"]


def readings(asked: str, seed: int = 1) -> ImuSamples:
    return conversion.imu_samples(on(topics.IMU, spoilt(asked, seed)))


@pytest.mark.parametrize("name", FAULTS)
def test_fault_stays_inside_its_window(name: str) -> None:
    before, after = recording(), spoilt(f"{name}:time=0.5,duration=3.0")
    assert after != before
    assert on(topics.SPEED, after) == on(topics.SPEED, before)  # another sensor's
    begin, end = START + 500_000_000, START + 3_500_000_000
    for topic in (topics.IMU, topics.LEAN_YAW):
        old, new = on(topic, before), on(topic, after)
        assert [r for r in new if r.publish_time_ns < begin] == [r for r in old if r.time_ns < begin]
        if name != "clock_drift":  # which keeps what it has gained
            assert [r for r in new if r.publish_time_ns >= end] == [r for r in old if r.time_ns >= end]
    if name in ("dropout", "loss"):
        assert len(after) < len(before)
    assert [r.time_ns for r in after] == sorted(r.time_ns for r in after)


@pytest.mark.parametrize("name", FAULTS)
def test_same_seed_same_bytes(name: str) -> None:
    assert spoilt(name, 3) == spoilt(name, 3)


@pytest.mark.parametrize("name", FAULTS)
def test_fault_on_a_bag_is_told_in_its_truth(name: str, tmp_path: Path, command: Command) -> None:
    source, target = tmp_path / "source", tmp_path / "target"
    with BagWriter(source, custom_data={"seed": "5"}) as bag:
        for record in recording():
            bag.write(record)
    asked = f"{name}:time=1.5,duration=0.7"
    answer = command("tms_sim", "fault", source, "--fault", asked, "-o", target, "--json")
    (shown,) = json.loads(answer.out)["events"]
    with BagReader(target) as bag:
        (told,) = events(bag.records([f"/{topics.EVENTS}"]))
        assert bag.custom_data["seed"] == "5"
        assert bag.custom_data["faults"].startswith(name)
        kept = [r for r in bag.records() if r.topic != f"/{topics.EVENTS}"]
    assert (told.kind, told.time_ns, told.duration) == ("fault", START + 1_500_000_000, 0.7)
    assert told.text.startswith(f"{name}: {FAULTS[name].text}, on /imu/data_raw")
    assert shown["text"] == told.text
    # The same as on the records themselves, and an analysis reads it.
    assert (
        kept
        == inject(
            recording(), [parse_request(f"{name}:time=1.5,duration=0.7")], START, np.random.default_rng(1)
        )[0]
    )
    assert len(read_recording(target).imu.time_ns) > 100


def test_dropout_by_hand() -> None:
    # 1.0 s to 1.5 s of 100 Hz: 50 samples, the window's end not among them.
    kept = readings("dropout:time=1.0").time_ns
    np.testing.assert_array_equal(kept, np.concatenate([TIMES[:100], TIMES[150:]]))


@pytest.mark.parametrize("share", [0.1, 0.6])
def test_loss_takes_its_share_of_packets_whole(share: float) -> None:
    after = spoilt(f"loss:share={share}")
    raw, summary = (
        conversion.imu_samples(on(topics.IMU, after)).time_ns,
        conversion.lean_yaw_samples(on(topics.LEAN_YAW, after)).time_ns,
    )
    np.testing.assert_array_equal(raw, summary)  # both were in the packet that is lost
    assert len(raw) / COUNT == pytest.approx(1.0 - share, abs=5.0 * math.sqrt(share * (1.0 - share) / COUNT))


def test_stuck_sensor_holds_what_it_read_last() -> None:
    found = readings("stuck:time=1.0,duration=0.5")
    np.testing.assert_array_equal(
        found.angular_velocity[100:150], np.tile(imu().angular_velocity[99], (50, 1))
    )
    np.testing.assert_array_equal(found.specific_force, imu().specific_force)
    one = readings("stuck:time=1.0,duration=0.5,axis=z,quantity=linear_acceleration")
    np.testing.assert_array_equal(one.specific_force[100:150, 2], imu().specific_force[99, 2])
    np.testing.assert_array_equal(one.specific_force[:, :2], imu().specific_force[:, :2])


def test_axes_swapped_and_flipped() -> None:
    np.testing.assert_array_equal(
        readings("swapped_axes:axis=y,other=z").angular_velocity, imu().angular_velocity[:, [0, 2, 1]]
    )
    np.testing.assert_array_equal(
        readings("flipped_axis:axis=z").angular_velocity, imu().angular_velocity * [1.0, 1.0, -1.0]
    )


def test_wrong_units() -> None:
    np.testing.assert_allclose(
        readings("degrees").angular_velocity, np.degrees(imu().angular_velocity), rtol=1e-15
    )
    np.testing.assert_allclose(readings("g_units").specific_force, imu().specific_force / 9.80665, rtol=1e-15)


def test_values_by_hand() -> None:
    truth = imu().angular_velocity
    np.testing.assert_allclose(
        readings("bias_jump:size=-0.3,time=2.0").angular_velocity - truth,
        np.outer(np.arange(COUNT) >= 200, [-0.3, 0.0, 0.0]),
        atol=1e-15,
    )
    np.testing.assert_array_equal(
        readings("saturation:limit=0.8").angular_velocity, np.clip(truth, -0.8, 0.8)
    )
    np.testing.assert_allclose(readings("scale:factor=1.5").angular_velocity, 1.5 * truth)
    missing = readings("missing_axis:axis=y").angular_velocity
    assert np.isnan(missing[:, 1]).all()
    np.testing.assert_array_equal(missing[:, [0, 2]], truth[:, [0, 2]])


def test_spikes_and_noise_are_as_large_as_asked() -> None:
    truth = imu().angular_velocity
    off = readings("spikes:share=0.3,size=4").angular_velocity - truth
    assert set(np.round(off[off != 0.0], 9).tolist()) == {-4.0, 4.0}
    assert (off != 0.0).mean() == pytest.approx(0.3, abs=5.0 * math.sqrt(0.21 / COUNT))
    extra = readings("noise:std=0.2").angular_velocity - truth
    assert extra.std() == pytest.approx(0.2, rel=5.0 / math.sqrt(2.0 * 3.0 * COUNT))


def test_clocks() -> None:
    jumped = readings("clock_jump:time=1.0,duration=1.0,size=-0.25").time_ns - TIMES
    np.testing.assert_array_equal(
        jumped, np.where((TIMES[100] <= TIMES) & (TIMES[200] > TIMES), -250_000_000, 0)
    )
    drifted = readings("clock_drift:drift=1e-3,time=1.0").time_ns - TIMES
    np.testing.assert_array_equal(drifted, np.maximum(TIMES - TIMES[100], 0) // 1000)
    arrivals = [record.time_ns for record in on(topics.IMU, spoilt("clock_jump"))]
    np.testing.assert_array_equal(arrivals, TIMES)  # messages come when they came


def test_duplicates_and_overtaking() -> None:
    twice = on(topics.IMU, spoilt("duplicated:share=0.3,delay=0.002"))
    assert len(twice) / COUNT == pytest.approx(1.3, abs=5.0 * math.sqrt(0.21 / COUNT))
    assert {record.data for record in twice} == {record.data for record in on(topics.IMU, recording())}
    overtaken = conversion.imu_samples(on(topics.IMU, spoilt("out_of_order"))).time_ns
    np.testing.assert_array_equal(np.sort(overtaken), TIMES)
    assert (np.diff(overtaken) < 0).any()
    late = on(topics.IMU, spoilt("late:delay=0.1"))
    np.testing.assert_array_equal([record.time_ns for record in late], TIMES + 100_000_000)


def test_other_topics_can_be_chosen() -> None:
    after = spoilt("scale:topic=bicycle/speed,quantity=twist.linear.x,factor=0.5")
    speeds = conversion.speed_samples(on(topics.SPEED, after)).speed
    np.testing.assert_array_equal(speeds, 1.8)
    assert on(topics.IMU, after) == on(topics.IMU, recording())


def test_several_faults_come_one_after_the_other() -> None:
    asked = parse_requests("degrees; saturation:limit=10")
    after, told = inject(recording(), asked, START, np.random.default_rng(1))
    expected = np.clip(np.degrees(imu().angular_velocity), -10.0, 10.0)
    np.testing.assert_allclose(conversion.imu_samples(on(topics.IMU, after)).angular_velocity, expected)
    assert [event.text.split(":")[0] for event in told] == ["degrees", "saturation"]
    assert parse_requests("none") == []


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        ("moon", "unknown 'moon'; expected one of dropout"),
        ("stuck:a", "found 'a'"),
        ("stuck:size=1", "expected time=.*, found 'size=1'"),
        ("stuck:time=x", "expected a number for time, found 'x'"),
        ("stuck:time=nan", "expected a number for time"),
        ("stuck:time=-1", "expected time of at least 0"),
        ("stuck:axis=w", "expected an axis x, y or z"),
        ("swapped_axes:other=all", "expected an axis x, y or z"),
        ("loss:share=1.5", "expected a share from 0 to 1"),
    ],
)
def test_requests_that_make_no_sense_are_refused(asked: str, says: str) -> None:
    with pytest.raises(ParameterError, match=says):
        parse_request(asked)


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        ("stuck:topic=foo", "expected a topic /foo with messages, found /bicycle/speed"),
        ("stuck:quantity=foo", "expected a quantity foo .* found angular_velocity"),
        ("clock_jump:size=-5", "expected stamps from 0 on"),
    ],
)
def test_faults_that_fit_no_message_are_refused(asked: str, says: str) -> None:
    with pytest.raises(RecordingError, match=says):
        spoilt(asked)


@pytest.mark.parametrize(
    "arguments", [["fault"], ["fault", "BAG", "-o", "x"], ["fault", "BAG", "--fault", "loss", "-o", "BAG"]]
)
def test_command_line_says_what_it_wants(
    arguments: list[str], tmp_path: Path, refused: Callable[..., str]
) -> None:
    assert "expected" in refused("tms_sim", *(a.replace("BAG", str(tmp_path / "bag")) for a in arguments))


def test_faults_are_listed(command: Command) -> None:
    listed = json.loads(command("tms_sim", "fault", "--list", "--json").out)["faults"]
    assert {entry["name"] for entry in listed} == set(FAULTS)
    assert len(command("tms_sim", "fault", "--list").out.splitlines()) == len(FAULTS)
