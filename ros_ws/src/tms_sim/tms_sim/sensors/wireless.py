"""The radio link between sensor and host: what gets through, when, and what time it says it is.

Packets are lost independently, or in bursts by the chain of Gilbert (1960, doi
10.1002/j.1538-7305.1960.tb03959.x) and Elliott (1963, doi 10.1002/j.1538-7305.1963.tb00955.x): the link is
good or bad, changes from packet to packet with the probabilities burst_start and burst_end, and loses packets
with probability burst_loss while it is bad. The share of bad packets is burst_start / (burst_start +
burst_end), the mean length of a burst 1 / burst_end packets.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tms_model import ParameterError
from tms_model.bicycle import Array


@dataclass(frozen=True)
class Link:
    """Properties of the link."""

    reach: float  # [m] farther away nothing gets through
    loss: float  # [1] probability that a packet is lost, each by itself
    burst_start: float  # [1] probability that the link turns bad with a packet
    burst_end: float  # [1] probability that it turns good again
    burst_loss: float  # [1] probability that a packet is lost while the link is bad
    latency: float  # [s] shortest time a packet takes
    jitter: float  # [s] mean of what comes on top, exponentially distributed
    duplicates: float  # [1] probability that a packet arrives twice
    clock_offset: float  # [s] sensor's clock ahead of the host's at the start
    clock_drift: float  # [s/s] how much faster the sensor's clock runs


@dataclass(frozen=True, eq=False)
class Delivery:
    """What arrived, in order of arrival."""

    rows: NDArray[np.int64]  # (m,) which of the packets, ascending; a duplicate stands twice
    stamp_ns: NDArray[np.int64]  # (m,) [ns] by the sensor's clock
    arrival_ns: NDArray[np.int64]  # (m,) [ns] by the host's clock, as rows: not ascending
    lost: NDArray[np.bool_]  # (n,) which packets never came


def deliver(
    time_ns: NDArray[np.int64], distance: Array, link: Link, start_ns: int, rng: np.random.Generator
) -> Delivery:
    """Send packets at times (n,) [ns, host's clock] from a distance (n,) [m]. Raises ParameterError.

    More packets at the end leave what happens to those before as it was.
    """
    independent, chain, inside, late, twice = rng.spawn(5)
    count = len(time_ns)
    lost = independent.random(count) < link.loss
    lost |= _bad(count, link, chain) & (inside.random(count) < link.burst_loss)
    lost |= np.asarray(distance) > link.reach
    again = (twice.random(count) < link.duplicates) & ~lost
    rows = np.sort(np.concatenate([np.flatnonzero(~lost), np.flatnonzero(again)]))
    delay = link.latency + link.jitter * late.standard_exponential((count, 2))
    second = np.zeros(len(rows), dtype=np.int64)
    second[1:] = rows[1:] == rows[:-1]
    arrival = time_ns[rows] + np.round(1e9 * delay[rows, second]).astype(np.int64)
    stamps = sensor_clock(time_ns, link, start_ns)[rows]
    return Delivery(rows, stamps, arrival, lost)


def sensor_clock(time_ns: NDArray[np.int64], link: Link, start_ns: int) -> NDArray[np.int64]:
    """What the sensor's clock shows [ns] at times of the host's clock (n,) [ns]. Raises ParameterError."""
    ahead = 1e9 * link.clock_offset + link.clock_drift * (time_ns - start_ns)
    stamps = time_ns + np.round(ahead).astype(np.int64)
    if len(stamps) and stamps.min() < 1:
        raise ParameterError(
            f"wireless.clock_offset: expected stamps after 0, found {stamps.min()} ns; a later start_time_ns"
            " makes room for a clock that is behind"
        )
    return stamps


def host_clock(stamp_ns: NDArray[np.int64], link: Link, start_ns: int) -> NDArray[np.int64]:
    """What the host's clock showed [ns] at stamps by the sensor's clock (n,) [ns]: `sensor_clock` undone."""
    since = (stamp_ns - start_ns - 1e9 * link.clock_offset) / (1.0 + link.clock_drift)
    return start_ns + np.round(since).astype(np.int64)


def _bad(count: int, link: Link, rng: np.random.Generator) -> NDArray[np.bool_]:
    """When the link is bad (n,): Gilbert's chain, its first packet drawn from the long-run shares."""
    draws = rng.random(count)
    states = np.zeros(count, dtype=bool)
    if link.burst_start <= 0.0 or not count:
        return states
    bad = bool(draws[0] < link.burst_start / (link.burst_start + link.burst_end))
    states[0] = bad
    change = (draws < link.burst_start, draws < link.burst_end)
    for row in range(1, count):
        if change[bad][row]:
            bad = not bad
        states[row] = bad
    return states
