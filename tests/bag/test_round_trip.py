"""Arrays -> messages -> bag -> arrays gives the same arrays, to the last bit."""

import dataclasses

import numpy as np
import pytest
from tms_bag import BagReader, BagWriter, RecordingError, conversion, read_recording
from tms_bag.event import Event, event_records, events
from tms_bag.messages import deserialize, serialize
from tms_bag.record import arriving
from tms_bag.samples import ImuSamples, MagneticSamples, SpeedSamples, in_time_order, selected


def assert_same(found, expected):
    for field in dataclasses.fields(expected):
        a, b = getattr(found, field.name), getattr(expected, field.name)
        if isinstance(b, np.ndarray):
            assert a.dtype == b.dtype
            assert a.tobytes() == b.tobytes(), field.name
        else:
            assert a == b or (a != a and b != b), field.name


@pytest.mark.parametrize("kind", ["imu", "lean_yaw", "speed", "steer_torque", "state"])
def test_samples_come_back_exactly(bag, run, kind):
    assert_same(getattr(read_recording(bag), kind), getattr(run, kind))


def test_run_info_comes_back_exactly(bag, run):
    recording = read_recording(bag)
    assert_same(recording.run_info, run.info)
    assert recording.custom_data == {"seed": "1", "configuration": run.info.configuration}
    assert recording.start_ns == run.info.start_ns
    assert recording.duplicates == 0


def test_records_come_back_byte_by_byte(bag, run):
    with BagReader(bag) as reader:
        assert list(reader.records()) == run.records()
        assert reader.complete
        assert reader.message_count == len(run.records())


def test_an_absent_lean_is_marked_as_not_valid(run):
    # Rows 3, 8, 13, ... of the made-up run have no lean.
    records = list(conversion.lean_yaw_records(run.lean_yaw))
    messages = [deserialize(record.data, record.type) for record in records[:5]]
    assert [message.lean_valid for message in messages] == [True, True, True, False, True]
    assert all(message.lean_rate_valid and message.yaw_rate_valid for message in messages)


def test_a_value_that_is_marked_as_not_valid_is_absent(run):
    record = next(conversion.lean_yaw_records(run.lean_yaw))
    message = dataclasses.replace(deserialize(record.data, record.type), lean_rate_valid=False)
    samples = conversion.lean_yaw_samples([dataclasses.replace(record, data=serialize(message))])
    assert np.isnan(samples.lean_rate[0])
    assert not np.isnan(samples.yaw_rate[0])


def test_imu_message_follows_rep_145(run):
    record = next(conversion.imu_records(run.imu))
    message = deserialize(record.data, record.type)
    assert message.orientation_covariance.tolist() == [-1.0] + [0.0] * 8  # no orientation
    assert message.angular_velocity_covariance.tolist() == [1e-6, 0, 0, 0, 2e-6, 0, 0, 0, 3e-6]
    assert message.linear_acceleration_covariance.tolist() == [0.0] * 9  # unknown
    assert message.header.frame_id == "imu_link"


def test_a_gyroscope_that_says_it_is_absent_is_nan(run):
    record = next(conversion.imu_records(run.imu))
    message = deserialize(record.data, record.type)
    message = dataclasses.replace(message, angular_velocity_covariance=np.array([-1.0] + [0.0] * 8))
    samples = conversion.imu_samples([dataclasses.replace(record, data=serialize(message))])
    assert np.isnan(samples.angular_velocity).all()
    assert np.isnan(samples.angular_velocity_variance[0])
    assert not np.isnan(samples.specific_force[0, 0])


def test_an_orientation_makes_imu_data(run):
    turned = np.random.default_rng(1).standard_normal((len(run.imu.time_ns), 4))
    samples = dataclasses.replace(
        run.imu, orientation=turned, orientation_variance=np.array([1e-4, 1e-4, 4e-4])
    )
    records = list(conversion.imu_records(samples))
    assert {record.topic for record in records} == {"/imu/data"}
    assert_same(conversion.imu_samples(records), samples)
    assert conversion.imu_samples(conversion.imu_records(run.imu)).orientation is None


def test_magnetic_field_comes_back():
    rng = np.random.default_rng(2)
    samples = MagneticSamples(np.arange(5) * 10**7, rng.standard_normal((5, 3)), np.array([1.0, 2.0, 3.0]))
    assert_same(conversion.magnetic_samples(conversion.magnetic_records(samples)), samples)
    assert conversion.magnetic_samples([]).magnetic_field.shape == (0, 3)


def test_a_speed_with_its_variance_is_preferred(tmp_path, run):
    # As a camera gives it: one speed, which both topics hold, and how sure it is.
    speed = SpeedSamples(run.speed.time_ns[:1], run.speed.speed[:1], np.array([4e-4]))
    with BagWriter(tmp_path / "bag") as bag:
        for records in (
            conversion.imu_records(run.imu),
            conversion.speed_records(speed),
            conversion.speed_covariance_records(speed),
        ):
            for record in records:
                bag.write(record)
    assert_same(read_recording(tmp_path / "bag").speed, speed)
    chosen = read_recording(tmp_path / "bag", speed_topic="bicycle/speed").speed
    assert np.isnan(chosen.variance).all()
    np.testing.assert_array_equal(chosen.speed, speed.speed)


def test_events_come_back():
    listed = [
        Event(10**9, "strike", "struck to the right", 0.01, {"lean_rate_rad_s": 0.5, "impulse_N_s": 2.0}),
        Event(2 * 10**9, "fault", "nothing arrives"),
    ]
    records = list(event_records(listed))
    assert [(r.topic, r.type, r.time_ns) for r in records] == [
        ("/bicycle/events", "tms_msgs/msg/Event", event.time_ns) for event in listed
    ]
    assert events(records) == listed


def test_what_arrives_late_is_logged_late_and_keeps_its_stamp(run):
    sent = list(conversion.imu_records(run.imu))[:4]
    arrival = [sent[0].time_ns + 50, sent[0].time_ns + 20, sent[0].time_ns + 50, sent[0].time_ns + 60]
    late = arriving(sent, arrival)
    assert [record.data for record in late] == [sent[i].data for i in (1, 0, 2, 3)]
    assert [record.time_ns for record in late] == sorted(arrival)
    assert [record.publish_time_ns for record in late] == [sent[i].time_ns for i in (1, 0, 2, 3)]
    found = conversion.imu_samples(late)  # stamps stay, out of order
    np.testing.assert_array_equal(found.time_ns, run.imu.time_ns[[1, 0, 2, 3]])


@pytest.mark.parametrize("time_ns", [-1, 2**31 * 10**9])
def test_a_time_that_ros_can_not_stamp_is_refused(time_ns):
    samples = SpeedSamples(np.array([time_ns]), np.array([1.0]))
    with pytest.raises(RecordingError, match="expected times"):
        list(conversion.speed_records(samples))


def test_samples_of_no_record_are_empty():
    assert conversion.imu_samples([]).angular_velocity.shape == (0, 3)
    assert conversion.state_samples([]).state.shape == (0, 4)
    assert conversion.speed_samples([]).speed.shape == (0,)


def test_in_time_order_sorts_and_keeps_the_first_of_equal_times():
    samples = SpeedSamples(np.array([30, 10, 30, 20, 10]), np.array([3.0, 1.0, 3.5, 2.0, 1.5]))
    ordered, left_out = in_time_order(samples)
    assert ordered.time_ns.tolist() == [10, 20, 30]
    assert ordered.speed.tolist() == [1.0, 2.0, 3.0]
    assert left_out == 2


def test_selection_leaves_what_belongs_to_the_run_alone():
    # Three samples: the variances (3,) must not be mistaken for a column.
    imu = ImuSamples(np.arange(3), np.eye(3), np.eye(3), np.array([1.0, 2.0, 3.0]))
    chosen = selected(imu, np.array([True, False, True]))
    assert chosen.time_ns.tolist() == [0, 2]
    assert chosen.angular_velocity.shape == (2, 3)
    assert chosen.angular_velocity_variance.tolist() == [1.0, 2.0, 3.0]
