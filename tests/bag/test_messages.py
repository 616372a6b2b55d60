"""Types, hashes and definitions agree with those of the installed ROS packages."""

import json
import os
from pathlib import Path

import pytest
from tms_bag import RecordingError, messages, topics

SHARES = [
    Path(prefix) / "share" for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix
]


def installed_hashes() -> dict[str, str]:
    """Hash of each installed message type, from the JSON files that rosidl generated."""
    found = {}
    for share in SHARES:
        for path in sorted(share.glob("*/msg/*.json")):
            for entry in json.loads(path.read_text())["type_hashes"]:
                if "/msg/" in entry["type_name"]:
                    found[entry["type_name"]] = entry["hash_string"]
    return found


def test_computed_hashes_are_those_of_rosidl():
    # type_hash prefers the installed JSON files; without them it computes, which must give the same.
    packages = "builtin_interfaces", "std_msgs", "geometry_msgs", "sensor_msgs", "diagnostic_msgs", "tms_msgs"
    expected = {name: text for name, text in installed_hashes().items() if name.split("/")[0] in packages}
    del expected["std_msgs/msg/Char"]  # rosbags takes char for uint8
    assert len(expected) > 80
    assert {messages.message_type(name).__msgtype__ for name in expected} == set(expected)
    assert {name: messages._store().hash_rihs01(name) for name in expected} == expected


@pytest.mark.parametrize("type_name", sorted(set(topics.TYPES.values())))
def test_type_hash_is_that_of_rosidl(type_name):
    assert messages.type_hash(type_name) == installed_hashes()[type_name]


def test_schema_is_the_msg_file_and_then_each_dependency_once_sorted():
    text = messages.schema_text("sensor_msgs/msg/Imu")
    parts = text.split("\n" + "=" * 80 + "\n")
    names = [part.split("\n")[0] for part in parts[1:]]
    assert names == [
        "MSG: geometry_msgs/Quaternion",
        "MSG: geometry_msgs/Vector3",
        "MSG: std_msgs/Header",
        "MSG: builtin_interfaces/Time",
    ]
    imu = next(
        share / "sensor_msgs/msg/Imu.msg" for share in SHARES if (share / "sensor_msgs/msg/Imu.msg").exists()
    )
    assert parts[0] == imu.read_text()


def test_schema_without_installed_packages_still_defines_the_type(monkeypatch):
    monkeypatch.setattr(messages, "_definition", lambda name: None)
    messages.schema_text.cache_clear()
    try:
        text = messages.schema_text("geometry_msgs/msg/TwistStamped")
    finally:
        messages.schema_text.cache_clear()
    assert "geometry_msgs/Twist twist" in text
    assert "float64 x" in text


def test_an_unknown_type_says_where_it_was_looked_for():
    with pytest.raises(
        RecordingError, match=r"nowhere_msgs/msg/Thing is not known: expected share/nowhere_msgs/msg"
    ):
        messages.message_type("nowhere_msgs/msg/Thing")


@pytest.mark.parametrize("name", ["", "Imu", "a/b/c/d", "../../etc/passwd", "sensor_msgs/msg/../../x"])
def test_a_name_that_is_no_type_is_refused(name):
    with pytest.raises(RecordingError, match="is not known"):
        messages.message_type(name)


@pytest.mark.parametrize(
    "data", [b"", b"\x00", b"\x00\x01\x00\x00", b"\xff" * 400, b"\x00\x01\x00\x00" + b"\xff" * 400]
)
@pytest.mark.parametrize(
    "type_name", ["sensor_msgs/msg/Imu", "tms_msgs/msg/RunInfo", "tms_msgs/msg/Estimate"]
)
def test_bytes_that_are_no_message_are_refused(data, type_name):
    with pytest.raises(RecordingError, match=f"expected a {type_name} message"):
        messages.deserialize(data, type_name)
