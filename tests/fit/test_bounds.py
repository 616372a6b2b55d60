"""What least squares can know: the Cramer-Rao bounds that others computed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from tms_fit.estimators import kalman_rts
from tms_fit.least_squares.problem import Problem, ProblemSolution, solve
from tms_fit.response.prediction import predictor
from tms_fit.speed_profile import constant_speed
from tms_fit.window import Window
from tms_model import linear_system, load_bicycle, response, yaw_rate

PUBLISHED = yaml.safe_load((Path(__file__).parents[1] / "data" / "least_squares.yaml").read_text())
CASE = PUBLISHED["case"]
BICYCLE = load_bicycle(CASE["bicycle"])


def free_response(speed: float, channels: tuple[str, ...] = ("lean_rate", "yaw_rate")) -> Window:
    """The case as a window that starts at the strike's very instant, with no noise on it."""
    time = np.arange(round(CASE["rate"] * CASE["duration"])) / CASE["rate"]
    system = linear_system(BICYCLE, speed)
    states = response(system, np.array([0.0, 0.0, CASE["initial_lean_rate"], 0.0]), time)
    measured = {"lean_rate": states[:, 2], "yaw_rate": yaw_rate(system, states)}
    absent = np.full(len(time), np.nan)
    columns = {name: values if name in channels else absent for name, values in measured.items()}
    return Window(0, time, **columns, bicycle=BICYCLE, speed=constant_speed(speed))


def solved(window: Window, free: tuple[str, ...]) -> ProblemSolution:
    """Least squares for unit noise."""
    good = np.isfinite(window.measured)
    linear = tuple(name for name in free if name != "speed")
    return solve(Problem(window, linear, free[len(linear) :]), lambda values: values[good])


def last_digit(number: float) -> float:
    """Half a unit of the last digit that a number is written with."""
    digits, _, exponent = f"{number:e}".partition("e")
    return 0.5 * 10.0 ** (int(exponent) - len(digits.rstrip("0").partition(".")[2]))


@pytest.mark.parametrize(
    "entry", PUBLISHED["bounds"], ids=lambda e: ",".join(e["free"] + e.get("channels", []))
)
def test_standard_errors_reach_the_bound(entry: dict[str, object]) -> None:
    free = tuple(entry["free"])  # type: ignore[call-overload]
    window = free_response(CASE["speed"], tuple(entry.get("channels", ("lean_rate", "yaw_rate"))))  # type: ignore[arg-type]
    index = free.index("initial_lean_rate")
    solution = solved(window, free)
    assert solution.values[index] == pytest.approx(CASE["initial_lean_rate"], rel=1e-9)
    std = CASE["noise"] * np.sqrt(solution.inverse[index, index])
    assert std == pytest.approx(entry["std"], abs=1.01 * last_digit(entry["std"]))  # type: ignore[arg-type]
    smoothed, inverse = kalman_rts.smooth_problem(Problem(window, free), solution.inverse)
    assert smoothed[index] == pytest.approx(CASE["initial_lean_rate"], rel=1e-9)
    assert CASE["noise"] * np.sqrt(inverse[index, index]) == pytest.approx(std, rel=1e-9)


@pytest.mark.parametrize("entry", PUBLISHED["bounds_with_speed"], ids=lambda e: ",".join(e["free"]))
def test_the_prediction_changes_with_speed_as_it_must(entry: dict[str, object]) -> None:
    # With speed as a further unknown, the bound needs the derivative of the prediction with respect to speed.
    free, step = tuple(entry["free"]), 1e-5  # type: ignore[call-overload]
    truth = {"initial_lean_rate": CASE["initial_lean_rate"]}
    ends = [predictor(free_response(CASE["speed"] + sign * step)).predict(truth) for sign in (-1, 1)]
    columns = predictor(free_response(CASE["speed"])).select(free).reshape(-1, len(free))
    jacobian = np.column_stack([columns, ((ends[1] - ends[0]) / (2 * step)).ravel()])
    std = CASE["noise"] * np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))
    assert std[0] == pytest.approx(entry["std"], abs=1.01 * last_digit(entry["std"]))  # type: ignore[arg-type]
    if "speed_std" in entry:
        assert std[-1] == pytest.approx(entry["speed_std"], abs=1.01 * last_digit(entry["speed_std"]))  # type: ignore[arg-type]


def test_the_yaw_rate_carries_most_of_the_information() -> None:
    def information(*channels: str) -> float:
        return float(
            1.0 / solved(free_response(CASE["speed"], channels), ("initial_lean_rate",)).inverse[0, 0]
        )

    both = information("lean_rate", "yaw_rate")
    assert information("lean_rate") + information("yaw_rate") == pytest.approx(both, rel=1e-12)
    assert information("yaw_rate") / both == pytest.approx(PUBLISHED["yaw_rate_share"], abs=0.005)
