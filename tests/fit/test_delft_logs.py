"""The main job on real input: the riderless pushes of the TU Delft Bicycle Lab, as a user would fit them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

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
        assert document["bicycle"] == "delft_sbw"
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
def test_pushes_are_found_and_the_model_explains_them(
    strikes: Any, run: dict[str, Any], free: str, key: str
) -> None:
    found = strikes("--free", free)
    vaf = [strike["estimates"][0]["vaf"]["lean_rate"] for strike in found]
    assert np.median(vaf) >= run["vaf"][key]
    assert [strike["estimates"][0]["status"] for strike in found] == ["ok"] * len(found)


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


def test_without_its_feedback_the_model_fails(strikes: Any, run: dict[str, Any]) -> None:
    # The model without feedback is unstable at these speeds: leaving the known torque out must show.
    found = strikes("--free", "initial_lean_rate,lean_rate_bias", "--steer-torque", "ignore")
    assert (
        np.median([strike["estimates"][0]["vaf"]["lean_rate"] for strike in found])
        < run["vaf"]["lean_rate_only"] - 0.2
    )
