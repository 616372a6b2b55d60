"""The main job on real input: the riderless pushes of the TU Delft Bicycle Lab, as a user would fit them."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from tms_model import load_bicycle

PUBLISHED = yaml.safe_load((Path(__file__).parents[1] / "data" / "delft_sbw.yaml").read_text())
ROOT = Path(__file__).parents[2]
LOGS = ROOT / os.environ.get("TMS_DELFT_DATA", "../shared/data/delft_sbw")

pytestmark = pytest.mark.skipif(
    not all((LOGS / run["log"]).is_file() for run in PUBLISHED["runs"]),
    reason=f"the logs of the TU Delft steer-by-wire bicycle are not part of the project and not in {LOGS};"
    " set TMS_DELFT_DATA to the folder that holds them",
)


@pytest.fixture(scope="module", params=PUBLISHED["runs"], ids=lambda run: run["log"])
def run(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """A log, imported as a user would."""
    bag = tmp_path_factory.mktemp("delft") / "bag"
    command = [sys.executable, "-m", "tms_bag", "import-csv", LOGS / request.param["log"]]
    subprocess.run([*command, "--mapping", "delft_sbw", "-o", bag], check=True, capture_output=True)
    return {**request.param, "bag": bag}


@pytest.fixture
def strikes(command: Any, run: dict[str, Any]) -> Any:
    """Strikes nearest to the pushes that the authors picked, by `fit run --json`."""

    def fit(*options: str) -> list[dict[str, Any]]:
        done = command("tms_fit", "run", run["bag"], "--estimator", "least_squares", "--json", *options)
        assert done.code == 0, done.err
        document = json.loads(done.out)
        assert document["bicycle"] == ("delft_sbw_calibrated" if "--bicycle" in options else "delft_sbw")
        times = np.array([strike["time_ns"] - document["start_ns"] for strike in document["strikes"]]) / 1e9
        picked = np.array(run["starts"]) / 100.0
        nearest = np.abs(times[:, None] - picked).argmin(axis=0)
        assert np.abs(times[nearest] - picked).max() <= PUBLISHED["found_within"]
        assert len(set(nearest.tolist())) == len(picked)
        return [document["strikes"][index] for index in nearest]

    return fit


@pytest.mark.parametrize(
    ("free", "key"),
    [
        ("initial_lean_rate,lean_rate_bias", "lean_rate_only"),
        ("initial_lean_rate,initial_steer_rate,lean_rate_bias", "with_steer_rate"),
    ],
)
@pytest.mark.long
def test_pushes_are_found_and_the_model_explains_them(
    strikes: Any, run: dict[str, Any], free: str, key: str
) -> None:
    found = strikes("--free", free)
    vaf = [strike["estimates"][0]["vaf"]["lean_rate"] for strike in found]
    assert np.median(vaf) >= run["vaf"][key]
    assert [strike["estimates"][0]["status"] for strike in found] == ["ok"] * len(found)


@pytest.mark.long
def test_feedback_of_the_lean_rate_is_found_in_the_command(strikes: Any, run: dict[str, Any]) -> None:
    # Measured slopes of the command over the lean rate: 6.93 at 3 m/s, 4.71 at 4 m/s.
    found = strikes()
    gains, speeds = (np.median([strike[key] for strike in found]) for key in ("lean_rate_gain", "speed"))
    gain, speed = (6.93, 3.0) if "10.8kph" in run["log"] else (4.71, 4.0)
    assert gains == pytest.approx(gain, rel=0.03)
    assert speeds == pytest.approx(speed, rel=0.05)
    # There is no yaw gyroscope in these logs: nothing is claimed about the yaw rate.
    assert all(set(strike["estimates"][0]["vaf"]) == {"lean_rate"} for strike in found)
    assert all("yaw_rate_bias" not in strike["estimates"][0]["parameters"] for strike in found)


@pytest.mark.long
def test_without_its_feedback_the_model_fails(strikes: Any, run: dict[str, Any]) -> None:
    # The model without feedback is unstable at these speeds: leaving the known torque out must show.
    found = strikes("--free", "initial_lean_rate,lean_rate_bias", "--steer-torque", "ignore")
    assert (
        np.median([strike["estimates"][0]["vaf"]["lean_rate"] for strike in found])
        < run["vaf"]["lean_rate_only"] - 0.2
    )


# Of docs/calibration.md: with one initial lean rate per push and nothing else of it, and the same before.
MEDIANS = {"10.8kph": (0.971, 0.927), "14.4kph": (0.979, 0.898)}
CALIBRATED = ("--bicycle", "delft_sbw_calibrated", "--free", "initial_lean_rate")


@pytest.mark.parametrize("how", ["command", "setting"])
@pytest.mark.long
def test_calibrated_it_explains_pushes_by_one_initial_lean_rate_each(
    strikes: Any, run: dict[str, Any], how: str
) -> None:
    # The feedback from the recorded command, or from what the controller and the treadmill were set to.
    speed = 3.0 if "10.8kph" in run["log"] else 4.0
    settings = ("--fix", f"lean_rate_gain={2.0 * (6.5 - speed)}", "--fix", f"speed={speed}")
    found = strikes(*CALIBRATED, *(settings if how == "setting" else ()))
    assert all(set(strike["estimates"][0]["parameters"]) == {"initial_lean_rate"} for strike in found)
    median = np.median([strike["estimates"][0]["vaf"]["lean_rate"] for strike in found])
    assert median >= run["vaf"]["calibrated"]
    if how == "command":
        after, before = MEDIANS[run["log"].split("_")[-1].removesuffix(".log")]
        assert round(median, 3) == after
        plain = strikes("--free", "initial_lean_rate")
        assert round(np.median([one["estimates"][0]["vaf"]["lean_rate"] for one in plain]), 3) == before


@pytest.fixture(scope="module")
def calibration(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The command that made the shipped bicycle, with other paths."""
    shipped = load_bicycle("delft_sbw_calibrated")
    assert shipped.calibrated is not None
    folder = tmp_path_factory.mktemp("calibration")
    for number, one in zip((3, 4), PUBLISHED["runs"], strict=True):
        command = [sys.executable, "-m", "tms_bag", "import-csv", LOGS / one["log"], "--mapping", "delft_sbw"]
        subprocess.run([*command, "-o", folder / "out" / f"delft_{number}"], check=True, capture_output=True)
    words = shlex.split(shipped.calibrated.command)[1:]
    words[words.index("-o") + 1] = "again.yaml"
    words[words.index("--picture") + 1] = "again.png"
    done = subprocess.run(
        [sys.executable, "-m", f"tms_{words[0]}", *words[1:], "--json"],
        cwd=folder,
        check=True,
        capture_output=True,
        text=True,
    )
    document: dict[str, Any] = json.loads(done.stdout)
    return {**document, "again": load_bicycle(str(folder / "again.yaml"))}


@pytest.mark.long
def test_the_shipped_bicycle_is_what_its_command_makes(calibration: dict[str, Any]) -> None:
    shipped, again = load_bicycle("delft_sbw_calibrated"), calibration["again"]
    assert shipped.calibrated is not None
    for name, std in shipped.calibrated.standard_deviations.items():
        assert abs(again.numbers[name] - shipped.numbers[name]) < 0.05 * std
        assert again.calibrated.standard_deviations[name] == pytest.approx(std, rel=0.05)
    assert again.calibrated.recordings == shipped.calibrated.recordings


@pytest.mark.long
def test_pushes_and_logs_left_out_are_predicted(calibration: dict[str, Any]) -> None:
    for name, wanted, pushes, other in (("delft_3", 0.95, 0.971, 0.957), ("delft_4", 0.96, 0.978, 0.972)):
        found = calibration["recordings"][name]
        assert found["median_vaf_left_out"] >= wanted
        assert found["by_the_other_recordings"]["median_vaf"] >= wanted
        assert found["median_vaf_left_out"] == pytest.approx(pushes, abs=0.002)
        assert found["by_the_other_recordings"]["median_vaf"] == pytest.approx(other, abs=0.003)


@pytest.mark.long
def test_what_data_and_priors_tell_is_as_documented(calibration: dict[str, Any]) -> None:
    told = {name: one["told_by"] for name, one in calibration["parameters"].items()}
    assert {name for name, word in told.items() if word == "data"} == {"steer_damper", "steer_torque_gain"}
    assert {name for name, word in told.items() if word == "prior"} == {
        "rear_frame_inertia_xz",
        "front_wheel_inertia_yy",
    }
    known = {key: one["known"] for key, one in calibration["identifiability"].items()}
    assert known == {"free": 4, "parameters": 5, "matrix_entries": 6}
    for one in calibration["parameters"].values():
        assert abs(one["value"] - one["prior"]) < 2.0 * one["prior_std"]
