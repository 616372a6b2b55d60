"""Launch files: installed, and about nodes and parameters that exist.

`launch` isn't among ROS's wheels: there they are read and not run; on a full ROS install they are loaded.
"""

from __future__ import annotations

import ast
import importlib.util
from pathlib import Path

import pytest

SOURCES = Path(__file__).parents[1] / "ros_ws" / "src"
FILES = sorted(SOURCES.glob("*/launch/*.launch.py"))


def calls(path: Path, name: str) -> list[dict[str, ast.expr]]:
    """Arguments of all calls of a function by keyword; positional ones by their number."""
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and ast.unparse(node.func) == name:
            by_place = {str(number): value for number, value in enumerate(node.args)}
            found.append(by_place | {keyword.arg: keyword.value for keyword in node.keywords if keyword.arg})
    return found


def executables(path: Path) -> list[tuple[str, str]]:
    """Packages and executables, which stand together at the head of a tuple."""
    return [
        (first.value, second.value)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Tuple) and len(node.elts) == 3
        for first, second in [node.elts[:2]]
        if isinstance(first, ast.Constant) and isinstance(second, ast.Constant)
    ]


def test_there_are_some() -> None:
    assert {path.name for path in FILES} >= {"experiment.launch.py", "replay.launch.py"}


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_it_is_installed_and_starts_nodes_that_exist(path: Path) -> None:
    compile(path.read_text(encoding="utf-8"), str(path), "exec")
    package = path.parents[1].name
    assert f'"launch/{path.name}"' in (SOURCES / package / "setup.py").read_text()
    started = executables(path)
    assert started
    for where, what in started:
        scripts = (SOURCES / where / "setup.py").read_text()
        assert f'"{what} = {where}.nodes.executables:{what}"' in scripts


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_every_argument_is_declared_described_and_used(path: Path) -> None:
    declared = [ast.literal_eval(call["0"]) for call in calls(path, "DeclareLaunchArgument")]
    used = {ast.literal_eval(call["0"]) for call in calls(path, "LaunchConfiguration")}
    assert set(declared) == used
    assert all("description" in call for call in calls(path, "DeclareLaunchArgument"))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_its_parameters_are_documented(path: Path) -> None:
    document = (SOURCES.parents[1] / "docs" / "nodes.md").read_text()
    keys = {
        ast.literal_eval(key)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Dict)
        for key in node.keys
        if key is not None
    }
    assert keys
    assert all(f"`{key}`" in document for key in keys)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_it_is_loaded_where_launch_is_installed(path: Path) -> None:
    pytest.importorskip("launch_ros", reason="launch_ros isn't among ROS's wheels; a full ROS install has it")
    spec = importlib.util.spec_from_file_location("description", path)
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.generate_launch_description().entities
