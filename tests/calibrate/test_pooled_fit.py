"""Several runs in one fit: identities with the fit of one run, and truths recovered with honest intervals."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tms_calibrate.pooled_fit import Strike, fit_pooled
from tms_calibrate.pooled_problem import PooledProblem, Run
from tms_calibrate.pooled_solver import model_of, solve_pooled
from tms_fit.estimators.least_squares import fit_window
from tms_fit.least_squares.block_arrowhead import Block, solve_block_arrowhead
from tms_fit.settings import Settings
from tms_fit.speed_profile import constant_speed
from tms_fit.window import Window
from tms_model import ParameterError, load_bicycle

FREE = ("initial_lean_rate", "lean_rate_bias", "yaw_rate_bias")
NOISE = 0.02  # [rad/s]
TIME = np.arange(0.0, 1.5, 0.01)


def window(
    speed: float, values: dict[str, float], generator: np.random.Generator, std: float = 0.0
) -> Window:
    """A free response of the two-mass skate with white noise; std: what is said of the speed's error."""
    bare = Window(
        first_ns=0,
        time=TIME,
        lean_rate=np.zeros(len(TIME)),
        yaw_rate=np.zeros(len(TIME)),
        bicycle=load_bicycle("tms_eq_10_1"),
        speed=constant_speed(speed, std),
    )
    rates = model_of(bare, values).predict(values) + NOISE * generator.standard_normal((len(TIME), 2))
    return replace(bare, lean_rate=rates[:, 0], yaw_rate=rates[:, 1])


def strike(one: Window, free: tuple[str, ...] = FREE, index: int = 1) -> Strike:
    """A window as `fit run` would hand it on."""
    return Strike("run", index, 0.0, 0, one, fit_window(one, Settings(free=free, noise="white")))


def values_of(lean_rate: float, bias: float = 0.03) -> dict[str, float]:
    return {"initial_lean_rate": lean_rate, "lean_rate_bias": bias, "yaw_rate_bias": -0.01}


@pytest.mark.parametrize("share", [(), ("lean_rate_bias",), ("yaw_rate_bias", "lean_rate_bias")])
@pytest.mark.parametrize("doubt", [{}, {"std": 0.02}, {"delay_std": 0.002, "delay": 0.004}])
def test_one_run_together_is_its_own_fit(share: tuple[str, ...], doubt: dict[str, float]) -> None:
    one = window(3.6, values_of(0.5), np.random.default_rng(1), doubt.get("std", 0.0))
    one = replace(one, delay=doubt.get("delay", 0.0), delay_std=doubt.get("delay_std", 0.0))
    alone = strike(one)
    fit = fit_pooled([alone], share)
    together = fit.solution.values(0)
    std = dict(zip(fit.solution.problem.shared, np.sqrt(np.diag(fit.shared_covariance)), strict=True))
    std |= dict(
        zip(fit.solution.problem.runs[0].linear, np.sqrt(np.diag(fit.own_covariance[0])), strict=True)
    )
    for k, name in enumerate(FREE):
        assert together[name] == pytest.approx(alone.alone.values[k], rel=1e-9)
        # The noise's variance is for one unknown more where the start was found, too: 1 in 600.
        assert std[name] == pytest.approx(alone.alone.std[k], rel=2e-3 if "delay" in doubt else 1e-5)


def test_nonlinear_unknowns_of_one_run_are_its_own_fit() -> None:
    generator = np.random.default_rng(5)
    truth = {**values_of(0.5), "speed": 3.7, "rolling_resistance": 0.03}
    one = strike(window(3.6, truth, generator), (*FREE, "speed", "rolling_resistance"))
    fit = fit_pooled([one], ("rolling_resistance",))
    for name, value, std in zip(one.alone.names, one.alone.values, one.alone.std, strict=True):
        assert abs(fit.solution.values(0)[name] - value) < 1e-3 * std
    index = one.alone.names.index("rolling_resistance")
    assert np.sqrt(fit.shared_covariance[0, 0]) == pytest.approx(one.alone.std[index], rel=1e-4)


def test_runs_that_share_nothing_are_their_own_fits() -> None:
    generator = np.random.default_rng(2)
    strikes = [strike(window(v, values_of(p), generator)) for v, p in ((3.0, 0.3), (3.6, -0.5), (4.4, 0.8))]
    fit = fit_pooled(strikes, ())
    for k, one in enumerate(strikes):
        np.testing.assert_allclose(fit.solution.own[k], one.alone.values, rtol=1e-8, atol=1e-10)
    assert fit.solution.problem.degrees_of_freedom == 3 * (2 * len(TIME) - 3)


@pytest.mark.parametrize("count", [50, pytest.param(200, marks=pytest.mark.long)])
def test_a_shared_bias_is_found_with_honest_and_narrower_intervals(count: int) -> None:
    generator = np.random.default_rng(3)
    inside, widths = [], []
    for _ in range(count):
        runs = [window(v, values_of(p), generator) for v, p in ((3.0, 0.3), (3.6, -0.5), (4.4, 0.8))]
        strikes = [strike(one) for one in runs]
        fit = fit_pooled(strikes, ("lean_rate_bias",))
        std = float(np.sqrt(fit.shared_covariance[0, 0]))
        inside.append(abs(fit.solution.shared[0] - 0.03) <= fit.quantile * std)
        widths.append(std / min(one.alone.std[1] for one in strikes))
    assert 0.91 <= np.mean(inside) <= 0.99  # 0.95 +/- 2.6 standard deviations of 200, 0.0154
    assert max(widths) < 0.75


def test_rolling_resistance_is_shared_while_each_run_has_its_speed() -> None:
    generator = np.random.default_rng(4)
    speeds = (3.4, 3.9, 4.3)
    free = (*FREE, "speed", "rolling_resistance")
    strikes = [
        strike(window(v, {**values_of(0.6), "speed": v, "rolling_resistance": 0.03}, generator), free)
        for v in speeds
    ]
    fit = fit_pooled(strikes, ("rolling_resistance",))
    std = float(np.sqrt(fit.shared_covariance[0, 0]))
    assert fit.solution.status == "ok"
    assert abs(fit.solution.shared[0] - 0.03) < 3.0 * std
    assert std < min(one.alone.std[one.alone.names.index("rolling_resistance")] for one in strikes)
    for k, v in enumerate(speeds):
        assert fit.solution.values(k)["speed"] == pytest.approx(v, abs=0.05)
    assert fit.between["rolling_resistance"].count == 3


def test_the_arrow_is_least_squares_of_everything_at_once() -> None:
    generator = np.random.default_rng(6)
    blocks = [
        Block(*(generator.standard_normal(shape) for shape in ((m, q), (m, 2), (m,))))
        for m, q in ((9, 2), (7, 0), (12, 3))
    ]
    prior, wanted = generator.standard_normal((1, 2)), np.array([0.3])
    full = np.zeros((29, 7))
    rows, columns = np.cumsum([0, 9, 7, 12]), np.cumsum([0, 2, 0, 3])
    for k, block in enumerate(blocks):
        full[rows[k] : rows[k + 1], columns[k] : columns[k + 1]] = block.own
        full[rows[k] : rows[k + 1], 5:] = block.shared
    full[28, 5:] = prior
    expected = np.linalg.lstsq(full, np.concatenate([*(b.target for b in blocks), wanted]), rcond=None)[0]
    inverse = np.linalg.inv(full.T @ full)
    found = solve_block_arrowhead(blocks, prior, wanted)
    assert found is not None
    np.testing.assert_allclose(np.concatenate([*found.own, found.shared]), expected, rtol=1e-10)
    np.testing.assert_allclose(found.shared_inverse, inverse[5:, 5:], rtol=1e-9)
    np.testing.assert_allclose(found.own_inverse[2], inverse[2:5, 2:5], rtol=1e-9)


def test_what_the_runs_do_not_tell_is_said() -> None:
    one = window(3.6, values_of(0.5), np.random.default_rng(7))
    lean_only = replace(one, yaw_rate=np.full(len(TIME), np.nan))
    runs = (Run(lean_only, ("initial_lean_rate",)),)
    solution = solve_pooled(PooledProblem(runs, ("yaw_rate_bias",)))
    assert solution.status == "not_observable"
    assert "yaw_rate_bias" in solution.message


@pytest.mark.parametrize(
    ("share", "why"),
    [
        (("initial_lean_rate",), "share: unknown 'initial_lean_rate'"),
        (("lean_rate_bias", "lean_rate_bias"), "each name once"),
    ],
)
def test_what_can_not_be_shared_is_refused(share: tuple[str, ...], why: str) -> None:
    one = strike(window(3.6, values_of(0.5), np.random.default_rng(8)))
    with pytest.raises(ParameterError, match=why):
        fit_pooled([one], share)


BAGS = sorted(str(path.parent) for path in (Path(__file__).parents[2] / "bags").glob("*/metadata.yaml"))


def test_the_command_line_tells_how_strikes_differ(command: Any) -> None:
    bags = [bag for bag in BAGS if "strike" in bag]
    done = command("tms_fit", "together", *bags, "--share", "lean_rate_bias", "--json")
    assert done.code == 0, done.err
    document = json.loads(done.out)
    assert document["status"] == "ok"
    assert list(document["shared"]) == ["lean_rate_bias"]
    assert {"initial_lean_rate", "yaw_rate_bias"} <= set(document["heterogeneity"])
    for one in document["strikes"]:
        low, high = one["parameters"]["initial_lean_rate"]["ci95"]
        assert low < one["parameters"]["initial_lean_rate"]["value"] < high
        assert "lean_rate_bias" not in one["parameters"]
        assert "lean_rate_bias" in one["alone"]
    table = command("tms_fit", "together", *bags, "--share", "lean_rate_bias").out
    assert "shared  lean_rate_bias" in table
    assert f"{len(document['strikes'])} strikes in one fit" in table


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (("together", "nowhere"), "nowhere"),
        (("together", BAGS[0], "--near", "1.0", "--near", "2.0"), "near: expected once per bag"),
        (("together", BAGS[0], "--near", "900"), "expected a strike within 0.3 s of 900 s"),
        (("together", BAGS[0], "--share", "speed_of_light"), "share: unknown 'speed_of_light'"),
        (("together", BAGS[0], "--share", "strike_time"), "share: unknown 'strike_time'"),
        pytest.param(
            *(("together", BAGS[0], "--fix", "steer_coulomb_friction=0.1"), "expected in fit run only"),
            marks=pytest.mark.long,
        ),
        (("together", BAGS[0], "--prior", "trail=0.1,0.01"), "trail: expected a free parameter; add it to"),
        (("together", BAGS[0], "--prior", "speed=3,0"), "NAME=MEAN,STD"),
        (("together", BAGS[0], "--noise", "pink"), "invalid choice: 'pink'"),
        (("together", BAGS[0], "--near", "soon"), "expected times in seconds"),
        (("calibrate", BAGS[0], "--free", "trail", "-o", "a.txt"), "expected a name that ends in .yaml"),
        (("calibrate", BAGS[0], "--free", "trial", "-o", "a.yaml"), "at least 4 strikes"),
        (("calibrate", BAGS[0], "--free", "trail", "--prior", "trail=1", "-o", "a.yaml"), "NAME=MEAN,STD"),
    ],
)
def test_nonsense_is_one_line(refused: Any, arguments: tuple[str, ...], why: str) -> None:
    assert why in refused("tms_fit", *arguments)
