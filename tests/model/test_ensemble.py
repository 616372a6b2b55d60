"""Many parameter sets at once give what each gives by itself."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pytest
from tms_model import (
    Bicycle,
    ParameterError,
    SteerElements,
    WhippleParameters,
    assemble,
    bicycle_names,
    eigenvalues,
    load_bicycle,
    stability,
)
from tms_model.ensemble import ensemble, ensemble_eigenvalues, ensemble_stability

KINDS = ("benchmark", "counterexample_7_rear_steering")

ASSEMBLED = [name for name in bicycle_names() if load_bicycle(name).parameters is not None]
ELEMENTS = {"free": SteerElements(), "controlled": SteerElements(0.5, 0.3, 0.0, 1.0)}
VARIED = (
    *("wheelbase", "trail", "steer_axis_tilt", "rear_frame_x", "rear_frame_mass"),
    *("front_frame_x", "front_frame_z", "front_frame_inertia_zz", "front_wheel_inertia_yy"),
)


def varied(bicycle: Bicycle, count: int) -> dict[str, np.ndarray]:
    generator = np.random.default_rng(5)
    return {
        name: getattr(bicycle.parameters, name) * (1.0 + 0.08 * generator.uniform(-1.0, 1.0, count))
        for name in VARIED
    }


def one_of(bicycle: Bicycle, changed: dict[str, np.ndarray], row: int) -> Bicycle:
    values = {name: float(column[row]) for name, column in changed.items()}
    parameters = WhippleParameters(**{**asdict(bicycle.parameters), **values})
    return assemble("one", parameters, steer_elements=bicycle.steer_elements)


@pytest.mark.parametrize("elements", ELEMENTS)
@pytest.mark.parametrize("name", ASSEMBLED)
@pytest.mark.quick_for(name=KINDS)
def test_each_set_is_as_by_itself(name: str, elements: str) -> None:
    plain = load_bicycle(name)
    bicycle = assemble(name, plain.parameters, steer_elements=ELEMENTS[elements])
    changed = varied(bicycle, 60)
    bicycles = ensemble(bicycle, changed)
    found = ensemble_stability(bicycles)
    roots = ensemble_eigenvalues(bicycles, 3.3)
    for row in range(60):
        alone = one_of(bicycle, changed, row)
        for matrix, one in (
            (bicycles.mass, alone.mass),
            (bicycles.damping, alone.damping),
            (bicycles.stiffness0, alone.stiffness0),
            (bicycles.stiffness2, alone.stiffness2),
        ):
            np.testing.assert_allclose(matrix[row], one, rtol=1e-13, atol=1e-15 * np.abs(one).max())
        np.testing.assert_allclose(roots[row], eigenvalues(alone, 3.3), rtol=1e-10, atol=1e-10)
        expected = stability(alone)
        for speed in ("onset_speed", "weave_speed", "capsize_speed"):
            one = getattr(expected, speed)
            ours = getattr(found, speed)[row]
            assert np.isnan(ours) if one is None else ours == pytest.approx(one, rel=1e-8), (row, speed)


def test_ten_thousand_benchmarks_in_one_call() -> None:
    benchmark = load_bicycle("benchmark")
    found = ensemble_stability(ensemble(benchmark, {"gravity": np.full(10_000, benchmark.gravity)}))
    # Meijaard et al. 2007, printed there.
    np.testing.assert_allclose(found.onset_speed, 4.29238253634111, rtol=1e-12)
    np.testing.assert_array_equal(found.onset_speed, found.weave_speed)
    np.testing.assert_allclose(found.capsize_speed, 6.02426201538837, rtol=1e-12)


def test_speed_grows_with_the_root_of_gravity() -> None:
    # Speed enters as v^2 / g only: four times the gravity, twice the speed.
    bicycle = load_bicycle("tms_table_7_1")
    found = ensemble_stability(ensemble(bicycle, {"gravity": np.array([9.81, 4.0 * 9.81])})).onset_speed
    assert found[1] == pytest.approx(2.0 * found[0], rel=1e-12)


def test_what_is_not_physical_is_nan_and_harms_no_other() -> None:
    bicycle = load_bicycle("benchmark")
    mass = np.array([85.0, -500.0, 85.0])
    bicycles = ensemble(bicycle, {"rear_frame_mass": mass})
    assert bicycles.physical.tolist() == [True, False, True]
    found = ensemble_stability(bicycles)
    for speeds in (found.onset_speed, found.weave_speed, found.capsize_speed):
        assert np.isnan(speeds).tolist() == [False, True, False]
    assert np.isnan(ensemble_eigenvalues(bicycles, 5.0)).any(axis=1).tolist() == [False, True, False]


def test_what_cannot_be_varied_is_said() -> None:
    with pytest.raises(ParameterError, match="tms_eq_10_1: expected one that is given by its parameters"):
        ensemble(load_bicycle("tms_eq_10_1"), {"trail": np.zeros(2)})
    benchmark = load_bicycle("benchmark")
    with pytest.raises(ParameterError, match="unknown trial; expected some of wheelbase"):
        ensemble(benchmark, {"trial": np.zeros(2)})
    for wrong in ({"trail": np.zeros(2), "wheelbase": np.ones(3)}, {"trail": np.zeros((2, 2))}, {}):
        with pytest.raises(ParameterError, match="arrays of one length"):
            ensemble(benchmark, wrong)
