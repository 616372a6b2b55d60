"""`study validate --quick`, whole: each figure in its band, and a wrong estimator told from a right one."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tms_study import trials, validation
from tms_study.findings import Finding, findings_text, write_markdown


@pytest.mark.long
def test_quick_validation_reaches_its_bands(command: Any, tmp_path: Path) -> None:
    done = command("tms_study", "validate", "--quick", "--json", "-o", tmp_path / "validation.md")
    assert done.code == 0
    document = json.loads(done.out)
    found = {(one["topic"], one["figure"]): one for one in document["findings"]}
    assert len(found) == 29
    missed = {key for key, one in found.items() if not one["reached"]}
    assert missed == set()
    for one in found.values():  # the band itself, whatever 'reached' says
        low, high = one["band"]
        assert low - one["spread"] <= one["value"] <= high + one["spread"]
    text = (tmp_path / "validation.md").read_text()
    assert "--quick --seed 2011" in text
    assert text.count("\n| ") == 1 + len(found)  # a heading and the figures


@pytest.mark.long
def test_intervals_that_are_too_narrow_are_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    # Standard errors 10 % too small: the coverage of 2000 runs falls to 92 %, out of its band.
    honest = validation.fit_window

    def rash(*arguments: Any) -> Any:
        estimate = honest(*arguments)
        return replace(estimate, covariance=0.81 * estimate.covariance)

    monkeypatch.setattr(validation, "fit_window", rash)
    window = trials.truth()
    _, inside = validation._fits(window, trials.white(np.random.default_rng(1), window.time, 600))
    assert not validation._coverage("x", inside, 0.945, 0.955).reached


def test_noise_is_as_it_says() -> None:
    rng, time = np.random.default_rng(5), np.arange(151) / 100.0
    for tau in (0.05, 0.2):
        noise = trials.colored_noise(tau)(rng, time, 400)
        assert np.std(noise) == pytest.approx(0.02, rel=0.03)
        lag = np.mean(noise[:, 1:] * noise[:, :-1]) / np.mean(noise**2)
        assert lag == pytest.approx(np.exp(-0.01 / tau), abs=0.02)
    assert np.isnan(trials.lossy(rng, time, 400)).mean() == pytest.approx(0.2, abs=0.01)
    shaken = trials.shimmy(rng, time, 400)
    assert np.std(shaken[:, :, 0]) == pytest.approx(0.02, rel=0.03)
    assert np.var(shaken[:, :, 1]) == pytest.approx(0.02**2 + 0.05**2 / 2.0, rel=0.05)


def test_no_runs_are_made_for_a_file_that_can_not_be_written(refused: Any, tmp_path: Path) -> None:
    text = refused("tms_study", "validate", "--quick", "-o", tmp_path / "nowhere" / "x.md")
    assert "expected a file in a folder that exists" in text


def test_a_missed_figure_is_told(tmp_path: Path) -> None:
    found = [Finding("a", "b", 2.0, 0.0, 1.0, 10), Finding("c", "d", 1.05, 0.0, 1.0, 10, spread=0.1)]
    assert [one.reached for one in found] == [False, True]
    assert "MISSED" in findings_text(found)
    assert "1 of 2 figures as aimed at" in findings_text(found)
    write_markdown(tmp_path / "x.md", found, 1, quick=False)
    assert "**missed**" in (tmp_path / "x.md").read_text()
    assert [path.name for path in tmp_path.iterdir()] == ["x.md"]


@pytest.mark.parametrize("seed", ["-1", "1.5", "x"])
@pytest.mark.parametrize("study", ["validate", "strikes", "demo"])
def test_a_seed_is_a_whole_number_from_0_on(refused: Any, study: str, seed: str) -> None:
    assert f"expected a whole number from 0 on, found {seed!r}" in refused("tms_study", study, "--seed", seed)
