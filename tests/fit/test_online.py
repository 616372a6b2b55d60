"""A live run, a replayed one and a recorded one give the same answers, however their messages arrive."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tms_bag import BagWriter, Record, conversion, read_recording, topics
from tms_bag.messages import deserialize
from tms_bag.samples import RunInfo, SpeedSamples
from tms_fit.kalman.ekf import ExtendedKalmanFilter, FilterStep
from tms_fit.messages import estimate_records
from tms_fit.recording_fit import bicycle_of, fit_recording
from tms_fit.settings import Settings
from tms_fit.streaming.live_fit import INPUTS, REORDER_WINDOW_S, LiveFit
from tms_fit.streaming.live_run import LiveRun
from tms_fit.streaming.synchronizer import LONGEST_WAIT_NS
from tms_fit.strike_fit import StrikeFit
from tms_model import ParameterError, load_bicycle
from tms_model.frames import imu_to_rear_frame
from tms_sim.run import SimulatedRun

SECOND = 1_000_000_000
Event = tuple[int, str, int, Any]  # time of the sample, topic, row, value


def events(run: SimulatedRun) -> list[Event]:
    """All samples of a run."""
    found: list[Event] = []
    for row, stamp in enumerate(run.imu.time_ns.tolist()):
        found.append((stamp, "imu", row, run.imu.angular_velocity[row]))
    for row, stamp in enumerate(run.speed.time_ns.tolist()):
        found.append((stamp, "speed", row, float(run.speed.speed[row])))
    if run.steer_torque is not None:
        for row, stamp in enumerate(run.steer_torque.time_ns.tolist()):
            found.append((stamp, "torque", row, float(run.steer_torque.steer_torque[row])))
    return found


def late(run: SimulatedRun, seed: int, longest: float) -> list[Event]:
    """The samples as they arrive: each topic in order, each sample up to `longest` seconds late."""
    rng = np.random.default_rng(seed)
    arrivals = []
    for topic in ("imu", "speed", "torque"):
        one = sorted(event for event in events(run) if event[1] == topic)
        when = np.array([event[0] for event in one]) + rng.uniform(0.0, longest * SECOND, len(one))
        arrivals += list(zip(np.maximum.accumulate(when).tolist(), one, strict=True))
    return [event for _, event in sorted(arrivals, key=lambda arrival: arrival[0])]


def results_of(run: SimulatedRun, order: Iterable[Event], **settings: Any) -> list[StrikeFit | FilterStep]:
    online = LiveRun(load_bicycle(run.info.bicycle), Settings(**settings), run.info.imu_orientation, 3.0)
    results: list[StrikeFit | FilterStep] = []
    for stamp, topic, _, value in order:
        if topic == "imu":
            online.add_imu(stamp, value, run.imu.angular_velocity_variance)
        elif topic == "speed":
            online.add_speed(stamp, value)
        else:
            online.add_steer_torque(stamp, value)
        results += online.results()
    online.finish()
    return results + online.results()


def assert_equal(one: list[StrikeFit | FilterStep], other: list[StrikeFit | FilterStep]) -> None:
    """Equal to the last bit, in the same order."""
    assert len(one) == len(other)
    for left, right in zip(one, other, strict=True):
        assert type(left) is type(right)
        if isinstance(left, FilterStep) and isinstance(right, FilterStep):
            for name, value in vars(left).items():
                np.testing.assert_array_equal(getattr(right, name), value)
        elif isinstance(left, StrikeFit) and isinstance(right, StrikeFit):
            assert left.strike == right.strike
            assert left.end_ns == right.end_ns
            for mine, theirs in zip(left.estimates, right.estimates, strict=True):
                assert (mine.status, mine.message, mine.names) == (
                    theirs.status,
                    theirs.message,
                    theirs.names,
                )
                np.testing.assert_array_equal(mine.values, theirs.values)
                np.testing.assert_array_equal(mine.covariance, theirs.covariance)


def in_order(run: SimulatedRun) -> list[Event]:
    return sorted(events(run), key=lambda event: (event[0], event[1] == "imu"))


@pytest.mark.parametrize("scenario", ["tms_strike", "delft_push"])
def test_order_of_arrival_does_not_matter(make_run: Any, scenario: str) -> None:
    run = make_run(scenario, strike__time=1.5037, duration=4.5)
    expected = results_of(run, in_order(run))
    assert sum(isinstance(result, StrikeFit) for result in expected) == 1
    assert sum(isinstance(result, FilterStep) for result in expected) == len(run.imu.time_ns)
    for seed in range(4):
        assert_equal(results_of(run, late(run, seed, 0.4)), expected)


def test_imu_waits_no_longer_than_its_patience(make_run: Any) -> None:
    # The speed sensor falls silent after 2 s: its last value holds, and every sample is used all the same.
    run = make_run("tms_strike", strike__time=1.5037, duration=4.5)
    silent = [event for event in in_order(run) if event[1] == "imu" or event[0] < 3 * SECOND]
    online = LiveRun(load_bicycle("tms_eq_10_1"), Settings(), run.info.imu_orientation)
    for stamp, topic, _, value in silent:
        if topic == "imu":
            online.add_imu(stamp, value, run.imu.angular_velocity_variance)
        else:
            online.add_speed(stamp, value)
    results = online.results()
    steps = [result for result in results if isinstance(result, FilterStep)]
    assert steps[-1].time_ns == run.imu.time_ns[-1] - LONGEST_WAIT_NS
    assert steps[-1].speed == run.speed.speed[run.speed.time_ns < 3 * SECOND][-1]
    online.finish()
    results += online.results()
    assert sum(isinstance(result, StrikeFit) for result in results) == 1
    assert sum(isinstance(result, FilterStep) for result in results) == len(run.imu.time_ns)


def test_without_a_speed_topic_the_nominal_speed_serves(make_run: Any) -> None:
    run = make_run("tms_strike_ideal", strike__time=1.5, duration=4.0)
    only_imu = [event for event in in_order(run) if event[1] == "imu"]
    settings = Settings(estimators=("least_squares",))
    for nominal, fixed in ((3.6, {}), (float("nan"), {"speed": 3.6})):
        online = LiveRun(
            load_bicycle("tms_eq_10_1"), replace(settings, fixed=fixed), run.info.imu_orientation, nominal
        )
        for stamp, _, _, value in only_imu:
            online.add_imu(stamp, value, run.imu.angular_velocity_variance)
        online.finish()
        results = online.results()
        (strike,) = (result for result in results if isinstance(result, StrikeFit))
        assert strike.estimates[0].parameters["initial_lean_rate"] == pytest.approx(0.5, rel=1e-3)
        assert sum(isinstance(result, FilterStep) for result in results) == len(only_imu)
    online = LiveRun(load_bicycle("tms_eq_10_1"), settings, run.info.imu_orientation)
    for stamp, _, _, value in only_imu:
        online.add_imu(stamp, value, run.imu.angular_velocity_variance)
    online.finish()
    (strike,) = online.results()  # no filter without a speed, and a reason instead of an estimate
    assert isinstance(strike, StrikeFit)
    assert strike.estimates[0].status == "not_observable"
    assert "--fix speed=V" in strike.estimates[0].message


def test_repeated_and_late_samples_change_nothing(make_run: Any) -> None:
    run = make_run("tms_strike", strike__time=1.5037, duration=4.0)
    expected = results_of(run, in_order(run))
    disturbed: list[Event] = []
    for index, event in enumerate(in_order(run)):
        disturbed.append(event)
        if index % 7 == 3:
            disturbed.append(event)
        if index > 20 and index % 50 == 0 and event[1] == "imu":
            disturbed.append((event[0] - 100_000_000, "imu", 0, np.full(3, 9.9)))
    assert_equal(results_of(run, disturbed), expected)


@pytest.mark.parametrize("held", [{}, {"speed": 3.3}])
def test_speed_is_the_median_of_the_window_unless_fixed(
    make_run: Any, fit_run: Any, held: dict[str, float]
) -> None:
    run = make_run(
        "tms_strike", strike__time=1.5, speed_sensor__noise=0.1, speed_sensor__rate=100.0, duration=4.0
    )
    (strike,) = fit_run(run, fixed=held, estimators=("least_squares",))
    used = (run.speed.time_ns >= strike.strike.time_ns) & (run.speed.time_ns <= strike.end_ns)
    assert strike.window is not None
    assert strike.window.start_speed == held.get("speed", float(np.median(run.speed.speed[used])))


def test_a_torque_acts_from_its_sample_on(make_run: Any) -> None:
    # Between two IMU samples acts the torque of the first of them: the filter by hand.
    run = make_run("delft_push", strike__time=7.9, strike__lean_rate=0.0, duration=8.0, imu__rate=50.0)
    torque = np.cos(np.arange(len(run.imu.time_ns)))  # of no strike and no feedback
    assert run.steer_torque is not None
    run = replace(run, steer_torque=replace(run.steer_torque, steer_torque=torque))
    steps = [one for one in results_of(run, in_order(run)) if isinstance(one, FilterStep)]
    running = ExtendedKalmanFilter(load_bicycle("delft_sbw"), 0.02)
    turned = imu_to_rear_frame(run.imu.angular_velocity, run.info.imu_orientation)
    held = np.concatenate([[0.0], torque[:-1]])
    for k, step in enumerate(steps[:100]):
        by_hand = running.step(
            step.time_ns, turned[k], run.imu.angular_velocity_variance, step.speed, float(held[k])
        )
        np.testing.assert_array_equal(step.state, by_hand.state)


def test_a_run_with_a_gap_stays_exact(make_run: Any, fit_run: Any) -> None:
    run = make_run("tms_strike_ideal", strike__time=1.5, duration=4.0)
    time = run.imu.time_ns - run.info.start_ns
    kept = (time < 2.1 * SECOND) | (time > 2.4 * SECOND)
    imu = replace(
        run.imu,
        time_ns=run.imu.time_ns[kept],
        angular_velocity=run.imu.angular_velocity[kept],
        specific_force=run.imu.specific_force[kept],
    )
    (whole,), (gappy,) = (fit_run(one, free=("initial_lean_rate",)) for one in (run, replace(run, imu=imu)))
    assert gappy.estimates[0].sample_count == whole.estimates[0].sample_count - 2 * 31
    for one, other in zip(whole.estimates, gappy.estimates, strict=True):
        assert one.values[0] == pytest.approx(other.values[0], rel=1e-4)


# Live, from serialised messages.


def messages(run: SimulatedRun) -> list[tuple[str, bytes]]:
    inputs = [(record.topic.removeprefix("/"), record.data) for record in run.records()]
    return [(topic, data) for topic, data in inputs if topic in INPUTS]


def live(
    run: SimulatedRun, order: list[tuple[str, bytes]], bicycle: str = "", settings: Settings | None = None
) -> list[Record]:
    fit = LiveFit(settings or Settings(), bicycle)
    answers = [record for topic, data in order for record in fit.process(topic, data)]
    return answers + fit.finish()


def finals(answers: list[Record]) -> list[Record]:
    """Estimates of windows that have closed."""
    estimates = [record for record in answers if record.topic == "/estimate"]
    return [record for record in estimates if deserialize(record.data, record.type).final]


@pytest.fixture
def recorded(make_run: Any, tmp_path: Path) -> Any:
    """A run, its bag read back and fitted."""

    def make(scenario: str = "tms_strike", **changes: Any) -> tuple[SimulatedRun, Any]:
        run = make_run(scenario, **changes)
        with BagWriter(tmp_path / "bag", overwrite=True) as bag:
            for record in run.records():
                bag.write(record)
        recording = read_recording(tmp_path / "bag")
        return run, fit_recording(recording, bicycle_of(recording, None), Settings())

    return make


@pytest.mark.parametrize("scenario", ["tms_strike", "delft_push"])
def test_live_estimates_are_the_offline_ones_to_the_byte(recorded: Any, scenario: str) -> None:
    run, offline = recorded(scenario, strike__time=1.5037, duration=4.5)
    answers = live(run, messages(run))
    estimates = finals(answers)
    expected = [record for strike in offline.strikes for record in estimate_records(strike)]
    assert len(estimates) == 2
    assert [(record.time_ns, record.data) for record in estimates] == [(r.time_ns, r.data) for r in expected]
    states = [record for record in answers if record.topic == "/filter_state"]
    assert [record.time_ns for record in states] == run.imu.time_ns.tolist()


def test_a_strike_as_a_force_is_live_what_it_is_offline(recorded: Any) -> None:
    changes = {"strike__time": 1.5037, "strike__duration": 0.005, "effects__steer_kick": True}
    run, offline = recorded(duration=3.5, **changes)
    settings = Settings(estimators=("strike",))
    strikes = fit_recording(offline.recording, offline.bicycle, settings).strikes
    expected = [record for strike in strikes for record in estimate_records(strike)]
    estimates = finals(live(run, messages(run), settings=settings))
    assert [record.data for record in estimates] == [record.data for record in expected]
    (estimate,) = [deserialize(record.data, record.type) for record in estimates]
    assert estimate.names[:2] == ["strike_lean_rate", "initial_lean_rate"]


def test_estimate_message_says_what_the_estimate_is(recorded: Any) -> None:
    run, offline = recorded(strike__time=1.5037, duration=4.5)
    (strike,) = offline.strikes
    for record, estimate in zip(estimate_records(strike), strike.estimates, strict=True):
        message = deserialize(record.data, record.type)
        assert (message.estimator, message.status, message.bicycle) == (
            estimate.estimator,
            "ok",
            "tms_eq_10_1",
        )
        assert tuple(message.names) == estimate.names
        np.testing.assert_array_equal(message.values, estimate.values)
        np.testing.assert_array_equal(message.covariance.reshape(3, 3), estimate.covariance)
        np.testing.assert_array_equal(np.stack([message.ci95_low, message.ci95_high], axis=1), estimate.ci95)
        assert dict(zip(message.channels, message.vaf.tolist(), strict=True)) == estimate.vaf
        stamp = message.header.stamp.sec * SECOND + message.header.stamp.nanosec
        assert stamp == strike.start_ns
        assert abs(stamp - run.info.start_ns - 1_503_700_000) < 5_000_000
        first = message.window_start.sec * SECOND + message.window_start.nanosec
        assert first == strike.strike.time_ns
        values = {entry.key: entry.value for entry in message.diagnostics}
        assert float(values["residual_std"]) == estimate.residual_std
        assert float(values["speed"]) == strike.window.start_speed
        assert values["speed_source"] == "measured"


def test_samples_wait_for_the_run_to_be_announced(make_run: Any) -> None:
    run = make_run("tms_strike", strike__time=1.5037, duration=4.0)
    announced = messages(run)
    unannounced = [message for message in announced if message[0] != topics.RUN_INFO]
    late_info = unannounced[:300] + [message for message in announced if message[0] == topics.RUN_INFO]
    assert live(run, late_info + unannounced[300:]) == live(run, announced)
    assert live(run, unannounced) == []
    # When somebody says which bicycle it is, no announcement is waited for for ever.
    assert live(run, unannounced, bicycle="tms_eq_10_1") == live(run, announced)


def test_an_announcement_begins_a_new_run(make_run: Any) -> None:
    first = make_run("tms_strike", strike__time=1.5037, duration=4.0)
    second = make_run("delft_push", strike__time=1.5037, duration=4.0, start_time_ns=20 * SECOND)
    fit = LiveFit(Settings())
    answers = [
        r for topic, data in messages(first) + messages(second) for r in fit.process(topic, data)
    ] + fit.finish()
    assert answers == live(first, messages(first)) + live(second, messages(second))
    assert fit.counts["strikes"] == 2


def test_time_that_jumps_back_begins_a_new_run(make_run: Any) -> None:
    # As a player in a loop makes it: the same stamps again. The strike that was open is fitted with what
    # there was.
    run = make_run("tms_strike", strike__time=1.5037, duration=3.0)
    once = messages(run)
    samples = [message for message in once if message[0] != topics.RUN_INFO]
    twice = live(run, once + samples)
    alone = live(run, once)
    assert len(finals(twice)) == 4
    assert [record.data for record in finals(twice)] == 2 * [record.data for record in finals(alone)]
    # The first speed comes before the jump is known, so that two samples make do with the nominal speed; from
    # the strike on, where the filter starts anew, nothing is left of that.
    since = run.info.start_ns + 2_200_000_000
    once_more = [
        record.data for record in twice if record.topic == "/filter_state" and record.time_ns >= since
    ]
    assert once_more == 2 * [r.data for r in alone if r.topic == "/filter_state" and r.time_ns >= since]


def test_a_mounting_that_nobody_states_is_level(make_run: Any) -> None:
    run = make_run("tms_strike", strike__time=1.5037, duration=4.0)
    (info,) = conversion.run_info_records(replace(run.info, imu_orientation=np.full(4, np.nan)))
    unstated = [(topics.RUN_INFO, info.data), *[m for m in messages(run) if m[0] != topics.RUN_INFO]]
    assert live(run, unstated) == live(run, messages(run))


def test_unreadable_messages_are_counted_and_left_out(make_run: Any) -> None:
    run = make_run("tms_strike", strike__time=1.5037, duration=4.0)
    fit = LiveFit(Settings())
    answers = []
    for index, (topic, data) in enumerate(messages(run)):
        answers += fit.process(topic, data)
        if index % 100 == 50:
            answers += fit.process(topics.IMU, data[:20])
    answers += fit.finish()
    assert answers == live(run, messages(run))
    assert fit.counts["unreadable"] == len(range(50, len(messages(run)), 100))


def test_unknown_names_are_refused_at_once() -> None:
    with pytest.raises(ParameterError, match="unknown bicycle 'tandem'"):
        LiveFit(Settings(), "tandem")
    with pytest.raises(ParameterError, match="estimator: unknown 'guess'"):
        LiveFit(Settings(estimators=("guess",)))


def test_speed_samples_may_be_missing_altogether(recorded: Any, tmp_path: Path, make_run: Any) -> None:
    # A bag without a speed topic, whose run_info says the speed.
    run, _ = recorded("tms_strike", strike__time=1.5, duration=4.0)
    without = replace(run, speed=SpeedSamples(np.empty(0, np.int64), np.empty(0)))
    with BagWriter(tmp_path / "still") as bag:
        for record in without.records():
            bag.write(record)
    recording = read_recording(tmp_path / "still")
    assert recording.speed is None
    assert isinstance(recording.run_info, RunInfo)
    fit = fit_recording(recording, bicycle_of(recording, None), Settings())
    assert fit.strikes[0].window is not None
    assert fit.strikes[0].window.start_speed == 3.6


def test_order_of_arrival_does_not_matter_within_the_reorder_window(recorded: Any) -> None:
    run, offline = recorded(strike__time=1.5037, duration=4.5)
    told, rest = messages(run)[:1], messages(run)[1:]
    stamps = [conversion_stamp(data) for _, data in rest]
    delays = np.random.default_rng(3).uniform(0.0, 0.9 * REORDER_WINDOW_S * SECOND, len(rest))
    shaken = [rest[index] for index in np.argsort(np.array(stamps) + delays, kind="stable")]
    assert shaken != rest
    fit = LiveFit(Settings())
    answers = [record for topic, data in told + shaken for record in fit.process(topic, data)] + fit.finish()
    expected = [record for strike in offline.strikes for record in estimate_records(strike)]
    assert [record.data for record in finals(answers)] == [record.data for record in expected]
    assert fit.diagnostics.get("late", 0) == 0
    states = [record for record in answers if record.topic == "/filter_state"]
    assert states == [record for record in live(run, messages(run)) if record.topic == "/filter_state"]


def test_late_and_repeated_samples_are_left_out_and_counted(make_run: Any) -> None:
    run = make_run("tms_strike", strike__time=1.5037, duration=4.0)
    in_order = messages(run)
    imu = [number for number, (topic, _) in enumerate(in_order) if topic == topics.IMU]
    late, twice = in_order[imu[120]], in_order[imu[140]]
    shaken = [one for number, one in enumerate(in_order) if number != imu[120]]
    shaken.insert(imu[180], late)  # 0.6 s after its time
    shaken.insert(imu[141], twice)
    fit = LiveFit(Settings())
    for topic, data in shaken:
        fit.process(topic, data)
    assert (fit.diagnostics["late"], fit.diagnostics["repeated"]) == (1, 1)


def test_an_unfolding_response_is_estimated_with_growing_certainty(make_run: Any) -> None:
    run = make_run("tms_strike", strike__time=1.5037, duration=4.5)
    answers = [record for record in live(run, messages(run)) if record.topic == "/estimate"]
    told = [deserialize(record.data, record.type) for record in answers]
    early = [message for message in told if not message.final]
    assert [message.final for message in told] == [False] * len(early) + [True, True]
    assert len(early) >= 3
    known = [message for message in [*early, told[-2]] if message.status == "ok"]
    assert {message.estimator for message in known} == {"least_squares"}
    widths = [message.ci95_high[0] - message.ci95_low[0] for message in known]
    assert widths[-1] < 0.5 * widths[0]
    assert all(
        abs(message.values[0] - 0.5) < 5.0 * (message.ci95_high[0] - message.ci95_low[0]) for message in known
    )


def test_a_strike_can_be_fitted_once_more(recorded: Any) -> None:
    run, offline = recorded(strike__time=1.5037, duration=6.0)
    fit = LiveFit(Settings())
    for topic, data in messages(run):
        fit.process(topic, data)
    longer = Settings(window=3.0, free=("initial_lean_rate", "initial_steer_rate"))
    again = fit.refit(0, longer)
    (expected,) = fit_recording(offline.recording, offline.bicycle, longer).strikes
    for one, other in zip(again.estimates, expected.estimates, strict=True):
        np.testing.assert_array_equal(one.values, other.values)
        np.testing.assert_array_equal(one.covariance, other.covariance)
    with pytest.raises(ParameterError, match=r"expected one of 2\.5"):
        fit.refit(10 * SECOND, longer)
    with pytest.raises(ParameterError, match="unknown bicycle"):
        fit.refit(0, longer, "nonsense")
    fit.finish()  # when the run is over it can still be done
    assert fit.refit(0, longer).end_ns == again.end_ns


def conversion_stamp(data: bytes) -> int:
    """Stamp of a message that begins with a header [ns]."""
    sec, nanosec = np.frombuffer(data[4:12], dtype="<u4")
    return int(sec) * SECOND + int(nanosec)
