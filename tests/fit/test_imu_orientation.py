"""Orientation of the sensor: found from gravity, strikes and yaw against lean, and taken by the fit."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tms_bag import Recording, RecordingError, read_recording
from tms_bag.imu_mounting import ImuMounting, imu_mounting
from tms_bag.samples import ImuSamples, SpeedSamples
from tms_fit.recording_fit import fit_recording
from tms_fit.settings import Settings
from tms_fit.streaming.live_fit import INPUTS, LiveFit
from tms_fit.strike_fit import StrikeFit
from tms_model.errors import ParameterError
from tms_model.frames import quaternion, roll_pitch_yaw, rotation_matrix
from tms_sim.scenario import scenario_names

ROOT = Path(__file__).parents[2]
LEVEL = quaternion(0.0, 0.0, 0.0)
Angles = tuple[float, float, float]  # roll, pitch, yaw [deg]
ALONG_AXES: list[Angles] = [
    (90, 0, 0),
    (-90, 0, 0),
    (0, 90, 0),
    (0, -90, 0),
    (0, 0, 90),
    (0, 0, -90),
    (0, 0, 180),
    (180, 0, 0),
    (0, 90, 90),
]
OBLIQUE: list[Angles] = [(15, 0, 0), (0, 15, 0), (0, 0, 15), (0, 0, -35), (20, -40, 160)]


def turned(recording: Recording, angles: Angles) -> Recording:
    """The recording by a sensor mounted in this way, with a run_info that states the level orientation."""
    rotation = rotation_matrix(quaternion(*np.radians(angles)))
    imu = recording.imu
    imu = replace(
        imu, angular_velocity=imu.angular_velocity @ rotation, specific_force=imu.specific_force @ rotation
    )
    return replace(recording, imu=imu)


def apart(found: ImuMounting, angles: Angles) -> float:
    """Angle [deg] between two orientations."""
    difference = rotation_matrix(found.quaternion).T @ rotation_matrix(quaternion(*np.radians(angles)))
    return float(np.degrees(np.arccos(np.clip(0.5 * (np.trace(difference) - 1.0), -1.0, 1.0))))


def mounting(recording: Recording, stated: Any = LEVEL) -> ImuMounting:
    return imu_mounting(recording.imu, recording.speed, stated)


@pytest.mark.parametrize("angles", ALONG_AXES)
@pytest.mark.parametrize("bag", ["tms_strike", "benchmark_strike", "delft_push"])
@pytest.mark.quick_for(bag=["tms_strike"])
def test_an_orientation_along_the_axes_is_found_exactly(bag: str, angles: Angles) -> None:
    found = mounting(turned(read_recording(ROOT / "bags" / bag), angles))
    assert apart(found, angles) < 1e-9
    assert found.forward_known
    assert found.tilted or found.turned
    assert not found.as_stated


@pytest.mark.parametrize("angles", OBLIQUE)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_an_oblique_orientation_is_found_within_its_uncertainty(
    make_run: Callable[..., Any], angles: Angles, seed: int
) -> None:
    run = make_run("tms_strike", imu__orientation_deg=list(map(float, angles)), seed=seed)
    found = mounting(run.recording())
    assert found.forward_known
    assert apart(found, angles) < 3.0 * np.degrees(np.hypot(found.tilt_std, found.heading_std))
    assert np.degrees(found.heading_std) < 4.0
    departs = max(abs(angle) for angle in angles) > 20
    assert (found.tilted or found.turned) == departs  # 15 degrees are no clear departure


def test_a_right_orientation_is_kept_as_it_is_stated(make_run: Callable[..., Any]) -> None:
    run = make_run("tms_strike", imu__orientation_deg=[35.0, -80.0, 160.0])
    found = mounting(run.recording(), run.info.imu_orientation)
    assert found.as_stated
    assert apart(found, (35, -80, 160)) < 0.02


@pytest.mark.parametrize("name", scenario_names())
@pytest.mark.parametrize("seed", [11, 12, 13])
@pytest.mark.quick_for(seed=[11])
def test_no_scenario_raises_a_false_alarm(make_run: Callable[..., Any], name: str, seed: int) -> None:
    run = make_run(name, seed=seed)
    found = mounting(run.recording(), run.info.imu_orientation)
    assert not found.tilted
    assert not found.turned
    assert found.as_stated


@pytest.mark.parametrize(
    "changes",
    [
        {"effects__steer_kick": True},
        {"effects__shimmy": True},
        {"speed": 3.0, "strike__lean_rate": -0.3},
        {"speed": 5.0, "strike__lean_rate": 0.2},
        {"strike__duration": 0.3},
        {"imu__rate": 400.0},
        {"imu__rate": 50.0},
    ],
)
def test_a_sensor_that_faces_backwards_is_found_by_yaw_against_lean(
    make_run: Callable[..., Any], changes: dict[str, Any]
) -> None:
    recording = make_run("tms_strike", **changes).recording()
    assert not mounting(recording).turned
    found = mounting(turned(recording, (0, 0, 180)))
    assert found.turned
    assert found.text == "0,0,180"


# By hand: a body that tips, roll acceleration = 10 lean - 3 yaw rate, and yaws by 6 times its lean, so that
# the lean swings with 8 = 3 * 6 - 10 [1/s^2].


def swinging(yaw_sign: float, count: int = 1000) -> tuple[ImuSamples, SpeedSamples]:
    """A strike of 0.4 rad/s after 5 s; yaw_sign -1: the bicycle yaws out of the fall."""
    time = np.arange(count) / 100.0
    after, omega = np.maximum(time - 5.0, 0.0), np.sqrt(8.0)
    rates = np.random.default_rng(1).normal(0.0, 0.005, (count, 3))
    rates[:, 0] += np.where(after > 0.0, 0.4 * np.cos(omega * after), 0.0)
    rates[:, 2] -= yaw_sign * 6.0 * 0.4 / omega * np.sin(omega * after)
    force = np.tile([0.0, 0.0, 9.81], (count, 1))
    time_ns = (time * 1e9).astype(np.int64)
    return ImuSamples(time_ns, rates, force), SpeedSamples(time_ns, np.full(count, 4.0))


def test_the_sign_by_hand() -> None:
    assert imu_mounting(*swinging(1.0), LEVEL).text == "0,0,0"
    assert imu_mounting(*swinging(-1.0), LEVEL).text == "0,0,180"


def test_bumps_are_not_taken_for_strikes() -> None:
    imu, speed = swinging(1.0)
    rates = imu.angular_velocity.copy()
    rates[700:715, 1] += 1.0  # a pitch rate
    rates[400:415, 1] += 1.0
    with pytest.raises(RecordingError, match=r"expected sudden changes about (one|the) "):
        imu_mounting(replace(imu, angular_velocity=rates), speed, LEVEL)


def test_what_is_pushed_at_rest_is_no_strike() -> None:
    imu, speed = swinging(1.0)
    with pytest.raises(
        RecordingError, match=r"expected sudden changes of the angular velocity, .* found none"
    ):
        imu_mounting(imu, replace(speed, speed=0.0 * speed.speed), LEVEL)


# The fit


def values(strikes: tuple[StrikeFit, ...]) -> list[float]:
    return [one.estimates[0]["initial_lean_rate"].value for one in strikes]


def test_a_stated_orientation_overrides_that_of_the_recording(make_run: Callable[..., Any]) -> None:
    angles = (0.0, 90.0, 90.0)
    stated = make_run("tms_strike", imu__orientation_deg=list(angles)).recording()
    assert stated.run_info is not None
    wrong = replace(stated, run_info=replace(stated.run_info, imu_orientation=LEVEL))
    by_recording = fit_recording(stated)
    by_option = fit_recording(wrong, settings=Settings(imu_orientation=angles))
    by_auto = fit_recording(wrong, settings=Settings(imu_orientation="auto"))
    none = replace(wrong, run_info=None)
    by_option_alone = fit_recording(none, by_recording.bicycle, Settings(imu_orientation=angles))
    assert len(by_recording.strikes) == 1
    for one in (by_option, by_auto, by_option_alone):
        assert values(one.strikes) == pytest.approx(values(by_recording.strikes), rel=1e-9)
    assert by_option.recording.warnings == by_recording.recording.warnings == ()
    (warning,) = by_auto.recording.warnings
    assert warning.startswith("orientation of the sensor 0,90,90 deg: roll and pitch by gravity, +- 1 deg")
    without = fit_recording(wrong)
    assert not values(without.strikes)
    assert "use --imu-orientation=0,90,90" in without.recording.warnings[0]


def test_auto_keeps_a_right_orientation_to_the_last_bit(make_run: Callable[..., Any]) -> None:
    recording = make_run("tms_strike", imu__orientation_deg=[35.0, -80.0, 160.0]).recording()
    auto = fit_recording(recording, settings=Settings(imu_orientation="auto"))
    assert values(auto.strikes) == values(fit_recording(recording).strikes)


def test_auto_takes_out_a_misalignment_of_15_degrees(make_run: Callable[..., Any]) -> None:
    level = make_run("tms_strike").recording()
    askew = turned(level, (15.0, 0.0, 0.0))  # yaw shows in the lean rate
    (right,) = values(fit_recording(level).strikes)
    (wrong,) = values(fit_recording(askew).strikes)
    (found,) = values(fit_recording(askew, settings=Settings(imu_orientation="auto")).strikes)
    assert abs(found - right) < 0.25 * abs(wrong - right)


def test_auto_needs_gravity(make_run: Callable[..., Any]) -> None:
    recording = make_run("tms_strike").recording()
    blind = replace(
        recording, imu=replace(recording.imu, specific_force=np.full((len(recording.imu.time_ns), 3), np.nan))
    )
    assert len(fit_recording(blind).strikes) == 1
    with pytest.raises(
        RecordingError, match=r"imu orientation auto: expected gravity .* --imu-orientation ROLL"
    ):
        fit_recording(blind, settings=Settings(imu_orientation="auto"))


def test_live_takes_an_orientation_and_refuses_auto(make_run: Callable[..., Any]) -> None:
    run = make_run("tms_strike", imu__orientation_deg=[0.0, 0.0, 90.0])
    info = replace(run.info, imu_orientation=LEVEL)
    settings = Settings(imu_orientation=(0.0, 0.0, 90.0), estimators=("least_squares",))
    published = []
    for given, stated in ((settings, info), (replace(settings, imu_orientation=None), run.info)):
        live = LiveFit(given)
        records = []
        for record in replace(run, info=stated).records():
            topic = record.topic.lstrip("/")
            if topic in INPUTS:
                records += live.process(topic, record.data)
        published.append([record.data for record in records + live.finish() if record.topic == "/estimate"])
    assert published[0]
    assert published[0] == published[1]
    with pytest.raises(
        ParameterError, match=r"expected ROLL,PITCH,YAW .* found auto, which needs a whole record"
    ):
        LiveFit(Settings(imu_orientation="auto"))


def test_the_check_prints_the_flag_that_the_fit_takes(
    make_run: Callable[..., Any], command: Any, tmp_path: Path
) -> None:
    run = make_run("tms_strike", imu__orientation_deg=[0.0, 0.0, -90.0])
    bag = tmp_path / "bag"
    replace(run, info=replace(run.info, imu_orientation=LEVEL)).write(bag)
    (finding,) = json.loads(command("tms_bag", "check", bag, "--json").out)["findings"]
    assert (finding["check"], finding["severity"]) == ("strike_axis", "error")
    assert finding["command"] == f"./tms fit run {bag} --imu-orientation=0,0,-90"
    _, *words = finding["command"].split()[2:]
    (strike,) = json.loads(command("tms_fit", "run", *words, "--json").out)["strikes"]
    assert strike["estimates"][0]["parameters"]["initial_lean_rate"]["value"] == pytest.approx(0.5, abs=0.02)
    assert "0 strikes" in command("tms_fit", "run", bag).out
    assert command("tms_fit", "run", bag, "--imu-orientation", "auto", "--json").code == 0


@pytest.mark.parametrize("angles", [*ALONG_AXES, *OBLIQUE, (0, 90, 45), (170, -90, 0)])
def test_angles_of_a_rotation_are_those_it_was_made_of(angles: Angles) -> None:
    rotation = rotation_matrix(quaternion(*np.radians(angles)))
    np.testing.assert_allclose(rotation_matrix(quaternion(*roll_pitch_yaw(rotation))), rotation, atol=1e-7)
