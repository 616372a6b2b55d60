"""Calibration of a bicycle: truths recovered inside their intervals, and the telling of data from priors."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import t as student_t
from tms_calibrate.calibration import Calibration, balanced_noise, calibrate, priors_for, scatter_degrees
from tms_calibrate.calibration_output import in_word
from tms_calibrate.cross_validation import jackknife_std, lean_rate_vaf, leave_recordings_out, leave_runs_out
from tms_calibrate.identifiability import identify
from tms_calibrate.initial_state_sensitivity import initial_state_sensitivity
from tms_calibrate.pooled_problem import PooledProblem, PooledSolution, Run
from tms_calibrate.pooled_solver import linearise, model_of, solve_pooled
from tms_fit.least_squares.block_arrowhead import BlockArrowheadSolution
from tms_fit.speed_profile import constant_speed
from tms_fit.window import Window
from tms_model import Bicycle, ParameterError, linear_system, load_bicycle, with_parameters
from tms_model.measured import Measured

OWN = ("initial_lean_rate", "lean_rate_bias")
TRUTH = {"rear_frame_inertia_zz": 2.6, "steer_damper": 0.3, "steer_torque_gain": 1.14}
PRIORS = {
    "rear_frame_inertia_zz": Measured(1.94, 0.76),
    "steer_damper": Measured(0.0, 0.5),
    "steer_torque_gain": Measured(1.0, 0.2),
}
TIME = np.arange(0.0, 1.5, 0.01)
SPEEDS = (3.0, 4.0)


def colored_noise(generator: np.random.Generator, std: float, tau: float, count: int) -> np.ndarray:
    """Noise (n,) whose autocorrelation falls with a time constant tau [s]; white for 0."""
    keep = np.exp(-0.01 / tau) if tau else 0.0
    noise = std * generator.standard_normal(count)
    for k in range(1, count):
        noise[k] = keep * noise[k - 1] + np.sqrt(1.0 - keep**2) * noise[k]
    return noise


def pushes(
    bicycle: Bicycle,
    truth: dict[str, float],
    generator: np.random.Generator,
    each: int,
    std: float,
    tau: float,
) -> tuple[Run, ...]:
    """`each` pushes at each speed of a bicycle with other numbers than it is said to have; lean rate only."""
    runs = []
    for speed in SPEEDS:
        for _ in range(each):
            bare = Window(
                first_ns=0,
                time=TIME,
                lean_rate=np.zeros(len(TIME)),
                yaw_rate=np.full(len(TIME), np.nan),
                bicycle=bicycle,
                speed=constant_speed(speed),
                lean_rate_gain=2.0 * (6.5 - speed),
            )
            own = {"initial_lean_rate": generator.uniform(0.4, 1.0), "lean_rate_bias": 0.01}
            rates = model_of(bare, truth).predict(own)[:, 0]
            runs.append(
                Run(replace(bare, lean_rate=rates + colored_noise(generator, std, tau, len(TIME))), OWN)
            )
    return tuple(runs)


@pytest.fixture(scope="module")
def delft() -> Bicycle:
    """The bicycle as published."""
    return load_bicycle("delft_sbw")


@pytest.fixture(scope="module", params=[5, pytest.param(20, marks=pytest.mark.long)])
def calibrations(request: pytest.FixtureRequest, delft: Bicycle) -> list[Calibration]:
    """Of some campaigns of 8 pushes each, with noise that is alike over 50 ms."""
    generator = np.random.default_rng(11)
    return [
        calibrate(delft, pushes(delft, TRUTH, generator, 4, 0.04, 0.05), tuple(TRUTH), PRIORS)
        for _ in range(request.param)
    ]


def test_changed_numbers_are_recovered_within_their_intervals(calibrations: list[Calibration]) -> None:
    truth = np.array(list(TRUTH.values()))
    off = np.array([(one.values - truth) / one.std for one in calibrations])
    # 60 normal numbers of 20 campaigns, those of one correlated: their mean square within 0.5 to 1.7.
    assert 0.5 < np.mean(off**2) < 1.7
    assert np.mean(np.abs(off) < 1.96) > 0.87
    assert np.abs(off).max() < 4.5
    assert all(one.solution.status == "ok" for one in calibrations)


@pytest.mark.long
def test_what_a_start_that_is_not_upright_does_is_told(delft: Bicycle) -> None:
    # Pushes of 0.2 s that end with lean and steer, all in the same proportion: their scatter shows nothing.
    generator = np.random.default_rng(3)
    upright = pushes(delft, TRUTH, generator, 4, 0.005, 0.0)
    leaning = []
    for run in upright:
        rate = generator.uniform(0.4, 1.0)
        own = {"initial_lean_rate": rate, "initial_lean": 0.13 * rate, "initial_steer_rate": -2.0 * rate}
        rates = model_of(run.window, TRUTH).predict(own)[:, 0]
        noise = colored_noise(generator, 0.005, 0.0, len(TIME))
        leaning.append(replace(run, window=replace(run.window, lean_rate=rates + noise)))
    truth = np.array(list(TRUTH.values()))
    right, wrong = (calibrate(delft, runs, tuple(TRUTH), PRIORS) for runs in (upright, tuple(leaning)))
    assert np.abs((wrong.values - truth) / wrong.std).max() > 5.0
    told = initial_state_sensitivity(wrong)
    assert told is not None
    assert told.matter
    assert "the intervals hold only if" in told.in_words
    assert np.abs((told.values - truth) / told.std).max() < 4.0
    same = initial_state_sensitivity(right)
    assert same is not None
    assert "the intervals hold only if" not in same.in_words or same.matter
    assert np.abs((same.values - truth) / same.std).max() < 4.0


@pytest.mark.long
def test_alike_residuals_count_less(calibrations: list[Calibration], delft: Bicycle) -> None:
    # An autocorrelation that falls with 50 ms at 100 Hz: 1 + 2 sum exp(-0.2 k) = 10.03 samples tell as much
    # as one, where the prediction changes slowly beside it; with white noise each tells for itself.
    assert 4.0 < np.median([one.design_effect for one in calibrations]) < 14.0
    generator = np.random.default_rng(12)
    white = [
        calibrate(delft, pushes(delft, TRUTH, generator, 4, 0.04, 0.0), tuple(TRUTH), PRIORS).design_effect
        for _ in range(3)
    ]
    assert 0.5 < np.median(white) < 1.6


def shaking(generator: np.random.Generator, std: float) -> np.ndarray:
    """An oscillation (n,) of 20 Hz, twice as large as white noise under it, its phase forgotten in 0.5 s."""
    turn = np.exp((-2.0 + 40j * np.pi) * 0.01)
    draws = generator.standard_normal((len(TIME), 2)) @ np.array([1.0, 1j])
    for k in range(1, len(TIME)):
        draws[k] = turn * draws[k - 1] + np.sqrt(1.0 - abs(turn) ** 2) * draws[k]
    return 2.0 * std * draws.real + std * generator.standard_normal(len(TIME))


@pytest.mark.parametrize(("kind", "each"), [("white", 8), ("shimmy", 8), ("0.05", 8), ("0.2", 8), ("0.2", 2)])
@pytest.mark.quick_for(each=[2])
def test_intervals_by_the_scatter_of_pushes_hold_whatever_the_noise_is_like(
    delft: Bicycle, kind: str, each: int
) -> None:
    # Truths drawn from the priors and predictions taken as linear, so that many campaigns are cheap.
    generator = np.random.default_rng(23)
    runs = pushes(delft, TRUTH, generator, each, 0.0, 0.0)
    problem = PooledProblem(runs, nonlinear=tuple(TRUTH), priors=PRIORS)
    around = linearise(problem, np.array(list(TRUTH.values()))).arrow
    assert around is not None
    bases = [np.linalg.qr(model_of(run.window, TRUTH).select(OWN)[:, 0])[0] for run in runs]
    mean = np.array([prior.value for prior in PRIORS.values()])
    spread = np.array([prior.deviation for prior in PRIORS.values()])
    inside = []
    for _ in range(100):
        truth, measured = spread * generator.standard_normal(3), []
        for slope, basis in zip(around.projected, bases, strict=True):
            noise = (
                shaking(generator, 0.04)
                if kind == "shimmy"
                else colored_noise(generator, 0.04, 0.0 if kind == "white" else float(kind), len(TIME))
            )
            measured.append(slope @ truth + noise - basis @ (basis.T @ noise))
        solution = linear_calibration(problem, around.projected, measured, mean)
        assert solution.arrow is not None
        std = np.sqrt(np.diag(solution.arrow.shared_inverse))
        wide = student_t.ppf(0.975, scatter_degrees(solution))
        inside.append(np.abs(solution.shared - mean - truth) < wide * std)
    # 0.95 of 300, correlated by threes at most: 0.022 is the deviation; four pushes hold a little less.
    assert (0.89 if each > 2 else 0.86) < np.mean(inside) < 0.99


def linear_calibration(
    problem: PooledProblem, slopes: tuple[np.ndarray, ...], measured: list[np.ndarray], mean: np.ndarray
) -> PooledSolution:
    """What `solve_balanced` comes to where predictions are linear; measured: off those of the priors."""
    prior = np.diag([1.0 / one.deviation**2 for one in PRIORS.values()])
    noise = 0.16
    for _ in range(30):
        information = sum(slope.T @ slope for slope in slopes) / noise**2
        pull = sum(slope.T @ one for slope, one in zip(slopes, measured, strict=True)) / noise**2
        covariance = np.linalg.inv(information + prior)
        step = covariance @ pull
        left = tuple(one - slope @ step for slope, one in zip(slopes, measured, strict=True))
        scaled = tuple(slope / noise for slope in slopes)
        arrow = BlockArrowheadSolution((), step, (), (), covariance, scaled)
        found = PooledSolution(replace(problem, noise=noise), "ok", "", mean + step, (), left, arrow)
        noise = balanced_noise(found)
    return found


def test_leaving_pushes_out_tells_the_same_scatter(calibrations: list[Calibration]) -> None:
    ratios = []
    for one in calibrations:
        values, _ = leave_runs_out(one)
        assert one.solution.arrow is not None
        information = sum(p.T @ p for p in one.solution.arrow.projected)
        by_data = np.sqrt(np.diag(one.covariance @ information @ one.covariance))
        ratios.append(jackknife_std(values) / by_data)
    assert 0.75 < np.median(ratios) < 1.35


def test_a_push_left_out_to_first_order_is_one_left_out(delft: Bicycle) -> None:
    runs = pushes(delft, TRUTH, np.random.default_rng(13), 4, 0.04, 0.05)
    whole = calibrate(delft, runs, tuple(TRUTH), PRIORS)
    values, vaf = leave_runs_out(whole)
    exact = solve_pooled(replace(whole.solution.problem, runs=whole.solution.problem.runs[1:]), whole.values)
    np.testing.assert_allclose((values[0] - exact.shared) / whole.std, 0.0, atol=0.1)
    window = whole.solution.problem.runs[0].window
    assert vaf[0] == pytest.approx(lean_rate_vaf(window, exact.shared_values), abs=1e-3)


def test_the_other_speed_is_predicted(delft: Bicycle) -> None:
    runs = pushes(delft, TRUTH, np.random.default_rng(14), 6, 0.02, 0.05)
    whole = calibrate(delft, runs, tuple(TRUTH), PRIORS)
    out = leave_recordings_out(whole, ["slow"] * 6 + ["fast"] * 6)
    assert set(out) == {"slow", "fast"}
    published = np.median([lean_rate_vaf(run.window, {}) for run in runs])
    for one in out.values():
        assert np.median(one.vaf) > 0.98 > published + 0.01
    assert leave_recordings_out(whole, ["one"] * 12) == {}


def test_what_the_runs_say_nothing_of_stays_as_its_prior(delft: Bicycle) -> None:
    # Without a torque nothing shows how much of it would arrive.
    runs = pushes(delft, {"steer_damper": 2.0}, np.random.default_rng(15), 3, 0.02, 0.0)
    silent = tuple(replace(run, window=replace(run.window, lean_rate_gain=0.0)) for run in runs)
    found = calibrate(
        delft, silent, ("steer_torque_gain", "steer_damper"), {"steer_damper": Measured(0.0, 2.0)}
    )
    assert found.values[0] == pytest.approx(1.0, abs=1e-9)
    assert found.std[0] == pytest.approx(0.2, rel=1e-9)
    assert in_word(float(found.contraction[0])) == "prior"
    assert in_word(float(found.contraction[1])) == "data"


def test_a_product_is_told_and_its_factors_are_not(delft: Bicycle) -> None:
    # The controller's gain and what of it arrives act by their product alone.
    runs = pushes(delft, TRUTH, np.random.default_rng(16), 3, 0.02, 0.0)[:3]
    values = {"steer_torque_gain": 1.14, "lean_rate_gain": 7.0}
    found = identify(
        PooledProblem(runs, noise=0.02), values, {"steer_torque_gain": 0.114, "lean_rate_gain": 0.7}
    )
    assert found.singular[1] < 1e-6 * found.singular[0]
    assert found.known == 1
    np.testing.assert_allclose(np.abs(found.directions[:, 0]), np.sqrt(0.5), rtol=1e-6)
    assert found.in_words(0) in (
        "0.71 steer_torque_gain + 0.71 lean_rate_gain",
        "0.71 lean_rate_gain + 0.71 steer_torque_gain",
    )
    # Known to a relative 0.1 each, and together well: what is left is the difference, 0.1 / sqrt(2).
    np.testing.assert_allclose(found.together, np.sqrt(0.5), rtol=1e-3)
    assert (found.alone < 0.1).all()


def test_entries_of_the_matrices_can_be_found_too(delft: Bicycle) -> None:
    truth = {"M_steer_steer": 1.1 * float(delft.mass[1, 1])}
    runs = pushes(delft, truth, np.random.default_rng(17), 3, 0.01, 0.0)
    found = calibrate(delft, runs, ("M_steer_steer",), {})
    assert found.prior_sources == {"M_steer_steer": "assumed"}
    assert abs(found.values[0] - truth["M_steer_steer"]) < 3.5 * found.std[0]
    assert found.std[0] < 0.2 * truth["M_steer_steer"] / 5.0


def test_priors_say_where_they_come_from(delft: Bicycle) -> None:
    stated = replace(delft, standard_deviations={"trail": 0.002})
    names = ("trail", "wheelbase", "steer_damper", "rear_frame_mass")
    priors, sources = priors_for(stated, names, {"rear_frame_mass": Measured(20.0, 0.5)})
    assert priors["trail"] == Measured(0.0803, 0.002)
    assert priors["wheelbase"] == Measured(1.036, pytest.approx(0.2072))
    assert priors["rear_frame_mass"] == Measured(20.0, 0.5)
    assert list(sources.values()) == ["stated", "assumed", "assumed", "given"]
    with pytest.raises(ParameterError, match="lean_rate_gain: expected a standard deviation"):
        priors_for(delft, ("lean_rate_gain",), {})
    with pytest.raises(ParameterError, match="free: unknown 'weight'"):
        priors_for(delft, ("weight",), {})
    with pytest.raises(ParameterError, match="prior: unknown 'trail'"):
        priors_for(delft, ("wheelbase",), {"trail": Measured(0.0, 1.0)})


def test_too_little_is_refused(delft: Bicycle) -> None:
    runs = pushes(delft, TRUTH, np.random.default_rng(18), 1, 0.02, 0.0)
    with pytest.raises(ParameterError, match="at least 4 strikes, whose scatter"):
        calibrate(delft, runs, ("trail",), {})
    with pytest.raises(ParameterError, match="each name once"):
        calibrate(delft, runs * 2, ("trail", "trail"), {})


@pytest.mark.long
def test_a_calibrated_bicycle_is_one_to_work_with(command: Any, tmp_path: Path) -> None:
    bag = Path(__file__).parents[2] / "bags" / "delft_push"
    bags = []
    for seed in range(4):
        bags.append(str(tmp_path / f"run_{seed}"))
        made = command("tms_sim", "run", "delft_push", "--seed", seed + 1, "-o", bags[-1])
        assert made.code == 0, made.err
    mine = tmp_path / "mine.yaml"
    arguments = (
        "--free",
        "steer_damper,rear_frame_inertia_zz",
        "-o",
        mine,
        "--picture",
        tmp_path / "mine.png",
    )
    done = command("tms_fit", "calibrate", *bags, *arguments, "--json")
    assert done.code == 0, done.err
    document = json.loads(done.out)
    bicycle = load_bicycle(str(mine))
    assert bicycle.calibrated is not None
    for k, name in enumerate(("steer_damper", "rear_frame_inertia_zz")):
        found = document["parameters"][name]
        assert bicycle.numbers[name] == pytest.approx(found["value"], rel=1e-6)
        assert bicycle.calibrated.standard_deviations[name] == pytest.approx(found["std"], rel=1e-5)
        assert abs(found["value"] - (0.0, 1.94)[k]) < 4.0 * found["std"]  # nothing was changed
    np.testing.assert_allclose(bicycle.calibrated.covariance, document["covariance"], rtol=1e-3)
    assert [one["strikes"] for one in bicycle.calibrated.recordings] == [1, 1, 1, 1]
    assert bicycle.calibrated.command.startswith("tms fit calibrate ")
    assert (tmp_path / "mine.png").stat().st_size > 10_000
    fitted = command("tms_fit", "run", bag, "--bicycle", mine, "--free", "initial_lean_rate", "--json")
    assert json.loads(fitted.out)["strikes"][0]["estimates"][0]["vaf"]["lean_rate"] > 0.95
    table = command("tms_fit", "calibrate", *bags, "--free", "steer_damper", "-o", mine).out
    assert "told by" in table
    assert f"written: {mine}" in table


def test_the_gain_of_a_run_reaches_the_prediction_through_the_bicycles_actuator(delft: Bicycle) -> None:
    run = pushes(delft, {}, np.random.default_rng(19), 1, 0.0, 0.0)[0]
    strong = with_parameters(delft, {"steer_torque_gain": 1.25})
    np.testing.assert_allclose(
        model_of(replace(run.window, bicycle=strong, lean_rate_gain=4.0), {}).columns,
        model_of(replace(run.window, lean_rate_gain=5.0), {}).columns,
        rtol=1e-12,
    )
    assert linear_system(strong, 3.0, 4.0).a[3, 2] == pytest.approx(linear_system(delft, 3.0, 5.0).a[3, 2])
