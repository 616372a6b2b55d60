"""Replay: how exactly the player keeps time, and how fast a bag goes through the estimator without loss.

./tms shell -c 'python benchmarks/replay.py'
"""

from __future__ import annotations

import argparse
import signal
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path

import numpy as np
from measure import print_machine
from tms_bag import BagReader, BagWriter, conversion, topics
from tms_bag.record import merged
from tms_bag.samples import ImuSamples, RunInfo, SpeedSamples
from tms_fit.settings import Settings
from tms_fit.streaming.live_fit import INPUTS, LiveFit
from tms_sim.run import simulate
from tms_sim.scenario import load_scenario
from tms_study.processes import own_domain

START = 1_700_000_000_000_000_000  # [ns]


def write_bag(path: Path, rate: float, duration: float) -> None:
    """A quiet run: noise of an inertial sensor at a rate, speed at a tenth of it."""
    rng = np.random.default_rng(1)
    count = int(rate * duration)
    time_ns = START + np.rint(np.arange(count) * 1e9 / rate).astype(np.int64)
    imu = ImuSamples(time_ns, rng.normal(size=(count, 3)) * 0.01, rng.normal(size=(count, 3)))
    speed = SpeedSamples(time_ns[::10], np.full(time_ns[::10].size, 4.0))
    info = RunInfo(START, "benchmark", {"wheelbase": 1.02}, source="benchmark", configuration="a: 1\n")
    streams = conversion.run_info_records(info), conversion.imu_records(imu), conversion.speed_records(speed)
    with BagWriter(path) as bag:
        for record in merged(*streams):
            bag.write(record, topics.QOS[record.topic.removeprefix("/")])


def start(module: str, *parameters: str) -> subprocess.Popen[bytes]:
    """A node as a process."""
    words = [word for parameter in parameters for word in ("-p", parameter)]
    command = [sys.executable, "-m", module, "--ros-args", *words]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def timing(folder: Path, rate: float, duration: float, speed: float) -> None:
    """Time between messages as sent (by the sender's stamp) against the bag's."""
    bag = folder / f"bag_{rate:g}"
    if not bag.exists():
        write_bag(bag, rate, duration)
    copy = folder / f"copy_{rate:g}_{speed:g}"
    recorder = start("tms_bag.nodes.recorder", f"output:={copy}", "topics:=[/imu/data_raw]")
    player = start(
        *("tms_bag.nodes.player", f"bag:={bag}", f"rate:={speed}", "topics:=[/imu/data_raw]"),
        *("wait_for_subscriptions:=1", "wait_timeout:=300.0"),
    )
    player.wait()
    recorder.send_signal(signal.SIGINT)
    recorder.wait()
    with BagReader(bag) as reader:
        planned = np.array([record.time_ns for record in reader.records(["/imu/data_raw"])])
    with BagReader(copy) as reader:
        found = [(r.publish_time_ns or 0, r.time_ns) for r in reader.records(["/imu/data_raw"])]
    sent = np.array([stamp for stamp, _ in found])
    if sent.size != planned.size:
        print(f"  {rate:g} Hz, rate {speed:g}: {planned.size - sent.size} messages were lost on the way")
        return
    late = (sent - sent[0] - (planned - planned[0]) / speed) / 1e6  # [ms] against the first
    late -= np.percentile(late, 1)  # the first may have been late itself
    median, high = np.percentile(late, (50, 99))
    low = max(np.percentile(late, 25), 0.0)
    text = f"timing error, {rate:g} Hz at rate {speed:g}"
    print(
        f"  {text:44} {median:10.3f} ms  ({low:.3f} to {high:.3f})"
        f"  quartile to 99 %, largest {late.max():.3f} ms"
    )


def write_strikes(path: Path, runs: int, duration: float) -> None:
    """Simulated runs one after the other, each with a strike."""
    with BagWriter(path) as bag:
        for number in range(runs):
            start_ns = START + round(number * (duration + 10.0) * 1e9)
            changes = {"seed": number + 1, "duration": duration, "start_time_ns": start_ns}
            run = simulate(load_scenario("tms_strike", changes), np.random.default_rng(number + 1))
            for record in run.records():
                if record.topic.removeprefix("/") in INPUTS:
                    bag.write(record, topics.QOS[record.topic.removeprefix("/")])


def answers(bag: Path) -> dict[str, list[bytes]]:
    """What the estimator says of a bag when it is given the messages in order, without ROS."""
    live, found = LiveFit(Settings()), defaultdict(list)
    with BagReader(bag) as reader:
        said = [one for r in reader.records() for one in live.process(r.topic.removeprefix("/"), r.data)]
    for one in said + live.finish():
        found[one.topic].append(one.data)
    return found


def lossless(folder: Path, runs: int, duration: float, speed: float) -> None:
    """Messages a second through the estimator, and whether its answers are those without ROS."""
    bag, copy = folder / "strikes", folder / f"answers_{speed:g}"
    if not bag.exists():
        write_strikes(bag, runs, duration)
    expected = answers(bag)
    recorder = start("tms_bag.nodes.recorder", f"output:={copy}", f"topics:=[{', '.join(expected)}]")
    estimator = start("tms_fit.nodes.estimator", "idle:=5.0")
    began = time.monotonic()
    parameters = [f"bag:={bag}", f"rate:={speed}", "lossless:=true", "wait_timeout:=300.0"]
    code = start("tms_bag.nodes.player", *parameters).wait()
    took = time.monotonic() - began
    time.sleep(10.0)  # the last run counts as ended after 5 s
    for node in (estimator, recorder):
        node.send_signal(signal.SIGINT)
        node.wait()
    with BagReader(bag) as reader:
        count, length = reader.message_count, (reader.end_ns - reader.start_ns) / 1e9
    print(f"  rate {speed:g}: {count} messages in {took:.1f} s, start of the processes included: ", end="")
    print(f"{length / took:.0f} times real time, exit code {code}")
    with BagReader(copy) as reader:
        for topic, those in expected.items():
            found = [record.data for record in reader.records([topic])]
            same = sum(one == other for one, other in zip(found, those, strict=False))
            print(
                f"    {topic}: {len(those)} answers expected, {len(found)} came, {same} the same to the byte"
            )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="little of everything")
    quick = parser.parse_args().quick
    print_machine(["numpy", "mcap"])
    print("\nplay to another process")
    with tempfile.TemporaryDirectory() as name, own_domain():
        for rate, speed in ((100.0, 1.0), (400.0, 1.0), (400.0, 5.0)):
            if not quick or rate == 100.0 or speed == 5.0:
                timing(Path(name), rate, 1.0 if quick else 20.0, speed)
        for speed in (1000.0,) if quick else (100.0, 1000.0):
            lossless(Path(name), *((1, 5.0) if quick else (10, 50.0)), speed)


if __name__ == "__main__":
    main()
