"""Tracking of strikes and of the free responses after them.

Detected strikes are tested against the bicycle's equations, their times refined, and each free response is
followed until its window is full or something ends it.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import replace

from tms_model import Bicycle, ParameterError

from tms_fit.parameters import INITIAL
from tms_fit.segment import FreeResponse, Segment, segment_window
from tms_fit.settings import Settings
from tms_fit.streaming.samples import Samples
from tms_fit.strikes.detector import StrikeDetector
from tms_fit.strikes.free_response import predicted_share
from tms_fit.strikes.manual import ManualStrikes
from tms_fit.strikes.strike import NANOSECONDS, Rejected, Strike
from tms_fit.strikes.strike_time import AFTER_STRIKE_NS, BEFORE_STRIKE_NS, is_impulsive, refine_strike_time
from tms_fit.strikes.window_end import STANDSTILL_SPEED, WindowEnd, find_window_end
from tms_fit.window import Window

HISTORY_NS = 10 * NANOSECONDS  # [ns] of samples kept; after a strike, changes are predicted from it this long
LOOK_BACK_NS = NANOSECONDS  # [ns] of motion from which a change is predicted where no strike began it
FIRST_HISTORY_NS = 3 * NANOSECONDS // 10  # [ns] at a recording's start, before a change can be predicted
PUSH_TAIL_NS = NANOSECONDS // 10  # [ns] for which a hand pushes on beyond the peak of the lean rate
SAME_CHANGE_NS = NANOSECONDS // 20  # [ns] after a change, up to which an end of the motion is that change
LEAST_DISTANCE_NS = 7 * NANOSECONDS // 20  # [ns] between the starts of two strikes
ONE_STRIKE = "strikes closer than 0.35 s count as one"
PREDICTED_SHARE = 0.5  # of a change, by which the motion before explains it; at most its inverse
# Unknowns of a free response, and of a motion whose beginning isn't known.
AFTER_STRIKE: tuple[str, ...] = ("initial_lean_rate", "initial_steer_rate", "lean_rate_bias")
UNKNOWN_START = (*INITIAL, "lean_rate_bias")
OWN_MOTION = "the bicycle's own motion, as the model continues what came before"


class StrikeTracker:
    """Strikes in synchronised samples, and their free responses once complete.

    Call `process` for each sample of `samples` in turn, then `completed`; in the end `finish`.
    """

    def __init__(
        self, samples: Samples, bicycle: Bicycle, settings: Settings, strike_times: Sequence[int] = ()
    ) -> None:
        """strike_times [ns]: starts of free responses, in place of those detected."""
        self._samples, self._bicycle, self._settings = samples, bicycle, settings
        self._detector = ManualStrikes(tuple(strike_times)) if strike_times else StrikeDetector()
        self._response_ns = round((settings.window + self._detector.latency) * NANOSECONDS)
        self._now_ns = 0
        self.first_ns = -(2**63)  # samples before are no longer needed
        self.strike_count = 0  # found so far
        self._open: list[Strike] = []
        self._onsets: list[int] = []  # [ns] of strikes, as far back as samples are kept
        self._latest: Strike | None = None

    @property
    def rejected(self) -> list[Rejected]:
        """The latest changes that were rejected, with the reason."""
        return list(self._detector.rejected)

    @property
    def open_strikes(self) -> list[Strike]:
        """Strikes whose free response is still unfolding."""
        return self._open

    def process(self, time_ns: int, lean_rate: float) -> Strike | None:
        """Use the next sample; return the strike that it completes, if any."""
        self._now_ns = time_ns
        strike = self._detector.push(time_ns, lean_rate)
        if strike is not None and strike.kind != "given":
            strike = self._accepted(strike)
            strike = strike and self._apart(strike)
        if strike is not None:
            self._open.append(strike)
            self._onsets.append(strike.onset_ns)
            self._latest = strike
            self.strike_count += 1
        return strike

    def completed(self) -> list[FreeResponse]:
        """Free responses that the last sample completed."""
        found = []
        while self._open and self._now_ns > self._open[0].time_ns + self._response_ns:
            found += self._close_oldest()
        if not self._open and self.first_ns < self._now_ns - 2 * HISTORY_NS:
            self._discard()
        return found

    def finish(self) -> list[FreeResponse]:
        """Free responses that are still open at the last sample."""
        found = []
        while self._open:
            found += self._close_oldest()
        return found

    def response(self, strike: Strike, end_ns: int) -> FreeResponse:
        """The free response after a strike up to a time [ns], or until something ends it earlier."""
        first_ns = strike.time_ns
        following = [onset for onset in self._onsets if first_ns < onset < end_ns]
        end: WindowEnd | None = None
        if following:
            end_ns = following[0]
            end = WindowEnd("next_strike", (end_ns - first_ns) / NANOSECONDS, "the next strike begins")
        elif self._now_ns < end_ns:
            after = (self._now_ns - first_ns) / NANOSECONDS
            end = WindowEnd("recording", after, "nothing more was recorded")
        found = self._window_end(first_ns, following[0] if following else self._now_ns)
        if found is not None and first_ns + round(found.time * NANOSECONDS) < end_ns:
            end = found
            end_ns = first_ns + max(round(found.time * NANOSECONDS), 0)
        before = self._segment(strike.since_ns, first_ns) if strike.since_ns else None
        return FreeResponse(strike, self._segment(first_ns, end_ns), end, before)

    def resized(self, response: FreeResponse, window: float) -> FreeResponse:
        """The same free response in a window of another length [s], as far as its samples are kept."""
        segment, end = response.segment, response.window_end
        first_ns, last_ns = int(segment.time_ns[0]), int(segment.time_ns[-1])
        end_ns = first_ns + round(window * NANOSECONDS)
        end_ns = min([end_ns, *(onset for onset in self._onsets if onset > first_ns)])
        has_ended = end is not None and end.kind != "recording"
        if not has_ended and end_ns > last_ns and self.first_ns <= first_ns:
            return self.response(response.strike, end_ns)
        end = end if end_ns >= last_ns else None
        return FreeResponse(response.strike, segment.until(end_ns), end, response.before)

    def forget(self) -> None:
        """Release all memory but the onsets of strikes; windows can't become longer any more."""
        self.first_ns, self._detector = self._now_ns + 1, ManualStrikes(())

    def _accepted(self, strike: Strike) -> Strike | None:
        """The strike with its time refined by the bicycle's equations; None, withdrawn, where it is none."""
        around = None
        why = self._stands(strike) or self._caught(strike)
        if not why:
            around = self._window_around(strike)
            why = OWN_MOTION if self._is_free_response(strike, around) else ""
        if not why:
            refined = strike if around is None else refine_strike_time(strike, around, self._least_change)
            if isinstance(refined, Strike):
                return refined if around is None else replace(refined, since_ns=around.first_ns)
            why = refined
        self._detector.withdraw(why)
        return None

    def _apart(self, strike: Strike) -> Strike | None:
        """The strike, unless it belongs to the last one: smaller and too close to it."""
        last = self._latest
        if last is None or not _is_close(last, strike):
            return strike
        if last in self._open and abs(strike.change) > abs(last.change):
            return strike  # it takes the last one's place unless it turns out to be a catch: `_close_oldest`
        distance = (strike.time_ns - last.time_ns) / NANOSECONDS
        self._detector.withdraw(f"{distance:.2f} s after a larger change: {ONE_STRIKE}")
        return None

    def _drop(self, strike: Strike, why: str) -> None:
        """Reject an open strike."""
        self._detector.rejected.append(Rejected(strike.time_ns, strike.change, why))
        self.strike_count -= 1
        self._open.remove(strike)
        self._onsets.remove(strike.onset_ns)

    @property
    def _least_change(self) -> float:
        return self._detector.least_change

    def _stands(self, strike: Strike) -> str:
        """The reason to reject a change of a bicycle at rest, or an empty text."""
        speed, _ = self._samples.speed.at(strike.onset_ns)
        stands = "speed" not in self._settings.fixed and abs(speed) < STANDSTILL_SPEED
        return "the bicycle stands" if stands else ""

    def _caught(self, strike: Strike) -> str:
        """The reason to reject a change that ends the free motion, as seen so far, or an empty text."""
        since = strike.onset_ns - LOOK_BACK_NS
        end = self._window_end(since, self._now_ns)
        ended = end is not None and since + round(end.time * NANOSECONDS) < strike.time_ns + SAME_CHANGE_NS
        return end.why if end is not None and ended else ""

    def _is_free_response(self, strike: Strike, around: Window | None) -> bool:
        """Whether the motion just before, as the bicycle continues it, explains half of this change."""
        last = self._latest
        if last is not None and strike.onset_ns - last.time_ns <= HISTORY_NS:
            since, unknowns = last.time_ns, AFTER_STRIKE
        else:
            since, unknowns = strike.onset_ns - LOOK_BACK_NS, UNKNOWN_START
        segment = self._segment(since, strike.time_ns)
        begins = strike.onset_ns < segment.time_ns[0] + FIRST_HISTORY_NS
        if last is None and not strike.sharp and begins:  # a recording may begin in mid-swing
            return around is None or not is_impulsive(strike, around, self._least_change)
        window = self._window(segment)
        if window is None:
            return False
        before = segment.time_ns <= strike.onset_ns
        share = predicted_share(window, before, unknowns, strike.change)
        return PREDICTED_SHARE < share < 1.0 / PREDICTED_SHARE

    def _window_around(self, strike: Strike) -> Window | None:
        """The motion around a strike since the last one, as far as recorded; None without a speed."""
        since = strike.onset_ns - BEFORE_STRIKE_NS
        if self._latest is not None:
            tail = PUSH_TAIL_NS if self._latest.kind == "push" else 0
            since = max(since, self._latest.time_ns + tail)
        return self._window(self._segment(min(since, strike.before_ns), strike.time_ns + AFTER_STRIKE_NS))

    def _window(self, segment: Segment) -> Window | None:
        try:
            return segment_window(segment, self._bicycle, self._settings)
        except ParameterError:
            return None

    def _close_oldest(self) -> list[FreeResponse]:
        """Response of the oldest open strike, or none where it turns out to be no strike of its own.

        Open strikes that turn out to be a catch are rejected.
        """
        for strike in [one for one in self._open if one.kind != "given"]:
            if why := self._caught(strike):
                self._drop(strike, why)
        if not self._open:
            return []
        if len(self._open) > 1 and _is_close(*self._open[:2]):
            first, second = self._open[:2]
            distance = (second.time_ns - first.time_ns) / NANOSECONDS
            self._drop(first, f"{distance:.2f} s before a larger change: {ONE_STRIKE}")
            return []
        strike = self._open.pop(0)
        return [self.response(strike, strike.time_ns + round(self._settings.window * NANOSECONDS))]

    def _window_end(self, first_ns: int, last_ns: int) -> WindowEnd | None:
        """What ends the free motion between two times; its time is in seconds since the first."""
        segment = self._segment(first_ns, last_ns)
        return find_window_end(
            (segment.time_ns - first_ns) / NANOSECONDS,
            segment.angular_velocity[:, ::2],
            (segment.speed_time_ns - first_ns) / NANOSECONDS,
            segment.speed,
        )

    def _segment(self, first_ns: int, last_ns: int) -> Segment:
        """Samples between two times, as far as they are kept and have been processed."""
        return self._samples.segment(max(first_ns, self.first_ns), min(last_ns, self._now_ns))

    def _discard(self) -> None:
        """Let go of samples that nothing needs any more, many at a time."""
        keep_ns = self._now_ns - HISTORY_NS
        times = self._samples.time_ns
        self.first_ns = int(times[bisect_right(times, keep_ns)])
        self._onsets = [onset for onset in self._onsets if onset > keep_ns]


def _is_close(first: Strike, second: Strike) -> bool:
    """Whether two detected strikes, the first one earlier, are too close together to be two."""
    given = "given" in (first.kind, second.kind)
    return not given and second.time_ns - first.time_ns < LEAST_DISTANCE_NS
