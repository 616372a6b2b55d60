"""Message definitions that are shipped for computers without ROS are those of ROS and of tms_msgs."""

from __future__ import annotations

from pathlib import Path

import pytest
from tms_bag import messages, topics

SHIPPED = sorted(messages.SHIPPED.glob("*/msg/*.msg"))
SOURCES = Path(__file__).parents[2] / "ros_ws" / "src"


def type_of(path: Path) -> str:
    return f"{path.parts[-3]}/msg/{path.stem}"


def test_every_topic_of_the_project_is_shipped_with_all_that_its_type_holds() -> None:
    shipped = {type_of(path) for path in SHIPPED}
    assert shipped >= set(topics.TYPES.values())
    assert shipped >= {f"tms_msgs/msg/{path.stem}" for path in (SOURCES / "tms_msgs" / "msg").glob("*.msg")}
    for path in SHIPPED:
        needed = messages._dependencies(path.read_text(), type_of(path))
        assert shipped >= {messages._full_name(name) for name in needed}


@pytest.mark.parametrize("path", SHIPPED, ids=type_of)
def test_shipped_definition_is_the_installed_one(path: Path) -> None:
    name = type_of(path)
    installed = messages._installed(name, "msg")
    assert installed is not None
    assert installed.read_bytes() == path.read_bytes()
    # Without ROS the hash comes from the definition: the same as ROS has.
    assert messages._store_with(name).hash_rihs01(name) == messages._installed_hash(name)
