"""Setting up from nothing: minutes each, with downloads, so they run only when asked for:

./tms test tests/setup -m slow_setup
"""

import os
import signal
import subprocess
import time
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow_setup

WORKS = "import rclpy, numpy, tms_msgs.msg, tms_bag; print(tms_msgs.msg.LeanYaw().lean)"


def killed(command: list[Path | str], when, environment: dict[str, str]) -> str:
    """Starts a command, kills it and its children once a condition holds, without warning; what it said."""
    process = subprocess.Popen(
        command, env=environment, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    deadline = time.monotonic() + 300
    while not when():
        assert process.poll() is None, "the set-up ended before it could be interrupted"
        assert time.monotonic() < deadline
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGKILL)
    return process.communicate()[1]


def check(project: Path, environment: dict[str, str]) -> None:
    done = subprocess.run(
        [project / "tms", "shell", "-c", f"python -c '{WORKS}'"],
        env=environment,
        cwd="/",
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "0.0\n", "")


@pytest.mark.parametrize("name", ["plain", "a path with spaces & more"])
def test_interrupted_twice_then_started_twice_at_once(name, copy_to, tmp_path_factory, clean_environment):
    """Killed while packages install, killed while messages build, then two at once."""
    folder = tmp_path_factory.mktemp("fresh")
    project = copy_to(folder / name)
    environment = clean_environment | {"XDG_CACHE_HOME": str(folder / "cache")}
    (folder / "cache").mkdir()
    # Packages that were downloaded before may be used.
    (folder / "cache/pip").symlink_to(Path("~/.cache/pip").expanduser())

    def in_venv(pattern: str) -> bool:
        return any(folder.glob(f"*/.venv/{pattern}")) or any(folder.glob(f"cache/tms/*/venv/{pattern}"))

    def in_workspace(pattern: str) -> bool:
        return any(folder.glob(f"*/.tms/wheels/{pattern}")) or any(
            folder.glob(f"cache/tms/*/wheels/{pattern}")
        )

    said = killed([project / "tms", "setup"], lambda: in_venv("lib/python*/site-packages/numpy"), environment)
    assert "installing" in said
    assert not in_venv("tms-stamp")
    said = killed(
        [project / "tms", "setup"], lambda: in_workspace("build/tms_msgs/rosidl_generator_c"), environment
    )
    assert "installing" in said, "half an environment was taken for a whole one"
    assert in_venv("tms-stamp")
    assert not in_workspace("stamps/tms_msgs")

    both = [
        subprocess.Popen([project / "tms", "setup"], env=environment, stderr=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    said = [process.communicate(timeout=600)[1] for process in both]
    assert [process.returncode for process in both] == [0, 0], said
    assert sorted("building" in text for text in said) == [False, True], said
    assert not any("installing" in text for text in said), "a whole environment was made again"
    check(project, environment)

    done = subprocess.run(
        [project / "tms", "setup"], env=environment, capture_output=True, text=True, check=True
    )
    assert done.stderr == "", "a second set-up had something to do"
    if " " in name:
        assert not (project / ".venv").exists()
        assert not (project / ".tms").exists()


def test_a_moved_project_sets_itself_up_anew_and_can_be_cleaned(copy_to, tmp_path_factory, clean_environment):
    """Everything that is made names its place."""
    folder = tmp_path_factory.mktemp("fresh")
    environment = clean_environment
    subprocess.run([copy_to(folder / "first") / "tms", "setup"], env=environment, check=True)
    project = (folder / "first").rename(folder / "moved")
    subprocess.run([project / "tms", "setup"], env=environment, check=True)
    check(project, environment)
    subprocess.run([project / "tms", "clean"], env=environment, check=True)
    assert not (project / ".venv").exists()
    assert not (project / ".tms").exists()
