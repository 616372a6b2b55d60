"""Strike and rejected change."""

from __future__ import annotations

from dataclasses import dataclass

NANOSECONDS = 1_000_000_000


@dataclass(frozen=True)
class Strike:
    """One strike and the reason for its detection. Times are integer nanoseconds."""

    time_ns: int  # first sample of the free response
    before_ns: int  # last sample before it
    onset_ns: int  # last sample before the lean rate began to change
    change: float  # [rad/s], of the lean rate, by the strike
    noise: float  # [rad/s], standard deviation of the lean rate's noise as seen just before
    sharp: bool  # the strike fell between before_ns and time_ns
    end_ns: int  # end of the impulse; time_ns where it is not known more finely
    end_std: float  # [s], 0: unknown
    kind: str  # strike, push, given
    rise: float  # [s], how long the change took
    needed: float  # [rad/s], threshold that the change exceeds
    why: str  # one sentence
    since_ns: int = 0  # first sample of the free motion before it; 0: none is known


@dataclass(frozen=True)
class Rejected:
    """A change of the lean rate that was classified as no strike."""

    time_ns: int
    change: float  # [rad/s]
    why: str
