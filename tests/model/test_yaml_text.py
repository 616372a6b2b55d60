"""Texts made to exhaust a reader are refused; the rest says what PyYAML's own safe loader says."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from tms_bag import RecordingError
from tms_bag.metadata import custom_data_of_record, read_file
from tms_bag.qos import from_yaml
from tms_model import ParameterError, load_bicycle
from tms_model.catalogue import FOLDER
from tms_model.yaml_text import MOST_NESTED, NOT_YAML, load_yaml

# Each opens some ten thousand levels, which end the process of a reader that goes down them one by one.
DEEP = {
    "sequences": "[" * 60_000,
    "mappings": "{a: " * 60_000,
    "closed again": "[" * 60_000 + "]" * 60_000,
    "dashes": "- " * 60_000,
    "keys": "? " * 60_000,
}


@pytest.mark.parametrize("text", DEEP.values(), ids=DEEP)
def test_what_is_nested_too_deep_is_refused(text: str, tmp_path: Path) -> None:
    with pytest.raises(yaml.YAMLError, match=f"more than {MOST_NESTED} levels"):
        load_yaml(text)
    path = tmp_path / "metadata.yaml"
    path.write_text(text)
    with pytest.raises(RecordingError, match="can't be read as YAML"):
        read_file(path)
    with pytest.raises(ParameterError, match="expected YAML"):
        load_bicycle(str(path))
    assert custom_data_of_record(text) == {}
    assert from_yaml(text[:60_000]) == ()


def test_as_many_levels_as_are_allowed_are_read() -> None:
    value = load_yaml("[" * MOST_NESTED + "]" * MOST_NESTED)
    for _ in range(MOST_NESTED - 1):
        (value,) = value
    assert value == []


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.yaml")), ids=lambda path: path.stem)
def test_files_say_what_the_uncompiled_safe_loader_finds(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert load_yaml(text) == yaml.load(text, Loader=yaml.SafeLoader)


def test_a_tag_runs_nothing() -> None:
    with pytest.raises(NOT_YAML):
        load_yaml("!!python/object/apply:os.getcwd []")
