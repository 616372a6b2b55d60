"""What others find in a bag: rosbags' reader, mcap's reader, the documented layout of metadata.yaml."""

import numpy as np
import pytest
import yaml
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Message, Metadata
from mcap.stream_reader import StreamReader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from tms_bag import messages, topics

INFINITE = {"sec": 9223372036, "nsec": 854775807}


def test_rosbags_reads_the_same_topics_messages_and_values(bag, run):
    records = run.records()
    store = get_typestore(Stores.ROS2_JAZZY)
    with AnyReader([bag], default_typestore=store) as reader:
        for connection in reader.connections:  # types from the definitions in the bag, not from ours
            text = connection.msgdef.data.split("=" * 80)[0]
            if connection.msgtype not in store.fielddefs:
                store.register(get_types_from_msg(text, connection.msgtype))
        raw = [(c.topic, c.msgtype, time, bytes(data)) for c, time, data in reader.messages()]
        assert sorted(raw) == sorted((r.topic, r.type, r.time_ns, r.data) for r in records)
        imu = [
            store.deserialize_cdr(data, connection.msgtype)
            for connection, _, data in reader.messages(
                [c for c in reader.connections if c.topic == "/imu/data_raw"]
            )
        ]
        rates = np.array([(m.angular_velocity.x, m.angular_velocity.y, m.angular_velocity.z) for m in imu])
        assert np.array_equal(rates, run.imu.angular_velocity)
        assert {c.topic: c.digest for c in reader.connections} == {
            record.topic: messages.type_hash(record.type) for record in records
        }


def test_rosbags_reads_the_quality_of_service(bag):
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        profiles = {c.topic: c.ext.offered_qos_profiles for c in reader.connections}
    latched, sensor = profiles.pop("/run_info"), list(profiles.values())
    assert [(q.durability.name, q.reliability.name, q.history.name, q.depth) for q in latched] == [
        ("TRANSIENT_LOCAL", "RELIABLE", "KEEP_LAST", 1)
    ]
    for offered in sensor:
        assert [(q.durability.name, q.reliability.name, q.history.name, q.depth) for q in offered] == [
            ("VOLATILE", "RELIABLE", "KEEP_LAST", 100)
        ]


def test_mcap_file_is_what_rosbag2_writes(bag):
    with (bag / "bag_0.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        header = reader.get_header()
        summary = reader.get_summary()
        stored = [record for record in reader.iter_metadata() if record.name == "rosbag2"]
    assert (header.profile, header.library) == ("ros2", "tms_bag")
    assert summary.statistics.message_count == sum(summary.statistics.channel_message_counts.values())
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        assert (channel.message_encoding, schema.encoding) == ("cdr", "ros2msg")
        assert schema.name == topics.TYPES[channel.topic[1:]]
        assert schema.data.decode() == messages.schema_text(schema.name)
        assert set(channel.metadata) == {"offered_qos_profiles", "topic_type_hash"}
        assert channel.metadata["topic_type_hash"] == messages.type_hash(schema.name)
        assert isinstance(yaml.safe_load(channel.metadata["offered_qos_profiles"]), list)
    on_disk = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert [yaml.safe_load(record.metadata["serialized_metadata"]) for record in stored] == [on_disk]


def test_metadata_yaml_has_the_layout_of_version_9(bag, run):
    found = yaml.safe_load((bag / "metadata.yaml").read_text())
    count = len(run.records())
    start, end = run.records()[0].time_ns, run.records()[-1].time_ns
    counts = {"run_info": 1, "imu/data_raw": 300, "imu/lean_yaw": 300, "bicycle/speed": 60}
    counts |= {"bicycle/steer_torque": 300, "bicycle/state": 300}

    def topic(name):
        latched = name == "run_info"
        return {
            "topic_metadata": {
                "name": "/" + name,
                "type": topics.TYPES[name],
                "serialization_format": "cdr",
                "offered_qos_profiles": [
                    {
                        "history": "keep_last",
                        "depth": 1 if latched else 100,
                        "reliability": "reliable",
                        "durability": "transient_local" if latched else "volatile",
                        "deadline": INFINITE,
                        "lifespan": INFINITE,
                        "liveliness": "automatic",
                        "liveliness_lease_duration": INFINITE,
                        "avoid_ros_namespace_conventions": False,
                    }
                ],
                "type_description_hash": messages.type_hash(topics.TYPES[name]),
            },
            "message_count": counts[name],
        }

    order = [
        "run_info",
        "imu/data_raw",
        "imu/lean_yaw",
        "bicycle/speed",
        "bicycle/steer_torque",
        "bicycle/state",
    ]
    span = {
        "duration": {"nanoseconds": end - start},
        "starting_time": {"nanoseconds_since_epoch": start},
        "message_count": count,
    }
    assert found == {
        "rosbag2_bagfile_information": {
            "version": 9,
            "storage_identifier": "mcap",
            **span,
            "topics_with_message_count": [topic(name) for name in order],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": ["bag_0.mcap"],
            "files": [{"path": "bag_0.mcap", **span}],
            "custom_data": {"seed": "1", "configuration": run.info.configuration},
            "ros_distro": "jazzy",
        }
    }


def test_a_bag_without_messages_is_written_as_rosbag2_writes_it(tmp_path, write_bag):
    folder = write_bag(tmp_path / "empty", [])
    found = yaml.safe_load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert found["starting_time"]["nanoseconds_since_epoch"] == 2**63 - 1
    assert (found["duration"]["nanoseconds"], found["message_count"]) == (0, 0)
    with AnyReader([folder], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        assert reader.message_count == 0


def test_an_unfinished_file_is_read_up_to_its_last_chunk_by_mcap_too(unfinished_bag, run):
    records = []
    with pytest.raises(EndOfFile):  # the way in which mcap tells that there is no footer
        records.extend(StreamReader(str(next(unfinished_bag.glob("*.mcap")))).records)
    assert sum(isinstance(record, Message) for record in records) == len(run.records()) // 100 * 100
    texts = [record.metadata["serialized_metadata"] for record in records if isinstance(record, Metadata)]
    assert [yaml.safe_load(text)["custom_data"] for text in texts] == [{"seed": "1"}]
