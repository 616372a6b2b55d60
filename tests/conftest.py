"""Options of the test suite, and fixtures shared by several packages."""

from __future__ import annotations

import resource
import runpy
import sys
from collections import Counter
from collections.abc import Callable, Generator, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

TESTS = Path(__file__).parent
LEFT_OUT = pytest.StashKey[dict[str, int]]()  # number of tests that were not selected, by marker
CHOSEN_BY = {"long": "--thorough runs them as well", "slow_setup": "-m slow_setup runs them"}


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add `--thorough`."""
    parser.addoption("--thorough", action="store_true", help="run the tests marked 'long' as well")


def place(item: pytest.Item) -> int:
    """Place of a test in the order of all.

    Tests that measure come first: one worker runs them, one after the other, since idle workers steal from
    the end. Those of several packages follow, of which some take a minute, and long ones come last, those of
    nodes first: one of them takes ten minutes, in which other workers have enough to do.
    """
    if item.get_closest_marker("measures"):
        return 0
    if item.get_closest_marker("long"):
        return 3 if item.path.parent == TESTS / "ros" else 4
    return 1 if item.path.parent == TESTS else 2


def spread(items: list[pytest.Item]) -> dict[Path, float]:
    """Place of each file among all (0 to 1).

    Tests of nodes wait more than they compute: their files stand at even distances between the others, so
    that never all workers wait at the same time.
    """
    files = list(dict.fromkeys(item.path for item in items))
    waiting = [file for file in files if file.parent == TESTS / "ros"]
    others = [file for file in files if file.parent != TESTS / "ros"]
    return {file: (k + 0.5) / len(group) for group in (waiting, others) for k, file in enumerate(group)}


def omitted(item: pytest.Item) -> str | None:
    """Marker for which a test is left out, unless an option or a marker expression (`-m`) asks for it."""
    for marker in CHOSEN_BY:
        asked_for = marker in item.config.option.markexpr or (
            marker == "long" and item.config.option.thorough
        )
        if item.get_closest_marker(marker) and not asked_for:
            return marker
    return None


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_collection_modifyitems(
    config: pytest.Config, items: list[pytest.Item]
) -> Generator[None, object, object]:
    """Mark cases of `quick_for(PARAMETER=VALUES)` with other values as long; deselect what is not asked."""
    for item in items:
        for marker in item.iter_markers("quick_for"):
            cases = item.callspec.params  # type: ignore[attr-defined]
            if any(cases[name] not in values for name, values in marker.kwargs.items()):
                item.add_marker("long")
    places = spread(items)
    items.sort(key=lambda item: (place(item), places[item.path]))
    result = yield  # -k and -m
    left_out = [item for item in items if omitted(item)]
    if left_out:
        config.stash[LEFT_OUT] = dict(Counter(str(omitted(item)) for item in left_out))
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if not omitted(item)]
    return result


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Hand the number of tests left out from a worker to the process that reports."""
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["left_out"] = session.config.stash.get(LEFT_OUT, {})


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """Take the number of tests left out from a worker; each collects all tests."""
    node.config.stash[LEFT_OUT] = getattr(node, "workeroutput", {}).get("left_out", {})


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    """Print how many tests were left out, and how they are run."""
    for marker, number in config.stash.get(LEFT_OUT, {}).items():
        terminalreporter.write_line(f"left out: {number} tests marked {marker} ({CHOSEN_BY[marker]})")


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
