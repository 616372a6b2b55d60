"""Fit of one strike's free response by every requested estimator."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from tms_model import Bicycle, ParameterError

from tms_fit.diagnostics.misspecification import Misspecification, find_misspecification
from tms_fit.diagnostics.remarks import with_remarks
from tms_fit.estimate import Estimate, Estimates, Parameter, Status
from tms_fit.estimators import ESTIMATORS
from tms_fit.estimators.least_squares import refine_start
from tms_fit.estimators.strike import with_force
from tms_fit.least_squares.intervals import with_intervals
from tms_fit.segment import FreeResponse, Segment, segment_window
from tms_fit.settings import Settings
from tms_fit.strikes.strike import NANOSECONDS, Strike
from tms_fit.strikes.window_end import WindowEnd
from tms_fit.window import Window


@dataclass(frozen=True, eq=False, repr=False)
class StrikeFit:
    """One strike and its estimates.

    `fit["initial_lean_rate"]` is a parameter of the first estimate, `fit.estimates["kalman_rts"]` another
    estimator's estimate.
    """

    strike: Strike
    segment: Segment
    window: Window | None  # None: nothing to compare with the model, the estimates' messages say why
    estimates: Estimates  # in the order asked for
    bicycle: str
    final: bool = True  # False: a preview, the response is still unfolding
    window_end: WindowEnd | None = None  # what ended the response before the window did; None: nothing
    misspecification: Misspecification | None = None  # of the first estimate, if final

    def __getitem__(self, name: str) -> Parameter:
        """A parameter of the first estimate. Raises KeyError where it was not estimated."""
        return self.estimates[0][name]

    def __contains__(self, name: object) -> bool:
        return name in self.estimates[0]

    def __iter__(self) -> Iterator[str]:
        return iter(self.estimates[0])

    def __repr__(self) -> str:
        return f"<StrikeFit at {self.start_ns / NANOSECONDS:.4f} s: {self.estimates!r}>"

    def __str__(self) -> str:
        head = f"{self.strike.kind} at {self.start_ns / NANOSECONDS:.4f} s"
        return "\n".join([head, *map(str, self.estimates)])

    @property
    def status(self) -> Status:
        """Status of the first estimate."""
        return self.estimates[0].status

    @property
    def start_ns(self) -> int:
        """Start of the free response."""
        return self.window.start_ns if self.window else self.strike.time_ns

    @property
    def speed(self) -> float:
        """Speed [m/s] at the start of the free response by the first estimate; NaN: unknown."""
        if self.window is None:
            return float("nan")
        return self.estimates[0].complete.get("speed", self.window.start_speed)

    @property
    def end_ns(self) -> int:
        """Last sample used."""
        return int(self.segment.time_ns[-1])


def fit_strike(response: FreeResponse, bicycle: Bicycle, settings: Settings, final: bool = True) -> StrikeFit:
    """Window, estimates by all estimators of the settings, and misspecification of a free response.

    By default the response of the linearised bicycle, initial lean rate and gyroscope biases unknown, is
    fitted to lean and yaw rate by least squares, and once more by a Kalman smoother.
    final: whether the response is complete; a preview is not tested for misspecification.
    """
    strike, segment, end = response.strike, response.segment, response.window_end
    try:
        window = segment_window(segment, bicycle, settings)
    except ParameterError as error:
        estimates = tuple(Estimate(name, Status.NOT_OBSERVABLE, str(error)) for name in settings.estimators)
        return StrikeFit(strike, segment, None, _with_causes(estimates, end, None), bicycle.name, final, end)
    window = _with_start(window, strike, settings)
    if "strike" in settings.estimators:
        window = with_force(window, response, settings)
    found = (with_remarks(window, ESTIMATORS[name](window, settings)) for name in settings.estimators)
    estimates = tuple(with_intervals(window, one, settings) for one in found)
    why = find_misspecification(window, settings, estimates[0]) if final and estimates else None
    explained = _with_causes(estimates, end, why)
    return StrikeFit(strike, segment, window, explained, bicycle.name, final, end, why)


def _with_start(window: Window, strike: Strike, settings: Settings) -> Window:
    """The window with the start of the free response: estimated between two samples, or as detected."""
    if strike.sharp:
        return refine_start(window, settings, (strike.time_ns - strike.before_ns) / 1e9)
    if strike.end_ns < strike.time_ns:
        delay = (strike.time_ns - strike.end_ns) / NANOSECONDS
        return replace(window, delay=delay, delay_std=strike.end_std)
    return window


def _with_causes(
    estimates: tuple[Estimate, ...], end: WindowEnd | None, why: Misspecification | None
) -> Estimates:
    """The estimates, their messages completed by what ended the window early and by a misspecification.

    A misspecification concerns the first estimate, and others of the same parameters.
    """
    cut = f"; window {max(end.time, 0.0):.2f} s: {end.why}" if end else ""
    found = []
    for one in estimates:
        warning = f"; {why.sentence}" if why and one.names == estimates[0].names else ""
        found.append(replace(one, message=f"{one.message}{cut}{warning}"))
    return Estimates(found)
