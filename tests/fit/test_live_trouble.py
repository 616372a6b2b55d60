"""A live fit that runs for hours: clocks that jump, and memory that stays where it is."""

from __future__ import annotations

import gc
import shutil
import tracemalloc
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
import tms_fit.streaming.live_fit
from tms_bag import Record, conversion, topics
from tms_bag.messages import deserialize
from tms_bag.samples import ImuSamples, RunInfo, SpeedSamples
from tms_fit.messages import estimate_records
from tms_fit.settings import Settings
from tms_fit.streaming.live_fit import LiveFit
from tms_model import linear_system, load_bicycle, response, yaw_rate
from tms_model.catalogue import FOLDER
from tms_model.frames import flip_axes

SECOND = 1_000_000_000
RATE, SPEED, NOISE = 100, 3.6, 0.02
PERIOD = 6.0  # [s] between strikes, which come 2 s after the start of each
INFO = RunInfo(start_ns=SECOND, bicycle="tms_eq_10_1", speed=SPEED)


def one_period(start_ns: int, rng: np.random.Generator) -> list[tuple[str, bytes]]:
    """Messages of a quiet ride of 2 s, a strike of 0.5 rad/s to the right, and what follows."""
    time = np.arange(round(PERIOD * RATE)) / RATE
    system = linear_system(load_bicycle(INFO.bicycle), SPEED)
    since = time[time >= 2.0] - 2.0
    states = np.zeros((len(time), 4))
    states[time >= 2.0] = response(system, np.array([0.0, 0.0, 0.5, 0.0]), since)
    rates = np.zeros((len(time), 3))
    rates[:, 0], rates[:, 2] = states[:, 2], yaw_rate(system, states)
    rates += NOISE * rng.standard_normal(rates.shape)
    stamps = start_ns + np.arange(len(time)) * (SECOND // RATE)
    imu = ImuSamples(stamps, flip_axes(rates), np.zeros_like(rates), np.full(3, NOISE**2))
    speed = SpeedSamples(stamps[::5], np.full(len(stamps[::5]), SPEED))
    records = [*conversion.speed_records(speed), *conversion.imu_records(imu)]
    records.sort(key=lambda record: record.time_ns)
    return [(record.topic.removeprefix("/"), record.data) for record in records]


def announced() -> tuple[str, bytes]:
    (record,) = conversion.run_info_records(INFO)
    return topics.RUN_INFO, record.data


def stream(start_ns: int, periods: int) -> Iterator[tuple[str, bytes]]:
    rng = np.random.default_rng(1)
    for number in range(periods):
        yield from one_period(start_ns + round(number * PERIOD * SECOND), rng)


def taken(fit: LiveFit, messages: Iterator[tuple[str, bytes]] | list[tuple[str, bytes]]) -> list[Record]:
    return [answer for topic, data in messages for answer in fit.process(topic, data)]


def finals(answers: list[Record]) -> list[bytes]:
    estimates = [one for one in answers if one.topic == "/estimate"]
    return [one.data for one in estimates if deserialize(one.data, one.type).final]


@pytest.mark.long
def test_a_clock_that_jumps_an_hour_ahead_is_a_gap_and_nothing_more() -> None:
    before, after = list(stream(SECOND, 1)), list(stream(3601 * SECOND, 1))
    fit = LiveFit(Settings())
    answers = taken(fit, [announced(), *before, *after]) + fit.finish()
    assert fit.counts["gaps"] == 1
    assert fit.counts["strikes"] == 2
    assert "late" not in fit.diagnostics
    # Every sample was used, and the filter began anew with the first after the jump.
    states = [deserialize(one.data, one.type) for one in answers if one.topic == "/filter_state"]
    assert len(states) == 2 * PERIOD * RATE
    assert [one.header.stamp.sec for one in states if one.reset and one.header.stamp.sec > 3000] == [3601]
    # What follows the jump is fitted as if nothing had been before.
    alone = LiveFit(Settings())
    expected = taken(alone, [announced(), *after]) + alone.finish()
    assert finals(answers)[2:] == finals(expected)
    assert len(finals(expected)) == 2


def test_one_stamp_an_hour_ahead_costs_one_restart() -> None:
    messages = list(stream(SECOND, 2))
    ahead = next(data for topic, data in stream(3601 * SECOND, 1) if topic == topics.IMU)
    fit = LiveFit(Settings())
    answers = taken(fit, [announced(), *messages[:620], (topics.IMU, ahead), *messages[620:]]) + fit.finish()
    assert (fit.counts["gaps"], fit.counts["jumps_back"], fit.counts["strikes"]) == (1, 1, 2)
    assert len(finals(answers)) == 4


@pytest.mark.long
def test_memory_does_not_grow_with_the_stream(monkeypatch: pytest.MonkeyPatch) -> None:
    # Ten strikes to fill what is kept, then ten more: 6000 samples of hundreds of bytes each, were they kept.
    monkeypatch.setattr(tms_fit.streaming.live_fit, "KEPT_STRIKES", 3)
    quick = replace(Settings(), estimators=("som2011",))
    fit = LiveFit(quick, preview_period=0.0)
    messages = stream(SECOND, 20)
    fit.process(*announced())
    half = 10 * round(PERIOD * RATE * 1.2)
    tracemalloc.start()
    try:
        sizes = []
        for _ in range(2):
            for topic, data in islice(messages, half):
                fit.process(topic, data)
            gc.collect()
            sizes.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    assert fit.counts["strikes"] >= 19
    assert sizes[1] - sizes[0] < 0.1 * sizes[0]


@pytest.mark.long
def test_of_runs_that_ended_the_latest_keep_their_samples_and_all_their_strikes() -> None:
    fit = LiveFit(Settings())
    starts = [SECOND + number * 60 * SECOND for number in range(tms_fit.streaming.live_fit.KEPT_RUNS + 2)]
    for start_ns in starts:
        taken(fit, [announced(), *stream(start_ns, 1)])
    fit.finish()
    longer = Settings(window=3.0)
    spans = [
        np.ptp(fit.refit(start_ns + 2 * SECOND, longer).segment.time_ns) / SECOND
        for start_ns in (starts[0], starts[1], starts[2], starts[-1])
    ]
    usual = Settings().window
    assert spans == pytest.approx([usual, usual, 3.0, 3.0], abs=0.1)


def test_what_waits_for_the_bicycle_is_bounded_and_the_loss_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tms_fit.streaming.live_fit, "HELD_MESSAGES_LIMIT", 50)
    fit, sent = LiveFit(Settings()), list(islice(stream(SECOND, 1), 200))
    assert taken(fit, sent) == []
    assert fit.diagnostics["forgotten"] == 150
    answers = taken(fit, [announced()]) + fit.finish()
    kept = [data for topic, data in sent[-50:] if topic == topics.IMU]
    assert len([one for one in answers if one.topic == "/filter_state"]) == len(kept)


def test_a_speed_that_no_bicycle_has_is_as_if_it_had_not_come() -> None:
    (mad,) = conversion.speed_records(SpeedSamples(np.array([SECOND]), np.array([1e200])))
    samples = [one for one in stream(SECOND, 1) if one[0] == topics.IMU]
    answers = []
    for sent in ([announced(), (topics.SPEED, mad.data), *samples], [announced(), *samples]):
        fit = LiveFit(Settings())
        answers.append(taken(fit, sent) + fit.finish())
    assert answers[0] == answers[1]
    assert len([one for one in answers[0] if one.topic == "/filter_state"]) == len(samples)


# A message may not have files opened, whatever it names; without all numbers it says no bicycle.
@pytest.mark.parametrize("name", ["tandem", str(FOLDER / "tms_eq_10_1.yaml"), "../bicycles/tms_eq_10_1"])
@pytest.mark.quick_for(name=["../bicycles/tms_eq_10_1"])
def test_a_run_info_with_an_unknown_bicycle_is_counted_and_waited_past(name: str) -> None:
    fit = LiveFit(Settings())
    (wrong,) = conversion.run_info_records(replace(INFO, bicycle=name, parameters={"trail": 0.1}))
    assert fit.process(topics.RUN_INFO, wrong.data) == []
    assert fit.diagnostics["unknown_bicycle"] == 1
    assert fit.bicycle == ""
    messages = list(stream(SECOND, 1))
    assert taken(fit, messages) == []  # they wait
    answers = [*taken(fit, [announced()]), *fit.finish()]
    right = LiveFit(Settings())
    assert answers == [*taken(right, [announced(), *messages]), *right.finish()]


def test_a_bicycle_of_ones_own_is_the_one_that_run_info_states() -> None:
    numbers = load_bicycle(INFO.bicycle).numbers
    (said,) = conversion.run_info_records(replace(INFO, bicycle="/home/me/tandem.yaml", parameters=numbers))
    live, known = LiveFit(Settings()), LiveFit(Settings())
    answers = [*taken(live, [(topics.RUN_INFO, said.data), *stream(SECOND, 1)]), *live.finish()]
    right = [*taken(known, [announced(), *stream(SECOND, 1)]), *known.finish()]
    assert live.bicycle == "tandem"
    assert "unknown_bicycle" not in live.diagnostics
    states = [one for one in answers if one.topic == "/filter_state"]
    assert states
    assert states == [one for one in right if one.topic == "/filter_state"]


def test_a_bicycle_of_ones_own_is_used_to_fit_once_more(tmp_path: Path) -> None:
    mine = tmp_path / "mine.yaml"
    shutil.copy(FOLDER / f"{INFO.bicycle}.yaml", mine)
    fit = LiveFit(Settings(), str(mine))
    answers = taken(fit, [announced(), *stream(SECOND, 1)]) + fit.finish()
    strikes = [one for one in answers if one.topic == "/estimate"]
    assert strikes
    again = fit.refit(0, Settings())
    assert again.bicycle == fit.bicycle == "mine"
    assert estimate_records(again) == strikes[-len(again.estimates) :]
