"""`tms model stability` and `eigenvalues` of a measured bicycle, with --uncertainty."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tms_model import load_bicycle
from tms_model.parameter_files import SYMBOLS
from tms_model.uncertainty import eigenvalue_uncertainty, stability_uncertainty


@pytest.fixture
def measured(tmp_path: Path) -> Path:
    """The benchmark bicycle, as if each of its numbers were measured to 0.2 %."""
    parameters = load_bicycle("benchmark").parameters
    path = tmp_path / "measured.txt"
    path.write_text(
        "".join(
            f"{symbol} = {getattr(parameters, name)}+/-{abs(0.002 * getattr(parameters, name))}\n"
            for symbol, name in SYMBOLS.items()
        )
    )
    return path


def answer(command: Any, *arguments: object) -> dict[str, Any]:
    done = command("tms_model", *arguments, "--json")
    assert (done.code, done.err) == (0, "")
    return dict(json.loads(done.out))


def test_stability(command: Any, measured: Path) -> None:
    document = answer(command, "stability", measured, "--uncertainty", "--samples", 300, "--seed", 4)
    expected = stability_uncertainty(load_bicycle(str(measured)), np.random.default_rng(4), 300)
    assert (document["samples"], document["seed"]) == (300, 4)
    assert set(document["uncertainty"]) == {"onset_speed", "weave_speed", "capsize_speed"}
    for name, quantity in document["uncertainty"].items():
        assert quantity["value"] == pytest.approx(document[name], rel=1e-12)
        assert quantity["std"] == expected[name].std
        assert quantity["interval"] == list(expected[name].interval)
        assert set(quantity["contributions"]) == set(SYMBOLS.values())
    again = answer(command, "stability", measured, "--uncertainty", "--samples", 300, "--seed", 4)
    assert again == document


def test_eigenvalues(command: Any, measured: Path) -> None:
    document = answer(command, "eigenvalues", measured, "--speed", 5, "--uncertainty", "--samples", 200)
    expected = eigenvalue_uncertainty(load_bicycle(str(measured)), 5.0, np.random.default_rng(0), 200)
    for root, found, (re, im) in zip(document["eigenvalues"], document["uncertainty"], expected, strict=True):
        assert (found["re"]["std"], found["im"]["sample_std"]) == (re.std, im.sample_std)
        assert found["re"]["value"] == pytest.approx(root["re"], rel=1e-12)


def test_no_samples_and_no_speed_are_null(command: Any, measured: Path) -> None:
    document = answer(command, "stability", measured, "--uncertainty", "--samples", 0)
    onset = document["uncertainty"]["onset_speed"]
    assert (onset["sample_std"], onset["interval"], onset["sample_share"]) == (None, [None, None], None)


def test_for_people(command: Any, measured: Path) -> None:
    done = command("tms_model", "stability", measured, "--uncertainty")
    assert (done.code, done.err) == (0, "")
    lines = done.out.splitlines()
    assert lines[0] == "measured is self-stable from 4.2923825 m/s to 6.0242620 m/s"
    assert sum("to first order" in line for line in lines) == 3
    assert sum(line.startswith("  samples: ") for line in lines) == 3
    # Speed goes with the root of gravity: 0.1 % of 4.29 m/s.
    assert lines[5].startswith("  mostly gravity +0.0043, ")
    shown = command("tms_model", "show", measured).out
    assert "  wheelbase                  w     1.02           +/- 0.002 m\n" in shown
    assert "(18 deg)" in shown
    done = command("tms_model", "eigenvalues", measured, "--speed", 5, "--uncertainty")
    # Two real eigenvalues and a pair: four quantities, each with two more lines, after the eigenvalues.
    assert len(done.out.splitlines()) == 4 + 4 * 3


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["stability", "benchmark", "--uncertainty"], "benchmark: expected standard deviations"),
        (["stability", "tms_eq_10_1", "--uncertainty"], "tms_eq_10_1: expected standard deviations"),
        (["stability", "benchmark", "--uncertainty", "--samples", "-1"], "samples: expected 0 to 1000000"),
        (["stability", "benchmark", "--uncertainty", "--samples", "1000001"], "found 1000001"),
        (
            ["stability", "benchmark", "--uncertainty", "--seed", "-1"],
            "seed: expected zero or more, found -1",
        ),
        (["stability", "benchmark", "--uncertainty", "--samples", "many"], "'many'"),
    ],
)
def test_bad_input(refused: Any, arguments: list[str], said: str) -> None:
    assert said in refused("tms_model", *arguments)
