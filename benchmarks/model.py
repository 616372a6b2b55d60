"""How fast the bicycle model is, against BicycleParameters in the same run. See benchmarks/README.md."""

from __future__ import annotations

import argparse
import sys
import warnings
from typing import Any

import numpy as np
from measure import in_turn, print_machine, print_timings
from tms_model import (
    WhippleParameters,
    assemble,
    eigenvalues,
    linear_system,
    load_bicycle,
    response,
    stability,
)
from tms_model.ensemble import ensemble, ensemble_stability
from tms_model.parameter_files import SYMBOLS

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    try:
        from bicycleparameters.models import Meijaard2007Model
        from bicycleparameters.parameter_sets import Meijaard2007ParameterSet
    except ImportError:
        sys.exit("benchmarks/model.py needs BicycleParameters: pip install 'BicycleParameters>=1.5'")

OURS, THEIRS = "tms_model", "BicycleParameters"
SPEED = 5.0  # [m/s]
INITIAL = np.array([0.0, 0.0, 0.5, 0.0])  # lean, steer, lean rate, steer rate


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few repeats and small sizes: does it run?")
    quick = parser.parse_args().quick
    repeats = 3 if quick else 41
    print_machine(("numpy", "scipy", "BicycleParameters"))
    print(f"medians of {repeats} runs, quartiles in brackets; benchmark bicycle of Meijaard et al. 2007")
    theirs = _their_model()
    measure_eigenvalues(theirs, 101 if quick else 1001, repeats)
    measure_response(theirs, repeats)
    measure_onsets(100 if quick else 10_000, max(3, repeats // 4))


def measure_eigenvalues(theirs: Any, count: int, repeats: int) -> None:
    """Eigenvalues at many speeds, and whether both find the same."""
    bicycle, speeds = load_bicycle("benchmark"), np.linspace(0.0, 10.0, count)
    timings = in_turn(
        {
            "BicycleParameters calc_eigen": lambda: theirs.calc_eigen(v=speeds),
            "tms_model eigenvalues": lambda: eigenvalues(bicycle, speeds),
            "tms_model, one speed after the other": lambda: [eigenvalues(bicycle, float(v)) for v in speeds],
        },
        repeats,
    )
    print_timings(f"eigenvalues at {count} speeds", timings, "BicycleParameters calc_eigen")
    found, _ = theirs.calc_eigen(v=speeds)
    order = np.lexsort((found.imag, found.real), axis=-1)
    difference = np.abs(np.take_along_axis(found, order, axis=-1) - eigenvalues(bicycle, speeds)).max()
    print(f"  largest difference between the two: {difference:.1e} 1/s")


def measure_response(theirs: Any, repeats: int) -> None:
    """Free response, 401 samples in 4 s, and how far each is from the exact one."""
    bicycle, times = load_bicycle("benchmark"), np.linspace(0.0, 4.0, 401)
    timings = in_turn(
        {
            "BicycleParameters simulate": lambda: theirs.simulate(times, INITIAL, v=SPEED),
            "tms_model response": lambda: response(linear_system(bicycle, SPEED), INITIAL, times),
        },
        repeats,
    )
    print_timings(
        f"free response at {SPEED:g} m/s, {len(times)} samples", timings, "BicycleParameters simulate"
    )
    system = linear_system(bicycle, SPEED)
    # By eigenvectors: another way, exact where eigenvalues differ, as they do here.
    values, vectors = np.linalg.eig(system.a)
    exact = ((vectors * np.linalg.solve(vectors, INITIAL)) @ np.exp(np.outer(values, times))).T.real
    for name, states in (
        (OURS, response(system, INITIAL, times)),
        (THEIRS, theirs.simulate(times, INITIAL, v=SPEED)[0]),
    ):
        print(f"  largest error of {name}: {np.abs(states - exact).max():.1e} rad or rad/s")


def measure_onsets(count: int, repeats: int) -> None:
    """Onset speeds of many parameter sets in one call, against one set after the other."""
    bicycle, few = load_bicycle("benchmark"), max(1, count // 100)
    generator = np.random.default_rng(0)
    varied = {
        name: value * (1.0 + 0.01 * generator.standard_normal(count))
        for name, value in bicycle.numbers.items()
    }
    alone = [
        assemble("one", WhippleParameters(**{name: float(values[k]) for name, values in varied.items()}))
        for k in range(few)
    ]
    at_once, apart = f"tms_model ensemble, {count} sets", f"tms_model stability, {few} sets"
    timings = in_turn(
        {
            apart: lambda: [stability(one) for one in alone],
            at_once: lambda: ensemble_stability(ensemble(bicycle, varied)),
        },
        repeats,
    )
    print_timings("onset, weave and capsize speeds", timings, apart)
    per_set = {name: timings[name].median / number for name, number in ((at_once, count), (apart, few))}
    print(f"  per set {1e6 * per_set[at_once]:.2f} us against {1e6 * per_set[apart]:.0f} us")
    found = ensemble_stability(ensemble(bicycle, varied)).onset_speed[:few]
    expected = np.array([stability(one).onset_speed for one in alone], dtype=float)
    print(f"  largest difference between the two: {np.nanmax(np.abs(found - expected)):.1e} m/s")


def _their_model() -> Any:
    parameters = load_bicycle("benchmark").parameters
    values = {symbol: float(getattr(parameters, name)) for symbol, name in SYMBOLS.items()}
    return Meijaard2007Model(Meijaard2007ParameterSet({**values, "v": SPEED}, True))


if __name__ == "__main__":
    main()
