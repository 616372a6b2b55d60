"""2,000 good files made bad, and what found a defect before: a clear line each, quickly, in little memory."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parent
sys.path.insert(0, str(FOLDER))

from targets import TARGETS, read  # noqa: E402

FILES = {
    "mcap": 400,
    "packed": 100,
    "db3": 100,
    "metadata": 400,
    "csv": 400,
    "mapping": 200,
    "scenario": 200,
    "bicycle": 200,
}
MOST_MEMORY = 512  # [MiB]
FOUND = sorted(path for path in (FOLDER / "corpus").glob("*/*") if path.is_file())


def test_every_kind_of_file_is_tried_and_there_are_2000() -> None:
    assert FILES.keys() == TARGETS.keys()
    assert sum(FILES.values()) == 2000


@pytest.mark.parametrize("name", TARGETS)
@pytest.mark.parametrize("share", [10, pytest.param(1, marks=pytest.mark.long)], ids=["a tenth", "all"])
def test_bad_files_are_refused_in_a_line_or_read(name: str, share: int) -> None:
    count = FILES[name] // share
    done = subprocess.run(
        [sys.executable, FOLDER / "batch.py", name, "0", str(count)],
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert answer["defects"] == []  # neither tracebacks nor more than two seconds for one file
    assert answer["files"] == count
    assert answer["memory_mib"] < MOST_MEMORY


@pytest.mark.parametrize("path", FOUND, ids=lambda path: f"{path.parent.name}-{path.name}")
def test_what_found_a_defect_once_finds_none_any_more(path: Path) -> None:
    read(path.parent.name, path.read_bytes())


def test_there_is_something_that_found_defects() -> None:
    assert {path.parent.name for path in FOUND} >= {"mcap", "metadata", "bicycle", "mapping"}
    assert all(path.stat().st_size < 4096 for path in FOUND)


@pytest.mark.parametrize("name", TARGETS)
def test_the_files_to_start_from_are_good_ones(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without this a reading that refuses everything would pass."""
    import targets

    refused: list[str] = []

    class Telling:
        def __init__(self, *_: object) -> None:
            pass

        def __enter__(self) -> None:
            pass

        def __exit__(self, kind: type | None, error: BaseException | None, _: object) -> bool:
            if isinstance(error, targets.ALLOWED):
                refused.append(str(error))
            return isinstance(error, targets.ALLOWED)

    monkeypatch.setattr(targets, "suppress", Telling)
    TARGETS[name].read(TARGETS[name].seeds()[0], tmp_path)
    expected = {  # what one file can't be at once
        "csv": (
            "/imu/data_raw angular_velocity.x",
            "expected times from 1970",
            "three columns of an accelerometer",
            "expected a finite number",
        ),
        "db3": ("nothing to repair",),
    }.get(name, ())
    assert [text for text in refused if not any(part in text for part in expected)] == []
