"""Which speed a fit used and where it is from."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tms_bag import BagWriter, Record, read_recording, topics
from tms_fit import Settings, fit_recording
from tms_fit.output import to_json
from tms_fit.speed_source import live_speed_sentence, other_speed_topics

USUAL = "/bicycle/speed"
RATE = 3.0  # [m/s] that the run had; its run_info states 3.6
QUICK = Settings(estimators=("least_squares",), noise="white", free=("initial_lean_rate",))


@pytest.fixture(scope="module")
def run(make_run: Any) -> Any:
    made = make_run("tms_strike", speed=RATE, speed_at_strike=RATE, duration=4.0)
    return replace(made, info=replace(made.info, speed=3.6))


@pytest.fixture
def bag_with(tmp_path: Path, run: Any) -> Callable[..., Path]:
    """A bag of the run whose speeds have other topics."""

    def write(*names: str) -> Path:
        records: list[Record] = []
        for record in run.records():
            usual = record.topic == "/bicycle/speed"
            records += [replace(record, topic=name) for name in names] if usual else [record]
        with BagWriter(tmp_path / "bag") as bag:
            for record in records:
                bag.write(record, topics.QOS.get(record.topic[1:], topics.QOS[topics.SPEED]))
        return tmp_path / "bag"

    return write


CASES = {  # topics, arguments, source, topic, value, words of the table
    "measured": ([USUAL], [], "measured", USUAL, None, "speed measured on /bicycle/speed"),
    "another name": (
        ["/wheel/speed"], [], "measured", "/wheel/speed", None,
        "warning: the speed is that of /wheel/speed, the only topic that may hold a measured one",
    ),
    "chosen": (["/a", "/b"], ["--speed-topic", "/b"], "measured", "/b", None, "speed measured on /b, "),
    "fixed": (
        [USUAL], ["--fix", "speed=3"], "fixed", None, 3.0, "speed 3.000 m/s, fixed in place of /bicycle",
    ),
    "prior": ([], ["--prior", "speed=3,0.1"], "prior", None, 3.0, "speed 3.000 m/s, the mean of its prior"),
    "nominal": ([], [], "run_info", None, 3.6, "speed 3.600 m/s, the nominal one of run_info: none was meas"),
    "command": (["/cmd_vel"], [], "run_info", None, 3.6, "warning: /cmd_vel: a command by its name"),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_table_and_json_say_which_speed_was_used(bag_with: Any, command: Any, case: str) -> None:
    names, arguments, source, topic, value, words = CASES[case]
    words_of_run = ["run", bag_with(*names), "--estimator", "least_squares", *arguments]
    done = json.loads(command("tms_fit", *words_of_run, "--json").out)
    stated = done["speed_source"]
    assert (stated["source"], stated["topic"], stated["value"]) == (source, topic, value)
    (strike,) = done["strikes"]
    assert strike["speed_source"] == source
    assert strike["speed"] == pytest.approx(3.6 if source == "run_info" else RATE, abs=0.05)
    message = strike["estimates"][0]["message"]
    assert ("is the nominal one of run_info" in message) == (source == "run_info")
    assert any("is the nominal one of run_info" in one for one in done["warnings"]) == (source == "run_info")
    assert words in command("tms_fit", *words_of_run).out


def test_several_topics_are_listed_with_the_flag_to_type(bag_with: Any, refused: Any, run: Any) -> None:
    path = bag_with("/wheel/speed", "/belt/speed")
    text = refused("tms_fit", "run", path)
    assert "--speed-topic /belt/speed or --speed-topic /wheel/speed" in text
    # A stated speed needs none of them.
    fixed = fit_recording(read_recording(path), settings=replace(QUICK, fixed={"speed": RATE}))
    assert fixed.strikes[0].speed == RATE
    assert not any("topic" in one for one in to_json(fixed)["warnings"])


def test_speeds_that_begin_after_the_window_are_no_silent_reason_for_the_nominal_one(run: Any) -> None:
    late = run.speed.time_ns > run.info.start_ns + 3_600_000_000
    speed = replace(
        run.speed,
        time_ns=run.speed.time_ns[late],
        speed=run.speed.speed[late],
        variance=run.speed.variance[late],
    )
    fit = fit_recording(replace(run.recording(), speed=speed), settings=replace(QUICK, window=1.0))
    document = to_json(fit)
    assert document["speed_source"]["source"] == "measured"
    (strike,) = document["strikes"]
    assert strike["speed_source"] == "run_info"
    assert "nominal one of run_info: none was measured up to the window's end" in document["warnings"][0]


def test_a_live_run_names_the_topic_that_may_hold_its_speed() -> None:
    twist = topics.TYPES[topics.SPEED]
    graph = [("/wheel/speed", [twist]), ("/cmd_vel", [twist]), ("/bicycle/speed", [twist]), ("/imu", ["x"])]
    others = other_speed_topics(graph, ["/bicycle/speed"])
    assert others == ["/wheel/speed"]
    said = live_speed_sentence("run_info", "bicycle/speed", others)
    assert said.endswith("/wheel/speed may hold it: -r bicycle/speed:=/wheel/speed")
    assert live_speed_sentence("measured", "bicycle/speed", others) == "speed measured on bicycle/speed"
