"""The command line of ./tms, in the built workspace that the tests themselves run in."""

import fcntl
import os
import signal
import subprocess
from functools import partial
from pathlib import Path

import pytest

TMS = Path(__file__).resolve().parents[2] / "tms"


def tms(*arguments: str, cwd: Path) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [TMS, *arguments], cwd=cwd, capture_output=True, text=True, timeout=600, check=False
    )


def one_line(text: str) -> str:
    assert text.count("\n") == 1, text
    return text


@pytest.mark.parametrize("arguments", [[], ["help"], ["--help"]])
def test_help_lists_the_commands_and_sets_nothing_up(arguments, copy_to, tmp_path):
    copy = copy_to(tmp_path / "copy")
    command = [copy / "tms", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    for command in ("demo", "run PACKAGE EXECUTABLE", "shell", "test", "lint", "setup", "clean"):
        assert command in done.stdout
    assert not (copy / ".venv").exists()
    assert not (copy / ".tms").exists()


def test_unknown_command_is_one_line_and_exit_2(tmp_path):
    done = tms("dmeo", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert "no command 'dmeo'" in one_line(done.stderr)


def test_run_names_the_packages_there_are(tmp_path):
    done = tms("run", "no_such_package", "node", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert "no package 'no_such_package'" in one_line(done.stderr)
    assert "tms_bag" in done.stderr


def test_run_names_the_executables_there_are(tmp_path):
    done = tms("run", "tms_bag", "recoder", cwd=tmp_path)
    assert done.returncode == 2
    assert one_line(done.stderr).endswith("no executable 'recoder' in tms_bag; there are: player recorder\n")


@pytest.mark.parametrize("arguments", [["run"], ["run", "tms_bag"]])
def test_run_without_executable_says_what_is_needed(arguments, tmp_path):
    done = tms(*arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert "run needs" in one_line(done.stderr)


def test_run_finds_executables_of_ros_packages_outside_the_workspace_too(tmp_path):
    done = tms("run", "rosidl_adapter", "msg2idl.py", "--help", cwd=tmp_path)
    assert done.returncode == 0
    assert "msg2idl.py" in done.stdout


def test_shell_runs_in_the_users_folder_and_hands_the_exit_code_on(tmp_path):
    done = tms("shell", "-c", 'pwd; exit "$1"', "bash", "7", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (7, f"{tmp_path}\n")


def test_workspace_is_sourced_and_messages_are_the_built_ones(tmp_path):
    code = (
        "import ament_index_python as a, tms_msgs.msg as m; "
        "print(a.get_package_prefix('tms_msgs')); print(m.LeanYaw())"
    )
    done = tms("shell", "-c", f'python -c "{code}"', cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    prefix, message = done.stdout.splitlines()
    assert (Path(prefix) / "share/tms_msgs/msg/LeanYaw.msg").exists()
    assert message.startswith("tms_msgs.msg.LeanYaw(")


def test_discovery_stays_on_this_machine_unless_told_otherwise(tmp_path, clean_environment):
    command = [TMS, "shell", "-c", "echo $ROS_AUTOMATIC_DISCOVERY_RANGE"]
    for given, expected in [({}, "LOCALHOST\n"), ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}, "SUBNET\n")]:
        environment = clean_environment | given
        done = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=600, check=True
        )
        assert done.stdout == expected


def test_a_file_beside_the_user_is_not_taken_for_a_python_module(tmp_path):
    (tmp_path / "numpy.py").write_text("raise SystemExit('the wrong numpy')\n")
    done = tms("shell", "-c", "ls $VIRTUAL_ENV/bin/python3.10", cwd=tmp_path)
    if done.returncode == 0:
        pytest.skip("Python 3.10 has no -P: there the user's folder stays first on the module path")
    done = tms("model", "list", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "benchmark" in done.stdout


def test_ctrl_c_while_python_imports_ends_a_tool_without_a_traceback(tmp_path):
    # Python writes what it imports into a pipe of 4 KiB, read without a buffer: at the first module of numpy
    # 9 KiB are left, so it waits there.
    said, saying = os.pipe()
    fcntl.fcntl(saying, fcntl.F_SETPIPE_SZ, 4096)
    environment = {**os.environ, "PYTHONPROFILEIMPORTTIME": "1"}
    tool = subprocess.Popen(
        [TMS, "model", "list"],
        cwd=tmp_path,
        env=environment,
        stderr=saying,
        stdout=subprocess.DEVNULL,
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),  # ignored in background jobs
    )
    os.close(saying)
    with os.fdopen(said, "rb", buffering=0) as stream:
        lines = iter(stream.readline, b"")
        assert any(b"numpy" in line for line in lines)
        tool.send_signal(signal.SIGINT)
        rest = b"".join(lines).decode()
    assert tool.wait(timeout=600) == 130
    assert "Traceback" not in rest
    assert rest.endswith("interrupted; nothing half-written is left\n")
