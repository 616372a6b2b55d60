"""Every benchmark runs. How fast anything is, no test says."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[1] / "benchmarks"
RUNNERS = sorted(path for path in FOLDER.glob("*.py") if "__main__" in path.read_text(encoding="utf-8"))


def test_each_is_described() -> None:
    text = (FOLDER / "README.md").read_text(encoding="utf-8")
    assert RUNNERS
    for path in RUNNERS:
        assert f"`{path.name}`" in text


@pytest.mark.parametrize("path", RUNNERS, ids=lambda path: path.stem)
@pytest.mark.quick_for(path=[FOLDER / "kalman.py"])
def test_it_runs_and_says_on_what(path: Path) -> None:
    if path.stem == "model":
        pytest.importorskip(
            "bicycleparameters", reason="BicycleParameters, which it compares with, is missing"
        )
    done = subprocess.run([sys.executable, path, "--quick"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert re.search(r"^machine: .+ cores, load ", done.stdout, re.MULTILINE)
    assert re.search(r"^Python 3\.\d+\.\d+, numpy \d", done.stdout, re.MULTILINE)
    medians = re.findall(r" ms  \(\d+\.\d+ to \d+\.\d+\)", done.stdout)
    rows = re.findall(r"^\| .+ \| \d+\.\d+ \|", done.stdout, re.MULTILINE)  # of a table, with a first figure
    assert len(medians) + len(rows) >= 2


def test_what_the_model_benchmark_compares_is_the_same() -> None:
    pytest.importorskip("bicycleparameters", reason="BicycleParameters, which it compares with, is missing")
    done = subprocess.run(
        [sys.executable, FOLDER / "model.py", "--quick"], capture_output=True, text=True, check=True
    )
    differences = re.findall(r"largest difference between the two: (\S+)", done.stdout)
    assert len(differences) == 2
    assert all(float(difference) < 1e-11 for difference in differences)
    error = re.search(r"largest error of tms_model: (\S+)", done.stdout)
    assert error
    assert float(error[1]) < 1e-12
