"""All bicycles that BicycleParameters ships load, and have the matrices that it finds for them.

The package is a development dependency; with a sourced ROS nothing is installed, and it may be missing.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from tms_model import load_bicycle
from tms_model.parameter_files import SYMBOLS

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    package = pytest.importorskip("bicycleparameters", reason="BicycleParameters is not installed")
    from bicycleparameters.bicycle import benchmark_par_to_canonical
    from bicycleparameters.io import load_parameter_text_file
    from bicycleparameters.parameter_sets import Moore2019ParameterSet

FOLDER = Path(package.__file__).parent
FILES = sorted([*FOLDER.rglob("*Benchmark.txt"), *FOLDER.rglob("parameter_sets/*.yml")])


def their_numbers(path: Path) -> dict[str, Any]:
    """The symbols of Meijaard et al. 2007 as BicycleParameters reads them, some with uncertainties."""
    if path.suffix == ".txt":
        return dict(load_parameter_text_file(str(path)))
    document = yaml.safe_load(path.read_text())
    values = document.get("values", document)
    if "mD" in values:
        return dict(Moore2019ParameterSet(values).to_parameterization("Meijaard2007").parameters)
    return dict(values)


def test_it_ships_bicycles_of_every_kind() -> None:
    assert len(FILES) >= 15
    assert any("principal" in path.name for path in FILES)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_matrices_agree(path: Path) -> None:
    bicycle, numbers = load_bicycle(str(path)), their_numbers(path)
    plain = {key: float(getattr(value, "nominal_value", value)) for key, value in numbers.items()}
    for ours, theirs in zip(bicycle.canonical.values(), benchmark_par_to_canonical(plain), strict=True):
        theirs = np.asarray(theirs, dtype=float)
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-12 * np.abs(theirs).max())
    for symbol, name in SYMBOLS.items():
        deviation = float(getattr(numbers[symbol], "std_dev", 0.0))
        assert bicycle.standard_deviations.get(name, 0.0) == pytest.approx(deviation, rel=1e-12)
