"""Where the disk takes no more, every command that writes says so in one line and leaves nothing behind."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from tms_bag import RecordingError
from tms_fit.settings import Settings
from tms_model import ParameterError
from tms_study.campaign import Campaign, Row
from tms_study.campaign_file import CampaignFile
from tms_study.findings import Finding, write_markdown

BAG = Path(__file__).parents[1] / "bags" / "tms_strike"
# module, arguments with {} in the place of what is to be written
COMMANDS = {
    "model plot": ("tms_model", "plot", "benchmark", "-o", "{}.png"),
    "sim run": ("tms_sim", "run", "tms_strike", "-o", "{}"),
    "sim run --blind": ("tms_sim", "run", "tms_strike", "--blind", "-o", "{}"),
    "sim fault": ("tms_sim", "fault", BAG, "--fault", "stuck:time=3,duration=0.5", "-o", "{}"),
    "sim plot": ("tms_sim", "plot", BAG, "-o", "{}.png"),
    "bag repair": ("tms_bag", "repair", BAG, "-o", "{}"),
    "bag export": ("tms_bag", "export", BAG, "-o", "{}.csv"),
    "bag import-csv": ("tms_bag", "import-csv", "LOG", "--mapping", "export", "-o", "{}"),
    "fit report": ("tms_fit", "report", BAG, "-o", "{}.html"),
    "fit figure3b": ("tms_fit", "figure3b", BAG, "-o", "{}.pdf"),
    "study campaign": ("tms_study", "campaign", "tms_strike", "--runs", "1", "-o", "{}.csv"),
}
ROOM = 10  # [bytes]
NoRoom = Callable[[int], AbstractContextManager[None]]


@pytest.mark.parametrize("name", COMMANDS)
def test_a_full_disk_is_one_line_and_leaves_nothing(
    name: str, refused: Callable[..., str], command: Any, no_room: NoRoom, tmp_path: Path
) -> None:
    module, *arguments = COMMANDS[name]
    log = tmp_path / "log.csv"
    if "LOG" in arguments:
        assert command("tms_bag", "export", BAG, "-o", log).code == 0
    target = tmp_path / "made" / "it"
    target.parent.mkdir()
    with no_room(ROOM):
        said = refused(module, *(str(one).format(target).replace("LOG", str(log)) for one in arguments))
    assert "File too large" in said
    assert str(target) in said
    assert list(target.parent.iterdir()) == []


def test_a_validation_whose_disk_is_full_keeps_the_old_table(no_room: NoRoom, tmp_path: Path) -> None:
    table = tmp_path / "validation.md"
    found = [Finding("white noise", "bias", 0.0, -1.0, 1.0, 5)]
    write_markdown(table, found, 1, True)
    before = table.read_text()
    with no_room(ROOM), pytest.raises(ParameterError, match="File too large"):
        write_markdown(table, found * 2, 1, True)
    assert list(tmp_path.iterdir()) == [table]
    assert table.read_text() == before


def test_a_campaign_goes_on_when_there_is_room_again(no_room: NoRoom, tmp_path: Path) -> None:
    path = tmp_path / "campaign.csv"
    campaign = Campaign("tms_strike", {}, {}, 2, 1, Settings())
    one, other = ([Row((), seed, 1, 1, "missed", *(0.1 * n for n in range(9)))] for seed in (1, 2))
    file = CampaignFile(path, campaign)
    file.add(one)
    goes_on = r"File too large\); make room, and the same command goes on"
    with no_room(path.stat().st_size + 10), pytest.raises(RecordingError, match=goes_on):
        file.add(other)
    again = CampaignFile(path, campaign)
    assert again.rows == one
    again.add(other)
    assert CampaignFile(path, campaign).rows == one + other


def say(arguments: str, stdout: int | None, unbuffered: str = "") -> tuple[int, str]:
    """Exit code and stderr of a command with this standard output; None: it is closed."""
    done = subprocess.run(
        [sys.executable, "-m", "tms_model", *arguments.split()],
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": unbuffered},
        preexec_fn=partial(os.close, 1) if stdout is None else None,
    )
    return done.returncode, done.stderr


# Unbuffered, argparse itself passes over a help that nobody takes.
SAYING = [("list", ""), ("list", "1"), ("matrices benchmark --json", ""), ("--help", "")]


@pytest.mark.parametrize(("arguments", "unbuffered"), SAYING)
@pytest.mark.quick_for(arguments=["list", "--help"], unbuffered=[""])
def test_standard_output_may_take_nothing(arguments: str, unbuffered: str) -> None:
    with Path("/dev/full").open("w") as full:
        code, said = say(arguments, full.fileno(), unbuffered)
    assert code == 2
    assert said == "error: standard output or a file takes no more: No space left on device\n"
    reader, writer = os.pipe()
    os.close(reader)
    assert say(arguments, writer, unbuffered) == (141, "")  # as in `... | head`
    os.close(writer)
    code, said = say(arguments, None, unbuffered)
    assert code == 0
    assert said == "" or arguments == "--help"  # which argparse then says there
