"""Public functions of `tms_fit`: fits of arrays, recordings and windows, and their result."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from importlib import import_module
from typing import TYPE_CHECKING, Any, overload

from numpy.typing import ArrayLike
from tms_bag import Recording, recording_from_arrays
from tms_model import Bicycle, load_bicycle
from tms_model.command_line import finite
from tms_model.errors import ParameterError

from tms_fit import recording_fit
from tms_fit.estimate import Estimate
from tms_fit.estimators import ESTIMATORS
from tms_fit.least_squares.intervals import with_intervals
from tms_fit.recording_fit import Progress, RecordingFit
from tms_fit.settings import OPTIONS, Settings
from tms_fit.strike_fit import StrikeFit
from tms_fit.strikes.strike import NANOSECONDS
from tms_fit.window import Window

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class FitResult(RecordingFit, Sequence[StrikeFit]):
    """Strikes of a run with their estimates.

    A sequence of strikes: `result[0]["initial_lean_rate"]` is a parameter of the first strike by the first
    estimator, `result[0].estimates["kalman_rts"]` another estimator's estimate. `print(result)`: a table.
    """

    @overload
    def __getitem__(self, index: int) -> StrikeFit: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[StrikeFit]: ...
    def __getitem__(self, index: int | slice) -> StrikeFit | Sequence[StrikeFit]:
        """Strike by index, counted from 0."""
        return self.strikes[index]

    def __len__(self) -> int:
        return len(self.strikes)

    def __repr__(self) -> str:
        strikes = ", ".join(map(repr, self.strikes))
        return f"<FitResult of {self.recording.path}, bicycle {self.bicycle.name}: [{strikes}]>"

    def __str__(self) -> str:
        from tms_fit.output import to_table

        return to_table(self)

    def to_dict(self, hypotheses: bool = False, budget: bool = False) -> dict[str, Any]:
        """Document of `fit run --json`: SI units and radians, None for unknown values.

        hypotheses: with hypothesis tests of each strike. budget: with the error budget of each strike.
        """
        from tms_fit.output import to_json

        asked = [name for name, wanted in (("hypotheses", hypotheses), ("budget", budget)) if wanted]
        document: dict[str, Any] = finite(to_json(self, asked))
        return document

    def to_pandas(self) -> Any:
        """Table (pandas.DataFrame) with a row for each parameter of each estimate. Raises ImportError.

        Columns: strike (from 0), time [s since the first stamp], estimator, status, parameter, value, std,
        low and high (95 % interval), unit.
        """
        try:
            pandas = import_module("pandas")
        except ImportError:
            raise ImportError("to_pandas: needs pandas, which isn't installed: pip install pandas") from None
        return pandas.DataFrame(list(self._rows()))

    def plot(self, strike: int = 0) -> Figure:
        """Figure 3B (matplotlib) of a strike, counted from 0: measured and predicted rates with their band.

        Raises RecordingError for a strike that isn't there or has no estimate.
        """
        from tms_fit.figure3b import figure_3b

        return figure_3b(self, strike + 1)

    def _rows(self) -> Iterable[dict[str, Any]]:
        start_ns = recording_fit.first_stamp(self.recording)
        for number, strike in enumerate(self.strikes):
            for estimate in strike.estimates:
                for name in estimate:
                    found = estimate[name]
                    yield {
                        "strike": number,
                        "time": (strike.start_ns - start_ns) / NANOSECONDS,
                        "estimator": estimate.estimator,
                        "status": estimate.status.value,
                        "parameter": name,
                        "value": found.value,
                        "std": found.std,
                        "low": found.ci95[0],
                        "high": found.ci95[1],
                        "unit": found.unit,
                    }


def fit(
    time: ArrayLike,
    angular_velocity: ArrayLike,
    *,
    speed: float | tuple[ArrayLike, ArrayLike],
    bicycle: str | Bicycle,
    orientation: ArrayLike | None = None,
    steer_torque: tuple[ArrayLike, ArrayLike] | None = None,
    strike_times: Iterable[float] = (),
    settings: Settings | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> FitResult:
    """Strikes in the readings of a gyroscope, each with its estimates.

    Parameters
    ----------
    time : array_like (n,)
        Ascending times [s].
    angular_velocity : array_like (n, 3)
        Angular velocity [rad/s] in REP-103 axes of the rear frame (x forward, y left, z up), or of the sensor
        where `orientation` is given. Not finite, or beyond
        1000 rad/s: not measured.
    speed : float or (times, values)
        Forward speed [m/s]: a constant that is known, or times (m,) [s] and speeds (m,). A number is only
        the first guess where `free` or `priors` hold the speed.
    bicycle : str or tms_model.Bicycle
        Name in the catalogue, file, or bicycle.
    orientation : array_like (4,), optional
        Quaternion x, y, z, w, sensor -> rear frame; None: the same axes.
    steer_torque : (times, values), optional
        Times (m,) [s] and known steer torques (m,) [N m], positive steers to the right.
    strike_times : iterable of float, optional
        Starts of the free responses [s since the first sample], in place of those detected.
    settings : Settings, optional
        Settings of the fit; None: the defaults.
    progress : callable, optional
        Called repeatedly with the completed share and the number of strikes; an exception that it raises ends
        the fit.
    **options
        Fields of `Settings` with other values: `window=2.0`, `free=("initial_lean_rate",)`.

    Returns
    -------
    FitResult
        A sequence of strikes; SAE signs (lean and yaw to the right are positive).

    Raises
    ------
    ParameterError
        For arrays and options that can't be used.
    RecordingError
        Where no rotation rate was measured, or a strike time is outside the samples. Not converging is no
        error: each estimate has a status.

    Examples
    --------
    >>> import numpy as np
    >>> from tms_fit import fit
    >>> from tms_model import linear_system, load_bicycle, response, yaw_rate
    >>> bicycle, after = load_bicycle("tms_eq_10_1"), np.arange(300) / 100.0
    >>> system = linear_system(bicycle, 4.6)
    >>> state = response(system, np.array([0.0, 0.0, 0.4, 0.0]), after)  # struck to 0.4 rad/s
    >>> rates = np.random.default_rng(1).normal(0.0, 0.005, (500, 3))
    >>> lean, yaw = state[:, 0], -yaw_rate(system, state)  # yaw to the left is positive in REP-103 axes
    >>> rates[200:] += np.stack([state[:, 2], yaw * np.sin(lean), yaw * np.cos(lean)], axis=1)
    >>> result = fit(np.arange(500) / 100.0, rates, speed=4.6, bicycle=bicycle)
    >>> len(result), abs(result[0]["initial_lean_rate"].value - 0.4) < 0.02
    (1, True)

    """
    chosen = _chosen(settings, options)
    if not isinstance(speed, tuple) and "speed" not in {*(chosen.free or ()), *chosen.priors, *chosen.fixed}:
        chosen = replace(chosen, fixed={**chosen.fixed, "speed": float(speed)})
    recording = recording_from_arrays(
        time, angular_velocity, speed, orientation=orientation, steer_torque=steer_torque
    )
    return fit_recording(recording, bicycle, chosen, strike_times=strike_times, progress=progress)


def fit_recording(
    recording: Recording,
    bicycle: str | Bicycle | None = None,
    settings: Settings | None = None,
    *,
    strike_times: Iterable[float] = (),
    progress: Progress | None = None,
    **options: Any,
) -> FitResult:
    """Strikes of a recording (`tms_bag.read_recording`), each with its estimates.

    bicycle: name of the catalogue, file, or `tms_model.Bicycle`; None: the one that the recording states.
    strike_times, settings, options, progress and errors: as for `fit`. Raises RecordingError also where the
    recording states neither a bicycle nor a speed.

    >>> from tms_bag import read_recording
    >>> print(fit_recording(read_recording("bags/tms_strike"))[0]["initial_lean_rate"].unit)
    rad/s
    """
    chosen = _chosen(settings, options)
    known = load_bicycle(bicycle) if isinstance(bicycle, str) else bicycle
    found = recording_fit.fit_recording(recording, known, chosen, strike_times, progress)
    return FitResult(found.recording, found.bicycle, found.settings, found.strikes, found.rejected)


def fit_window(
    window: Window, settings: Settings | None = None, *, estimator: str = "least_squares", **options: Any
) -> Estimate:
    """Estimate of the parameters of one free response, by one estimator, without looking for strikes.

    settings, options: as for `fit`. Raises ParameterError for an unknown estimator or option.
    """
    chosen = replace(_chosen(settings, options), estimators=(estimator,))
    return with_intervals(window, ESTIMATORS[estimator](window, chosen), chosen)


def _chosen(settings: Settings | None, options: dict[str, Any]) -> Settings:
    """Settings updated by options. Raises ParameterError for an unknown option."""
    for name in options:
        if name not in OPTIONS:
            raise ParameterError(f"unknown option {name!r}; expected of {', '.join(OPTIONS)}")
    return replace(settings or Settings(), **options)
