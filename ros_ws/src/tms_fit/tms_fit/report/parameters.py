"""Tables of estimated parameters: values, standard errors, intervals, correlations."""

from __future__ import annotations

from tms_fit.estimate import Estimate
from tms_fit.report.element import Element, element, table
from tms_fit.report.rounding import NONE, decimals, fixed, number
from tms_fit.strike_fit import StrikeFit

UNITS = {
    "initial_lean": "rad",
    "initial_steer": "rad",
    "speed": "m/s",
    "rolling_resistance": "1",
    "strike_time": "s",
    "lean_rate_gain": "N m s/rad",
    "steer_damper": "N m s/rad",
    "mounting_pitch": "rad",
    "steer_coulomb_friction": "N m",
}
RATE = "rad/s"


def parameter_table(estimate: Estimate) -> Element:
    """Parameters of one estimate, and how they hang together."""
    std = estimate.std
    done = estimate.message[:1].upper() + estimate.message[1:]
    correlation = estimate.correlation
    head = ["parameter", "value", "standard error", "95 % interval", "unit"]
    head += [f"corr. with {words_of(name)}" for name in estimate.names] if len(estimate.names) > 1 else []
    rows: list[list[Element | str]] = []
    for index, name in enumerate(estimate.names):
        places = decimals(float(std[index]))
        low, high = estimate.ci95[index]
        row: list[Element | str] = [
            words_of(name),
            number(float(estimate.values[index]), places),
            number(float(std[index]), places),
            element("span", number(float(low), places), " to ", number(float(high), places), class_="range"),
            unit_of(name),
        ]
        if len(estimate.names) > 1:
            row += ["" if j == index else fixed(float(correlation[index, j]), 2) for j in range(len(std))]
        rows.append(row)
    return element(
        "section",
        element("h3", f"Parameters ({words_of(estimate.estimator)})"),
        element("p", f"{done}. Residual standard deviation {estimate.residual_std:.2g} rad/s."),
        table(head, rows, class_="parameters"),
    )


def unit_of(name: str) -> str:
    """Unit of a parameter."""
    return UNITS.get(name, RATE)


def estimator_table(strike: StrikeFit) -> Element:
    """What each estimator says, side by side."""
    rows: list[list[Element | str]] = []
    for estimate in strike.estimates:
        rate: Element | str = NONE
        interval: Element | str = NONE
        if "initial_lean_rate" in estimate.names:
            index = estimate.names.index("initial_lean_rate")
            places = decimals(float(estimate.std[index]))
            low, high = estimate.ci95[index]
            rate = number(float(estimate.values[index]), places)
            interval = element("span", number(float(low), places), " to ", number(float(high), places))
        vaf = ", ".join(f"{words_of(name)} {fixed(100.0 * v, 1)} %" for name, v in estimate.vaf.items())
        rows.append(
            [words_of(estimate.estimator), estimate.status, rate, interval, vaf or NONE, estimate.message]
        )
    head = [
        "estimator",
        "status",
        "initial lean rate [rad/s]",
        "95 % interval [rad/s]",
        "VAF",
        "what was done",
    ]
    return element("section", element("h3", "Estimators"), table(head, rows, class_="estimators"))


def words_of(name: str) -> str:
    """A parameter's name in text."""
    return name.replace("_", " ")
