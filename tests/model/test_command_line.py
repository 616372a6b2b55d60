"""`tms model`: JSON that other tools rely on, and refusals in one line."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tms_model import bicycle_names, eigenvalues, linear_system, load_bicycle, response, stability


@pytest.fixture
def answer(command: Any) -> Any:
    """Runs `tms model ARGUMENTS --json` and reads its one JSON document."""

    def run(*arguments: object) -> dict[str, Any]:
        done = command("tms_model", *arguments, "--json")
        assert (done.code, done.err) == (0, "")
        return dict(json.loads(done.out))

    return run


def test_list(answer: Any) -> None:
    assert [entry["name"] for entry in answer("list")["bicycles"]] == bicycle_names()


@pytest.mark.parametrize("name", bicycle_names())
def test_matrices_and_numbers(answer: Any, name: str) -> None:
    matrices = answer("matrices", name)
    assert set(matrices) == {"bicycle", "M", "C1", "K0", "K2"}
    for letter, matrix in load_bicycle(name).canonical.items():
        np.testing.assert_array_equal(matrices[letter], matrix)
    shown = answer("show", name)
    assert shown["parameters"] == load_bicycle(name).numbers
    assert shown["source"] == load_bicycle(name).source


@pytest.mark.parametrize("speed", [0, 3.6])
def test_eigenvalues(answer: Any, speed: float) -> None:
    document = answer("eigenvalues", "benchmark", "--speed", speed)
    assert (document["bicycle"], document["speed"]) == ("benchmark", speed)
    roots = [complex(value["re"], value["im"]) for value in document["eigenvalues"]]
    np.testing.assert_array_equal(roots, eigenvalues(load_bicycle("benchmark"), speed))


def test_stability_with_and_without_an_upper_end(answer: Any) -> None:
    benchmark, skate = answer("stability", "benchmark"), answer("stability", "tms_eq_10_1")
    expected = stability(load_bicycle("benchmark"))
    assert benchmark["stable_speed_ranges"] == [[expected.weave_speed, expected.capsize_speed]]
    assert (benchmark["weave_speed"], benchmark["capsize_speed"]) == (
        expected.weave_speed,
        expected.capsize_speed,
    )
    assert skate["stable_speed_ranges"] == [[skate["weave_speed"], None]]
    assert skate["capsize_speed"] is None


def test_response(answer: Any) -> None:
    document = answer(
        "response", "delft_sbw", "--speed", 3, "--lean-rate", -0.7, "--gain", 7, "--duration", 2
    )
    system = linear_system(load_bicycle("delft_sbw"), 3.0, 7.0)
    times = np.arange(201) * 0.01
    states = response(system, np.array([0.0, 0.0, -0.7, 0.0]), times)
    np.testing.assert_allclose(document["time"], times)
    for index, column in enumerate(("lean", "steer", "lean_rate", "steer_rate")):
        np.testing.assert_allclose(document[column], states[:, index], rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(document["yaw_rate"], states @ system.yaw, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("question", ["list", "show", "matrices", "eigenvalues", "stability", "response"])
def test_tables_for_people(command: Any, question: str) -> None:
    rest = {"eigenvalues": ["--speed", 3], "response": ["--speed", 3, "--lean-rate", 1, "--step", 0.5]}
    done = command(
        "tms_model", question, *([] if question == "list" else ["benchmark"]), *rest.get(question, [])
    )
    assert (done.code, done.err) == (0, "")
    assert len(done.out.splitlines()) == {
        "list": len(bicycle_names()),
        "show": 29,
        "stability": 3,
        "response": 10,
    }.get(question, 4)


@pytest.mark.parametrize("suffix", ["png", "svg", "pdf"])
def test_plot(command: Any, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"figure.{suffix}"
    assert command("tms_model", "plot", "tms_table_7_1", "-o", path).code == 0
    start = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}[suffix]
    assert path.read_bytes().startswith(start)
    assert list(tmp_path.iterdir()) == [path]


REFUSED = {
    "unknown bicycle": (["stability", "tandem"], "unknown bicycle 'tandem': expected one of benchmark"),
    "missing file": (["show", "mine.yaml"], "mine.yaml: expected a readable YAML file"),
    "negative speed": (
        ["eigenvalues", "benchmark", "--speed", "-1"],
        "expected zero or a positive number of m/s",
    ),
    "no speed": (["eigenvalues", "benchmark"], "--speed"),
    "speed in words": (["eigenvalues", "benchmark", "--speed", "fast"], "'fast'"),
    "speed NaN": (["eigenvalues", "benchmark", "--speed", "nan"], "found nan"),
    "response at rest": (
        ["response", "benchmark", "--speed", "0", "--lean-rate", "1"],
        "speed: expected a positive",
    ),
    "infinite lean rate": (["response", "benchmark", "--speed", "3", "--lean-rate", "inf"], "found inf"),
    "step zero": (
        ["response", "benchmark", "--speed", "3", "--lean-rate", "1", "--step", "0"],
        "positive step",
    ),
    "endless response": (
        ["response", "benchmark", "--speed", "3", "--lean-rate", "1", "--duration", "1e9"],
        "1 to 1000000",
    ),
    "NaN duration": (
        ["response", "benchmark", "--speed", "3", "--lean-rate", "1", "--duration", "nan"],
        "1 to 1000000",
    ),
    "infinite gain": (
        ["response", "benchmark", "--speed", "3", "--lean-rate", "1", "--gain", "inf"],
        "gain: expected a finite number",
    ),
    "figure of another kind": (["plot", "benchmark", "-o", "figure.jpg"], "ends in .png, .svg or .pdf"),
    "figure in a file": (
        ["plot", "benchmark", "-o", "/dev/null/figure.png"],
        "expected a place to write a file",
    ),
    "unknown question": (["fly", "benchmark"], "invalid choice: 'fly'"),
    "no question": ([], "required"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_bad_input(refused: Any, case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    arguments, said = REFUSED[case]
    assert said in refused("tms_model", *arguments)
    assert list(tmp_path.iterdir()) == []


def test_as_a_process() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tms_model", "stability", "benchmark", "--json"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stderr == ""
    assert math.isclose(json.loads(done.stdout)["weave_speed"], 4.29238253634111, rel_tol=1e-12)
    done = subprocess.run(
        [sys.executable, "-m", "tms_model", "show", "tandem"], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)


def test_reader_that_leaves_early_is_no_error() -> None:
    # As in `tms model response ... | head -1`.
    shell = f"{sys.executable} -m tms_model response benchmark --speed 3 --lean-rate 1 --step 1e-4 | head -1"
    done = subprocess.run(["bash", "-c", shell], capture_output=True, text=True, check=True)
    assert done.stderr == ""
    assert len(done.stdout.splitlines()) == 1


@pytest.mark.parametrize(
    "arguments",
    [
        ("eigenvalues", "benchmark", "--speed", "1e300"),
        ("response", "benchmark", "--speed", "1e200", "--lean-rate", "0.5"),
        ("stability", "benchmark", "--set", "front_wheel_inertia_yy=1e308"),
        ("linearity", "benchmark", "--speed", "1e6"),
        ("linearity", "benchmark", "--speed", "5", "--duration", "1e9"),
    ],
)
def test_absurd_but_finite_numbers_are_one_line(arguments: tuple[str, ...]) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tms_model", *arguments], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert len(done.stderr.splitlines()) == 1
    assert done.stderr.startswith("error: ")


def test_urdf(command: Any, answer: Any) -> None:
    text = command("tms_model", "urdf", "tms_eq_10_1").out  # drawn with the parameters that stand in for it
    assert text.startswith('<robot name="tms_eq_10_1">')
    assert answer("urdf", "tms_eq_10_1") == {"bicycle": "tms_eq_10_1", "urdf": text}
