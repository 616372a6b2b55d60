"""The options table of a fit: command line, node, JSON and reference page follow from it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from tms_fit.estimators import ESTIMATORS
from tms_fit.least_squares.losses import LOSSES
from tms_fit.parameters import INITIAL, PARAMETERS, STRIKE, UNITS
from tms_fit.settings import OPTIONS, Option, Settings
from tms_fit.settings_parser import add_options, settings_of
from tms_model.command_line import Parser
from tms_model.errors import ParameterError
from tms_model.response import STATE

DOCUMENT = Path(__file__).parents[2] / "docs" / "options.md"


def parsed(*words: str) -> Settings:
    parser = Parser()
    add_options(parser)
    return settings_of(parser.parse_args(words))


def row(one: Option) -> str:
    """An option as docs/options.md should show it."""
    default = ", ".join(map(str, one.default)) if isinstance(one.default, tuple | dict) else one.default
    shown = f"`{default:g}`" if isinstance(default, float) else f"`{default}`" if default else one.unset
    limits = ", ".join(f"`{name}`" for name in one.choices) if one.choices != PARAMETERS else "a parameter"
    node = f"`{one.parameter}`" if one.parameter else ""
    line = f"`{one.flag}`" if one.flag else ""
    unit = f" [{one.unit}]" if one.unit else ""
    return f"| `{one.name}` | {line} | {node} | {shown} | {limits or one.limits} | {one.help}{unit} |"


def test_without_arguments_the_settings_are_the_defaults() -> None:
    assert parsed() == Settings()


def test_each_option_is_read_from_the_command_line() -> None:
    texts = {
        "number": "0.4",
        "numbers": "8,0.2",
        "values": "speed=3",
        "priors": "speed=3,0.1",
        "angles": "0,0,90",
    }
    for name, one in OPTIONS.items():
        if one.flag:
            text = texts.get(one.kind) or one.choices[-1]
            assert getattr(parsed(one.flag, text), name) != one.default, name


def test_json_holds_every_option() -> None:
    settings = Settings(fixed={"speed": 3.0}, priors={"steer_damper": (0.0, 1.0)}, filter="extended")
    document = settings.as_json()
    assert list(document) == list(OPTIONS)
    assert document["fixed"] == {"speed": 3.0}
    assert document["priors"] == {"steer_damper": [0.0, 1.0]}
    assert document["filter"] == "extended"
    assert document["channels"] == ["lean_rate", "yaw_rate"]


@pytest.mark.parametrize("name", [name for name, one in OPTIONS.items() if one.kind == "number"])
def test_numbers_keep_to_their_range(name: str) -> None:
    one = OPTIONS[name]
    low = 0.0 if one.positive else one.low
    for wrong in (low if one.positive else low - 0.01, one.high * 1.01, float("nan")):
        with pytest.raises(ParameterError, match=f"^{name.replace('_', ' ')}: expected .* found"):
            Settings(**{name: wrong})


@pytest.mark.parametrize("name", [name for name, one in OPTIONS.items() if one.kind == "choice"])
def test_choices_are_those_that_exist(name: str) -> None:
    for choice in OPTIONS[name].choices:
        assert getattr(Settings(**{name: choice}), name) == choice
    with pytest.raises(ParameterError, match=f"^{name.replace('_', ' ')}: unknown 'none'; expected of"):
        Settings(**{name: "none"})


@pytest.mark.parametrize("text", ["90", "0,0", "0,0,0,1", "0,0,nan"])
def test_an_orientation_is_three_finite_angles(text: str) -> None:
    with pytest.raises(ParameterError, match=rf"expected ROLL,PITCH,YAW \[deg\] or auto, found {text}"):
        parsed("--imu-orientation", text)


@pytest.mark.parametrize("text", ["upright", "0,0,x", "", "0;0;90"])
def test_an_orientation_is_of_numbers_or_auto(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert parsed("--imu-orientation", "auto").imu_orientation == "auto"
    assert parsed("--imu-orientation", "-90,0,180").imu_orientation == (-90.0, 0.0, 180.0)
    assert parsed("--imu-orientation=-90,0,180").imu_orientation == (-90.0, 0.0, 180.0)
    with pytest.raises(SystemExit):
        parsed("--imu-orientation", text)
    assert f"expected ROLL,PITCH,YAW [deg] or auto, found {text!r}" in capsys.readouterr().err


def test_names_in_the_table_are_those_of_the_modules_behind() -> None:
    assert OPTIONS["estimators"].choices == tuple(ESTIMATORS)
    assert OPTIONS["loss"].choices == LOSSES
    assert tuple(f"initial_{name}" for name in STATE) == INITIAL
    assert tuple(UNITS) == (*STRIKE, *PARAMETERS)


def test_reference_page_says_what_the_table_says() -> None:
    found = re.findall(r"^\| `.*\|$", DOCUMENT.read_text(), re.MULTILINE)
    expected = [row(one) for one in OPTIONS.values()]
    assert found == expected, "\n".join(["docs/options.md should say:", *expected])
