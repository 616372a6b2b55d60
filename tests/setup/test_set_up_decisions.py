"""What ./tms decides before it makes anything: which ROS, which Python, what is missing, what is stale."""

import os
import shutil
import sys
from pathlib import Path

import pytest


@pytest.fixture
def project(copy_to, tmp_path) -> Path:
    return copy_to(tmp_path / "project")


def executable(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    path.chmod(0o755)
    return path


def base_python() -> str:
    return os.path.realpath(sys._base_executable)  # the interpreter below the virtual environment


# --- Which Python ------------------------------------------------------------------------------------------

CHOOSE = "choose_python; echo ${BASE:-none} missing=${missing[*]:-}"


def test_a_python_that_does_not_run_is_passed_over(project, bash, tmp_path, clean_environment):
    """pyenv leaves stand-ins on the PATH for versions that aren't switched on: they exist and fail."""
    for name in ("python3.12", "python3.11", "python3.13", "python3.10"):
        executable(tmp_path / "stand_ins" / name, "#!/bin/sh\necho 'pyenv: not found' >&2\nexit 127\n")
    executable(tmp_path / "real" / "python3", f'#!/bin/sh\nexec "{base_python()}" "$@"\n')
    for tool in ("readlink", "dirname"):  # what else the script needs here, without the system's own Pythons
        (tmp_path / "real" / tool).symlink_to(shutil.which(tool))
    done = bash(project, CHOOSE, PATH=f"{tmp_path}/stand_ins:{tmp_path}/real")
    assert done.stdout == f"{base_python()} missing=\n", done.stderr


def test_an_unsuitable_python_is_refused(project, bash, tmp_path):
    old = executable(tmp_path / "old", "#!/bin/sh\nexit 1\n")
    assert bash(project, f"python_facts {old}").returncode == 1
    assert bash(project, f"python_facts {tmp_path}/absent").returncode != 0


def test_the_python_asked_for_is_taken_even_from_a_path_with_spaces(project, bash, tmp_path):
    asked = executable(tmp_path / "a python", f'#!/bin/sh\nexec "{base_python()}" "$@"\n')
    done = bash(project, CHOOSE, TMS_PYTHON=str(asked))
    assert done.stdout == f"{base_python()} missing=\n"


def test_a_python_asked_for_that_does_not_run_is_an_error(project, bash, tmp_path):
    asked = executable(tmp_path / "broken", "#!/bin/sh\nexit 1\n")
    done = bash(project, "missing=(); packages=(); choose_python", TMS_PYTHON=str(asked))
    assert done.returncode == 1
    said = f"tms: TMS_PYTHON={asked} is no CPython 3.10 to 3.13 that runs; unset it, or name another\n"
    assert done.stderr == said


# --- What is missing ---------------------------------------------------------------------------------------


def test_everything_missing_is_told_in_one_line_with_the_remedy(project, bash, tmp_path):
    """No Python at all and no compiler: both in one line."""
    done = bash(project, "type() { return 1; }; check_machine", CC="/no/cc", CXX="/no/c++")
    assert done.returncode == 1
    assert done.stderr == (
        "tms: missing: a C and C++ compiler, Python 3.10 to 3.13. "
        "On Debian or Ubuntu: sudo apt-get install build-essential python3 python3-dev python3-venv\n"
    )


def test_a_python_without_headers_is_named_with_its_package(project, bash):
    facts = 'python_facts() { echo "/opt/python3.12|3.12|python3.12-dev python3.12-venv"; }'
    done = bash(project, f"{facts}; check_machine")
    assert done.returncode == 1
    assert "headers or venv of" in done.stderr
    assert done.stderr.endswith("sudo apt-get install python3.12-dev python3.12-venv\n")


@pytest.mark.parametrize(
    ("fake", "reason"),
    [
        ("uname() { echo Linux aarch64; }", "x86-64 Linux only, not for Linux aarch64"),
        ("getconf() { echo glibc 2.17; }", "glibc 2.28 (found 2.17)"),
        ("getconf() { return 1; }", "(found another C library)"),
    ],
)
def test_a_machine_without_wheels_is_told_what_to_do(project, bash, fake, reason):
    done = bash(project, f"{fake}; check_machine")
    assert done.returncode == 1
    assert reason in done.stderr
    assert "a sourced ROS 2 Jazzy" in done.stderr
    assert done.stderr.count("\n") == 1


# --- Which ROS ---------------------------------------------------------------------------------------------


@pytest.fixture
def jazzy(tmp_path) -> Path:
    marker = tmp_path / "opt/share/ament_index/resource_index/packages/rclpy"
    marker.parent.mkdir(parents=True)
    marker.touch()
    return tmp_path / "opt"


SOURCED = "sourced_ros || echo wheels"


def test_a_sourced_jazzy_is_used(project, bash, jazzy):
    done = bash(project, SOURCED, ROS_DISTRO="jazzy", AMENT_PREFIX_PATH=f"/an/overlay:{jazzy}")
    assert done.stdout == str(jazzy)


@pytest.mark.parametrize(
    "variables",
    [
        {},
        {"ROS_DISTRO": "humble"},
        {"ROS_DISTRO": "jazzy", "TMS_ROS": "wheels"},
        {"ROS_DISTRO": "jazzy", "AMENT_PREFIX_PATH": ""},
    ],
)
def test_anything_else_means_the_wheels(project, bash, jazzy, variables):
    assert bash(project, SOURCED, **({"AMENT_PREFIX_PATH": str(jazzy)} | variables)).stdout == "wheels\n"


def test_an_environment_of_wheels_is_no_sourced_ros(project, bash, jazzy):
    """Inside './tms shell' it looks like a sourced ROS; another copy of the project doesn't build on it."""
    (jazzy / "pyvenv.cfg").touch()
    assert bash(project, SOURCED, ROS_DISTRO="jazzy", AMENT_PREFIX_PATH=str(jazzy)).stdout == "wheels\n"


def test_with_wheels_nothing_of_another_ros_gets_in(project, bash):
    foreign = {
        "ROS_DISTRO": "humble",
        "AMENT_PREFIX_PATH": "/opt/ros/humble",
        "CMAKE_PREFIX_PATH": "/opt/ros/humble",
        "PYTHONPATH": "/opt/ros/humble/lib/python3.10",
        "LD_LIBRARY_PATH": "/opt/ros/humble/lib",
        "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp",
    }
    done = bash(project, "choose_folders; choose_ros; enter_ros; env", **foreign)
    assert done.returncode == 0, done.stderr
    variables = dict(line.split("=", 1) for line in done.stdout.splitlines() if "=" in line)
    assert [name for name, value in variables.items() if "humble" in value] == []
    assert variables["AMENT_PREFIX_PATH"] == str(project / ".venv")
    assert variables["RMW_IMPLEMENTATION"] == "rmw_fastrtps_cpp"


# --- How the tests are run ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "cores", "workers"),
    [
        ("", 4, True),
        ("--thorough -k lean", 4, True),
        ("", 1, False),
        ('"$1"', 4, False),  # a path
        ('-x "$1::test_one"', 4, False),
        ("-n 3", 4, False),
        ("--pdb", 4, False),
    ],
)
def test_the_whole_suite_gets_more_workers_than_cores(project, bash, arguments, cores, workers):
    fakes = f'PYTHON=true; nproc() {{ echo {cores}; }}; run_python() {{ echo "$*"; }}'
    done = bash(project, f"{fakes}; run_tests {arguments}")
    given = arguments.replace('"', "").replace("$1", f"{project}/tms")
    started = f" -n {cores * 3 // 2} --dist worksteal" if workers else ""
    assert done.stdout.split() == f"-m pytest{started} {given}".split(), done.stderr


# --- Where things lie --------------------------------------------------------------------------------------


def test_made_things_stay_in_the_project_when_its_path_is_plain(copy_to, bash, tmp_path_factory):
    project = copy_to(tmp_path_factory.mktemp("plain"))
    assert bash(project, 'choose_folders; echo "$STATE|$VENV"').stdout == f"{project}/.tms|{project}/.venv\n"


@pytest.mark.parametrize("name", ["with space", "semi;colon", "quote'", "dollar$HOME", "colon:", "umlaut-ü"])
def test_an_unusual_path_keeps_made_things_in_a_plain_folder(copy_to, bash, tmp_path, name):
    project = copy_to(tmp_path / name)
    done = bash(project, 'choose_folders; echo "$STATE|$VENV"', XDG_CACHE_HOME="/var/cache/somebody")
    state, venv = done.stdout.strip().split("|")
    assert venv == f"{state}/venv"
    assert state.startswith("/var/cache/somebody/tms/")
    done = bash(project, 'choose_folders; echo "$STATE"', XDG_CACHE_HOME=f"/home/{name}/.cache")
    assert done.stdout.startswith(f"/var/tmp/tms-{os.getuid()}/")


# --- What is stale -----------------------------------------------------------------------------------------

READY = "choose_folders; choose_ros; venv_ready && echo whole || echo stale"


@pytest.fixture
def whole_venv(project, bash) -> Path:
    venv = project / ".venv"
    executable(venv / "bin/python", "#!/bin/sh\n")
    (venv / "tms-python").write_text(base_python() + "\n")
    bash(project, 'choose_folders; venv_key > "$VENV/tms-stamp"')
    return venv


def test_a_whole_environment_is_kept(project, bash, whole_venv):
    assert bash(project, READY).stdout == "whole\n"
    assert bash(project, READY, TMS_PYTHON=base_python()).stdout == "whole\n"


@pytest.mark.parametrize("missing", ["tms-stamp", "bin/python"])
def test_half_an_environment_is_not_taken_for_a_whole_one(project, bash, whole_venv, missing):
    (whole_venv / missing).unlink()
    assert bash(project, READY).stdout == "stale\n"


@pytest.mark.parametrize("changed", ["requirements/lock.txt", "requirements/repair_wheels.py"])
def test_new_pins_make_the_environment_stale(project, bash, whole_venv, changed):
    with (project / changed).open("a") as file:
        file.write("\n")
    assert bash(project, READY).stdout == "stale\n"


def test_a_moved_project_makes_its_environment_stale(project, bash, whole_venv, tmp_path):
    moved = project.rename(tmp_path / "moved")
    assert bash(moved, READY).stdout == "stale\n"


def test_another_python_asked_for_makes_the_environment_stale(project, bash, whole_venv):
    (whole_venv / "tms-python").write_text("/another/python3.12\n")
    assert bash(project, READY, TMS_PYTHON=base_python()).stdout == "stale\n"


def test_a_venv_of_the_users_own_is_left_alone(project, bash):
    (project / ".venv").mkdir()
    (project / ".venv/precious").touch()
    done = bash(project, "choose_folders; set_up")
    assert done.returncode == 1
    assert done.stderr == f"tms: {project}/.venv wasn't made by ./tms: move it out of the way\n"
    assert (project / ".venv/precious").exists()


def key(project: Path, bash) -> dict[str, str]:
    done = bash(project, 'choose_folders; ROS=/opt PYTHON=python3 FOLDERS=("$SOURCES"); build_key')
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0] == "/opt python3"
    return {path: digest for digest, path in (line.split("  ") for line in lines[1:])}


def test_interfaces_that_ros_has_are_built_with_wheels_only(project, bash):
    paths = 'choose_folders; choose_ros; printf "%s\\n" "${PATHS[@]##*/}"'
    assert "tf2_msgs" in bash(project, paths, TMS_ROS="wheels").stdout.split()
    sourced = 'choose_folders; sourced_ros() { echo /opt; }; choose_ros; printf "%s\\n" "${PATHS[@]##*/}"'
    assert "tf2_msgs" not in bash(project, sourced).stdout.split()
    assert "tms_msgs" in bash(project, sourced).stdout.split()


@pytest.mark.parametrize(
    "path",
    [
        "tms_msgs/msg/RunInfo.msg",
        "tms_msgs/CMakeLists.txt",
        "tms_bag/package.xml",
        "tms_bag/setup.py",
        "tms_bag/setup.cfg",
    ],
)
def test_what_a_build_reads_makes_its_package_stale(project, bash, path):
    before = key(project, bash)
    with (project / "ros_ws/src" / path).open("a") as file:
        file.write("\n")
    after = key(project, bash)
    assert {name for name in before if before[name] != after[name]} == {f"./{path}"}


def test_a_new_or_removed_file_makes_its_package_stale(project, bash):
    before = key(project, bash)
    (project / "ros_ws/src/tms_msgs/msg/New.msg").write_text("float64 x\n")
    (project / "ros_ws/src/tms_msgs/msg/RunInfo.msg").unlink()
    after = key(project, bash)
    assert set(after) ^ set(before) == {"./tms_msgs/msg/New.msg", "./tms_msgs/msg/RunInfo.msg"}


def test_symlinked_python_packages_need_no_build(project, bash):
    """A changed or new module, a new data file, what Python and pip leave behind."""
    before = key(project, bash)
    package = project / "ros_ws/src/tms_bag"
    with (package / "tms_bag/__init__.py").open("a") as file:
        file.write("\n")
    left_behind = ["tms_bag/__pycache__/x.pyc", "tms_bag.egg-info/PKG-INFO", ".pytest_cache/x"]
    for path in ["tms_bag/new.py", "tms_bag/logs/mappings/new.yaml", *left_behind]:
        executable(package / path, "")
    assert key(project, bash) == before
