"""Scenarios: what is recorded makes the same run again; what can't be run is refused by name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from tms_model import ParameterError
from tms_sim.imu_grade import imu_names, load_imu
from tms_sim.keys import KEYS
from tms_sim.run import simulate
from tms_sim.scenario import FOLDER, description, load_scenario, parse_change, scenario_names


def records(name: str, changes: dict[str, Any] | None = None) -> list[Any]:
    scenario = load_scenario(name, changes)
    return list(simulate(scenario, np.random.default_rng(scenario.integer("seed"))).records())


def flat(document: dict[str, Any]) -> dict[str, Any]:
    values = {}
    for key, value in document.items():
        if isinstance(value, dict):
            values |= {f"{key}.{leaf}": item for leaf, item in value.items()}
        else:
            values[key] = value
    return values


@pytest.mark.parametrize("name", scenario_names())
def test_every_scenario_holds_every_key_and_says_what_it_is(name: str) -> None:
    assert set(load_scenario(name).values) == set(KEYS)
    assert len(description(name)) > 10


@pytest.mark.parametrize("name", scenario_names())
@pytest.mark.quick_for(name=["tms_strike", "gym_run", "delft_push"])
def test_configuration_makes_the_same_run_again(name: str) -> None:
    changed = load_scenario(name, {"strike.lean_rate": 0.123, "seed": 99})
    configuration = flat(yaml.safe_load(changed.to_yaml()))
    assert configuration.pop("scenario") == name
    again = load_scenario(name, configuration)
    assert again.values == changed.values
    assert records(name, configuration) == records(name, {"strike.lean_rate": 0.123, "seed": 99})


def test_scenario_from_a_file(tmp_path: Path) -> None:
    document = yaml.safe_load((FOLDER / "tms_strike.yaml").read_text())
    document["strike"]["lean_rate"] = -0.4
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(document))
    mine = load_scenario(str(path))
    assert mine.name == "mine"
    assert mine.number("strike.lean_rate") == -0.4


WRONG_FILES = {
    "unknown key": ({"wind": 3.0}, "unknown wind"),
    "unknown key in a group": (
        {"strike": {"time": 2.0, "lean_rate": 0.5, "steer_rate": 0.0, "force": 1.0}},
        "force",
    ),
    "missing key in a group": ({"strike": {"time": 2.0, "lean_rate": 0.5}}, "strike: missing steer_rate"),
    "number for a group": ({"strike": 2.0}, "strike: expected keys time, lean_rate, steer_rate, found float"),
    "text for a number": (
        {"speed": "fast"},
        "speed: expected forward speed at the release [m/s], from 0.1 to 30, found 'fast'",
    ),
    "true for a number": ({"speed": True}, "found True"),
    "nothing": ({"speed": None}, "found None"),
    "number for a name": ({"bicycle": 5}, "bicycle: expected name in the catalogue"),
    "no name": ({"bicycle": ""}, "bicycle: expected"),
    "list for a number": ({"speed": [1.0, 2.0]}, "found [1.0, 2.0]"),
    "fraction for a whole number": ({"seed": 1.5}, "a whole number, found 1.5"),
}


@pytest.mark.parametrize("case", WRONG_FILES)
def test_wrong_files_are_refused(case: str, tmp_path: Path) -> None:
    changes, said = WRONG_FILES[case]
    document = yaml.safe_load((FOLDER / "tms_strike.yaml").read_text()) | changes
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(document))
    with pytest.raises(ParameterError) as error:
        load_scenario(str(path))
    assert said in str(error.value)


@pytest.mark.parametrize("key", [key for key, rule in KEYS.items() if rule.kind in (int, float)])
def test_every_number_has_a_range_that_is_kept(key: str) -> None:
    rule = KEYS[key]
    beyond = [rule.low - 1, rule.high * 2 + 1]
    for value in [*beyond, *([] if rule.kind is int else [float("nan"), float("inf")])]:
        with pytest.raises(ParameterError, match=f"^{key}: expected"):
            load_scenario("tms_strike", {key: value})


@pytest.mark.parametrize("key", [key for key, rule in KEYS.items() if rule.kind is tuple])
@pytest.mark.parametrize(
    "value", [[0.0, 0.0], [0.0, 0.0, 1e4], [0.0, 0.0, "a"], 1.0, "here", [0.0, 0.0, float("nan")]]
)
def test_places_are_three_numbers_in_range(key: str, value: Any) -> None:
    with pytest.raises(ParameterError, match=f"^{key}: expected .*, three numbers, found"):
        load_scenario("tms_strike", {key: value})


@pytest.mark.parametrize("time", [8.0, 8.1, 3600.0])
def test_strike_must_fall_inside_the_record(time: float) -> None:
    with pytest.raises(
        ParameterError, match=r"strike\.time: expected a strike inside the record of 8 s, found"
    ):
        load_scenario("tms_strike", {"strike.time": time})


def test_unknown_names_list_the_known_ones() -> None:
    with pytest.raises(ParameterError) as error:
        load_scenario("moon")
    assert all(name in str(error.value) for name in scenario_names())
    with pytest.raises(ParameterError) as error:
        load_scenario("tms_strike", {"wind": 3.0})
    assert all(key in str(error.value) for key in KEYS)
    with pytest.raises(ParameterError) as error:
        load_imu("moon")
    assert all(name in str(error.value) for name in imu_names())


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("strike.time=1.5", 1.5),
        (" strike.time = 1.5", 1.5),
        ("strike.time=15e-1", 1.5),  # a text by YAML 1.1, a number by everybody else
        ("imu.position=[0, 0, 1]", (0.0, 0.0, 1.0)),
        ("bicycle=benchmark", "benchmark"),
        ("seed=12", 12),
    ],
)
def test_changes_from_the_command_line(text: str, value: Any) -> None:
    key, parsed = parse_change(text)
    assert load_scenario("tms_strike", {key: parsed}).values[key] == value


@pytest.mark.parametrize("text", ["speed", "speed: 3", "speed=[1", "speed={a: b: c}", ""])
def test_changes_that_are_none(text: str) -> None:
    with pytest.raises(ParameterError, match="--set: expected KEY=VALUE, found"):
        parse_change(text)


@pytest.mark.parametrize("name", imu_names())
def test_every_sensor_loads(name: str) -> None:
    sensor = load_imu(name).only(["noise_density"])
    assert sensor.gyroscope.noise_std(400.0) == pytest.approx(2.0 * sensor.gyroscope.noise_std(100.0))
    assert sensor.accelerometer.noise_std(1.0) == sensor.accelerometer.noise_density


@pytest.mark.parametrize(
    "wrong", [{"gyroscope_limit": 0.0}, {"gyroscope_noise_density": -1.0}, {"bias": 1.0}]
)
def test_wrong_sensors_are_refused(
    wrong: dict[str, float], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    document = yaml.safe_load((FOLDER.parent / "imus" / "pi_node.yaml").read_text()) | wrong
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(document))
    monkeypatch.setattr("tms_sim.imu_grade.FOLDER", tmp_path)
    with pytest.raises(ParameterError, match=next(iter(wrong))):
        load_imu("mine")


def test_a_scenario_says_what_differs_from_its_parent(tmp_path: Path) -> None:
    text = {"description": "mine", "source": "me", "uncertainty": "all of it"}
    (tmp_path / "first.yaml").write_text(
        yaml.safe_dump({**text, "parent": "tms_strike", "speed": 4.0, "strike": {"lean_rate": -0.1}})
    )
    (tmp_path / "second.yaml").write_text(yaml.safe_dump({**text, "parent": "first.yaml", "duration": 5.0}))
    mine, whole = load_scenario(str(tmp_path / "second.yaml")), load_scenario("tms_strike")
    expected = whole.values | {"speed": 4.0, "strike.lean_rate": -0.1, "duration": 5.0}
    assert mine.values == expected
    assert mine.name == "second"


@pytest.mark.parametrize(
    ("parent", "said"),
    [("moon", "parent: expected a scenario"), ("mine.yaml", "parent: expected a scenario"), (3, "parent")],
)
def test_parents_that_are_none_are_refused(parent: Any, said: str, tmp_path: Path) -> None:
    text = {"description": "mine", "source": "me", "uncertainty": "all of it"}
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump({**text, "parent": parent}))
    with pytest.raises(ParameterError, match=said):
        load_scenario(str(tmp_path / "mine.yaml"))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"strike.time": [1.0, 2.0], "strike.lean_rate": [0.1, 0.2, 0.3]}, "as many as strike.time"),
        ({"strike.time": [2.0, 1.0]}, "one after the other"),
        ({"strike.time": []}, "strike.time: expected"),
        ({"strike.time": [1.0, True]}, "found"),
        ({"run_up.duration": 3.0}, "after the release"),
        ({"effects.slip": 1}, "effects.slip: expected .*, true or false, found 1"),
        ({"effects.slip": "yes"}, "effects.slip: expected"),
    ],
)
def test_strikes_and_switches_are_told_as_they_must_be(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(ParameterError, match=said):
        load_scenario("tms_strike", changes)


def test_one_number_serves_all_strikes() -> None:
    scenario = load_scenario("tms_strike", {"strike.time": [1.0, 2.0, 3.0], "strike.lean_rate": 0.2})
    assert scenario.numbers("strike.time") == (1.0, 2.0, 3.0)
    assert scenario.numbers("strike.lean_rate") == (0.2,)
