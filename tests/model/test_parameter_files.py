"""Parameter files of BicycleParameters: read as that package reads them, and refused in words."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from tms_model import Bicycle, ParameterError, load_bicycle
from tms_model.parameter_files import SYMBOLS
from tms_model.principal_form import PRINCIPAL_SYMBOLS, from_principal


def text_of(numbers: dict[str, Any]) -> str:
    return "".join(f"{symbol} = {value}\n" for symbol, value in numbers.items())


def benchmark() -> dict[str, Any]:
    """The benchmark bicycle by its symbols, from the catalogue."""
    return {symbol: getattr(load_bicycle("benchmark").parameters, name) for symbol, name in SYMBOLS.items()}


@pytest.fixture
def written(tmp_path: Path) -> Callable[..., Bicycle]:
    def load(text: str, name: str = "mine.txt") -> Bicycle:
        (tmp_path / name).write_text(text)
        return load_bicycle(str(tmp_path / name))

    return load


def test_every_parameter_has_one_symbol() -> None:
    parameters = load_bicycle("benchmark").parameters
    assert sorted(SYMBOLS.values()) == sorted(vars(parameters))


def test_benchmark_as_text_and_as_yaml_is_the_catalogues(written: Callable[..., Bicycle]) -> None:
    numbers = benchmark()
    values = {"parameterization": "benchmark", "parameters": "benchmark", "rider": True, "values": numbers}
    for bicycle in (
        written(text_of(numbers)),
        written(yaml.safe_dump(numbers), "mine.yml"),
        written(yaml.safe_dump({**values, "description": "as\nprinted"}), "mine.yaml"),
    ):
        assert bicycle.name == "mine"
        assert bicycle.parameters == load_bicycle("benchmark").parameters
        assert bicycle.standard_deviations == {}
    assert bicycle.description == "as printed"


@pytest.mark.parametrize(
    ("text", "value", "deviation"),
    [
        ("0.08+/-0.01", 0.08, 0.01),
        (" 0.08 +/- 0.01   # by hand", 0.08, 0.01),
        ("8e-2+/-1E-2", 0.08, 0.01),
        ("(8.0+/-1.0)e-02", 0.08, 0.01),
        ("0.08", 0.08, None),
        ("0.08+/-0.0", 0.08, None),
        (".07, .09", 0.08, None),
        # Two measurements: the mean, and sqrt(3^2 + 4^2) / 2 = 2.5.
        ("0.07+/-0.03, 0.09+/-0.04", 0.08, 0.025),
    ],
)
def test_numbers(written: Callable[..., Bicycle], text: str, value: float, deviation: float | None) -> None:
    bicycle = written("# a comment\n\n" + text_of({**benchmark(), "c": text}))
    assert bicycle.trail == pytest.approx(value, rel=1e-15)
    assert bicycle.standard_deviations == ({"trail": pytest.approx(deviation)} if deviation else {})


def test_what_is_said_twice_or_not_needed(written: Callable[..., Bicycle]) -> None:
    numbers = benchmark()
    more = {"v": 5.0, "yB": 0.0, "IRzz": numbers["IRxx"], "mG": 3.35, "xS": 0.9, "IGxz": 0.005}
    assert written(text_of({**numbers, **more})).parameters == load_bicycle("benchmark").parameters


WRONG: dict[str, tuple[Callable[[], str], str]] = {
    "no number": (lambda: text_of({**benchmark(), "c": "8 cm"}), "line 2: c: expected a number such as"),
    "half a number": (lambda: text_of({**benchmark(), "c": "0.08+/-"}), "found '0.08+/-'"),
    "infinite": (lambda: text_of({**benchmark(), "c": "1e999"}), "expected a finite number"),
    "negative deviation": (
        lambda: text_of({**benchmark(), "c": "1+/--0.1"}),
        "zero or more, found '1+/--0.1'",
    ),
    "no equals sign": (lambda: text_of(benchmark()) + "mass 3\n", "line 27: expected 'symbol = value'"),
    "twice": (lambda: text_of(benchmark()) + "c = 0.1\n", "line 27: c stands there for the second time"),
    "unknown symbol": (lambda: text_of({**benchmark(), "mX": 1.0}), "unknown mX; expected w, c, lam"),
    "a rider alone": (lambda: text_of({"mB": 72.0, "xB": 0.3}), "missing w, c, lam"),
    "not round": (lambda: text_of({**benchmark(), "IRzz": 1.0}), "IRzz: expected 0.0603, as IRxx"),
    "one-sided": (lambda: text_of({**benchmark(), "yB": 0.01}), "yB: expected 0, since the model is symm"),
    "massless": (lambda: text_of({**benchmark(), "w": 0.0}), "wheelbase: expected a positive number"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_text_files_are_refused(written: Callable[..., Bicycle], case: str) -> None:
    make, said = WRONG[case]
    with pytest.raises(ParameterError) as error:
        written(make())
    assert said in str(error.value)
    assert "mine.txt" in str(error.value)


def test_files_that_cannot_be_read_are_named(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match=r"nowhere\.txt: expected a readable text file, found: No such"):
        load_bicycle(str(tmp_path / "nowhere.txt"))
    (tmp_path / "picture.txt").write_bytes(b"\x89PNG\xff")
    with pytest.raises(ParameterError, match=r"picture\.txt: expected a text file"):
        load_bicycle(str(tmp_path / "picture.txt"))


def principal() -> dict[str, float]:
    """A bicycle whose every number differs: rider above the frame, all axes turned."""
    return {symbol: 0.1 + 0.01 * index for index, symbol in enumerate(PRINCIPAL_SYMBOLS)}


def test_principal_form_is_the_same_mass_in_space() -> None:
    # Independently: mass points, two on each principal axis, put at their places and summed up.
    values = principal()
    numbers = from_principal(values)
    points = []
    for body in "DP":
        mass, alpha = values[f"m{body}"], values[f"alpha{body}"]
        squares = np.array([values[f"k{body}{axes}"] ** 2 for axes in ("aa", "yy", "bb")])
        reach = np.sqrt(3.0 * (squares.sum() / 2.0 - squares))
        axes = np.array(
            [
                [math.cos(alpha), 0.0, -math.sin(alpha)],
                [0.0, 1.0, 0.0],
                [math.sin(alpha), 0.0, math.cos(alpha)],
            ]
        )
        centre = np.array([values[f"x{body}"], 0.0, values[f"z{body}"]])
        for axis, length in zip(axes, reach, strict=True):
            points += [(mass / 6.0, centre + sign * length * axis) for sign in (1.0, -1.0)]
    total = sum(mass for mass, _ in points)
    centre = sum(mass * place for mass, place in points) / total
    assert [numbers["mB"], numbers["xB"], numbers["zB"]] == pytest.approx([total, centre[0], centre[2]])
    inertia = sum(
        mass * ((place - centre) @ (place - centre) * np.eye(3) - np.outer(place - centre, place - centre))
        for mass, place in points
    )
    xx, xz, yy, zz = (numbers[f"IB{axes}"] for axes in ("xx", "xz", "yy", "zz"))
    found = [[xx, 0.0, xz], [0.0, yy, 0.0], [xz, 0.0, zz]]
    np.testing.assert_allclose(found, inertia, rtol=1e-12, atol=1e-14)


WRONG_YAML: dict[str, tuple[Callable[[], Any], str]] = {
    "another form": (
        lambda: {"parameterization": "Moore2012", "values": benchmark()},
        "parameterization benchmark or Meijaard2007 or principal or Moore2019, found 'Moore2012'",
    ),
    "unknown key": (lambda: {"values": benchmark(), "rider_name": "J"}, "unknown rider_name"),
    "no mapping": (lambda: {"values": [1, 2]}, "values: expected symbols with numbers, found list"),
    "true": (lambda: {**benchmark(), "c": True}, "c: expected a number, found True"),
    "NaN": (lambda: {**benchmark(), "c": math.nan}, "c: expected a number such as"),
    "half a principal form": (lambda: {"w": 1.0, "lam": 0.1, "mD": 3.0}, "missing c, g, rR"),
    "too much in it": (lambda: {**principal(), "kZ": 1.0}, "unknown kZ; expected w, c"),
    "deviations of a principal form": (
        lambda: {**principal(), "w": "1.0+/-0.1"},
        "Meijaard et al. 2007 only",
    ),
}


@pytest.mark.parametrize("case", WRONG_YAML)
def test_wrong_yaml_files_are_refused(written: Callable[..., Bicycle], case: str) -> None:
    make, said = WRONG_YAML[case]
    with pytest.raises(ParameterError) as error:
        written(yaml.safe_dump(make()), "mine.yaml")
    assert said in str(error.value)
    assert "mine.yaml" in str(error.value)


def test_the_catalogues_own_form_has_standard_deviations_too(written: Callable[..., Bicycle]) -> None:
    source = load_bicycle("benchmark")
    parameters = {**vars(source.parameters)}
    parameters["steer_axis_tilt_deg"] = math.degrees(parameters.pop("steer_axis_tilt"))
    document = {"description": "d", "source": "s", "uncertainty": "u", "parameters": parameters}
    deviations = {"trail": 0.002, "steer_axis_tilt_deg": 0.2}
    bicycle = written(yaml.safe_dump({**document, "standard_deviations": deviations}), "mine.yaml")
    assert bicycle.standard_deviations == {
        "trail": 0.002,
        "steer_axis_tilt": pytest.approx(math.radians(0.2)),
    }
    for wrong, said in (({"trial": 0.1}, "unknown trial"), ({"trail": -0.1}, "zero or more, found -0.1")):
        with pytest.raises(ParameterError, match=said):
            written(yaml.safe_dump({**document, "standard_deviations": wrong}), "mine.yaml")


def test_from_the_command_line(command: Any, tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text(text_of(benchmark()))
    ours, theirs = (command("tms_model", "stability", name) for name in ("benchmark", tmp_path / "mine.txt"))
    assert ours.out.replace("benchmark", "") == theirs.out.replace("mine", "")
