"""Finding the topics of a run in bags of any make."""

import dataclasses

import numpy as np
import pytest
from tms_bag import RecordingError, conversion, read_recording
from tms_bag.messages import deserialize, serialize


def renamed(records, space):
    return [dataclasses.replace(record, topic=space + record.topic) for record in records]


def test_topics_are_found_in_a_namespace(tmp_path, run, write_bag):
    path = write_bag(tmp_path / "bag", renamed(run.records(), "/lab/bike1"))
    recording = read_recording(path)
    assert np.array_equal(recording.imu.angular_velocity, run.imu.angular_velocity)
    assert np.array_equal(recording.state.state, run.state.state)
    assert recording.run_info.bicycle == "benchmark"


@pytest.fixture
def two_bicycles(tmp_path, run, make_run, write_bag):
    first, second = renamed(run.records(), "/bike1"), renamed(make_run(seed=2).records(), "/bike2")
    return write_bag(tmp_path / "two", sorted(first + second, key=lambda record: record.time_ns))


def test_two_bicycles_need_a_choice(two_bicycles):
    expected = r"one topic imu/data_raw, found /bike1/imu/data_raw, /bike2/imu/data_raw; .*--imu-topic /bike1"
    with pytest.raises(RecordingError, match=expected):
        read_recording(two_bicycles)


def test_the_other_topics_are_those_of_the_chosen_namespace(two_bicycles, make_run):
    recording = read_recording(two_bicycles, imu_topic="/bike2/imu/data_raw")
    second = make_run(seed=2)
    assert np.array_equal(recording.imu.angular_velocity, second.imu.angular_velocity)
    assert np.array_equal(recording.speed.speed, second.speed.speed)
    assert np.array_equal(recording.steer_torque.steer_torque, second.steer_torque.steer_torque)
    assert recording.run_info.seed == 2


def test_a_topic_of_another_name_is_offered_with_the_flag(tmp_path, run, write_bag):
    records = [dataclasses.replace(record, topic="/xsens/imu") for record in conversion.imu_records(run.imu)]
    path = write_bag(tmp_path / "bag", records)
    with pytest.raises(RecordingError, match=r"found of this type /xsens/imu; use --imu-topic /xsens/imu"):
        read_recording(path)
    for name in ("/xsens/imu", "xsens/imu"):
        recording = read_recording(path, imu_topic=name)
        assert recording.imu.time_ns.size == 300
        assert recording.speed is None


def test_a_bag_without_an_imu_lists_what_it_holds(tmp_path, run, write_bag):
    path = write_bag(tmp_path / "bag", list(conversion.speed_records(run.speed)))
    with pytest.raises(
        RecordingError, match=r"/imu/data_raw of type sensor_msgs/msg/Imu .*holds /bicycle/speed \(geo"
    ):
        read_recording(path)


def test_an_empty_bag_is_told(tmp_path, write_bag):
    with pytest.raises(RecordingError, match="the bag holds no topics"):
        read_recording(write_bag(tmp_path / "bag", []))


@pytest.mark.parametrize("flag", ["imu_topic", "speed_topic", "steer_torque_topic"])
def test_a_chosen_topic_that_is_not_there_is_told(bag, flag):
    with pytest.raises(
        RecordingError, match=r"expected a topic /nope of type .*found of this type /(imu|bicycle)/"
    ):
        read_recording(bag, **{flag: "nope"})


def test_a_chosen_topic_of_another_type_is_refused(bag):
    with pytest.raises(RecordingError, match="expected a topic /bicycle/speed of type sensor_msgs/msg/Imu"):
        read_recording(bag, imu_topic="/bicycle/speed")


def test_samples_are_sorted_by_their_stamps_and_repeated_ones_left_out(tmp_path, run, write_bag):
    # As over a wireless link: arrival in another order, some sent twice.
    records = list(conversion.imu_records(run.imu))
    order = np.random.default_rng(0).permutation(len(records)).tolist()
    order += [3, 17]
    arrived = [dataclasses.replace(records[i], time_ns=10**18 + number) for number, i in enumerate(order)]
    recording = read_recording(write_bag(tmp_path / "bag", arrived))
    assert np.array_equal(recording.imu.time_ns, run.imu.time_ns)
    assert np.array_equal(recording.imu.angular_velocity, run.imu.angular_velocity)
    assert recording.duplicates == 2
    assert recording.start_ns == 10**18  # log time, not the stamp


def test_messages_without_stamps_are_refused(tmp_path, run, write_bag):
    def unstamped(record):
        message = deserialize(record.data, record.type)
        message.header.stamp.sec = message.header.stamp.nanosec = 0
        return dataclasses.replace(record, data=serialize(message))

    path = write_bag(tmp_path / "bag", [unstamped(record) for record in conversion.imu_records(run.imu)])
    with pytest.raises(
        RecordingError, match=r"expected time stamps in /imu/data_raw \(header.stamp\), found only 0"
    ):
        read_recording(path)


def test_a_damaged_message_is_named(tmp_path, run, write_bag):
    records = list(conversion.imu_records(run.imu))
    records[5] = dataclasses.replace(records[5], data=b"\x00\x01\x00\x00short")
    path = write_bag(tmp_path / "bag", records)
    with pytest.raises(
        RecordingError, match=rf"/imu/data_raw at {records[5].time_ns} ns: expected a sensor_msgs/msg/Imu"
    ):
        read_recording(path)


def test_an_unfinished_bag_is_read_as_far_as_it_goes(unfinished_bag, run):
    recording = read_recording(unfinished_bag)
    count = recording.imu.time_ns.size
    assert 0.8 * run.imu.time_ns.size < count < run.imu.time_ns.size
    assert np.array_equal(recording.imu.angular_velocity, run.imu.angular_velocity[:count])
