"""The ride: coasting, asymmetry, slip, kick, shimmy, joints, fall and catch, each by what it must do."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tms_model import load_bicycle, stability
from tms_model.acceleration import effective_mass, parameters_under_acceleration
from tms_model.sliding import sliding_equations
from tms_model.varying_speed import varying_response, varying_system
from tms_sim.motion import Trajectory

G = 9.81
ONSET = 2.2592374  # [m/s], tms_eq_10_1
# A run of Eq. (10.1) that coasts from the start, struck at once.
COASTING: dict[str, Any] = {
    "floor": "thin_rubber",
    "effects__rolling_resistance": True,
    "strike__time": 0.5,
    "speed_at_strike": 3.6,
}
LEAN, STEER, LEAN_RATE, STEER_RATE = range(4)


def figures(trajectory: Trajectory, kind: str) -> list[dict[str, float]]:
    return [dict(event.figures) for event in trajectory.events if event.kind == kind]


def grid(trajectory: Trajectory, step: float = 0.001) -> np.ndarray:
    return np.arange(0.0, trajectory.end, step)


# Coasting


def test_coasting_follows_the_equations_of_a_changing_speed(go: Any) -> None:
    run = go("tms_strike", **COASTING, duration=3.0)
    times = np.linspace(0.5, 3.0, 26)
    motion = run.at(times)
    speeds = 3.6 - 0.06 * G * (times - 0.5)
    np.testing.assert_allclose(motion.speed, speeds, atol=1e-12)
    system = varying_system(load_bicycle("tms_eq_10_1"), times, speeds)
    expected = varying_response(system, np.array([0.0, 0.0, 0.5, 0.0]))
    found = np.stack([motion.lean, motion.steer, motion.lean_rate, motion.steer_rate], axis=1)
    np.testing.assert_allclose(found, expected, atol=1e-8)


@pytest.mark.parametrize("bicycle", ["tms_eq_10_1", "tms_table_8_1"])
def test_lost_energy_is_the_work_of_the_resistance(go: Any, bicycle: str) -> None:
    # Straight ahead: 1/2 m_eff v^2 is lost to the force C_r m g along the way; m_eff counts the wheels' spin.
    run = go("tms_strike", **COASTING, bicycle=bicycle, strike__lean_rate=0.0, duration=3.0)
    p, _ = parameters_under_acceleration(load_bicycle(bicycle))
    mass = p.rear_wheel_mass + p.rear_frame_mass + p.front_frame_mass + p.front_wheel_mass
    motion = run.at(np.array([0.0, 3.0]))
    lost = 0.5 * effective_mass(p) * (motion.speed[0] ** 2 - motion.speed[1] ** 2)
    assert lost == pytest.approx(0.06 * mass * G * motion.rear_contact[1, 0], rel=1e-12)


def test_run_of_3_6_m_s_is_unstable_from_the_onset_speed_on(go: Any) -> None:
    # Below 2.2592 m/s after 2.28 s, by the supplement's C_r.
    run = go("tms_strike", **COASTING, duration=8.0)
    times = grid(run)
    speed = run.at(times).speed
    assert times[np.argmax(speed < ONSET)] - 0.5 == pytest.approx((3.6 - ONSET) / (0.06 * G), abs=0.002)
    ((low, high),) = stability(load_bicycle("tms_eq_10_1")).stable_speed_ranges
    assert low == pytest.approx(ONSET, abs=1e-6)
    assert math.isinf(high)
    # And it shows: at constant speed the swing has died out when the coasting bicycle's has grown large.
    kept = go("tms_strike", strike__time=0.5, duration=8.0)
    late = np.linspace(6.0, run.end, 200)
    assert np.abs(run.at(late).lean).max() > 30.0 * np.abs(kept.at(late).lean).max()


def test_speed_at_strike_is_met_on_every_floor(go: Any) -> None:
    for floor in ("hard_wood", "linoleum", "thick_rubber", "thin_rubber"):
        run = go("gym_run", floor=floor)
        assert run.at(np.array([4.0])).speed[0] == pytest.approx(3.6, rel=1e-12)
    # Too fast to see self-stability: within a second of the strike it is gone.
    thick = go("gym_run", floor="thick_rubber", catch__lean_deg=0.0)
    assert thick.at(np.array([5.0])).speed[0] < ONSET


def test_path_is_where_speed_heading_and_slip_lead(go: Any) -> None:
    run = go("gym_strikes")
    times = grid(run)
    motion = run.at(times)
    cos, sin = np.cos(motion.yaw), np.sin(motion.yaw)
    velocity = np.stack(
        [motion.speed * cos - motion.rear_slip * sin, motion.speed * sin + motion.rear_slip * cos], axis=1
    )
    steps = 0.0005 * (velocity[1:] + velocity[:-1])
    np.testing.assert_allclose(np.diff(motion.rear_contact, axis=0), steps, atol=1e-5)
    # The front contact moves where the front wheel points, but for its slip.
    p = load_bicycle("tms_eq_10_1")
    moved = np.diff(motion.front_contact, axis=0) / 0.001
    points = motion.yaw + math.cos(p.steer_axis_tilt) * motion.steer
    across = -np.sin(points[:-1]) * moved[:, 0] + np.cos(points[:-1]) * moved[:, 1]
    rolling = (np.abs(motion.front_slip[:-1]) < 1e-9) & (np.abs(motion.steer[:-1]) < 0.1)
    assert np.abs(across[rolling]).max() < 0.05  # of 3.6 m/s: steer is small to first order only


# Asymmetry


def test_an_offset_mass_leads_in_a_circle(go: Any) -> None:
    # K [lean, steer] = [m y g, 0] at constant speed; the circle's radius is w / (cos(lambda_s) steer).
    bicycle = load_bicycle("tms_eq_10_1")
    lean, steer = np.linalg.solve(bicycle.stiffness_at(3.6), [0.0005 * G, 0.0])
    run = go("tms_strike", asymmetry__rear_frame=0.0005, strike__lean_rate=0.0, duration=40.0)
    motion = run.at(np.linspace(30.0, 40.0, 500))
    np.testing.assert_allclose(motion.lean, lean, rtol=1e-9)
    np.testing.assert_allclose(motion.steer, steer, rtol=1e-9)
    radius = bicycle.wheelbase / (math.cos(bicycle.steer_axis_tilt) * steer)
    centre = motion.rear_contact + radius * np.stack([-np.sin(motion.yaw), np.cos(motion.yaw)], axis=1)
    np.testing.assert_allclose(centre, np.broadcast_to(centre[0], centre.shape), atol=1e-6)
    assert 1.0 < abs(radius) < 1000.0


def test_a_mass_on_the_front_frame_steers_as_well(go: Any) -> None:
    bicycle = load_bicycle("tms_table_8_1")
    tilt = math.sin(bicycle.steer_axis_tilt)
    lean, steer = np.linalg.solve(bicycle.stiffness_at(3.6), 0.0003 * G * np.array([1.0, tilt]))
    run = go(
        "tms_strike",
        bicycle="tms_table_8_1",
        asymmetry__front_frame=0.0003,
        strike__lean_rate=0.0,
        duration=40.0,
    )
    motion = run.at(np.array([40.0]))
    assert motion.lean[0] == pytest.approx(lean, rel=1e-9)
    assert motion.steer[0] == pytest.approx(steer, rel=1e-9)


# Strike: kick and slip


def test_a_strike_without_kick_and_slip_never_reverses_the_yaw(go: Any) -> None:
    for side in (1.0, -1.0):
        for duration in (0.0, 0.02):
            run = go("tms_strike", strike__lean_rate=0.5 * side, strike__duration=duration, duration=4.0)
            assert (run.at(grid(run)[:3000]).yaw_rate * side).min() > -1e-6
            assert figures(run, "slip") == []


def test_kick_of_a_strike_on_the_upper_tube(go: Any) -> None:
    # M q' = J [height, x (c/w) cos(lambda_s)]: by hand with Eq. (10.1), x 0.8 m and 0.65 m up, -7.0.
    run = go("tms_strike", effects__steer_kick=True, duration=4.0)
    (strike,) = figures(run, "strike")
    ratio = strike["steer_rate_change_rad_s"] / strike["lean_rate_change_rad_s"]
    assert ratio == pytest.approx(-6.996, abs=0.005)
    assert -7.2 < ratio < -6.5
    assert strike["lean_rate_change_rad_s"] == pytest.approx(0.5, rel=1e-12)
    # Pure roll: a strike very far up has no arm about the steer axis beside its height.
    roll = go("tms_strike", effects__steer_kick=True, strike__x=0.0, duration=4.0)
    (strike,) = figures(roll, "strike")
    ratio = strike["steer_rate_change_rad_s"] / strike["lean_rate_change_rad_s"]
    assert ratio == pytest.approx(-0.006029 / 0.002974, rel=1e-9)
    # The yaw goes the wrong way at first, by the kick alone: to -1.1 rad/s per rad/s, for 0.23 s.
    motion = run.at(grid(run)[2000:])
    reversed_until = motion.time[np.argmax(motion.yaw_rate[100:] > 0.0) + 100] - 2.0
    assert reversed_until == pytest.approx(0.23, abs=0.02)
    assert motion.yaw_rate.min() / 0.5 == pytest.approx(-1.1, abs=0.1)


@pytest.mark.parametrize(
    ("kick", "slip", "lowest", "lasts"),
    [
        (True, True, -0.22, 0.23),
        (True, False, -0.22, 0.22),
        (False, True, -0.02, 0.03),
        (False, False, 0.0, 0.0),
    ],
)
def test_table_of_what_reverses_the_yaw(go: Any, kick: bool, slip: bool, lowest: float, lasts: float) -> None:
    run = go(
        "gym_run", effects__shimmy=False, effects__steer_kick=kick, effects__slip=slip,
        release__lean_deg=0.0, release__lean_rate=0.0, asymmetry__rear_frame=0.0,
    )  # fmt: skip
    yaw_rate = run.at(np.arange(4.0, 5.0, 1e-4)).yaw_rate
    assert yaw_rate.min() == pytest.approx(lowest, abs=0.005)  # as docs/experiment.md prints them
    assert 1e-4 * (yaw_rate < -1e-6).sum() == pytest.approx(lasts, abs=0.005)
    slides = [event.duration for event in run.events if event.kind == "slip"]
    assert slides == pytest.approx([0.011] if slip else [], abs=0.001)


def test_slip_alone_reverses_the_yaw_and_the_front_wheel_recovers(go: Any) -> None:
    # Struck to the right with the handlebars held against the kick, the front wheel slides to the left.
    run = go("gym_run", effects__steer_kick=False, effects__shimmy=False, strike__lean_rate=0.4)
    (strike,) = figures(run, "strike")
    assert strike["rolling_steer_kick_rad_s"] < -1.0  # told, though it doesn't act
    slides = [e for e in run.events if e.kind == "slip"]
    front = [e for e in slides if e.text == "the front wheel slides to the left"]
    assert front
    assert all(e.time + e.duration < 4.1 for e in slides)  # within 0.1 s both roll again
    motion = run.at(np.arange(4.0, 4.1, 0.0005))
    assert motion.yaw_rate.min() < motion.yaw_rate[0] - 0.02
    assert np.abs(motion.front_slip[-1]) < 1e-9
    assert np.abs(motion.rear_slip[-1]) < 1e-9
    held = go("gym_run", effects__steer_kick=False, effects__shimmy=False, effects__slip=False)
    still = held.at(np.arange(4.0, 4.1, 0.0005))
    assert still.yaw_rate.min() > still.yaw_rate[0] - 0.005


def test_more_lean_ends_in_a_low_side_fall(go: Any) -> None:
    # On 0.4 of friction a small strike is survived, and a large one makes the front wheel slide away.
    small = go("gym_run", catch__lean_deg=0.0, effects__shimmy=False)
    assert small.ended_by == "caught"  # for lack of speed
    large = go("gym_run", catch__lean_deg=0.0, effects__shimmy=False, strike__lean_rate=0.45)
    assert large.ended_by == "fallen"
    sliding = [e for e in large.events if e.kind == "slip" and e.time + e.duration > large.end - 0.2]
    assert any("front wheel" in e.text for e in sliding)
    gripped = go("gym_run", catch__lean_deg=0.0, effects__shimmy=False, effects__slip=False)
    assert gripped.ended_by == "caught"


def test_on_linoleum_a_small_strike_makes_the_front_wheel_slip_away(go: Any) -> None:
    run = go("gym_linoleum", catch__lean_deg=0.0)
    assert run.ended_by == "fallen"
    assert any("front wheel" in e.text for e in run.events if e.kind == "slip")
    assert go("gym_linoleum", catch__lean_deg=0.0, strike__lean_rate=0.05).ended_by != "fallen"
    assert go("gym_run", catch__lean_deg=0.0).ended_by != "fallen"


def test_slip_is_what_an_integrator_with_stiff_friction_finds(go: Any) -> None:
    # The same equations with friction that grows steeply with the sliding speed instead of jumping.
    bicycle = load_bicycle("tms_table_8_1")
    equations = sliding_equations(bicycle)
    limits = 0.4 * equations.normal_forces
    impulse, lasts = 3.0, 0.01
    push = np.array([1.0, 0.8, 0.65, 0.0]) * impulse
    jerk = math.pi / (2.0 * lasts)

    def change(time: float, z: np.ndarray) -> np.ndarray:
        angles, speeds = z[:2], z[2:]
        slip = equations.slip(3.6, angles[1], speeds)
        forces = -limits * np.tanh(slip / 2e-5)
        right = equations.contacts.T @ forces - (equations.stiffness @ angles)
        right -= 3.6 * equations.gyroscopic @ speeds
        right += push * jerk * math.sin(math.pi * time / lasts) * (time < lasts)
        rates = np.linalg.solve(equations.mass, right)
        rates[0] -= 3.6 * speeds[1]
        return np.concatenate([speeds[2:], rates])

    found = solve_ivp(change, (0.0, 0.15), np.zeros(6), "LSODA", rtol=1e-9, atol=1e-11, max_step=1e-3)
    lean_rate = np.linalg.solve(
        bicycle.mass, [0.65, 0.8 * bicycle.trail / 0.75 * math.cos(math.radians(7.0))]
    )
    run = go(
        "tms_strike",
        bicycle="tms_table_8_1",
        floor="thin_rubber",
        effects__slip=True,
        effects__steer_kick=True,
        strike__duration=lasts,
        strike__lean_rate=float(lean_rate[0]) * impulse,
        duration=2.5,
    )
    motion = run.at(np.array([2.15]))
    assert figures(run, "slip")
    state = [motion.lean[0], motion.steer[0], motion.lean_rate[0], motion.steer_rate[0], motion.yaw_rate[0]]
    expected = found.y[[0, 1, 4, 5, 3], -1]
    np.testing.assert_allclose(state, expected, rtol=2e-3, atol=2e-4)


def test_friction_that_is_never_reached_changes_nothing(go: Any, tmp_path: Any) -> None:
    grippy = tmp_path / "grippy.yaml"
    entry = "{value: %s, source: a test}"
    grippy.write_text(
        "description: much friction\n"
        + "".join(
            f"{key}: {entry % value}\n"
            for key, value in {
                "rolling_resistance": 0.06,
                "lateral_friction": 50.0,
                "scrub": 0.001,
                "joint_spacing": "null",
                "joint_impulse": 0.0,
            }.items()
        )
    )
    changes = {"effects__joints": False, "catch__lean_deg": 0.0, "floor": str(grippy)}
    one, other = go("gym_run", **changes), go("gym_run", **changes, effects__slip=False)
    assert figures(one, "slip") == []
    times = grid(one)
    for name in ("lean", "steer_rate", "yaw", "lean_acceleration"):
        np.testing.assert_allclose(getattr(one.at(times), name), getattr(other.at(times), name), atol=1e-8)


def test_a_short_strike_tends_to_the_instant_one(go: Any) -> None:
    for slip in (False, True):
        ends = []
        for duration in (0.0, 1e-5, 1e-3):
            run = go(
                "tms_strike",
                floor="thin_rubber",
                effects__slip=slip,
                effects__steer_kick=True,
                strike__duration=duration,
                strike__lean_rate=0.2,
                duration=3.0,
            )
            ends.append(run.at(np.array([2.5])).lean[0])
        assert ends[1] == pytest.approx(ends[0], rel=1e-4)
        assert ends[2] == pytest.approx(ends[0], rel=1e-2)


# Shimmy, scrub, joints


def amplitude_near(times: np.ndarray, values: np.ndarray, low: float, high: float) -> tuple[float, float]:
    """Frequency [Hz] and amplitude of the largest line of a spectrum between two frequencies."""
    rest = values - np.polyval(np.polyfit(times - times[0], values, 4), times - times[0])
    spectrum = np.abs(np.fft.rfft(rest * np.hanning(len(rest)))) * 4.0 / len(rest)
    frequency = np.fft.rfftfreq(len(rest), times[1] - times[0])
    inside = np.flatnonzero((frequency > low) & (frequency < high))
    best = inside[spectrum[inside].argmax()]
    return float(frequency[best]), float(spectrum[best])


@pytest.mark.parametrize("floor", ["hard_wood", "linoleum", "thick_rubber", "thin_rubber"])
@pytest.mark.quick_for(floor=["hard_wood"])
def test_shimmy_of_20_hz_on_every_floor_above_walking_speed(go: Any, floor: str) -> None:
    run = go("gym_run", floor=floor, effects__joints=False, effects__slip=False)
    times = np.arange(3.0, 4.0, 0.001)
    frequency, size = amplitude_near(times, run.at(times).steer, 10.0, 40.0)
    assert frequency == pytest.approx(20.0, abs=1.0)
    assert 0.1 < math.degrees(size) < 0.3
    walking = go(
        "tms_strike", effects__shimmy=True, speed=1.2, strike__lean_rate=0.0, strike__time=0.1, duration=3.0
    )
    times = np.arange(1.0, 3.0, 0.001)
    assert math.degrees(amplitude_near(times, walking.at(times).steer, 10.0, 40.0)[1]) < 0.01


def test_shimmy_settles_into_one_limit_cycle_whatever_it_begins_with(go: Any) -> None:
    sizes = []
    for seed in (1, 2, 3):
        run = go("tms_strike", effects__shimmy=True, strike__lean_rate=0.0, duration=6.0, seed=seed)
        times = np.arange(4.0, 6.0, 0.001)
        sizes.append(amplitude_near(times, run.at(times).steer, 10.0, 40.0)[1])
    np.testing.assert_allclose(sizes, sizes[0], rtol=1e-3)


def test_shimmy_is_of_little_influence_on_the_rest(go: Any) -> None:
    # Averaged over its period, the lean rate of a struck run is the same within 1 % of the strike.
    means = []
    for shimmy in (True, False):
        run = go("gym_run", effects__shimmy=shimmy, catch__lean_deg=0.0)
        rate = run.at(np.arange(4.0, 6.5, 0.001)).lean_rate
        means.append(np.convolve(rate, np.full(50, 0.02), "valid"))
    assert np.abs(means[0] - means[1]).max() < 0.01 * np.abs(means[1]).max()


def test_scrub_of_polyurethane_wheels_locks_the_steering(go: Any) -> None:
    run = go("gym_polyurethane", catch__lean_deg=0.0, strike__lean_rate=0.02)
    assert run.ended_by == "fallen"
    assert run.end < 6.0
    free = go("gym_polyurethane", catch__lean_deg=0.0, strike__lean_rate=0.02, effects__scrub=False)
    assert free.ended_by == "caught"


def test_scrub_is_a_damper_on_both_wheels_turning(go: Any) -> None:
    # The same scrub in the equations of the sliding bicycle, wheels rolling by much friction.
    with_contacts = go("gym_run", effects__joints=False, strike__lean_rate=0.01, asymmetry__rear_frame=0.0)
    without = go(
        "gym_run",
        effects__joints=False,
        strike__lean_rate=0.01,
        asymmetry__rear_frame=0.0,
        effects__slip=False,
    )
    times = np.arange(2.0, 3.9, 0.01)
    forces = figures(with_contacts, "slip")
    assert forces == []
    np.testing.assert_allclose(with_contacts.at(times).lean, without.at(times).lean, atol=1e-9)


def test_joints_of_wood_kick_at_their_spacing(go: Any) -> None:
    run = go("gym_wood", effects__slip=False, catch__lean_deg=0.0, effects__shimmy=False)
    joints = [e for e in run.events if e.kind == "joint"]
    times = np.array([e.time for e in joints])
    way = np.concatenate([[0.0], np.cumsum(np.diff(times) * run.at((times[1:] + times[:-1]) / 2).speed)])
    np.testing.assert_allclose(np.diff(way), 1.0, atol=1e-3)
    before, after = run.at(times - 1e-9).steer_rate, run.at(times).steer_rate
    np.testing.assert_allclose(after - before, [e.figures["steer_kick_rad_s"] for e in joints], atol=1e-4)
    assert len(joints) > 20


# Protocol


def test_straight_struck_straight_in_a_new_direction(go: Any) -> None:
    # Video 1. At constant speed, without anything that bends the path.
    run = go("tms_strike", duration=30.0)
    before, after = run.at(np.linspace(0.0, 1.99, 50)), run.at(np.linspace(25.0, 30.0, 50))
    assert not before.yaw.any()
    np.testing.assert_allclose(after.yaw, after.yaw[0], atol=1e-9)
    assert after.yaw[0] > 0.5
    (end,) = figures(run, "end")
    assert end["heading_rad"] == pytest.approx(after.yaw[-1], abs=1e-12)


def test_strikes_to_the_right_and_to_the_left(go: Any) -> None:
    run = go("gym_strikes")
    told = [e for e in run.events if e.kind == "strike"]
    assert [e.text for e in told] == ["struck to the right", "struck to the left"]
    assert [e.time for e in told] == [3.5, 5.0]
    right, left = (e.figures["lean_rate_change_rad_s"] for e in told)
    assert right > 0.1
    assert left < -0.1


def test_run_up_is_held_straight_and_smooth(go: Any) -> None:
    run = go("gym_run")
    times = np.linspace(0.0, 1.999, 400)
    motion = run.at(times)
    assert (motion.phase == 1).all()
    assert not motion.steer.any()
    assert motion.speed[0] == pytest.approx(1.0)
    across = run.at(np.array([2.0 - 1e-9, 2.0]))
    for name in ("lean", "lean_rate", "speed", "acceleration", "steer", "steer_rate"):
        values = getattr(across, name)
        assert values[1] == pytest.approx(values[0], abs=1e-6), name


def test_caught_before_it_falls_and_brought_to_a_stand(go: Any) -> None:
    run = go("gym_linoleum", catch__duration=0.4)
    assert run.ended_by == "caught"
    caught = next(e for e in run.events if e.text == "caught")
    assert caught.duration == pytest.approx(0.4)
    before, after = run.at(np.array([caught.time - 1e-9, caught.time + 1e-9])), run.at(np.array([run.end]))
    assert math.degrees(abs(before.lean[0])) == pytest.approx(20.0, abs=1e-3)
    for name in ("lean", "steer", "speed", "lean_rate", "yaw_rate", "rear_slip"):
        values = getattr(before, name)
        assert values[1] == pytest.approx(values[0], abs=1e-5), name
        assert getattr(after, name)[0] == pytest.approx(0.0, abs=1e-9), name
    let_fall = go("gym_linoleum", catch__lean_deg=0.0, catch__speed=0.0)
    assert let_fall.ended_by == "fallen"
    assert let_fall.at(np.array([let_fall.end])).phase[0] == 6


def test_rolls_to_a_stop(go: Any) -> None:
    run = go("tms_strike", **COASTING, strike__lean_rate=0.0, duration=60.0)
    assert run.ended_by == "stopped"
    assert run.at(np.array([run.end])).speed[0] == pytest.approx(0.0, abs=1e-9)


def test_handlebars_that_stand_across_end_the_ride(go: Any) -> None:
    # A feedback this absurd turns the steering over while both wheels slide and the lean stays small.
    ride = go("gym_linoleum", **{"steer_torque.lean_rate_gain": -940.0, "catch.lean_deg": 0.0})
    assert ride.ended_by == "fallen"
    assert abs(ride.at(np.array([ride.end])).steer[0]) <= math.pi / 2.0 + 1e-6
