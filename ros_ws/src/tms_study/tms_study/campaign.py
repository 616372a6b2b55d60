"""A campaign: a scenario ridden many times with some of its keys varied, each run fitted and judged.

Where `tms_study.bound` tells what an experiment can say at best, a campaign tells what the estimators make of
it, with all that the simulator knows of: slip, shimmy, lost packets, strikes that nobody found.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from tms_bag import BagWriter, read_recording, topics
from tms_fit.recording_fit import bicycle_of, first_stamp, fit_recording
from tms_fit.settings import Settings
from tms_fit.strike_fit import StrikeFit
from tms_model import ParameterError
from tms_sim.run import SimulatedRun, simulate
from tms_sim.scenario import Scenario, load_scenario
from tms_sim.sensors.imu_stream import link_of
from tms_sim.sensors.wireless import host_clock, sensor_clock
from tqdm import tqdm

from tms_study import __version__

SAME = 0.25  # [s]; farther apart, a strike found and a true one are two strikes
MOST_RUNS = 1_000_000
NAN = float("nan")


@dataclass(frozen=True)
class Campaign:
    """What is asked for. Raises ParameterError for an unknown scenario or key, and for less than one run."""

    scenario: str
    changes: Mapping[str, Any]  # of all runs
    varied: Mapping[str, tuple[Any, ...]]  # values by key; every combination is ridden
    runs: int  # of each combination
    seed: int  # of the first run of each; the next has the next seed
    settings: Settings
    given: bool = False  # the fit is told when each impulse ended; else it looks for the strikes

    def __post_init__(self) -> None:
        if not 1 <= self.runs * len(self.combinations) <= MOST_RUNS:
            raise ParameterError(
                f"campaign: expected 1 to {MOST_RUNS} runs, found {self.runs} of each of"
                f" {len(self.combinations)} combinations"
            )
        twice = [key for key in self.varied if key in self.changes or key == "seed"]
        if twice:
            raise ParameterError(f"vary: {twice[0]}: is set otherwise; leave it out of one of the two")
        for combination in self.combinations:
            self.scenario_of(combination, self.seed)

    @property
    def combinations(self) -> list[dict[str, Any]]:
        """Values by varied key, the last key fastest."""
        return [
            dict(zip(self.varied, values, strict=True)) for values in itertools.product(*self.varied.values())
        ]

    @property
    def mark(self) -> str:
        """Twelve digits that two campaigns share only if their rows may stand in one table."""
        scenario = load_scenario(self.scenario, dict(self.changes)).to_yaml()
        text = f"{__version__}\n{scenario}\n{self.settings}\n{self.given}"
        return sha256(text.encode()).hexdigest()[:12]

    def scenario_of(self, combination: Mapping[str, Any], seed: int) -> Scenario:
        """The scenario of one run; `sim run` with the same --set and --seed rides it again."""
        return load_scenario(self.scenario, {**self.changes, **combination, "seed": seed})


@dataclass(frozen=True)
class Row:
    """One strike of one run: a true one that was found or missed, or one that was never struck."""

    combination: tuple[Any, ...]
    seed: int
    number: int  # of this run's rows, from 1
    of: int  # rows of this run
    status: str  # of the estimate, or missed, or false
    time: float  # [s since the start] end of the true strike; of a false one: where it was found
    late: float = NAN  # [s] by which the free response found begins after the true strike's end
    truth: float = NAN  # [rad/s] true lean rate of the instant that the estimate is about
    estimate: float = NAN  # [rad/s]
    std: float = NAN  # [rad/s]
    low: float = NAN  # [rad/s] 95 % interval
    high: float = NAN
    vaf_lean_rate: float = NAN
    vaf_yaw_rate: float = NAN
    doubted: int = 0  # 1: the answer says that the model may be wrong, which no interval covers

    @property
    def error(self) -> float:
        """Estimate less truth [rad/s]."""
        return self.estimate - self.truth

    @property
    def covered(self) -> bool:
        """Whether the interval holds the truth."""
        return self.low <= self.truth <= self.high


def told(combination: Mapping[str, Any]) -> tuple[str, ...]:
    """The values of a combination as rows and their file have them."""
    return tuple(map(str, combination.values()))


def ride_all(
    campaign: Campaign, done: Sequence[Row] = (), keep: Callable[[list[Row]], None] = lambda rows: None
) -> list[Row]:
    """All rows, in the order of combinations and seeds.

    `done` are rows of before, which are not made again; `keep` is called with the rows of each new run.
    """
    known: dict[tuple[tuple[Any, ...], int], list[Row]] = {}
    for row in done:
        known.setdefault((row.combination, row.seed), []).append(row)
    found: list[Row] = []
    seeds = range(campaign.seed, campaign.seed + campaign.runs)
    tasks = list(itertools.product(campaign.combinations, seeds))
    for combination, seed in tqdm(tasks, unit=" runs", leave=False, disable=not sys.stderr.isatty()):
        rows = known.get((told(combination), seed))
        if rows is None:
            rows = list(ride_one(campaign, combination, seed))
            keep(rows)
        found += rows
    return found


def ride_one(campaign: Campaign, combination: Mapping[str, Any], seed: int) -> Iterator[Row]:
    """The rows of one run: through a bag, as `sim run` and `fit run` go."""
    scenario = campaign.scenario_of(combination, seed)
    run = simulate(scenario, np.random.default_rng(seed))
    with TemporaryDirectory(prefix="tms_campaign_") as folder:
        path = Path(folder) / "bag"
        with BagWriter(path, custom_data=run.custom_data()) as bag:
            for record in run.records():
                bag.write(record, topics.qos_of(record.topic))
        recording = read_recording(path)
    link, start_ns = link_of(scenario), run.info.start_ns
    given: tuple[float, ...] = ()  # ends of the impulses, as the sensor's clock has them
    if campaign.given:
        ends_ns = start_ns + np.round(1e9 * np.array(_ends(run))).astype(np.int64)
        stamps = sensor_clock(ends_ns, link, start_ns)
        given = tuple(((stamps - first_stamp(recording)) / 1e9).tolist())
    bicycle = bicycle_of(recording, scenario.text("bicycle"))
    fits = fit_recording(recording, bicycle, campaign.settings, given).strikes
    starts = host_clock(np.array([fit.start_ns for fit in fits], np.int64), link, start_ns)
    rows = _judged(run, dict(zip(((starts - start_ns) / 1e9).tolist(), fits, strict=True)))
    for number, row in enumerate(rows, start=1):
        yield Row(told(combination), seed, number, len(rows), **row)


def _ends(run: SimulatedRun) -> list[float]:
    """When each impulse ended [s since the start]."""
    struck = (one for one in run.events if one.kind == "strike")
    return [(one.time_ns - run.info.start_ns) / 1e9 + one.duration for one in struck]


def _judged(run: SimulatedRun, fits: Mapping[float, StrikeFit]) -> list[dict[str, Any]]:
    """Figures of each strike, by time: each true one with the nearest found; fits by start [s]."""
    rows: list[dict[str, Any]] = []
    left = dict(fits)
    for end in _ends(run):
        near = min(left, key=lambda start, end=end: abs(start - end), default=NAN)  # type: ignore[misc]
        if not abs(near - end) <= SAME:
            rows.append({"status": "missed", "time": end})
            continue
        figures = _figures(run, left.pop(near), near, end)
        rows.append({"time": end, "late": near - end, **figures})
    rows += [{"status": "false", "time": start} for start in left]
    return sorted(rows, key=lambda row: float(row["time"]))


def _figures(run: SimulatedRun, fit: StrikeFit, start: float, end: float) -> dict[str, Any]:
    """What the estimate says and what is true, where the free response found begins at start [s].

    Where the impulse's end is estimated and its uncertainty is in the interval, truth is what was right after
    it, at `end` [s]. Any other start is taken for exact, and truth is that of its instant.
    """
    (one,) = fit.estimates
    if one.status != "ok" or "initial_lean_rate" not in one.names:
        return {"status": one.status}
    index = one.names.index("initial_lean_rate")
    assert fit.window is not None
    instant = end if fit.window.delay_std else max(start, end)
    return {
        "status": one.status,
        "truth": float(run.trajectory.at(np.array([instant])).lean_rate[0]),
        "estimate": float(one.values[index]),
        "std": float(one.std[index]),
        "low": float(one.ci95[index, 0]),
        "high": float(one.ci95[index, 1]),
        **{f"vaf_{channel}": value for channel, value in one.vaf.items()},
        "doubted": int(fit.misspecification is not None),
    }
