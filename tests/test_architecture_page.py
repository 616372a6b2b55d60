"""The page on the architecture leads to files that are there."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")


def test_each_file_and_folder_named_is_there() -> None:
    named = re.findall(r"`((?:tms_\w+|tests)/[\w./]*)`", PAGE)
    assert len(named) > 25
    places = [ROOT / name if name.startswith("tests/") else source(name) for name in named]
    assert [str(place) for place in places if not place.exists()] == []


def source(name: str) -> Path:
    """Place of a module or folder of a package."""
    return ROOT / "ros_ws" / "src" / name.partition("/")[0] / name


def test_each_package_stands_in_the_table() -> None:
    packages = {path.parent.name for path in (ROOT / "ros_ws" / "src").glob("*/package.xml")}
    assert packages == set(re.findall(r"^\| `(tms_\w+)` \|", PAGE, re.MULTILINE))
