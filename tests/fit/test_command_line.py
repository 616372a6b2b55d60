"""`tms fit`: JSON that other tools rely on, figures, and refusals in one line."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tms_bag import BagReader, BagWriter, Record
from tms_fit.estimators import ESTIMATORS
from tms_model.catalogue import FOLDER
from tms_sim.run import SimulatedRun


def write(path: Path, records: Any) -> Path:
    with BagWriter(path, custom_data={"seed": "1"}) as bag:
        for record in records:
            bag.write(record)
    return path


@pytest.fixture(scope="module")
def run(make_run: Any) -> SimulatedRun:
    made: SimulatedRun = make_run("tms_strike", strike__time=1.5037, duration=4.5)
    return made


@pytest.fixture(scope="module")
def bag(run: SimulatedRun, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("fit") / "bag", run.records())


def test_json_keys_that_stay(command: Any, bag: Path, run: SimulatedRun) -> None:
    done = command("tms_fit", "run", bag, "--json")
    assert (done.code, done.err) == (0, "")
    document = json.loads(done.out)
    assert {"bag", "bicycle", "start_ns", "strikes"} <= set(document)
    assert (document["bag"], document["bicycle"], document["start_ns"]) == (
        str(bag),
        "tms_eq_10_1",
        1_000_000_000,
    )
    (strike,) = document["strikes"]
    first, last = strike["window"]
    assert strike["time_ns"] <= first < last
    assert last - first == 1_500_000_000
    assert {first, last} <= set(run.imu.time_ns.tolist())
    assert [one["estimator"] for one in strike["estimates"]] == ["least_squares", "kalman_rts"]
    for estimate in strike["estimates"]:
        assert {"estimator", "status", "message", "parameters", "vaf", "sample_count"} <= set(estimate)
        assert estimate["status"] == "ok"
        assert set(estimate["parameters"]) == {"initial_lean_rate", "lean_rate_bias", "yaw_rate_bias"}
        assert set(estimate["vaf"]) == {"lean_rate", "yaw_rate"}
        assert estimate["sample_count"] == 2 * 151
        for parameter in estimate["parameters"].values():
            low, high = parameter["ci95"]
            assert low < parameter["value"] < high
            # 302 measurements, four unknowns with the start: 97.5 % of Student's t lie below 1.968.
            assert high - low == pytest.approx(2 * 1.968 * parameter["std"], rel=1e-3)
    assert document["settings"]["window"] == 1.5
    assert document["recording"]["seed"] == "1"


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_every_estimator_by_name(command: Any, bag: Path, estimator: str) -> None:
    document = json.loads(command("tms_fit", "run", bag, "--estimator", estimator, "--json").out)
    (answer,) = document["strikes"][0]["estimates"]
    assert (answer["estimator"], answer["status"]) == (estimator, "ok")
    assert answer["parameters"]["initial_lean_rate"]["value"] == pytest.approx(0.5, abs=0.05)


def test_estimators_in_the_order_asked_for(command: Any, bag: Path) -> None:
    words = [word for name in ("som2011", "least_squares") for word in ("--estimator", name)]
    document = json.loads(command("tms_fit", "run", bag, *words, "--json").out)
    assert [one["estimator"] for one in document["strikes"][0]["estimates"]] == ["som2011", "least_squares"]


def test_settings_reach_the_fit(command: Any, bag: Path) -> None:
    words = [
        "--free",
        "initial_lean_rate,initial_steer_rate",
        "--fix",
        "speed=3.5",
        "--fix",
        "lean_rate_bias=0.01",
    ]
    document = json.loads(command("tms_fit", "run", bag, *words, "--window", 0.8, "--json").out)
    (strike,) = document["strikes"]
    assert strike["speed"] == 3.5
    assert strike["window"][1] - strike["window"][0] == 800_000_000
    assert set(strike["estimates"][0]["parameters"]) == {"initial_lean_rate", "initial_steer_rate"}
    assert document["settings"]["fixed"] == {"speed": 3.5, "lean_rate_bias": 0.01}
    other = json.loads(command("tms_fit", "run", bag, "--bicycle", "tms_table_8_1", "--json").out)
    assert other["bicycle"] == "tms_table_8_1"


def test_what_is_too_short_is_a_status_not_an_error(command: Any, run: SimulatedRun, tmp_path: Path) -> None:
    # After the strike most samples are lost: what is left are 6 of both channels, and 4 unknowns ask for 14.
    # (One sample alone would be no strike: an outlier looks like that.)
    struck = run.info.start_ns + 1_500_000_000
    kept = (run.imu.time_ns <= struck + 40_000_000) | (
        (run.imu.time_ns >= struck + 290_000_000) & (run.imu.time_ns <= struck + 300_000_000)
    )
    imu = replace(
        run.imu,
        time_ns=run.imu.time_ns[kept],
        angular_velocity=run.imu.angular_velocity[kept],
        specific_force=run.imu.specific_force[kept],
    )
    bag = write(tmp_path / "short", replace(run, imu=imu).records())
    done = command(
        "tms_fit",
        "run",
        bag,
        "--free",
        "initial_lean,initial_steer,initial_lean_rate,initial_steer_rate",
        "--json",
    )
    assert done.code == 0
    (strike,) = json.loads(done.out)["strikes"]
    for estimate in strike["estimates"]:
        assert (estimate["status"], estimate["parameters"], estimate["vaf"]) == ("too_short", {}, {})
    assert (
        "too_short"
        in command(
            "tms_fit", "run", bag, "--free", "initial_lean,initial_steer,initial_lean_rate,initial_steer_rate"
        ).out
    )


def test_a_quiet_recording_has_no_strikes(command: Any, make_run: Any, tmp_path: Path) -> None:
    bag = write(tmp_path / "quiet", make_run("tms_strike", strike__lean_rate=0.0, duration=4.0).records())
    done = command("tms_fit", "run", bag, "--json")
    assert (done.code, json.loads(done.out)["strikes"]) == (0, [])
    assert "0 strikes" in command("tms_fit", "run", bag).out


def test_table_for_people(command: Any, bag: Path) -> None:
    done = command("tms_fit", "run", bag)
    assert (done.code, done.err) == (0, "")
    lines = done.out.splitlines()
    assert "tms_eq_10_1" in lines[0]
    assert sum("least_squares" in line for line in lines) == 1
    assert sum("kalman_rts" in line for line in lines) == 1


def altered(run: SimulatedRun, **arrays: np.ndarray) -> SimulatedRun:
    return replace(run, imu=replace(run.imu, **arrays))


def without(run: SimulatedRun, topic: str) -> list[Record]:
    return [record for record in run.records() if record.topic != topic]


def named(run: SimulatedRun, bicycle: str, **numbers: float) -> SimulatedRun:
    return replace(run, info=replace(run.info, bicycle=bicycle, parameters=numbers))


def at_speed(run: SimulatedRun, speed: float) -> SimulatedRun:
    return replace(run, speed=replace(run.speed, speed=np.full(len(run.speed.speed), speed)))


BAGS: dict[str, tuple[Callable[[SimulatedRun], Any], str]] = {
    "no IMU": (lambda run: without(run, "/imu/data_raw"), "expected a topic /imu/data_raw"),
    "no messages": (lambda run: [], "/imu/data_raw"),
    "no bicycle named": (lambda run: without(run, "/run_info"), "use --bicycle NAME"),
    "unknown bicycle named": (
        lambda run: named(run, "tandem").records(),
        "found 'tandem', expected all numbers of a bicycle, found missing wheelbase",
    ),
    "bicycle named by its file": (
        lambda run: named(run, str(FOLDER / "delft_sbw.yaml")).records(),
        "steer_axis_tilt, gravity; use --bicycle NAME or FILE",
    ),
    "bicycle named by a way to its file": (
        lambda run: named(run, "../bicycles/delft_sbw").records(),
        "found '../bicycles/delft_sbw', expected all numbers",
    ),
    "bicycle with a number that is none": (
        lambda run: named(run, "tandem", **{**run.info.parameters, "trail": float("nan")}).records(),
        "trail: expected a finite number",
    ),
    "speed zero": (
        lambda run: at_speed(run, 0.0).records(),
        "expected a positive forward speed, found at most 0 m/s",
    ),
    "speed negative": (lambda run: at_speed(run, -3.6).records(), "found at most -3.6 m/s"),
    "speed NaN": (lambda run: at_speed(run, float("nan")).records(), "expected a positive forward speed"),
    "gyroscopes NaN": (
        lambda run: altered(run, angular_velocity=np.full((len(run.imu.time_ns), 3), np.nan)).records(),
        "expected gyroscope readings",
    ),
}


@pytest.mark.parametrize("case", BAGS)
@pytest.mark.filterwarnings("error")
def test_bags_that_hold_nothing_to_fit(refused: Any, run: SimulatedRun, tmp_path: Path, case: str) -> None:
    make, said = BAGS[case]
    bag = write(tmp_path / "bag", make(run))
    line = refused("tms_fit", "run", bag, "--json")
    assert said in line
    assert "Warning" not in line
    assert said in refused("tms_fit", "figure3b", bag, "-o", tmp_path / "figure.png")
    assert not (tmp_path / "figure.png").exists()


def test_what_is_no_bag(refused: Any, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "text.mcap").write_text("time,lean_rate\n0,1\n")
    for name in ("nowhere", "empty", "empty.mcap", "text.mcap"):
        assert name in refused("tms_fit", "run", tmp_path / name)


@pytest.mark.parametrize("share", [0.02, 0.3, 0.6, 0.97])
def test_truncated_bags_end_in_a_line_or_an_answer(
    command: Any, bag: Path, tmp_path: Path, share: float
) -> None:
    (whole,) = bag.glob("*.mcap")
    data = whole.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: int(share * len(data))])
    done = command("tms_fit", "run", cut)
    assert done.code in (0, 2)
    if done.code == 2:
        assert done.out == ""
        assert done.err.count("\n") == 1


def test_a_recording_cut_short_by_a_crash_is_fitted_as_far_as_it_goes(
    command: Any, run: SimulatedRun, tmp_path: Path
) -> None:
    # As the recorder leaves it when it is killed: chunks complete up to the last flush, no index, no
    # metadata.yaml.
    live = BagWriter(tmp_path / "killed", live=True)
    live.__enter__()
    for index, record in enumerate(run.records()):
        live.write(record)
        if index % 100 == 0:
            live.flush()
    live.flush()
    with BagReader(tmp_path / "killed") as reader:
        assert not reader.complete
    (strike,) = json.loads(command("tms_fit", "run", tmp_path / "killed", "--json").out)["strikes"]
    assert strike["estimates"][0]["status"] == "ok"
    live._file._file.close()


REFUSED = {
    "unknown bicycle": (["--bicycle", "tandem"], "unknown bicycle 'tandem': expected one of"),
    "unknown estimator": (["--estimator", "guess"], "invalid choice: 'guess'"),
    "nothing free": (["--free", ""], "free: expected at least one of"),
    "unknown free": (["--free", "initial_yaw"], "free: unknown 'initial_yaw'; expected of initial_lean"),
    "free twice": (["--free", "initial_lean_rate,initial_lean_rate"], "initial_lean_rate: found twice"),
    "prior on what is not free": (
        ["--prior", "speed=3.6,0.1", "--free", "initial_lean_rate"],
        "prior: speed: expected a free parameter",
    ),
    "prior without deviation": (["--prior", "speed=3.6"], "expected NAME=MEAN,STD with STD positive"),
    "prior of no width": (["--prior", "speed=3.6,0"], "expected NAME=MEAN,STD with STD positive"),
    "no channel": (["--channels", ""], "channels: expected at least one of"),
    "unknown channel": (["--channels", "pitch_rate"], "channels: unknown 'pitch_rate'"),
    "noise": (["--noise", "pink"], "invalid choice: 'pink'"),
    "range zero": (["--gyroscope-range", "0"], "gyroscope range: expected a positive number of rad/s"),
    "censored outliers": (["--saturation", "censor", "--loss", "huber"], "censor goes with white noise"),
    "slip window": (["--slip-window", "1.5"], "slip window: expected 0 s to less than the window of 1.5 s"),
    "speed model": (["--speed-model", "falling"], "invalid choice: 'falling'"),
    "free and fixed": (
        ["--fix", "lean_rate_bias=0", "--free", "lean_rate_bias"],
        "found both free and fixed",
    ),
    "speed negative": (["--fix", "speed=-1"], "speed: expected a positive number of m/s, found -1"),
    "speed zero": (["--fix", "speed=0"], "speed: expected a positive number of m/s, found 0"),
    "speed NaN": (["--fix", "speed=nan"], "speed: expected a positive number of m/s, found nan"),
    "speed in words": (["--fix", "speed=fast"], "expected NAME=VALUE with a number, found 'speed=fast'"),
    "no value": (["--fix", "speed"], "expected NAME=VALUE with a number, found 'speed'"),
    "unknown fixed": (["--fix", "gravity=9.8"], "fix: unknown 'gravity'"),
    "infinite": (["--fix", "initial_lean=inf"], "initial_lean: expected a finite number, found inf"),
    "window short": (["--window", "0.1"], "window: expected 0.3 to 60 s, found 0.1"),
    "window long": (["--window", "61"], "window: expected 0.3 to 60 s, found 61"),
    "window NaN": (["--window", "nan"], "window: expected 0.3 to 60 s, found nan"),
    "steer torque": (["--steer-torque", "double"], "invalid choice: 'double'"),
    "other topic": (["--imu-topic", "/imu/other"], "--imu-topic /imu/data_raw"),
    "topic of another kind": (["--speed-topic", "/imu/data_raw"], "--speed-topic /bicycle/speed"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_bad_input(refused: Any, bag: Path, case: str) -> None:
    arguments, said = REFUSED[case]
    assert said in refused("tms_fit", "run", bag, *arguments)


FIGURES = {
    "another kind": (["-o", "figure.jpg"], "ends in .png, .svg or .pdf"),
    "no kind": (["-o", "figure"], "ends in .png, .svg or .pdf"),
    "inside a file": (["-o", "/dev/null/figure.png"], "expected a place to write a file"),
    "strike that is not there": (
        ["-o", "figure.png", "--strike", "2"],
        "expected a strike number from 1 to 1, found 2",
    ),
    "strike zero": (["-o", "figure.png", "--strike", "0"], "found 0"),
    "no output": ([], "-o/--output"),
}


@pytest.mark.parametrize("case", FIGURES)
def test_figures_refused(
    refused: Any, bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, case: str
) -> None:
    monkeypatch.chdir(tmp_path)
    arguments, said = FIGURES[case]
    assert said in refused("tms_fit", "figure3b", bag, *arguments)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("suffix", "start"), [("png", b"\x89PNG"), ("svg", b"<?xml"), ("pdf", b"%PDF")])
def test_figures(command: Any, bag: Path, tmp_path: Path, suffix: str, start: bytes) -> None:
    path = tmp_path / f"figure.{suffix}"
    done = command("tms_fit", "figure3b", bag, "-o", path)
    assert (done.code, done.out, done.err) == (0, "", "")
    assert path.read_bytes().startswith(start)
    assert list(tmp_path.iterdir()) == [path]


def test_as_a_process(bag: Path) -> None:
    command = [sys.executable, "-m", "tms_fit", "run", str(bag)]
    done = subprocess.run([*command, "--json"], capture_output=True, text=True, check=True)
    assert done.stderr == ""
    assert len(json.loads(done.stdout)["strikes"]) == 1
    done = subprocess.run([*command, "--bicycle", "tandem"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)


def test_strikes_by_hand(command: Any, bag: Path, run: SimulatedRun, refused: Any) -> None:
    # In place of what is found: the free response starts exactly where it was said to.
    document = json.loads(command("tms_fit", "run", bag, "--strike", 1.5037, "--strike", 3.0, "--json").out)
    assert [strike["time_ns"] - run.info.start_ns for strike in document["strikes"]] == [
        1_503_700_000,
        3_000_000_000,
    ]
    assert [strike["detection"]["kind"] for strike in document["strikes"]] == ["given", "given"]
    assert document["strikes"][0]["window"][0] == run.info.start_ns + 1_510_000_000
    low, high = document["strikes"][0]["estimates"][0]["parameters"]["initial_lean_rate"]["ci95"]
    assert low < 0.5 < high
    text = refused("tms_fit", "run", bag, "--strike", 99)
    assert "expected a time inside the IMU's samples, 0.000 to 4.500 s, found 99" in text


def test_every_strike_says_why(command: Any, bag: Path) -> None:
    (strike,) = json.loads(command("tms_fit", "run", bag, "--json").out)["strikes"]
    detection = strike["detection"]
    assert detection["kind"] == "strike"
    assert detection["sharp"] is True
    assert detection["needed"] >= 0.15
    assert "the lean rate jumps by +0.5" in detection["why"]
    assert detection["why"] in command("tms_fit", "run", bag).out


def test_hypotheses_and_budget_on_request(command: Any, bag: Path) -> None:
    (plain,) = json.loads(command("tms_fit", "run", bag, "--json").out)["strikes"]
    assert not {"hypotheses", "error_budget"} & set(plain)
    assert {test["name"] for test in plain["estimates"][0]["criticism"]["tests"]} == {
        "ljung_box",
        "periodogram",
        "normality",
        "chi_square",  # the recording states its noise
    }
    done = command("tms_fit", "run", bag, "--hypotheses", "--budget", "--json")
    (strike,) = json.loads(done.out)["strikes"]
    told = {one["hypothesis"]: one for one in strike["hypotheses"]}
    assert told["constant speed"]["rejected"] is False
    assert "constant speed is not rejected (p = " in told["constant speed"]["sentence"]
    budget = strike["error_budget"]
    assert budget["model_std"] is None  # nobody states how sure Eq. (10.1) is
    assert {"speed", "strike_time", "M_lean_lean", "K2_steer_steer"} <= {
        one["name"] for one in budget["contributions"]
    }
    text = command("tms_fit", "run", bag, "--hypotheses", "--budget").out
    assert told["constant speed"]["sentence"] in text
    assert "error budget of the initial lean rate" in text


@pytest.mark.long
def test_a_kicked_steering_is_found_and_said(command: Any, bag: Path, make_run: Any, tmp_path: Path) -> None:
    # The strike of gym_run kicks the steering: without a steer rate the interval misses the truth.
    run = make_run("gym_run", duration=6.0)
    kicked = write(tmp_path / "kicked", run.records())
    end = next(one.time_ns + round(one.duration * 1e9) for one in run.events if one.kind == "strike")
    truth = float(run.trajectory.at(np.array([(end - run.info.start_ns) / 1e9])).lean_rate[0])
    (strike,) = json.loads(command("tms_fit", "run", kicked, "--json").out)["strikes"]
    best = strike["estimates"][0]
    low, high = best["parameters"]["initial_lean_rate"]["ci95"]
    assert low < truth < high
    assert "initial_steer_rate" in best["parameters"]
    assert "initial steer rate" in best["chosen"][0]
    assert f"chosen: {best['chosen'][0]}" in command("tms_fit", "run", kicked).out
    # The floor's scrub is not in the model, and a bias that no gyroscope has stands in for it.
    assert strike["doubt"]["parameter"] == "yaw_rate_bias"
    assert strike["doubt"]["sentence"] in best["message"]
    # Held to a start upright and straight it is wrong, and whatever the noise model that is said.
    held = ("--free", "initial_lean_rate,lean_rate_bias,yaw_rate_bias", "--estimator", "least_squares")
    for noise in ("auto", "ar", "white"):
        done = command("tms_fit", "run", kicked, "--json", "--noise", noise, *held)
        (strike,) = json.loads(done.out)["strikes"]
        low, _ = strike["estimates"][0]["parameters"]["initial_lean_rate"]["ci95"]
        assert low > truth
        assert strike["doubt"]["parameter"] == "initial_steer_rate"
    # Where the model is right nothing is said.
    (strike,) = json.loads(command("tms_fit", "run", bag, "--json").out)["strikes"]
    assert (strike["doubt"], strike["estimates"][0]["chosen"]) == (None, [])
    text = command("tms_fit", "run", bag).out
    assert "doubtful" not in text
    assert "chosen" not in text


@pytest.mark.parametrize(
    ("option", "texts", "said"),
    [
        ("--fix", ("speed=3", "speed=4"), "--fix: speed: expected each name once, found it twice"),
        ("--prior", ("speed=3,1", "speed=4,1"), "--prior: speed: expected each name once, found it twice"),
        ("--prior", ("speed=3,0",), "STD positive"),
        ("--oscillator", ("20,x",), "expected numbers"),
    ],
)
def test_what_is_said_twice_or_wrongly_is_refused(
    refused: Any, bag: Path, option: str, texts: tuple[str, ...], said: str
) -> None:
    assert said in refused("tms_fit", "run", bag, *(word for text in texts for word in (option, text)))


def test_strikes_are_not_counted_double(command: Any, bag: Path) -> None:
    done = command("tms_fit", "together", bag, f"{bag}/")
    assert (done.code, done.out) == (2, "")
    assert "its strikes would count double" in done.err
