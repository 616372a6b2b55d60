import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

# What ./tms reads: enough to set the project up elsewhere.
PARTS = ["tms", "pyproject.toml", "requirements", "ros_ws/src", "ros_ws/interfaces"]


@pytest.fixture
def clean_environment() -> dict[str, str]:
    """The user's environment as it is before any ROS is set up: tests themselves run inside ./tms."""
    foreign = (
        "AMENT_",
        "CMAKE_",
        "COLCON_",
        "ROS_",
        "RMW_",
        "TMS_",
        "_ROS_",
        "PYTHON",
        "LD_LIBRARY_PATH",
        "VIRTUAL_ENV",
    )
    environment = {name: value for name, value in os.environ.items() if not name.startswith(foreign)}
    own = str(ROOT / ".venv")
    environment["PATH"] = os.pathsep.join(
        p for p in os.environ["PATH"].split(os.pathsep) if not p.startswith(own)
    )
    return environment


@pytest.fixture
def copy_to() -> Callable[[Path], Path]:
    """Lays a copy of the project's sources, with nothing that was made from them, at a path."""

    def copy(target: Path) -> Path:
        ignore = shutil.ignore_patterns("__pycache__", "*.egg-info")
        for part in PARTS:
            source, destination = ROOT / part, target / part
            destination.parent.mkdir(parents=True, exist_ok=True)
            if source.is_dir():
                shutil.copytree(source, destination, ignore=ignore)
            else:
                shutil.copy2(source, destination)
        return target

    return copy


@pytest.fixture
def bash(clean_environment: dict[str, str]) -> Callable[..., "subprocess.CompletedProcess[str]"]:
    """Runs a bash text with the functions of a copy's ./tms at hand."""

    def run(project: Path, text: str, **variables: str) -> "subprocess.CompletedProcess[str]":
        return subprocess.run(
            [shutil.which("bash"), "-c", f'source "$1"; {text}', "test", str(project / "tms")],
            env=clean_environment | variables,
            capture_output=True,
            text=True,
            timeout=600,
            check=False,
        )

    return run
