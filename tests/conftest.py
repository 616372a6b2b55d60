"""What tests of several packages share."""

from __future__ import annotations

import resource
import runpy
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass

import pytest


@dataclass(frozen=True)
class Answer:
    """What a command line left behind."""

    code: int
    out: str
    err: str


Command = Callable[..., Answer]


@pytest.fixture(scope="session", autouse=True)
def _fonts_are_known() -> None:
    """On a new machine matplotlib looks for fonts first, and says so on stderr if that takes long."""
    import matplotlib.font_manager  # noqa: F401


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    """Runs `python -m MODULE ARGUMENTS...` in this process. A defect (traceback) fails the test."""

    def run(module: str, *arguments: object) -> Answer:
        monkeypatch.setattr(sys, "argv", [module, *map(str, arguments)])
        capsys.readouterr()
        with pytest.raises(SystemExit) as leaving:
            runpy.run_module(module, run_name="__main__")
        captured = capsys.readouterr()
        code = leaving.value.code
        return Answer(code if isinstance(code, int) else 0 if code is None else 1, captured.out, captured.err)

    return run


@pytest.fixture
def refused(command: Command) -> Callable[..., str]:
    """Runs a command line that must refuse its input: exit code 2 and one line, which is the answer."""

    def run(module: str, *arguments: object) -> str:
        answer = command(module, *arguments)
        assert answer.code == 2, answer
        assert answer.out == ""
        assert answer.err.count("\n") == 1, answer.err
        assert answer.err.endswith("\n")
        assert "Traceback" not in answer.err
        return answer.err.strip()

    return run


@pytest.fixture
def no_room(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], AbstractContextManager[None]]:
    """Within it, files may grow to so many bytes, and then fail as on a full disk.

    Not until the test is over: pytest itself then writes, perhaps to a file.
    """
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # of modules that are imported meanwhile

    @contextmanager
    def limited(size: int) -> Iterator[None]:
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)

    return limited
