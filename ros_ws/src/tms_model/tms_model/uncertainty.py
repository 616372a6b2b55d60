"""What the uncertainties of a bicycle's parameters make of its eigenvalues and of its speeds of stability.

Two ways, which agree when the uncertainties are small: first order (each parameter's derivative times its
standard deviation, summed in squares) and Monte Carlo (normal samples through the whole calculation).
Parameters count as independent, but for those of a calibrated bicycle, whose covariance is known: parameter
files state none, though trail, tilt and wheelbase, say, may have been measured together. What is uncertain is
what a bicycle's `standard_deviations` name; its steer elements count as known.

Where two eigenvalues meet, neither of them has a derivative: first order says nothing there, samples do.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from tms_model.bicycle import Array, Bicycle
from tms_model.ensemble import Ensemble, ensemble, ensemble_eigenvalues, ensemble_stability
from tms_model.errors import ParameterError

Complex = NDArray[np.complex128]
STEP = 1e-3  # of the central differences, in standard deviations
SPEEDS = ("onset_speed", "weave_speed", "capsize_speed")


@dataclass(frozen=True)
class Uncertain:
    """A quantity of an uncertain bicycle. NaN where the bicycle, or every sample, lacks it."""

    value: float  # of the stated parameters
    std: float  # to first order
    contributions: dict[str, float]  # parameter -> its part of std, with the derivative's sign
    sample_mean: float  # of the samples that have it; NaN without samples
    sample_std: float
    interval: tuple[float, float]  # 95 % of the samples that have it
    sample_share: float  # share of the samples that have it


def stability_uncertainty(
    bicycle: Bicycle, generator: np.random.Generator, samples: int = 10_000
) -> dict[str, Uncertain]:
    """Onset, weave and capsize speed [m/s] by their names in `SPEEDS`.

    samples: number for the Monte Carlo method, 0 for none. Raises ParameterError for a bicycle without
    parameters or without any standard deviation, and for a number of samples that is negative.
    """

    def speeds(bicycles: Ensemble) -> Array:
        found = ensemble_stability(bicycles)
        return np.stack([getattr(found, name) for name in SPEEDS], axis=1)

    return dict(zip(SPEEDS, _propagated(bicycle, speeds, generator, samples), strict=True))


def eigenvalue_uncertainty(
    bicycle: Bicycle, speed: float, generator: np.random.Generator, samples: int = 10_000
) -> list[tuple[Uncertain, Uncertain]]:
    """Real and imaginary part [1/s] of the four eigenvalues at a speed [m/s], in the order of `eigenvalues`.

    Each varied eigenvalue is compared with the nearest one of the stated parameters. Raises ParameterError as
    `stability_uncertainty` does.
    """
    stated = ensemble_eigenvalues(_stated(bicycle), speed)[0]

    def parts(bicycles: Ensemble) -> Array:
        roots = _matched(ensemble_eigenvalues(bicycles, speed), stated)
        return np.stack([roots.real, roots.imag], axis=2).reshape(len(roots), 8)

    found = _propagated(bicycle, parts, generator, samples)
    return list(zip(found[::2], found[1::2], strict=True))


def sampled(bicycle: Bicycle, generator: np.random.Generator, samples: int) -> dict[str, Array]:
    """Normal samples (n,) of the uncertain parameters, drawn in the order of `standard_deviations`."""
    means = asdict(bicycle.parameters) if bicycle.parameters else {}
    names = tuple(bicycle.standard_deviations)
    drawn = generator.standard_normal((len(names), samples))
    if bicycle.calibrated is not None:
        values, vectors = np.linalg.eigh(bicycle.calibrated.correlation_of(names))
        drawn = vectors @ (np.sqrt(np.maximum(values, 0.0))[:, None] * drawn)
    return {
        name: means[name] + bicycle.standard_deviations[name] * row
        for name, row in zip(names, drawn, strict=True)
    }


def _stated(bicycle: Bicycle) -> Ensemble:
    if bicycle.parameters is None or not any(bicycle.standard_deviations.values()):
        raise ParameterError(
            f"bicycle {bicycle.name}: expected standard deviations of its parameters, found none; a file says"
            " them as 'c = 0.069+/-0.002' (BicycleParameters), or under the key standard_deviations (YAML)"
        )
    return ensemble(bicycle, {"gravity": np.array([bicycle.gravity])})


def _propagated(
    bicycle: Bicycle, quantities: Callable[[Ensemble], Array], generator: np.random.Generator, samples: int
) -> list[Uncertain]:
    if samples < 0:
        raise ParameterError(f"samples: expected zero or more, found {samples}")
    values = quantities(_stated(bicycle))[0]
    names = [name for name, deviation in bicycle.standard_deviations.items() if deviation > 0.0]
    parts = _contributions(bicycle, names, quantities)
    correlation = (
        bicycle.calibrated.correlation_of(tuple(names)) if bicycle.calibrated else np.eye(len(names))
    )
    drawn = np.empty((0, len(values)))
    if samples:
        drawn = quantities(ensemble(bicycle, sampled(bicycle, generator, samples)))
    return [
        _uncertain(
            float(value),
            dict(zip(names, part.tolist(), strict=True)),
            float(part @ correlation @ part),
            column,
        )
        for value, part, column in zip(values, parts.T, drawn.T, strict=True)
    ]


def _contributions(bicycle: Bicycle, names: list[str], quantities: Callable[[Ensemble], Array]) -> Array:
    """Central differences times standard deviations, (parameters, quantities); all of them in one call."""
    means = asdict(bicycle.parameters) if bicycle.parameters else {}
    deviations = np.array([bicycle.standard_deviations[name] for name in names])
    steps = STEP * np.concatenate([np.diag(deviations), -np.diag(deviations)])
    varied = quantities(ensemble(bicycle, {name: means[name] + steps[:, k] for k, name in enumerate(names)}))
    return np.asarray((varied[: len(names)] - varied[len(names) :]) / (2.0 * STEP))


def _uncertain(value: float, contributions: dict[str, float], variance: float, drawn: Array) -> Uncertain:
    there = drawn[np.isfinite(drawn)]
    mean, std, low, high = np.nan, np.nan, np.nan, np.nan
    if len(there):
        mean, std = float(np.mean(there)), float(np.std(there, ddof=min(1, len(there) - 1)))
        low, high = (float(edge) for edge in np.quantile(there, (0.025, 0.975)))
    return Uncertain(
        value=value,
        std=math.sqrt(max(variance, 0.0)) if np.isfinite(variance) else np.nan,
        contributions=contributions,
        sample_mean=mean,
        sample_std=std,
        interval=(low, high),
        sample_share=len(there) / len(drawn) if len(drawn) else np.nan,
    )


def _matched(roots: Complex, stated: Complex) -> Complex:
    """Each row of roots (n, 4) in the order that brings it nearest to `stated` (4,), in square."""
    orders = np.array(list(permutations(range(4))))
    distances = np.abs(roots[:, orders] - stated) ** 2
    best = orders[np.argmin(distances.sum(axis=2), axis=1)]
    return np.take_along_axis(roots, best, axis=1)
