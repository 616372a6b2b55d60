"""Which topics are recorded: by name, pattern and type; what is left out stays out."""

import pytest
from tms_bag import RecordingError
from tms_bag.selection import Selection

IMU, TEXT = "sensor_msgs/msg/Imu", "std_msgs/msg/String"
TOPICS = {
    "/bike/imu": IMU,
    "/other/imu": IMU,
    "/chatter": TEXT,
    "/_hidden": TEXT,
    "/bike/_private/x": IMU,
    "/rosout": "rcl_interfaces/msg/Log",
}


def meant(**choice) -> set[str]:
    selection = Selection(**choice)
    return {name for name, kind in TOPICS.items() if selection.means(name, [kind])}


@pytest.mark.parametrize(
    ("choice", "expected"),
    [
        ({}, {"/bike/imu", "/other/imu", "/chatter"}),
        ({"hidden": True}, {"/bike/imu", "/other/imu", "/chatter", "/_hidden", "/bike/_private/x"}),
        ({"names": ("/chatter", "/rosout")}, {"/chatter", "/rosout"}),
        ({"names": ("/_hidden",)}, {"/_hidden"}),
        ({"pattern": "^/bike/"}, {"/bike/imu"}),
        ({"pattern": "^/bike/", "hidden": True}, {"/bike/imu", "/bike/_private/x"}),
        ({"pattern": "rosout"}, {"/rosout"}),
        ({"types": (IMU,)}, {"/bike/imu", "/other/imu"}),
        ({"types": (TEXT,), "names": ("/bike/imu",)}, {"/chatter", "/bike/imu"}),
        ({"not_pattern": "imu"}, {"/chatter"}),
        ({"not_names": ("/chatter",)}, {"/bike/imu", "/other/imu"}),
        ({"not_types": (IMU,)}, {"/chatter"}),
        ({"names": ("/chatter",), "not_names": ("/chatter",)}, set()),
    ],
)
def test_what_is_meant(choice, expected):
    assert meant(**choice) == expected


def test_a_pattern_that_is_none_is_refused():
    with pytest.raises(RecordingError, match=r"expected a regular expression, found '\*imu'"):
        Selection(pattern="*imu")
