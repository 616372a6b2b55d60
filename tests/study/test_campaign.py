"""A campaign: its rows are those of `sim run` and `fit run`, its figures follow from them, and it goes on."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tms_bag import RecordingError
from tms_fit.settings import Settings
from tms_study.campaign import Campaign, Row, ride_all
from tms_study.campaign_file import CampaignFile
from tms_study.campaign_result import summarise

SETTINGS = Settings(window=1.0, estimators=("least_squares",))


def campaign(runs: int = 2, **changes: object) -> Campaign:
    return Campaign(
        "tms_strike", {"duration": 4.0, **changes}, {"strike.lean_rate": (0.3, 0.5)}, runs, 7, SETTINGS
    )


@pytest.fixture(scope="module")
def rows() -> list[Row]:
    return ride_all(campaign())


def test_a_row_is_what_sim_run_and_fit_run_give(rows: list[Row], command: Any, tmp_path: Path) -> None:
    one = next(row for row in rows if row.combination == ("0.5",) and row.seed == 8)
    bag = tmp_path / "bag"
    settings = ("--set", "duration=4.0", "--set", "strike.lean_rate=0.5")
    command("tms_sim", "run", "tms_strike", *settings, "--seed", "8", "-o", bag)
    said = command("tms_fit", "run", bag, "--window", "1.0", "--estimator", "least_squares", "--json")
    (strike,) = json.loads(said.out)["strikes"]
    found = strike["estimates"][0]["parameters"]["initial_lean_rate"]
    assert one.estimate == found["value"]
    assert [one.low, one.high] == found["ci95"]
    assert one.truth == pytest.approx(0.5, rel=0.01)


def test_summary_by_hand(rows: list[Row]) -> None:
    for one, told in zip(summarise(campaign(), rows), ("0.3", "0.5"), strict=True):
        errors = [row.estimate - row.truth for row in rows if row.combination == (told,)]
        assert (one.runs, one.struck, one.missed, one.false, one.fitted) == (2, 2, 0, 0, 2)
        assert one.bias == pytest.approx(np.mean(errors))
        assert one.std == pytest.approx(abs(errors[0] - errors[1]) / np.sqrt(2.0))
        # No estimator can promise less than the bound; at so few samples the stated error scatters by some %.
        assert 0.85 < one.stated / one.bound < 1.3


def test_missed_and_false_strikes_are_counted() -> None:
    weak = Campaign("tms_strike", {"duration": 4.0, "strike.lean_rate": 0.0}, {}, 1, 1, SETTINGS)
    (row,) = ride_all(weak)
    assert row.status == "missed"
    (one,) = summarise(weak, [row, Row((), 1, 2, 2, "false", 3.0)])
    assert (one.struck, one.missed, one.false, one.fitted) == (1, 1, 1, 0)


def test_answers_that_raise_a_doubt_are_not_judged() -> None:
    one = campaign()
    said = {"status": "ok", "time": 2.0, "truth": 0.5, "std": 0.01, "vaf_lean_rate": 1.0}
    rows = [
        Row(("0.3",), 7, 1, 1, estimate=0.5, low=0.4, high=0.6, **said),  # type: ignore[arg-type]
        Row(("0.3",), 8, 1, 1, estimate=0.9, low=0.8, high=1.0, doubted=1, **said),  # type: ignore[arg-type]
        Row(("0.3",), 9, 1, 1, estimate=0.5, low=0.4, high=0.6, doubted=1, **said),  # type: ignore[arg-type]
    ]
    weak, hard = summarise(one, rows)
    assert (weak.covered, weak.doubted, weak.sure, weak.sure_covered) == pytest.approx((2 / 3, 2 / 3, 1, 1.0))
    assert weak.honest
    assert hard.sure == 0
    assert hard.honest


def test_given_strikes_begin_where_the_impulse_ended() -> None:
    keys = {"duration": 4.0, "strike.time": 2.003, "strike.duration": 0.012}
    for clock in ({}, {"wireless.clock_offset": 0.05, "wireless.clock_drift": 1e-3}):
        given = Campaign("tms_strike", {**keys, **clock}, {}, 1, 1, SETTINGS, given=True)
        (row,) = ride_all(given)
        assert row.time == pytest.approx(2.015)
        assert abs(row.late) < 2e-9
        assert given.mark != Campaign("tms_strike", {**keys, **clock}, {}, 1, 1, SETTINGS).mark


def test_it_goes_on_where_it_was_killed(rows: list[Row], tmp_path: Path) -> None:
    path = tmp_path / "campaign.csv"
    whole = CampaignFile(path, campaign())
    for row in rows:
        whole.add([row])
    text = path.read_text()
    for cut in range(len(text) // 2, len(text), 37):  # killed at any byte
        path.write_text(text[:cut])
        again = CampaignFile(path, campaign())
        assert again.rows == rows[: len(again.rows)]
        assert len(again.rows) >= 1
    made: list[Row] = []
    assert ride_all(campaign(), again.rows, made.extend) == rows
    assert len(made) == len(rows) - len(again.rows)
    for row in made:
        again.add([row])
    assert path.read_text() == text


def test_another_campaign_is_not_continued(rows: list[Row], tmp_path: Path) -> None:
    path = tmp_path / "campaign.csv"
    CampaignFile(path, campaign()).add(rows)
    with pytest.raises(RecordingError, match="another scenario, fit or version"):
        CampaignFile(path, campaign(speed=3.0))
    path.write_text("time,rate\n1,2\n")
    with pytest.raises(RecordingError, match="another table"):
        CampaignFile(path, campaign())
    assert path.read_text() == "time,rate\n1,2\n"


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["nonsense"], "unknown scenario"),
        (["tms_strike", "--vary", "speed=3"], "--vary: expected KEY="),
        (["tms_strike", "--vary", "speed=[3, 3]"], "each value once"),
        (["tms_strike", "--vary", "sped=[3]"], "unknown key 'sped'"),
        (["tms_strike", "--vary", "speed=[3]", "--set", "speed=4"], "leave it out of one"),
        (["tms_strike", "--vary", "seed=[3]"], "leave it out of one"),
        (["tms_strike", "--vary", "speed=[-3]"], "speed"),
        (["tms_strike", "--runs", "0"], "expected 1 to"),
        (["tms_strike", "--fit", "windw=1"], "--fit: unknown 'windw'"),
        (["tms_strike", "--fit", "window=wide"], "values of the right kind"),
        (["tms_strike", "--fit", "window=0"], "window: expected"),
        (["tms_strike", "-o", "/nowhere/at/all.csv"], "a folder that exists"),
    ],
)
def test_nonsense_is_one_clear_line(refused: Any, arguments: list[str], expected: str) -> None:
    assert expected in refused("tms_study", "campaign", *arguments)


def test_command_writes_table_figure_and_json(command: Any, tmp_path: Path) -> None:
    path, figure = tmp_path / "campaign.csv", tmp_path / "campaign.svg"
    words = ["tms_strike", "--vary", "strike.lean_rate=[0.4, 0.5]", "--runs", "1", "--fit", "window=1.0"]
    said = command(
        "tms_study", "campaign", *words, "--set", "duration=4.0", "-o", path, "--figure", figure, "--json"
    )
    assert (said.code, said.err) == (0, "")
    assert [one["combination"] for one in json.loads(said.out)["combinations"]] == [
        {"strike.lean_rate": 0.4}, {"strike.lean_rate": 0.5}
    ]  # fmt: skip
    lines = list(csv.DictReader(path.open()))
    assert [line["strike.lean_rate"] for line in lines] == ["0.4", "0.5"]
    assert "estimate less truth" in figure.read_text()


def test_stamps_of_a_sensor_whose_clock_is_ahead_are_taken_for_what_they_are(rows: list[Row]) -> None:
    ahead = campaign(runs=1, **{"wireless.clock_offset": 0.05, "wireless.clock_drift": 1e-3})
    for late, one in zip(ride_all(ahead), rows[::2], strict=True):
        assert late.combination == one.combination
        assert (late.time, late.late) == pytest.approx((one.time, one.late), abs=1e-3)
        assert late.truth == pytest.approx(one.truth, rel=0.02)
