"""Bicycles calibrated against recordings: their covariance is read, carried on, and refused when wrong."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from tms_model import Bicycle, ParameterError, linear_system, load_bicycle, with_parameters
from tms_model.calibrated import calibration_yaml, read_calibration, yaml_text
from tms_model.catalogue import FOLDER
from tms_model.changes import MATRIX_ENTRIES, numbers_of
from tms_model.uncertainty import eigenvalue_uncertainty, sampled

NAME = "delft_sbw_calibrated"
DOCUMENT: dict[str, Any] = yaml.safe_load((FOLDER / f"{NAME}.yaml").read_text())
CHANGED = tuple(DOCUMENT["changes"])


@pytest.fixture
def bicycle() -> Bicycle:
    return load_bicycle(NAME)


def test_it_is_its_parent_with_changes_that_have_a_covariance(bicycle: Bicycle) -> None:
    calibrated = bicycle.calibrated
    assert calibrated is not None
    assert calibrated.names == CHANGED
    assert np.linalg.eigvalsh(calibrated.covariance)[0] > 0.0
    for name, prior in calibrated.priors.items():
        assert calibrated.standard_deviations[name] <= prior.deviation * (1.0 + 1e-6)
    parameters = {name for name in CHANGED if not name.startswith("steer")}
    assert set(bicycle.standard_deviations) == parameters
    assert sum(one["strikes"] for one in calibrated.recordings) == 17


def test_nothing_in_it_leaves_what_is_physically_sensible(bicycle: Bicycle) -> None:
    # Within three prior deviations, dissipating, and with a body that can exist (checked on loading).
    assert bicycle.calibrated is not None
    for name, prior in bicycle.calibrated.priors.items():
        assert abs(bicycle.numbers[name] - prior.value) < 3.0 * prior.deviation
    assert bicycle.steer_elements.steer_damper > 0.0


def test_writing_and_reading_again_is_the_same(bicycle: Bicycle) -> None:
    assert bicycle.calibrated is not None
    document = yaml.safe_load(yaml_text(calibration_yaml(bicycle.calibrated)))
    again = read_calibration(document, CHANGED, "again")
    np.testing.assert_allclose(again.covariance, bicycle.calibrated.covariance, rtol=1e-9)
    assert again.priors == bicycle.calibrated.priors
    assert again.command == bicycle.calibrated.command


def test_samples_have_the_covariance_that_is_stated(bicycle: Bicycle) -> None:
    drawn = sampled(bicycle, np.random.default_rng(1), 40_000)
    names = tuple(drawn)
    assert bicycle.calibrated is not None
    index = [bicycle.calibrated.names.index(name) for name in names]
    expected = bicycle.calibrated.covariance[np.ix_(index, index)]
    found = np.cov([drawn[name] for name in names])
    std = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(found / np.outer(std, std), expected / np.outer(std, std), atol=0.03)


def test_first_order_and_samples_agree_on_what_correlated_parameters_do(bicycle: Bicycle) -> None:
    # At 6 m/s no two eigenvalues are near each other.
    found = eigenvalue_uncertainty(bicycle, 6.0, np.random.default_rng(2), 4000)
    for part in (part for pair in found for part in pair if part.std > 1e-3):
        assert part.sample_std == pytest.approx(part.std, rel=0.35)
        assert part.std <= sum(abs(one) for one in part.contributions.values()) * (1.0 + 1e-9)
    independent = [np.linalg.norm(list(re.contributions.values())) for re, _ in found]
    assert any(abs(re.std / one - 1.0) > 0.05 for (re, _), one in zip(found, independent, strict=True))


def test_a_change_makes_the_calibration_void(bicycle: Bicycle) -> None:
    assert with_parameters(bicycle, {"trail": 0.08}).calibrated is None


def _set(document: dict[str, Any], *path: Any, to: Any) -> dict[str, Any]:
    changed = copy.deepcopy(document)
    inner = changed["calibration"]
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = to
    return changed


@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        (_set(DOCUMENT, "correlations", to=[[1.0]]), "expected a 6 x 6 correlation matrix"),
        (_set(DOCUMENT, "correlations", 0, 1, to=0.9), "expected a 6 x 6 correlation matrix"),
        (_set(DOCUMENT, "correlations", to="none"), "expected a 6 x 6 correlation matrix"),
        (
            _set(DOCUMENT, "standard_deviations", "trail", to=0.1),
            "trail: expected a positive number for one of",
        ),
        (_set(DOCUMENT, "standard_deviations", "steer_damper", to=-1.0), "steer_damper: expected a positive"),
        (_set(DOCUMENT, "standard_deviations", "steer_damper", to="small"), "expected a finite number"),
        (_set(DOCUMENT, "priors", "steer_damper", to="about 1"), "expected a number such as"),
        (_set(DOCUMENT, "priors", to={}), "expected names and numbers"),
        (_set(DOCUMENT, "recordings", to=[]), "expected a list of name, sha256, strikes"),
        (_set(DOCUMENT, "recordings", to=[{"name": "a"}]), "expected the keys name, sha256, strikes"),
        (_set(DOCUMENT, "mood", to="good"), "expected the keys standard_deviations, correlations"),
        ({**DOCUMENT, "calibration": 3}, "expected the keys standard_deviations"),
    ],
)
def test_what_is_no_calibration_is_refused_in_one_line(
    wrong: dict[str, Any], why: str, tmp_path: Path
) -> None:
    path = tmp_path / "wrong.yaml"
    path.write_text(yaml.safe_dump(wrong))
    with pytest.raises(ParameterError, match=why) as caught:
        load_bicycle(str(path))
    assert "\n" not in str(caught.value)


def test_show_tells_how_it_was_made(command: Callable[..., Any]) -> None:
    text = command("tms_model", "show", NAME).out
    assert "calibrated: tms fit calibrate" in text
    assert "9 strikes of delft_3 (sha256 2352f9de" in text
    assert "steer_torque_gain" in text
    assert " +/- " in next(
        line for line in text.splitlines() if "steer_damper" in line and "calibr" not in line
    )


@pytest.mark.parametrize("name", MATRIX_ENTRIES)
def test_entries_of_matrices_change_by_name(name: str) -> None:
    bicycle = load_bicycle("benchmark")
    before = numbers_of(bicycle)
    changed = with_parameters(bicycle, {name: before[name] * 1.01 + 0.001})
    after = numbers_of(changed)
    assert {key for key in MATRIX_ENTRIES if after[key] != before[key]} == {name}
    assert changed.parameters is None
    np.testing.assert_array_equal(changed.mass, changed.mass.T)
    np.testing.assert_array_equal(changed.stiffness0, changed.stiffness0.T)
    assert not np.array_equal(linear_system(changed, 5.0).a, linear_system(bicycle, 5.0).a)
    assert bicycle.parameters is not None
