"""The public names of the packages: loaded when used, documented by examples that run, without ROS."""

from __future__ import annotations

import doctest
import importlib
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("tms_model", "tms_bag", "tms_sim", "tms_fit")
EXAMPLES = (
    "tms_model",
    "tms_bag.arrays",
    "tms_bag.reading.reader",
    "tms_sim.api",
    "tms_fit.api",
    "tms_fit.estimate",
)

# With ROS out of reach: a run is simulated, written, read, fitted.
WITHOUT_ROS = """
import json, sys
class Wall:
    def find_spec(self, name, path=None, target=None):
        top = name.partition(".")[0]
        if top.startswith(("rclpy", "rosidl", "ament_")) or top.endswith(("_msgs", "_interfaces")):
            raise ImportError(f"{name} is out of reach")
sys.meta_path.insert(0, Wall())
from tms_sim import simulate
from tms_bag import open_bag, read_recording
from tms_fit import fit_recording
simulate("tms_strike", seed=5).write(sys.argv[1])
with open_bag(sys.argv[1]) as bag:
    types = {topic.type for topic in bag.topics}
result = fit_recording(read_recording(sys.argv[1]))
print(json.dumps([sorted(types), result.to_dict()]))
"""


@pytest.mark.parametrize("package", PACKAGES)
def test_every_public_name_is_there_and_documented(package: str) -> None:
    module = importlib.import_module(package)
    assert list(module.__all__) == sorted(module.__all__)
    for name in module.__all__:
        assert getattr(module, name).__doc__, name
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        _ = module.nothing


def test_a_function_is_not_hidden_by_the_module_of_its_name() -> None:
    program = (
        "import tms_model.stability, tms_model.response, tms_model.modes\n"
        "from tms_model import modes, response, stability\n"
        "assert callable(modes) and callable(response) and callable(stability)\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


@pytest.mark.parametrize("package", PACKAGES)
def test_importing_a_package_loads_nothing_heavy(package: str) -> None:
    heavy = ("numpy", "scipy", "yaml", "rosbags", "matplotlib")
    program = f"import sys, {package}; print([name for name in {heavy} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True)
    assert done.stdout.strip() == "[]"


def test_a_fit_loads_neither_statistics_nor_figures_before_they_are_used() -> None:
    program = (
        "import sys; from tms_fit import fit, fit_recording\n"
        "heavy = ('scipy', 'filterpy', 'matplotlib', 'tqdm', 'vl_convert')\n"
        "print([name for name in heavy if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_in_docstrings(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    found = doctest.testmod(importlib.import_module(name))
    assert found.attempted > 0
    assert found.failed == 0


def test_examples_in_the_documentation(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    found = doctest.testfile(str(ROOT / "docs" / "api.md"), module_relative=False)
    assert found.attempted > 20
    assert found.failed == 0


def test_a_run_is_simulated_written_read_and_fitted_without_ros(tmp_path: Path) -> None:
    environment = {**os.environ, "AMENT_PREFIX_PATH": ""}
    answers = []
    for place, settings in (("without", environment), ("with", dict(os.environ))):
        program = WITHOUT_ROS if place == "without" else WITHOUT_ROS.replace("sys.meta_path.insert", "id # ")
        folder = tmp_path / place
        folder.mkdir()
        done = subprocess.run(
            [sys.executable, "-c", program, "run"],
            cwd=folder,
            env=settings,
            check=True,
            capture_output=True,
            text=True,
        )
        answers.append(json.loads(done.stdout))
    (types, fitted), (same_types, same_fitted) = answers
    assert "tms_msgs/msg/RunInfo" in types
    assert types == same_types
    assert fitted == same_fitted
    # The definitions in the bag are the same, and so are all other bytes.
    (one,), (other,) = ((tmp_path / place / "run").glob("*.mcap") for place in ("without", "with"))
    assert one.read_bytes() == other.read_bytes()
