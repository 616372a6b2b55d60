"""What a bicycle that was calibrated against recordings says of itself: covariance, priors, how it was made.

    calibration:
      standard_deviations: {steer_damper: 0.08, steer_torque_gain: 0.04}    of what was calibrated
      correlations: [[1.0, -0.5], [-0.5, 1.0]]                              rows and columns in that order
      priors: {steer_damper: 0+/-0.5, steer_torque_gain: 1+/-0.15}
      recordings: [{name: run_1, sha256: 23..., strikes: 9}]
      command: tms fit calibrate ...
      version: 0.1.0

Angles are in radians here, also where the changes are in degrees.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from tms_model.errors import ParameterError
from tms_model.measured import Measured, parse

_KEYS = ("standard_deviations", "correlations", "priors", "recordings", "command", "version")
_OF_RECORDING = ("name", "sha256", "strikes")


@dataclass(frozen=True, eq=False)
class Calibrated:
    """Covariance of p numbers of a bicycle, and where they come from."""

    names: tuple[str, ...]
    covariance: NDArray[np.float64]  # (p, p) SI
    priors: Mapping[str, Measured]
    recordings: tuple[Mapping[str, Any], ...]  # name, sha256 of the log or bag, strikes used
    command: str
    version: str

    @property
    def standard_deviations(self) -> dict[str, float]:
        """By name."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    @property
    def correlation(self) -> NDArray[np.float64]:
        """(p, p)"""
        std = np.sqrt(np.diag(self.covariance))
        correlation: NDArray[np.float64] = self.covariance / np.outer(std, std)
        return correlation

    def correlation_of(self, names: tuple[str, ...]) -> NDArray[np.float64]:
        """Correlation (n, n) of some numbers; those that were not calibrated are independent of all."""
        matrix = np.eye(len(names))
        inside = [k for k, name in enumerate(names) if name in self.names]
        index = [self.names.index(names[k]) for k in inside]
        matrix[np.ix_(inside, inside)] = self.correlation[np.ix_(index, index)]
        return matrix


def read_calibration(document: Any, changed: tuple[str, ...], where: str) -> Calibrated:
    """From the mapping under `calibration`; `changed` are the numbers that the file changes.

    Raises ParameterError for anything that is missing, unknown or no covariance.
    """
    _check(document, _KEYS, where)
    deviations = {
        name: _number(value, f"{where}.standard_deviations.{name}")
        for name, value in _mapping(document["standard_deviations"], f"{where}.standard_deviations").items()
    }
    names = tuple(deviations)
    for name, value in deviations.items():
        if name not in changed or value <= 0.0:
            raise ParameterError(
                f"{where}.standard_deviations.{name}: expected a positive number for one of"
                f" {', '.join(changed)}, found {value:g}"
            )
    priors = _mapping(document["priors"], f"{where}.priors")
    _check(priors, names, f"{where}.priors")
    recordings = document["recordings"]
    if not isinstance(recordings, list) or not recordings:
        raise ParameterError(f"{where}.recordings: expected a list of {', '.join(_OF_RECORDING)}")
    for recording in recordings:
        _check(recording, _OF_RECORDING, f"{where}.recordings")
    std = np.array(list(deviations.values()))
    return Calibrated(
        names=names,
        covariance=np.outer(std, std) * _correlations(document["correlations"], len(names), where),
        priors={name: parse(str(value), f"{where}.priors.{name}") for name, value in priors.items()},
        recordings=tuple(recordings),
        command=str(document["command"]),
        version=str(document["version"]),
    )


def calibration_yaml(calibrated: Calibrated) -> dict[str, Any]:
    """The mapping that `read_calibration` reads; correlations to 4 digits, deviations to 6."""
    return {
        "standard_deviations": {k: float(f"{v:.6g}") for k, v in calibrated.standard_deviations.items()},
        "correlations": [[float(f"{value:.4f}") for value in row] for row in calibrated.correlation],
        "priors": {k: f"{v.value:.6g}+/-{v.deviation:.6g}" for k, v in calibrated.priors.items()},
        "recordings": [dict(recording) for recording in calibrated.recordings],
        "command": calibrated.command,
        "version": calibrated.version,
    }


def yaml_text(document: Mapping[str, Any]) -> str:
    """YAML in the order of the keys; lists of numbers on one line each."""
    return str(yaml.safe_dump(dict(document), sort_keys=False, width=110, default_flow_style=None))


def _correlations(value: Any, count: int, where: str) -> NDArray[np.float64]:
    try:
        matrix = np.array(value, dtype=float)
    except (TypeError, ValueError):
        matrix = np.empty(0)
    good = matrix.shape == (count, count) and bool(np.isfinite(matrix).all())
    if not (
        good
        and np.allclose(matrix, matrix.T, rtol=0.0, atol=1e-9)
        and np.allclose(np.diag(matrix), 1.0, rtol=0.0, atol=1e-9)
        and np.linalg.eigvalsh(matrix)[0] > -1e-3  # written to four digits
    ):
        raise ParameterError(
            f"{where}.correlations: expected a {count} x {count} correlation matrix, found {value!r}"
        )
    return matrix


def _mapping(value: Any, where: str) -> dict[str, Any]:
    if not isinstance(value, dict) or not value:
        raise ParameterError(f"{where}: expected names and numbers, found {type(value).__name__}")
    return {str(key): item for key, item in value.items()}


def _check(mapping: Any, keys: tuple[str, ...], where: str) -> None:
    found = tuple(str(key) for key in mapping) if isinstance(mapping, dict) else ()
    if sorted(found) != sorted(keys):
        raise ParameterError(
            f"{where}: expected the keys {', '.join(keys)}, found {', '.join(found) or 'none'}"
        )


def _number(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise ParameterError(f"{where}: expected a finite number, found {value!r}")
    return float(value)
