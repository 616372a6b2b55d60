"""The examples run, and the README's commands do what they say."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
BLOCKS = re.findall(r"```console\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
COMMANDS = [
    line for block in BLOCKS for line in block.splitlines() if line != "./tms test"
]  # which runs this


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs(example: Path, tmp_path: Path) -> None:
    assert len(example.read_text().splitlines()) <= 40
    done = subprocess.run([sys.executable, example], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout
    assert not done.stderr


@pytest.mark.parametrize(
    "commands", [["./tms demo"], pytest.param(COMMANDS, marks=pytest.mark.long)], ids=["demo", "all"]
)
def test_readme_commands_in_order(commands: list[str], tmp_path: Path) -> None:
    assert "./tms demo" in COMMANDS
    environment = {key: value for key, value in os.environ.items() if key != "ROS_DOMAIN_ID"}
    for command in commands:
        words = shlex.split(command)
        done = subprocess.run(
            [str(ROOT / words[0]), *words[1:]],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
            env=environment,
        )
        assert done.returncode == 0, f"{command}\n{done.stderr}"
        output = [words[i + 1] for i, word in enumerate(words[:-1]) if word == "-o"]
        assert all((tmp_path / name).exists() for name in output), command
    for name in ("bag/metadata.yaml", "estimate.json", "figure_3b.png"):
        assert (tmp_path / "out/demo" / name).exists()
