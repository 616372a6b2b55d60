"""The radio link: losses, delays and clocks as its settings say."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tms_model import ParameterError
from tms_sim.sensors.wireless import Link, deliver, host_clock, sensor_clock

PERFECT = Link(
    reach=100.0, loss=0.0, burst_start=0.0, burst_end=1.0, burst_loss=1.0, latency=0.0, jitter=0.0,
    duplicates=0.0, clock_offset=0.0, clock_drift=0.0,
)  # fmt: skip
START = 10**9
COUNT = 100_000
TIMES = START + np.arange(COUNT) * 10**7
NEAR = np.zeros(COUNT)


def link(**changes: float) -> Link:
    return dataclasses.replace(PERFECT, **changes)


def send(**changes: float):
    return deliver(TIMES, NEAR, link(**changes), START, np.random.default_rng(1))


def test_perfect_link_delivers_everything_at_once() -> None:
    got = send()
    np.testing.assert_array_equal(got.rows, np.arange(COUNT))
    np.testing.assert_array_equal(got.stamp_ns, TIMES)
    np.testing.assert_array_equal(got.arrival_ns, TIMES)
    assert not got.lost.any()


@pytest.mark.parametrize("loss", [0.01, 0.2, 0.9])
def test_independent_losses(loss: float) -> None:
    lost = send(loss=loss).lost
    assert lost.mean() == pytest.approx(loss, abs=5.0 * math.sqrt(loss * (1.0 - loss) / COUNT))
    # Independent: after a loss the next is lost as often as ever.
    after = lost[1:][lost[:-1]]
    assert after.mean() == pytest.approx(loss, abs=5.0 * math.sqrt(loss * (1.0 - loss) / len(after)))


@pytest.mark.parametrize(("start", "end", "inside"), [(0.01, 0.2, 1.0), (0.05, 0.5, 0.7)])
def test_bursts_have_gilberts_share_and_length(start: float, end: float, inside: float) -> None:
    lost = send(burst_start=start, burst_end=end, burst_loss=inside).lost
    share = inside * start / (start + end)
    # Correlation from packet to packet is 1 - start - end: so many fewer are independent.
    independent = COUNT * (start + end) / (2.0 - start - end)
    assert lost.mean() == pytest.approx(share, abs=5.0 * math.sqrt(share * (1.0 - share) / independent))
    # The next packet is lost if the link stays bad and loses it: (1 - end) * inside.
    after, expected = lost[1:][lost[:-1]], (1.0 - end) * inside
    assert after.mean() == pytest.approx(expected, abs=5.0 * math.sqrt(0.25 / len(after)))


def test_bursts_that_lose_everything_last_as_long_as_they_should() -> None:
    lost = send(burst_start=0.01, burst_end=0.2).lost.astype(int)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], lost, [0]])))
    lengths = edges[1::2] - edges[::2]
    # Geometric with mean 5 and standard deviation sqrt(1 - 0.2) / 0.2 = 4.47.
    assert lengths.mean() == pytest.approx(5.0, abs=5.0 * 4.47 / math.sqrt(len(lengths)))


def test_out_of_reach_nothing_arrives() -> None:
    far = np.linspace(0.0, 200.0, COUNT)
    got = deliver(TIMES, far, PERFECT, START, np.random.default_rng(1))
    np.testing.assert_array_equal(got.lost, far > 100.0)


def test_latency_and_jitter() -> None:
    delay = (send(latency=0.02, jitter=0.005).arrival_ns - TIMES) / 1e9
    assert delay.min() >= 0.02
    assert delay.mean() == pytest.approx(0.025, abs=5.0 * 0.005 / math.sqrt(COUNT))
    assert delay.std() == pytest.approx(
        0.005, rel=5.0 * math.sqrt(2.0 / COUNT)
    )  # kurtosis 9 of an exponential
    # 10 ms apart: the later one overtakes with probability exp(-10 / 5) / 2.
    overtaken = (np.diff(send(latency=0.02, jitter=0.005).arrival_ns) < 0).mean()
    assert overtaken == pytest.approx(0.5 * math.exp(-2.0), rel=0.05)


def test_duplicates_arrive_twice_each_in_its_own_time() -> None:
    got = send(duplicates=0.1, jitter=0.001)
    rows, counts = np.unique(got.rows, return_counts=True)
    np.testing.assert_array_equal(rows, np.arange(COUNT))
    assert set(counts.tolist()) == {1, 2}
    assert (counts == 2).mean() == pytest.approx(0.1, abs=5.0 * math.sqrt(0.09 / COUNT))
    twice = np.flatnonzero(np.diff(got.rows) == 0)
    assert (got.arrival_ns[twice] != got.arrival_ns[twice + 1]).all()
    np.testing.assert_array_equal(got.stamp_ns[twice], got.stamp_ns[twice + 1])


def test_sensor_clock_by_hand() -> None:
    # 2 ms ahead and 50 ppm fast: 10 s after the start it is 2.5 ms ahead.
    shown = sensor_clock(
        np.array([START, START + 10 * 10**9]), link(clock_offset=2e-3, clock_drift=50e-6), START
    )
    np.testing.assert_array_equal(shown, [START + 2_000_000, START + 10 * 10**9 + 2_500_000])
    with pytest.raises(ParameterError, match=r"wireless\.clock_offset"):
        sensor_clock(np.array([START]), link(clock_offset=-1.5), START)


def test_host_clock_undoes_the_sensors_by_hand() -> None:
    way = link(clock_offset=2e-3, clock_drift=50e-6)
    stamps = np.array([START + 2_000_000, START + 10 * 10**9 + 2_500_000])
    np.testing.assert_array_equal(host_clock(stamps, way, START), [START, START + 10 * 10**9])
    np.testing.assert_array_equal(host_clock(sensor_clock(TIMES, way, START), way, START), TIMES)


def test_one_effect_does_not_change_the_draws_of_another() -> None:
    plain, lossy = send(jitter=0.003), send(jitter=0.003, loss=0.3, duplicates=0.1)
    kept = np.flatnonzero(~lossy.lost)
    _, first = np.unique(lossy.rows, return_index=True)
    np.testing.assert_array_equal(lossy.arrival_ns[first], plain.arrival_ns[kept])


SHARE = st.floats(0.0, 1.0)


@settings(max_examples=100, deadline=None)
@given(
    way=st.builds(
        Link, st.floats(0.0, 200.0), SHARE, SHARE, st.floats(0.01, 1.0), SHARE, st.floats(0.0, 1.0),
        st.floats(0.0, 1.0), SHARE, st.floats(-0.5, 100.0), st.floats(-1e-3, 1e-3),
    ),
    count=st.integers(0, 50),
    seed=st.integers(0, 2**32),
)  # fmt: skip
def test_whatever_the_link_what_arrives_was_sent(way: Link, count: int, seed: int) -> None:
    times, distance = TIMES[:count], np.linspace(0.0, 150.0, count)
    got = deliver(times, distance, way, START, np.random.default_rng(seed))
    assert set(got.rows.tolist()) == set(np.flatnonzero(~got.lost).tolist())
    assert (got.arrival_ns >= times[got.rows]).all()  # nothing comes before it was sent
    assert (np.diff(got.rows) >= 0).all()
    np.testing.assert_array_equal(got.stamp_ns, sensor_clock(times, way, START)[got.rows])
