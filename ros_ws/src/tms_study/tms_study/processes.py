"""Nodes as processes, found through the ament index as `ros2 run` does, stopped with SIGINT."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from ament_index_python.packages import get_package_prefix
from domain_coordinator import domain_id
from tms_bag import RecordingError

STOP_WITHIN = 120.0  # [s], longest wait for a clean end
PR_SET_PDEATHSIG = 1  # of prctl(2)


class NodeProcess:
    """One running node; what it prints goes to a log file."""

    def __init__(self, package: str, executable: str, parameters: Mapping[str, object], log: Path) -> None:
        self.name, self._log = executable, log
        program = Path(get_package_prefix(package)) / "lib" / package / executable
        arguments = [argument for key, value in parameters.items() for argument in ("-p", f"{key}:={value}")]
        with log.open("wb") as stream:
            command = [sys.executable, str(program), "--ros-args", *arguments]
            self._process = subprocess.Popen(
                command, stdout=stream, stderr=subprocess.STDOUT, preexec_fn=_end_with_parent
            )

    def wait(self, timeout: float) -> None:
        """Wait for it to end by itself. RecordingError when it fails or takes longer than `timeout` [s]."""
        try:
            code = self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            text = f"{self.name}: expected to end within {timeout:g} s; {self._last_words()}"
            raise RecordingError(text) from None
        if code != 0:
            raise RecordingError(f"{self.name}: ended with exit code {code}; {self._last_words()}")

    def wait_for(self, text: str, timeout: float) -> None:
        """Wait until its log holds `text`. Raises RecordingError when it ends before, or takes longer."""
        deadline = time.monotonic() + timeout
        while text not in self._log.read_text(errors="replace"):
            if self._process.poll() is not None or time.monotonic() > deadline:
                wanted = f"expected it to say {text!r} within {timeout:g} s"
                raise RecordingError(f"{self.name}: {wanted}; {self._last_words()}")
            time.sleep(0.02)

    def stop(self) -> None:
        """SIGINT, then wait for a clean end."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
        self.wait(STOP_WITHIN)

    def kill(self) -> None:
        """End it at once, if it still runs."""
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()

    def _last_words(self) -> str:
        lines = self._log.read_text(errors="replace").strip().splitlines()
        return f"its last line: {lines[-1]}" if lines else f"it said nothing (log: {self._log})"


def _end_with_parent() -> None:
    """Ask Linux to end this process when its parent dies, even by SIGKILL: no node is left running alone."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)


@contextmanager
def own_domain() -> Iterator[None]:
    """A ROS domain that no other test or demo here uses, unless the user chose one; loopback by default."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    if "ROS_DOMAIN_ID" in os.environ:
        yield
        return
    with domain_id() as number:
        os.environ["ROS_DOMAIN_ID"] = str(number)
        try:
            yield
        finally:
            del os.environ["ROS_DOMAIN_ID"]
