"""`--help` answers at once: no command's help loads numpy, scipy or the bicycle."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
from tms_bag.commands.record_play import COMPRESSIONS
from tms_bag.writing.presets import PRESETS
from tms_calibrate import commands, random_effects

TOOLS = ("tms_model", "tms_bag", "tms_sim", "tms_fit", "tms_study")
HEAVY = ("numpy", "scipy", "matplotlib", "yaml", "rosbags", "mcap", "filterpy", "rclpy", "tms_model.bicycle")

# Prints the help of a tool and of each of its commands, then which heavy modules have been loaded.
PROGRAM = """
import argparse, contextlib, importlib, io, json, sys
tool, *heavy = sys.argv[1:]
main = importlib.import_module(tool + ".cli").main
shown = {}
def help_of(*words):
    with contextlib.redirect_stdout(io.StringIO()) as text, contextlib.suppress(SystemExit):
        main([*words, "--help"])
    return text.getvalue()
shown[""] = help_of()
for name in shown[""].partition("{")[2].partition("}")[0].split(","):
    shown[name] = help_of(name)
print(json.dumps([shown, [name for name in heavy if name in sys.modules]]))
"""


@pytest.mark.parametrize("tool", TOOLS)
def test_help_loads_nothing_heavy(tool: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, tool, *HEAVY], check=True, capture_output=True, text=True
    )
    shown, loaded = json.loads(done.stdout)
    assert len(shown) > 3
    assert all(text.startswith("usage: tms ") for text in shown.values())
    assert loaded == []


def test_names_in_help_are_those_of_the_modules_behind() -> None:
    assert tuple(PRESETS) == COMPRESSIONS
    assert random_effects.METHODS == commands.METHODS
