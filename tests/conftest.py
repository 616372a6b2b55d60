"""Options of the test suite, and fixtures shared by several packages."""

from __future__ import annotations

import resource
import runpy
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from typing import Any

import pytest

LEFT_OUT = pytest.StashKey[int]()  # number of long tests that were not selected


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add `--thorough`."""
    parser.addoption("--thorough", action="store_true", help="run the tests marked 'long' as well")


def place(item: pytest.Item) -> int:
    """Place of a test in the order of all."""
    return 0 if item.get_closest_marker("measures") else 2 if item.get_closest_marker("long") else 1


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Deselect long tests, unless `--thorough` or a marker expression (`-m`) decides about them.

    A test marked `quick_for(name=values)` is long for every other value of its parameter `name`.
    Tests that measure come first: one worker runs them, one after the other, since idle workers steal from
    the end. Long ones come last.
    """
    for item in items:
        for marker in item.iter_markers("quick_for"):
            cases = item.callspec.params  # type: ignore[attr-defined]
            if any(cases[name] not in values for name, values in marker.kwargs.items()):
                item.add_marker("long")
    items.sort(key=place)
    if config.option.thorough or "long" in config.option.markexpr:
        return
    left_out = [item for item in items if item.get_closest_marker("long")]
    config.stash[LEFT_OUT] = len(left_out)
    if left_out:
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if not item.get_closest_marker("long")]


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Hand the number of tests left out from a worker to the process that reports."""
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["left_out"] = session.config.stash.get(LEFT_OUT, 0)


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """Take the number of tests left out from a worker; each collects all tests."""
    node.config.stash[LEFT_OUT] = getattr(node, "workeroutput", {}).get("left_out", 0)


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    """Print how many long tests were left out."""
    if left_out := config.stash.get(LEFT_OUT, 0):
        terminalreporter.write_line(f"long tests left out: {left_out} (--thorough runs them as well)")


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
