"""Interfaces that ROS brings and its wheels don't are those of ROS."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
from rosbags.typesys import Stores, get_typestore
from tms_bag.messages import schema_text, type_hash

FOLDER = Path(__file__).parents[2] / "ros_ws" / "interfaces"
TYPES = sorted(f"{path.parents[1].name}/msg/{path.stem}" for path in FOLDER.glob("*/msg/*.msg"))


def test_colcon_leaves_them_alone_where_ros_has_them() -> None:
    # 'colcon build' in ros_ws finds every package that no COLCON_IGNORE stands above.
    assert (FOLDER / "COLCON_IGNORE").exists()
    assert TYPES == ["tf2_msgs/msg/TFMessage"]


@pytest.mark.parametrize("name", TYPES)
def test_they_are_installed_with_the_hash_and_fields_of_ros(name: str) -> None:
    jazzy = get_typestore(Stores.ROS2_JAZZY)
    assert type_hash(name) == jazzy.hash_rihs01(name)
    first = schema_text(name).partition("=" * 80)[0].split()
    assert first == ["geometry_msgs/TransformStamped[]", "transforms"]


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*/package.xml")), ids=lambda path: path.parent.name)
def test_they_carry_the_name_of_the_package_that_they_stand_for(path: Path) -> None:
    assert ElementTree.parse(path).findtext("name") == path.parent.name
