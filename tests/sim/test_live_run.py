"""A run that is struck on the way is the run of the scenario with that strike."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from tms_bag import Record, conversion, topics
from tms_model import ParameterError
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
def test_all_is_sent_once_and_in_order(name: str) -> None:
    last = load_scenario(name).numbers("strike.time")[-1]
    live = LiveRun(load_scenario(name, {"duration": last + 1.0, "imu.rate": 50.0}))
    sent = until(live, 1e9)
    assert live.finished
    assert sent == live.records
    live.reset()
    assert until(live, 1e9) == sent


@pytest.mark.parametrize("name", scenario_names())
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
