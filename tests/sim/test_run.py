"""Simulated runs: the motion, the sensors, the topics and their stamps."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation
from tms_bag.samples import ImuSamples
from tms_model import linear_system, load_bicycle
from tms_sim.imu_grade import imu_names, load_imu
from tms_sim.keys import KEYS
from tms_sim.protocol import FALLEN_LEAN as FALLEN
from tms_sim.run import SimulatedRun, simulate
from tms_sim.scenario import load_scenario, scenario_names

G = 9.81
# The supplement's idealisation: constant speed, a strike in no time, nothing else.
IDEALISED = [
    name
    for name in scenario_names()
    if not any(value is True for value in load_scenario(name).values.values())
]


def run(name: str = "tms_strike_ideal", **changes: Any) -> SimulatedRun:
    """A run of a scenario, keys with their dot written as two underscores."""
    scenario = load_scenario(name, {key.replace("__", "."): value for key, value in changes.items()})
    return simulate(scenario, np.random.default_rng(scenario.integer("seed")))


@pytest.mark.parametrize("name", IDEALISED)
def test_every_scenario_shows_its_strike(name: str) -> None:
    scenario, result = load_scenario(name), run(name)
    assert result.fallen_at is None
    start, struck = scenario.integer("start_time_ns"), round(scenario.number("strike.time") * 1e9)
    after = result.state.time_ns - start >= struck
    assert not result.state.state[~after].any()
    np.testing.assert_allclose(
        result.state.state[after][0],
        [0.0, 0.0, scenario.number("strike.lean_rate"), scenario.number("strike.steer_rate")],
        atol=1e-12,
    )
    assert result.info.parameters == load_bicycle(scenario.text("bicycle")).numbers
    assert result.info.simulated


# Where the sensor's clock is the host's and nothing is lost on the way.
PUNCTUAL = [
    name
    for name in scenario_names()
    if all(
        load_scenario(name).values[key] == KEYS[key].default for key in KEYS if key.startswith("wireless.")
    )
    and load_scenario(name).text("speed_sensor.kind") == "noise"
]


@pytest.mark.parametrize("name", PUNCTUAL)
def test_stamps_are_exact_and_rates_are_kept(name: str) -> None:
    scenario, result = load_scenario(name), run(name)
    for samples, rate in (
        (result.imu, scenario.number("imu.rate")),
        (result.lean_yaw, scenario.number("imu.rate")),
        (result.speed, scenario.number("speed_sensor.rate")),
        (result.state, scenario.number("state_rate")),
    ):
        steps = np.arange(int(result.trajectory.end * rate + 1e-9) + 1)
        expected = scenario.integer("start_time_ns") + np.round(steps * (1e9 / rate)).astype(np.int64)
        np.testing.assert_array_equal(samples.time_ns, expected)


def test_rates_that_do_not_divide_a_second_drift_by_no_nanosecond() -> None:
    # 300 Hz: every third sample falls on a hundredth of a second, to the nanosecond, after an hour as well.
    times = run(imu__rate=300.0, duration=8.0).imu.time_ns - 1_000_000_000
    np.testing.assert_array_equal(times[::3], np.arange(801) * 10_000_000)
    assert set(np.diff(times).tolist()) == {3_333_333, 3_333_334}


@pytest.mark.parametrize("name", IDEALISED)
def test_motion_is_what_an_integrator_finds(name: str) -> None:
    # The strike falls between two samples; so does nothing of the motion's exactness.
    scenario = load_scenario(name, {"strike.time": 2.0037, "strike.steer_rate": -1.1})
    result = simulate(scenario, np.random.default_rng(1))
    gain = scenario.number("steer_torque.lean_rate_gain")
    system = linear_system(load_bicycle(scenario.text("bicycle")), scenario.number("speed"))

    def change(_: float, state: np.ndarray) -> np.ndarray:
        return system.a @ state + system.b * (gain * state[2])

    struck = [0.0, 0.0, scenario.number("strike.lean_rate"), -1.1]
    since = (result.state.time_ns - scenario.integer("start_time_ns")) / 1e9 - 2.0037
    times = since[since >= 0.0][:300:50]
    found = solve_ivp(change, (0.0, times[-1]), struck, "DOP853", times, rtol=1e-11, atol=1e-13)
    np.testing.assert_allclose(result.state.state[since >= 0.0][:300:50], found.y.T, rtol=0.0, atol=2e-9)


def test_finer_rate_shares_its_samples_with_the_coarser() -> None:
    coarse = run(strike__time=2.0037, imu__rate=100.0, state_rate=50.0, speed_sensor__rate=10.0)
    fine = run(strike__time=2.0037, imu__rate=1000.0, state_rate=500.0, speed_sensor__rate=100.0)
    for one, other in (
        (coarse.imu, fine.imu),
        (coarse.state, fine.state),
        (coarse.lean_yaw, fine.lean_yaw),
        (coarse.speed, fine.speed),
    ):
        for name, values in vars(one).items():
            if isinstance(values, np.ndarray) and len(values) == len(one.time_ns):
                np.testing.assert_allclose(
                    getattr(other, name)[::10], values, rtol=0.0, atol=1e-11, err_msg=name
                )


@pytest.mark.parametrize("mounting", [(0.0, 0.0, 0.0), (25.0, -40.0, 130.0)], ids=["level", "askew"])
def test_ideal_sensor_against_its_path_through_the_world(mounting: tuple[float, ...]) -> None:
    # From the truth alone (lean, yaw, speed), without the formulas that the simulator and the estimator
    # share: where the sensor is in the world, and how it is turned, each differentiated numerically. REP-103
    # axes.
    place = np.array([0.2, 0.05, 0.6])
    result = run(
        "benchmark_strike",
        imu__grade="ideal",
        imu__position=place.tolist(),
        imu__orientation_deg=list(mounting),
        state_rate=1000.0,
        strike__lean_rate=1.0,
    )
    seconds = (result.state.time_ns - result.state.time_ns[0]) / 1e9
    moving = seconds >= 2.0
    seconds, heading = seconds[moving], -result.state.yaw[moving]
    lean, speed = result.state.state[moving, 0], result.state.speed[moving]
    along = CubicSpline(seconds, speed * np.cos(heading)).antiderivative()(seconds)
    left = CubicSpline(seconds, speed * np.sin(heading)).antiderivative()(seconds)
    frame = Rotation.from_euler("ZX", np.stack([heading, lean], axis=1))
    path = np.stack([along, left, np.zeros_like(along)], axis=1) + frame.apply(place)
    sensor = frame * Rotation.from_euler("xyz", mounting, degrees=True)
    force = sensor.inv().apply(CubicSpline(seconds, path)(seconds, 2) + np.array([0.0, 0.0, G]))
    turn = (sensor[:-2].inv() * sensor[2:]).as_rotvec() / (seconds[2:] - seconds[:-2])[:, None]

    measured = (result.imu.time_ns - result.imu.time_ns[0]) / 1e9
    shared = np.flatnonzero((measured > 2.05) & (measured < 7.9))
    index = np.round((measured[shared] - 2.0) * 1000.0).astype(int)
    np.testing.assert_allclose(result.imu.specific_force[shared], force[index], atol=2e-4)
    np.testing.assert_allclose(result.imu.angular_velocity[shared], turn[index - 1], atol=2e-5)
    assert np.ptp(force, axis=0).min() > 0.3  # there was something to feel on each axis


def test_before_the_strike_the_sensor_feels_the_ground_alone() -> None:
    imu = run(imu__position=[0.3, 0.0, 0.9]).imu
    still = imu.time_ns < imu.time_ns[0] + 2_000_000_000
    np.testing.assert_array_equal(imu.angular_velocity[still], 0.0)
    np.testing.assert_allclose(imu.specific_force[still], np.tile([0.0, 0.0, G], (200, 1)), atol=1e-15)


def test_lean_and_yaw_are_levelled() -> None:
    # Of a sensor that is not level, too, the summary says lean rate, and yaw rate about the vertical, to the
    # right.
    result = run(imu__orientation_deg=[15.0, -25.0, 70.0], strike__lean_rate=3.0)
    np.testing.assert_allclose(result.lean_yaw.lean_rate, result.state.state[:, 2], atol=1e-12)
    np.testing.assert_allclose(result.lean_yaw.yaw_rate, result.state.yaw_rate, atol=1e-12)
    np.testing.assert_allclose(result.lean_yaw.lean, result.state.state[:, 0], atol=1e-15)
    assert np.abs(result.state.yaw_rate).max() > 1.0


@pytest.mark.parametrize("grade", imu_names())
@pytest.mark.parametrize("rate", [50.0, 400.0])
def test_noise_is_density_times_root_of_rate(grade: str, rate: float) -> None:
    sensor = load_imu(grade)
    changes = {"imu__rate": rate, "duration": 60.0, "strike__time": 59.9}
    truth, noisy = run(imu__grade="ideal", **changes).imu, run(imu__grade=grade, **changes).imu
    expected = {
        "angular_velocity": sensor.gyroscope.noise_density * np.sqrt(rate),
        "specific_force": sensor.accelerometer.noise_density * np.sqrt(rate),
    }
    for name, std in expected.items():
        error = getattr(noisy, name) - getattr(truth, name)
        np.testing.assert_allclose(getattr(noisy, f"{name}_variance"), std**2, rtol=1e-12)
        if std == 0.0:
            assert not error.any()
            continue
        # Each of n samples of white noise adds 1 / sqrt(2 n) to the relative error of their standard
        # deviation, and neighbours and axes correlate by 1 / sqrt(n): five of those are never reached by
        # chance.
        count = len(error)
        np.testing.assert_allclose(error.std(axis=0), std, rtol=5.0 / np.sqrt(2.0 * count))
        np.testing.assert_allclose(error.mean(axis=0), 0.0, atol=5.0 * std / np.sqrt(count))
        for axis in range(3):
            neighbours = np.corrcoef(error[1:, axis], error[:-1, axis])[0, 1]
            axes = np.corrcoef(error[:, axis], error[:, (axis + 1) % 3])[0, 1]
            assert max(abs(neighbours), abs(axes)) < 5.0 / np.sqrt(count)


def saturated(imu: ImuSamples, limit: float) -> np.ndarray:
    return np.abs(imu.specific_force) >= limit


@pytest.mark.parametrize(
    ("orientation", "axis"),
    [((0.0, 0.0, 0.0), 2), ((90.0, 0.0, 0.0), 1), ((0.0, 90.0, 0.0), 0), ((180.0, 0.0, 0.0), 2)],
    ids=["z", "y", "x", "minus z"],
)
def test_accelerometer_stops_at_two_g_and_says_so(orientation: tuple[float, ...], axis: int) -> None:
    # Struck to 8 rad/s, 1.2 m up the frame: centripetal 8^2 * 1.2 = 76.8 m/s^2, downward along the frame.
    changes = {
        "strike__lean_rate": 8.0,
        "imu__position": [0.0, 0.0, 1.2],
        "imu__orientation_deg": list(orientation),
    }
    truth, cut = run(imu__grade="ideal", **changes), run(imu__grade="pi_node", **changes)
    limit = load_imu("pi_node").accelerometer.limit
    assert limit == 2.0 * G
    beyond = saturated(cut.imu, limit)
    assert 3 < beyond[:, axis].sum() < len(beyond) / 2
    assert np.abs(cut.imu.specific_force).max() == limit  # held at the limit, not beyond
    np.testing.assert_array_equal(cut.lean_yaw.saturation, beyond @ [1, 2, 4])
    # Where the truth is beyond the limit by more than noise can be, the reading is at the limit, of the
    # truth's sign; where it is clearly inside, it is the truth and noise.
    std = load_imu("pi_node").only(["noise_density"]).accelerometer.noise_std(100.0)
    far = np.abs(truth.imu.specific_force) > limit + 6.0 * std
    np.testing.assert_array_equal(cut.imu.specific_force[far], limit * np.sign(truth.imu.specific_force[far]))
    inside = np.abs(truth.imu.specific_force) < limit - 6.0 * std
    assert np.abs(cut.imu.specific_force - truth.imu.specific_force)[inside].max() < 6.0 * std
    assert not truth.lean_yaw.saturation.any()  # the ideal sensor has no limits


def test_violent_yaw_turns_gyroscope_flags_on(monkeypatch: pytest.MonkeyPatch) -> None:
    # No shipped sensor has a limit on its gyroscopes; one of 0.3 rad/s is reached in lean (x, flag 8) and yaw
    # (z, flag 32).
    ideal = load_imu("ideal")
    limited = replace(ideal, gyroscope=replace(ideal.gyroscope, limit=0.3))
    monkeypatch.setattr("tms_sim.sensors.imu_stream.load_imu", lambda name: limited)
    result = run()
    truth = result.state
    lean_beyond, yaw_beyond = np.abs(truth.state[:, 2]) >= 0.3, np.abs(truth.yaw_rate) >= 0.3 * 1.01
    np.testing.assert_array_equal((result.lean_yaw.saturation & 8) > 0, lean_beyond)
    assert lean_beyond.any()
    assert yaw_beyond.any()
    assert (result.lean_yaw.saturation[yaw_beyond] & 32).all()
    assert set(result.lean_yaw.saturation.tolist()) <= {0, 8, 32, 40}


def test_steer_torque_is_known_if_and_only_if_there_is_one() -> None:
    assert run("tms_strike").steer_torque is None
    assert "/bicycle/steer_torque" not in {record.topic for record in run("tms_strike").records()}
    fed = run("delft_push", imu__grade="ideal")
    assert fed.steer_torque is not None
    np.testing.assert_allclose(
        fed.steer_torque.steer_torque, 7.0 * fed.imu.angular_velocity[:, 0], atol=1e-12
    )
    np.testing.assert_array_equal(fed.steer_torque.time_ns, fed.imu.time_ns)
    np.testing.assert_allclose(fed.state.steer_torque, 7.0 * fed.state.state[:, 2], atol=1e-15)


def test_a_run_ends_where_the_bicycle_lies_down() -> None:
    # At 1.5 m/s the two-mass skate is unstable. However long the run was to be, numbers never overflow.
    result = run("tms_strike", speed=1.5, duration=600.0)
    assert result.fallen_at is not None
    assert 2.0 < result.fallen_at < 30.0
    for samples in (result.imu, result.lean_yaw, result.speed, result.state):
        last = (samples.time_ns[-1] - result.info.start_ns) / 1e9
        assert result.fallen_at - 0.021 < last <= result.fallen_at
    leans = np.abs(result.state.state[:, 0])
    assert leans.max() < FALLEN * 1.1
    assert leans[-2] < FALLEN
    longer = run("tms_strike", speed=1.5, duration=60.0)
    assert longer.fallen_at == result.fallen_at


def test_speed_sensor_is_noisy_about_the_speed() -> None:
    speed = run("tms_strike", duration=60.0, speed_sensor__noise=0.2, strike__time=59.0).speed.speed
    assert len(speed) == 3001
    assert abs(speed.mean() - 3.6) < 5.0 * 0.2 / np.sqrt(3001)
    assert speed.std() == pytest.approx(0.2, rel=5.0 / np.sqrt(2 * 3001))


def test_run_info_says_what_made_the_run() -> None:
    result = run("tms_strike", imu__orientation_deg=[0.0, 0.0, 90.0], imu__position=[0.1, -0.2, 0.3], seed=7)
    info = asdict(result.info)
    np.testing.assert_allclose(info["imu_orientation"], [0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)])
    np.testing.assert_array_equal(info["imu_position"], [0.1, -0.2, 0.3])
    assert (info["bicycle"], info["speed"], info["seed"], info["simulated"]) == ("tms_eq_10_1", 3.6, 7, True)
    assert info["source"] == "tms_sim, scenario tms_strike"
