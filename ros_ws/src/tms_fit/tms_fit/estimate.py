"""Estimates of the parameters of one free response, with their uncertainty."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import SupportsIndex, overload

import numpy as np
from tms_model.bicycle import Array

from tms_fit.parameters import UNITS, shaping
from tms_fit.settings import Settings


class Status(str, Enum):
    """Status of an estimate; equal to its word in messages and JSON."""

    OK = "ok"
    NOT_CONVERGED = "not_converged"
    NOT_OBSERVABLE = "not_observable"
    TOO_SHORT = "too_short"

    @property
    def text(self) -> str:
        """Meaning of the status in one phrase."""
        return _STATUS_TEXTS[self]

    def __str__(self) -> str:
        return str(self.value)

    def __format__(self, form: str) -> str:
        return format(str(self.value), form)


_STATUS_TEXTS = {
    Status.OK: "the parameters were found",
    Status.NOT_CONVERGED: "no minimum was found; free fewer parameters or give priors",
    Status.NOT_OBSERVABLE: "the measurements don't determine the parameters that are free",
    Status.TOO_SHORT: "the free response holds too few samples",
}


@dataclass(frozen=True)
class Parameter:
    """One estimated parameter.

    >>> print(Parameter(0.5512, 0.0213, (0.5091, 0.5933), "rad/s"))
    0.5512 ± 0.021 rad/s (95 % 0.5091 to 0.5933)
    """

    value: float
    std: float  # standard error
    ci95: tuple[float, float]  # 95 % interval; infinite where it is open
    unit: str  # SI; 1: none

    def __str__(self) -> str:
        low, high = self.ci95
        unit = "" if self.unit == "1" else f" {self.unit}"
        return f"{self.value:.4g} ± {self.std:.2g}{unit} (95 % {low:.4g} to {high:.4g})"


@dataclass(frozen=True, eq=False, repr=False)
class Estimate:
    """Parameters of one free response with their uncertainty, or the reason why there are none.

    `estimate["initial_lean_rate"]` is a Parameter; `name in estimate` and iteration are by the names of the
    parameters that were estimated.
    """

    estimator: str
    status: Status
    message: str
    names: tuple[str, ...] = ()
    values: Array = field(default_factory=lambda: np.empty(0))  # (p,) SI
    covariance: Array = field(default_factory=lambda: np.empty((0, 0)))  # (p, p)
    degrees_of_freedom: int = 0
    residual_std: float = float("nan")  # [rad/s]
    vaf: dict[str, float] = field(default_factory=dict)  # per channel, 1 is perfect
    sample_count: int = 0  # scalar measurements used
    residual_autocorrelation: float = math.nan  # at lag one, largest of the channels; 0 for white noise
    known: Mapping[str, float] = field(default_factory=dict)  # values of the parameters that were not free
    predicted: Array = field(default_factory=lambda: np.empty((0, 2)))  # (n, 2) [rad/s]
    residual: Array = field(default_factory=lambda: np.empty((0, 2)))  # (n, 2) [rad/s], NaN: not used
    whitened: Array = field(
        default_factory=lambda: np.empty((0, 2))
    )  # (n, 2), of unit variance under the noise model
    jacobian: Array = field(default_factory=lambda: np.empty((0, 2, 0)))  # (n, 2, p) of predicted by values
    noise: Mapping[str, float] = field(default_factory=dict)  # parameters of the noise model, by name
    noise_model: str = "white"
    loss: str = "squares"  # of LOSSES, as used
    chosen: tuple[str, ...] = ()  # selections by the data where the settings left them open, with reasons
    log_likelihood: float = float("nan")  # at the maximum, noise parameters included
    unknown_count: int = 0  # of the likelihood: parameters and noise parameters
    settings: Settings | None = None  # as asked for
    intervals: Array | None = None  # (p, 2) 95 % intervals by profile or bootstrap; None: by the covariance

    def __getitem__(self, name: str) -> Parameter:
        """A parameter by name. Raises KeyError where it was not estimated."""
        if name not in self.names:
            raise KeyError(f"{name}: not estimated; expected of {', '.join(self.names) or 'none'}")
        index = self.names.index(name)
        low, high = self.ci95[index].tolist()
        value, std = float(self.values[index]), float(self.std[index])
        return Parameter(value, std, (low, high), UNITS.get(name, ""))

    def __contains__(self, name: object) -> bool:
        return name in self.names

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __repr__(self) -> str:
        found = ", ".join(f"{name}={self[name].value:.4g}" for name in self.names)
        return f"<Estimate {self.estimator} {self.status}{f': {found}' if found else ''}>"

    def __str__(self) -> str:
        width = max((len(name) for name in self.names), default=0)
        lines = [f"{self.estimator}: {self.message if self.status != Status.OK else self.status}"]
        return "\n".join([*lines, *(f"  {name:{width}}  {self[name]}" for name in self.names)])

    @property
    def parameters(self) -> dict[str, float]:
        """Values by name."""
        return dict(zip(self.names, (float(value) for value in self.values), strict=True))

    @property
    def complete(self) -> dict[str, float]:
        """Values of all parameters of the prediction by name, estimated and known."""
        return {**self.known, **self.parameters}

    @property
    def nonlinear(self) -> dict[str, float]:
        """Nonlinear parameters of `complete`, the arguments of `tms_fit.response.prediction.predictor`."""
        return shaping(self.complete)

    @property
    def std(self) -> Array:
        """Standard errors (p,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlation(self) -> Array:
        """Correlation matrix (p, p)."""
        correlation: Array = self.covariance / np.outer(self.std, self.std)
        return correlation

    @property
    def quantile(self) -> float:
        """Half of a 95 % interval per standard error: Student's t."""
        from scipy.special import stdtrit  # here, since its import takes as long as numpy's

        return float(stdtrit(max(self.degrees_of_freedom, 1), 0.975))

    @property
    def ci95(self) -> Array:
        """95 % intervals (p, 2): `intervals`, or by Student's t under the noise model."""
        if self.intervals is not None:
            return self.intervals
        half = self.quantile * self.std
        return np.stack([self.values - half, self.values + half], axis=1)

    @property
    def aic(self) -> float:
        """Akaike information criterion (AIC); comparable among fits of the same samples."""
        return 2.0 * self.unknown_count - 2.0 * self.log_likelihood

    @property
    def bic(self) -> float:
        """Bayesian information criterion (BIC); comparable among fits of the same samples."""
        return self.unknown_count * math.log(max(self.sample_count, 1)) - 2.0 * self.log_likelihood


class Estimates(tuple[Estimate, ...]):
    """Estimates of one strike in the requested order; `estimates["kalman_rts"]` looks up an estimator."""

    @overload
    def __getitem__(self, key: str | SupportsIndex) -> Estimate: ...
    @overload
    def __getitem__(self, key: slice) -> tuple[Estimate, ...]: ...
    def __getitem__(self, key: str | SupportsIndex | slice) -> Estimate | tuple[Estimate, ...]:
        """Estimate by estimator name or index. Raises KeyError for an estimator that was not requested."""
        if not isinstance(key, str):
            return super().__getitem__(key)
        for one in self:
            if one.estimator == key:
                return one
        raise KeyError(f"{key}: expected of {', '.join(one.estimator for one in self) or 'none'}")

    def __repr__(self) -> str:
        return f"Estimates({', '.join(map(repr, self))})"
