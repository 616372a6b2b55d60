"""What a strike's fit comes to, in plain words with its uncertainty."""

from __future__ import annotations

from tms_fit.comparison import first_good
from tms_fit.estimate import Estimate
from tms_fit.least_squares.make_estimate import AUTOCORRELATION_WARNING
from tms_fit.recording_fit import RecordingFit, first_stamp
from tms_fit.report.element import Element, element
from tms_fit.report.rounding import as_sentence, decimals, fixed, number
from tms_fit.strike_fit import StrikeFit

NAME = "initial_lean_rate"


def sentence(fit: RecordingFit, index: int) -> Element:
    """One paragraph about strike `index`, counted from 0."""
    strike = fit.strikes[index]
    when = fixed((strike.start_ns - first_stamp(fit.recording)) / 1e9, 2)
    estimate = first_good(strike)
    if estimate is None:
        reason = strike.estimates[0].message if strike.estimates else "no estimator was asked"
        return element(
            "p", f"{when} s into the recording the lean rate changed suddenly. No estimate: {reason}."
        )
    return element(
        "p",
        f"{when} s into the recording the bicycle was struck to the {_side(strike, estimate)}. ",
        *_initial(estimate),
        *_agreement(fit, strike, estimate),
        _caution(estimate),
        *_doubt(strike),
        class_="result",
    )


def _side(strike: StrikeFit, estimate: Estimate) -> str:
    change = estimate.parameters.get(NAME, strike.strike.change)
    return "right" if change > 0.0 else "left"


def _initial(estimate: Estimate) -> list[Element | str]:
    if NAME not in estimate.names:
        return [f"Its initial lean rate was not estimated ({estimate.estimator.replace('_', ' ')}). "]
    index = estimate.names.index(NAME)
    places = decimals(float(estimate.std[index]))
    low, high = estimate.ci95[index]
    return [
        "It began to lean at ",
        element("strong", number(float(estimate.values[index]), places), " rad/s"),
        " (95 % interval ",
        number(float(low), places),
        " to ",
        number(float(high), places),
        f" rad/s, {estimate.estimator.replace('_', ' ')}). ",
    ]


def _agreement(fit: RecordingFit, strike: StrikeFit, estimate: Estimate) -> list[Element | str]:
    assert strike.window is not None
    shares = [
        f"{fixed(100.0 * value, 1)} % of the {channel.replace('_', ' ')}'s variance"
        if value > 0.0
        else f"nothing of the {channel.replace('_', ' ')}'s variance (VAF {fixed(100.0 * value, 1)} %)"
        for channel, value in estimate.vaf.items()
    ]
    if not shares:
        return []
    span = (strike.end_ns - strike.start_ns) / 1e9
    return [
        f"Over the following {fixed(span, 2)} s the model of {fit.bicycle.name} at"
        f" {fixed(strike.speed, 2)} m/s accounts for {' and '.join(shares)}. "
    ]


def _doubt(strike: StrikeFit) -> list[Element | str]:
    if strike.misspecification is None:
        return []
    return [" ", element("strong", as_sentence(strike.misspecification.sentence), class_="caution doubt")]


def _caution(estimate: Estimate) -> Element | None:
    """What makes the interval too narrow, where the residuals show it."""
    if not estimate.residual_autocorrelation > AUTOCORRELATION_WARNING:
        return None
    alike = (
        f"Neighbouring residuals are alike (autocorrelation {fixed(estimate.residual_autocorrelation, 2)})"
    )
    if estimate.noise_model != "white":
        return element("span", f"{alike}; the interval allows for coloured noise.")
    text = f"{alike}: the model misses something, and the interval is too narrow."
    return element("strong", text, class_="caution")
