"""The player's time: rate, pause, step and seek, with a clock that the test turns."""

import math

import pytest
from tms_bag import transport
from tms_bag.delays import Delays
from tms_bag.transport import Transport

SECOND = 10**9


class Time:
    """Stands for the module time."""

    def __init__(self) -> None:
        self.now = 1000.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch) -> Time:
    time = Time()
    monkeypatch.setattr(transport, "time", time)
    return time


def test_time_goes_at_the_rate_and_a_new_rate_holds_from_then_on(clock):
    player = Transport(100 * SECOND, 2.0)
    clock.now += 3.0
    assert player.now_ns() == 106 * SECOND
    player.set_rate(0.5)
    clock.now += 4.0
    assert player.now_ns() == 108 * SECOND


def test_time_stands_still_while_paused(clock):
    player = Transport(0, 1.0)
    clock.now += 1.0
    player.pause()
    clock.now += 5.0
    assert player.now_ns() == SECOND
    player.pause(False)
    clock.now += 1.0
    assert player.now_ns() == 2 * SECOND


def test_what_is_due_is_let_through_with_its_delay(clock):
    player = Transport(0, 2.0)
    clock.now += 1.5
    assert player.wait_until(2 * SECOND, 0.01, lambda: None) == pytest.approx(0.5)


def test_what_is_asked_for_before_the_beginning_counts(clock):
    player = Transport(0, 1.0, paused=True)
    assert player.step()
    clock.now += 5.0
    player.begin(0)
    assert player.take_target() == 0
    assert player.wait_until(SECOND, 0.01, lambda: None) == 0.0
    player = Transport(0, 1.0)
    player.seek(7 * SECOND)
    clock.now += 5.0
    player.begin(0)
    assert player.take_target() == player.now_ns() == 7 * SECOND


def test_steps_pass_while_paused_and_only_then(clock):
    player = Transport(0, 1.0)
    assert not player.step()
    player.pause()
    assert player.step()
    assert player.wait_until(7 * SECOND, 0.01, lambda: None) == 0.0
    assert player.now_ns() == 7 * SECOND


def test_a_seek_ends_the_waiting_and_moves_the_time(clock):
    player = Transport(0, 1.0)
    assert player.wait_until(50 * SECOND, 0.01, lambda: player.seek(20 * SECOND)) is None
    assert player.take_target() == 20 * SECOND
    assert player.take_target() is None
    clock.now += 1.0
    assert player.now_ns() == 21 * SECOND


def test_quantiles_of_delays_are_right_to_a_quarter():
    delays = Delays()
    for number in range(1, 1001):
        delays.add(number * 1e-5)
    for share in (0.5, 0.9, 0.99):
        assert math.log(delays.quantile(share) / (share * 1e-2)) == pytest.approx(0.0, abs=math.log(1.26))
    assert delays.largest == 1e-2
    assert Delays().quantile(0.5) == 0.0
