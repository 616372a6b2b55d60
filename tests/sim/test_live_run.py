"""A run that is struck on the way is the run of the scenario with that strike."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from tms_bag import Record, RecordingError, conversion, topics
from tms_model import ParameterError
from tms_sim.faults import FAULTS
from tms_sim.live_run import LARGEST_STEP, LiveRun
from tms_sim.run import simulate
from tms_sim.scenario import load_scenario, scenario_names

STEP = 20_000_000  # [ns]


def until(live: LiveRun, seconds: float) -> list[Record]:
    sent: list[Record] = []
    while live.elapsed < seconds and not live.finished:
        sent += live.advance(STEP)
    return sent


def rates(records: list[Record]) -> dict[int, np.ndarray]:
    samples = conversion.imu_samples([one for one in records if one.topic == f"/{topics.IMU}"])
    return dict(zip(samples.time_ns.tolist(), samples.angular_velocity, strict=True))


@pytest.mark.parametrize("name", scenario_names())
@pytest.mark.quick_for(name=["tms_strike", "gym_run", "gym_strikes"])
def test_all_is_sent_once_and_in_order(name: str) -> None:
    last = load_scenario(name).numbers("strike.time")[-1]
    live = LiveRun(load_scenario(name, {"duration": last + 1.0, "imu.rate": 50.0}))
    sent = until(live, 1e9)
    assert live.finished
    assert sent == live.records
    live.reset()
    assert until(live, 1e9) == sent


@pytest.mark.parametrize("name", scenario_names())
@pytest.mark.quick_for(name=["tms_strike", "gym_run", "gym_strikes"])
def test_a_strike_on_the_way_agrees_with_what_was_sent(name: str) -> None:
    scenario = load_scenario(name)
    live = LiveRun(scenario)
    sent = until(live, scenario.numbers("strike.time")[0] + 0.3)
    live.strike(-0.1, 0.0)
    before, now = rates(sent), rates(live.records)
    assert set(before) == {stamp for stamp in now if stamp <= max(before)}
    for stamp, values in before.items():
        # The steps of the motion end elsewhere: this is what they are exact to, where wheels slip.
        np.testing.assert_allclose(now[stamp], values, rtol=0.0, atol=1e-8)  # [rad/s]
    after = until(live, 1e9)
    assert not {id(one) for one in after} & {id(one) for one in live.records[: live.sent - len(after)]}
    # The scenario as run_info tells it gives the same run.
    told = yaml.safe_load(live.run.info.configuration)
    again = load_scenario(name, {f"strike.{key}": told["strike"][key] for key in told["strike"]})
    assert list(simulate(again, np.random.default_rng(again.integer("seed"))).records()) == live.records


@pytest.mark.parametrize("name", FAULTS)
@pytest.mark.quick_for(name=["loss", "out_of_order", "bias_jump"])
def test_a_fault_on_the_way_leaves_what_was_sent_as_it_was(name: str) -> None:
    # The sensor's clock is 50 ms ahead of the host's: stamps of what was sent lie ahead of now.
    live = LiveRun(load_scenario("gym_as_measured", {"faults": "noise:std=0.01", "duration": 6.0}))
    sent = until(live, 4.1)
    seen = live.records
    info = live.change_faults(live.timed(f"noise:std=0.01,time=0; {name}"))
    assert live.records[1 : len(sent)] == sent[1:]
    assert live.records[len(sent) :] != seen[len(sent) :]
    told = yaml.safe_load(conversion.run_info(info).configuration)["faults"]
    again = load_scenario("gym_as_measured", {"duration": 6.0, "faults": told})
    assert list(simulate(again, np.random.default_rng(again.integer("seed"))).records()) == live.records
    assert sent[1:] + until(live, 1e9) == live.records[1:]


def test_faults_that_cannot_be() -> None:
    live = LiveRun(load_scenario("tms_strike", {"faults": "scale:time=1,factor=2"}))
    assert live.timed("loss") == "loss"  # nothing has been sent: from the start
    until(live, 3.0)
    before = live.records
    for faults, says in (
        ("none", "those that have begun as they are, which is 'scale:time=1,factor=2'"),
        ("scale:time=1,factor=2; loss:time=2.9", "expected faults that begin after what has been sent"),
        ("moon", "unknown 'moon'"),
        ("scale:time=1,factor=2; stuck:time=4,topic=/moon", "expected a topic /moon"),
    ):
        with pytest.raises((ParameterError, RecordingError), match=says):
            live.change_faults(faults)
        assert live.records is before
        assert live.scenario.text("faults") == "scale:time=1,factor=2"
    until(live, 1e9)


def test_a_fault_begins_at_once_and_another_may_still_be_dropped() -> None:
    live = LiveRun(load_scenario("tms_strike_ideal", {"faults": "none"}))
    until(live, 2.0)
    live.change_faults(live.timed("dropout:duration=0.1"))
    times = [one.time_ns for one in live.records if one.topic == f"/{topics.IMU}"]
    gap = int(np.argmax(np.diff(times)))
    assert times[gap] == 3_000_000_000  # 2 s after the start, at 1 s: the last that had been sent
    assert times[gap + 1] == 3_110_000_000
    kept = live.scenario.text("faults")
    live.change_faults(f"{kept}; bias_jump:time=5")
    live.change_faults(kept)
    assert [one.time_ns for one in live.records if one.topic == f"/{topics.IMU}"] == times


def test_a_strike_does_what_it_says() -> None:
    live = LiveRun(load_scenario("tms_strike_ideal"))
    until(live, 3.0)
    at = live.elapsed
    rate = live.run.trajectory.at(np.array([at + 0.001])).lean_rate[0]
    live.strike(-0.2, 0.0)
    assert live.run.trajectory.at(np.array([at + 0.001])).lean_rate[0] - rate == pytest.approx(-0.2, abs=5e-3)


def test_strikes_that_cannot_be() -> None:
    live = LiveRun(load_scenario("tms_strike"))
    until(live, 3.0)
    before, sent = live.records, live.sent
    start_ns = live.scenario.integer("start_time_ns")
    for arguments, text in [
        ((0.1, 0.0, start_ns + 10**9), "after now"),
        ((0.1, 0.0, start_ns + 10**12), "before the run's end"),
        ((100.0, 0.0), "strike.lean_rate"),
        ((float("nan"), 0.0), "strike.lean_rate"),
    ]:
        with pytest.raises(ParameterError, match=text):
            live.strike(*arguments)
        assert (live.records, live.sent) == (before, sent)


def test_a_late_look_sends_no_more_than_fits() -> None:
    live = LiveRun(load_scenario("tms_strike"))
    start_ns = live.now_ns
    assert live.advance(10**10)
    assert live.now_ns == start_ns + LARGEST_STEP
    while not live.finished:
        live.advance(0)
    assert live.sent == len(live.records)


def test_saturated_and_lost_packets_are_counted_as_they_come() -> None:
    changes = {"wireless.loss": 0.1, "wireless.burst_start": 0.01, "floor_vibration.rms": 8.0}
    live = LiveRun(load_scenario("gym_run", changes))
    halves = []
    for seconds in (3.0, 1e9):
        until(live, seconds)
        figures = live.sensor_figures()
        run = live.run
        stamps = run.lean_yaw.time_ns
        made = round((min(live.now_ns, int(stamps[-1])) - run.info.start_ns) / 1e7) + 1  # at 100 Hz
        assert figures["packets"] == (stamps <= live.now_ns).sum()
        assert figures["packets"] + figures["lost"] == pytest.approx(made, abs=1)
        assert figures["lost_share"] == pytest.approx(figures["lost"] / made, rel=0.01)
        assert figures["saturated"] == (run.lean_yaw.saturation[stamps <= live.now_ns] > 0).sum()
        halves.append(figures)
    assert 0 < halves[0]["saturated"] < halves[1]["saturated"]
    assert 0 < halves[0]["lost"] < halves[1]["lost"]
