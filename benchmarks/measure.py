"""What benchmarks share: repeated timing of several ways in turn, and what they ran on."""

from __future__ import annotations

import os
import platform
import statistics
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_CORETYPE", "OPENBLAS_L2_SIZE")


@dataclass(frozen=True)
class Timing:
    """Durations of one way of doing something [s]."""

    name: str
    durations: tuple[float, ...]
    processor: tuple[float, ...] = ()  # time of all cores together [s]

    @property
    def least_processor(self) -> float:
        """Of all runs the least [s]: other work on the machine only adds to it, by pushing caches aside."""
        return min(self.processor)

    @property
    def median(self) -> float:
        """Half of the runs were faster [s]."""
        return statistics.median(self.durations)

    @property
    def quartiles(self) -> tuple[float, float]:
        """Between them lie half of the runs [s]."""
        if len(self.durations) < 2:
            return self.median, self.median
        low, _, high = statistics.quantiles(self.durations, n=4, method="inclusive")
        return low, high


def in_turn(ways: dict[str, Callable[[], object]], repeats: int) -> dict[str, Timing]:
    """Time every way `repeats` times, one after the other each time, so that a busy moment hits all of them.

    Each runs once before, unmeasured.
    """
    durations: dict[str, list[float]] = {name: [] for name in ways}
    processor: dict[str, list[float]] = {name: [] for name in ways}
    for way in ways.values():
        way()
    for _ in range(repeats):
        for name, way in ways.items():
            start, busy = time.perf_counter(), time.process_time()
            way()
            durations[name].append(time.perf_counter() - start)
            processor[name].append(time.process_time() - busy)
    return {name: Timing(name, tuple(durations[name]), tuple(processor[name])) for name in ways}


def by_processor(timings: dict[str, Timing]) -> dict[str, Timing]:
    """The same with processor time in place of what a clock on the wall says: for a machine that is busy."""
    return {name: Timing(name, one.processor, one.processor) for name, one in timings.items()}


def print_timings(title: str, timings: dict[str, Timing], reference: str) -> None:
    """One line for each way: median, quartiles, and how many times faster than the reference it is."""
    print(f"\n{title}")
    for timing in timings.values():
        low, high = timing.quartiles
        line = f"  {timing.name:44} {1e3 * timing.median:10.3f} ms  ({1e3 * low:.3f} to {1e3 * high:.3f})"
        if timing.name != reference:
            line += f"  {timings[reference].median / timing.median:8.1f} x faster"
        print(line)


def print_machine(packages: Iterable[str]) -> None:
    """Processor, cores, load, Python, versions and what steers the threads of linear algebra."""
    load = os.getloadavg()[0]
    print(f"machine: {_processor()}, {os.cpu_count()} cores, load {load:.1f}, {platform.platform()}")
    print(f"Python {platform.python_version()}, " + ", ".join(_version(name) for name in packages))
    settings = [f"{name}={os.environ[name]}" for name in THREADS if name in os.environ]
    print(f"environment: {', '.join(settings) or 'nothing set for linear algebra'}")
    if load > 0.5 * (os.cpu_count() or 1):
        print("the machine is busy with other work: ratios hold roughly, times don't", file=sys.stderr)


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def _version(name: str) -> str:
    try:
        return f"{name} {version(name)}"
    except PackageNotFoundError:
        return f"{name} not installed"
