"""The catalogue of bicycles: every entry holds what an entry must, and what is wrong is said."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from tms_model import ParameterError, bicycle_names, load_bicycle
from tms_model.catalogue import FOLDER

Document = dict[str, Any]


@pytest.mark.parametrize("name", bicycle_names())
def test_every_bicycle_says_what_it_is_and_whence(name: str) -> None:
    bicycle = load_bicycle(name)
    assert bicycle.name == name
    for text in (bicycle.description, bicycle.source, bicycle.uncertainty):
        assert len(text) > 3


@pytest.mark.parametrize("name", bicycle_names())
def test_numbers_define_the_bicycle(name: str, tmp_path: Path) -> None:
    # What `tms model show` prints and a recording carries is enough to build the same bicycle again.
    bicycle = load_bicycle(name)
    values: dict[str, Any] = dict(bicycle.numbers)
    values["steer_axis_tilt_deg"] = math.degrees(values.pop("steer_axis_tilt"))
    document: Document = {"description": "copy", "source": "test", "uncertainty": "none"}
    if bicycle.parameters is not None:
        document["parameters"] = values
    else:
        letters = ("M", "C1", "K0", "K2")
        rows = ("lean", "steer")
        document["matrices"] = {k: [[values[f"{k}_{i}_{j}"] for j in rows] for i in rows] for k in letters}
        document["geometry"] = {
            key: value for key, value in values.items() if key.partition("_")[0] not in letters
        }
    path = tmp_path / "copy.yaml"
    path.write_text(yaml.safe_dump(document))
    copy = load_bicycle(str(path))
    assert copy.name == "copy"
    for letter, matrix in bicycle.canonical.items():
        np.testing.assert_allclose(copy.canonical[letter], matrix, rtol=1e-12, atol=1e-15)
    assert copy.steer_axis_tilt == pytest.approx(bicycle.steer_axis_tilt, rel=1e-14)


def test_degrees_end_in_deg() -> None:
    assert load_bicycle("benchmark").steer_axis_tilt == pytest.approx(math.pi / 10.0, rel=1e-15)


def _assembled() -> Document:
    return dict(yaml.safe_load((FOLDER / "benchmark.yaml").read_text()))


def _given() -> Document:
    return dict(yaml.safe_load((FOLDER / "tms_eq_10_1.yaml").read_text()))


def _put(document: Document, group: str, key: str, value: Any) -> Document:
    return {**document, group: {**document[group], key: value}}


def _without(document: Document, group: str, key: str) -> Document:
    return {**document, group: {k: v for k, v in document[group].items() if k != key}}


WRONG: dict[str, tuple[Callable[[], Any], str]] = {
    "unknown key": (
        lambda: _put(_assembled(), "parameters", "wheel_base", 1.0),
        "unknown wheel_base; expected",
    ),
    "missing key": (
        lambda: _without(_assembled(), "parameters", "trail"),
        "missing trail; expected wheelbase",
    ),
    "radians under the name of degrees": (
        lambda: _put(
            _without(_assembled(), "parameters", "steer_axis_tilt_deg"), "parameters", "steer_axis_tilt", 0.3
        ),
        "missing steer_axis_tilt_deg",
    ),
    "text for a number": (
        lambda: _put(_assembled(), "parameters", "trail", "8 cm"),
        "parameters.trail: expected a finite number, found '8 cm'",
    ),
    "true for a number": (lambda: _put(_assembled(), "parameters", "trail", True), "found True"),
    "nothing for a number": (lambda: _put(_assembled(), "parameters", "trail", None), "found None"),
    "NaN": (
        lambda: _put(_assembled(), "parameters", "trail", math.nan),
        "expected a finite number, found nan",
    ),
    "infinity": (
        lambda: _put(_assembled(), "parameters", "trail", math.inf),
        "expected a finite number, found inf",
    ),
    "no source": (lambda: {k: v for k, v in _assembled().items() if k != "source"}, "missing source"),
    "parameters are a list": (lambda: {**_assembled(), "parameters": [1, 2]}, "found list"),
    "matrices and parameters": (
        lambda: {**_given(), "parameters": _assembled()["parameters"]},
        "unknown parameters",
    ),
    "matrix of the wrong shape": (
        lambda: _put(_given(), "matrices", "K0", [[1.0, 2.0]]),
        "K0: expected a 2 x 2 list of finite numbers, found",
    ),
    "ragged matrix": (lambda: _put(_given(), "matrices", "K0", [[1.0, 2.0], [3.0]]), "expected a 2 x 2 list"),
    "text in a matrix": (lambda: _put(_given(), "matrices", "K0", [[1.0, "a"], [2.0, 3.0]]), "2 x 2 list"),
    "NaN in a matrix": (
        lambda: _put(_given(), "matrices", "K0", [[1.0, math.nan], [2.0, 3.0]]),
        "2 x 2 list",
    ),
    "unsymmetric mass": (
        lambda: _put(_given(), "matrices", "M", [[2.31, 0.006], [0.007, 0.003]]),
        "symmetric positive definite mass matrix",
    ),
    "missing matrix": (lambda: _without(_given(), "matrices", "K2"), "missing K2"),
    "unknown geometry": (lambda: _put(_given(), "geometry", "height", 1.0), "unknown height"),
    "a list": (lambda: [1, 2, 3], "expected a mapping of keys, found list"),
    "nothing": (lambda: None, "expected a mapping of keys, found NoneType"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_files_are_refused_by_name(case: str, tmp_path: Path) -> None:
    make, said = WRONG[case]
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(make()))
    with pytest.raises(ParameterError) as error:
        load_bicycle(str(path))
    assert said in str(error.value)
    assert "mine" in str(error.value)  # which file, or which bicycle


def test_what_is_no_yaml_is_said_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "broken.yaml"
    path.write_text("a: [1, 2\nb: }")
    with pytest.raises(ParameterError, match="expected YAML, found"):
        load_bicycle(str(path))
    path.write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(ParameterError, match="expected YAML, found"):
        load_bicycle(str(path))


@pytest.mark.parametrize("name", ["tandem", "", "Benchmark", "bench mark"])
def test_unknown_name_lists_the_known_ones(name: str) -> None:
    with pytest.raises(ParameterError) as error:
        load_bicycle(name)
    for known in bicycle_names():
        assert known in str(error.value)


def test_missing_file_is_named() -> None:
    with pytest.raises(
        ParameterError, match=r"nowhere/mine\.yaml: expected a readable YAML file, found: No such file"
    ):
        load_bicycle("nowhere/mine.yaml")


def test_yaml_cannot_run_code(tmp_path: Path) -> None:
    path = tmp_path / "evil.yaml"
    path.write_text(f"description: !!python/object/apply:os.system ['touch {tmp_path}/ran']\n")
    with pytest.raises(ParameterError, match="expected YAML"):
        load_bicycle(str(path))
    assert not (tmp_path / "ran").exists()
