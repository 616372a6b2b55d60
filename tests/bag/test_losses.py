"""Lost messages are told from sequence numbers: worked by hand."""

from tms_bag.losses import SequenceCounter


def counted(numbers: list[int], *publishers: str) -> SequenceCounter:
    counter = SequenceCounter(lambda: set(publishers))
    for number in numbers:
        counter.follow(number)
    return counter


def test_gaps_are_counted():
    assert counted([1, 2, 3], "a").missing == 0
    assert counted([1, 2, 5, 6, 8], "a").missing == 3


def test_what_was_sent_before_is_no_loss():
    counter = counted([41, 42, 44], "a")
    assert (counter.missing, counter.missed_before) == (1, 40)


def test_a_publisher_that_returns_counts_anew():
    there = {"a"}
    counter = SequenceCounter(lambda: there)
    for number in (1, 2, 3):
        counter.follow(number)
    there.clear()
    there.add("b")
    for number in (7, 8, 10):  # 7: it had sent 6 before it was heard
        counter.follow(number)
    assert counter.missing == 1


def test_numbers_of_several_publishers_are_not_mixed_up():
    assert counted([1, 1, 2, 5, 2, 9], "a", "b").missing == 0


def test_before_anything_arrived_nothing_is_said():
    assert counted([], "a").missed_before is None
