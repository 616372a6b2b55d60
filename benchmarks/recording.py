"""Recording: what each way of packing costs, and how many messages a second two processes carry without loss.

./tms shell -c 'python benchmarks/recording.py'                       packing, then 2 kHz for 60 s, twice
./tms shell -c 'python benchmarks/recording.py --packing'             only packing
./tms shell -c 'python benchmarks/recording.py --limit'               up to the rate where something is lost
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import yaml
from measure import in_turn, print_machine
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from tms_bag import BagReader, BagWriter, Record, conversion
from tms_bag.samples import ImuSamples
from tms_bag.writing.presets import PRESETS
from tms_sim.run import simulate
from tms_sim.scenario import load_scenario
from tms_study.processes import own_domain

IMU = "sensor_msgs/msg/Imu"
LIVE_CHUNK = 100  # messages of 0.25 s at 400 Hz


def imu_records(count: int) -> list[Record]:
    """Noise of an inertial sensor at 400 Hz."""
    rng = np.random.default_rng(1)
    time_ns = np.arange(1, count + 1, dtype=np.int64) * 2_500_000
    return list(
        conversion.imu_records(ImuSamples(time_ns, rng.normal(size=(count, 3)), rng.normal(size=(count, 3))))
    )


def ride_records(count: int) -> list[Record]:
    """What a simulated sensor with all its errors measures at 400 Hz while a bicycle is struck and coasts."""
    changes = {"imu.rate": 400.0, "duration": count / 400.0 + 1.0}
    scenario = load_scenario("tms_strike", changes)
    run = simulate(scenario, np.random.default_rng(1))
    return [record for record in run.records() if record.topic == "/imu/data_raw"][:count]


def compare_packing(title: str, records: list[Record], repeats: int) -> None:
    """Processor time and size of a bag of IMU messages, packed in each way and by rosbags.

    Once as `sim run` or an import writes it, once as the recorder does, with a chunk completed every 0.25 s.
    """
    count, store = len(records), get_typestore(Stores.ROS2_JAZZY)
    raw = sum(len(record.data) for record in records)
    sizes: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as folder:

        def packed(preset: str, live: bool) -> None:
            path = Path(tempfile.mkdtemp(dir=folder)) / "bag"
            with BagWriter(path, preset=preset) as bag:
                for number, record in enumerate(records):
                    bag.write(record)
                    if live and number % LIVE_CHUNK == LIVE_CHUNK - 1:
                        bag.flush()
            sizes[name_of(preset, live)] = (path / "bag_0.mcap").stat().st_size / raw

        def by_rosbags() -> None:
            path = Path(tempfile.mkdtemp(dir=folder)) / "bag"
            with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
                connection = bag.add_connection(records[0].topic, IMU, typestore=store)
                for record in records:
                    bag.write(connection, record.time_ns, record.data)
            sizes["rosbags, not compressed"] = (path / "bag.mcap").stat().st_size / raw

        ways: dict[str, Callable[[], object]] = {
            name_of(preset, live): (lambda preset=preset, live=live: packed(preset, live))
            for preset in PRESETS
            for live in (False, True)
        }
        timings = in_turn({**ways, "rosbags, not compressed": by_rosbags}, repeats)
    print(f"\n{title}: {count} messages of {raw / count:.0f} bytes, {repeats} times each")
    print("| way | processor time a message [us] | MB/s of one core | size of the file / of the messages |")
    print("|---|---|---|---|")
    for name, timing in timings.items():
        took = timing.least_processor
        print(f"| {name} | {1e6 * took / count:.1f} | {raw / took / 1e6:.0f} | {sizes[name]:.2f} |")


def name_of(preset: str, live: bool) -> str:
    """How a way to pack is called in the table."""
    return f"{preset}, recorded" if live else preset


def publish(topics: int, rate: float, duration: float) -> None:
    """Publish IMU messages on some topics in turn, `rate` a second in total; prints how many."""
    import rclpy
    from rclpy.qos import QoSProfile
    from sensor_msgs.msg import Imu

    rclpy.init()
    node = rclpy.create_node("load")
    publishers = [node.create_publisher(Imu, f"imu_{k}", QoSProfile(depth=100)) for k in range(topics)]
    while not all(publisher.get_subscription_count() for publisher in publishers):
        time.sleep(0.01)
    time.sleep(2.0)  # that the publishers know the recorder does not mean that it knows them
    data, sent, start = imu_records(1)[0].data, 0, time.monotonic()
    while (elapsed := time.monotonic() - start) < duration:
        due = int(elapsed * rate)
        while sent < due:
            publishers[sent % topics].publish(data)
            sent += 1
        time.sleep(0.0005)
    for publisher in publishers:
        publisher.wait_for_all_acked()
    print(sent)
    rclpy.shutdown()


def record_load(topics: int, rate: float, duration: float) -> tuple[int, int, dict[str, int], float]:
    """Messages sent, in the bag, lost by topic as the bag says, and the recorder's share of one core."""
    with tempfile.TemporaryDirectory() as folder:
        command = [
            sys.executable,
            "-m",
            "tms_bag.nodes.recorder",
            "--ros-args",
            "-p",
            f"output:={folder}/bag",
        ]
        recorder = subprocess.Popen([*command, "-p", "regex:=imu"], stderr=subprocess.DEVNULL)
        while not Path(folder, "bag").exists():
            time.sleep(0.01)
        before, start = processor_time(recorder.pid), time.monotonic()
        load = [sys.executable, __file__, "--publish", str(topics), str(rate), str(duration)]
        published = subprocess.run(load, check=True, capture_output=True, text=True)
        share = (processor_time(recorder.pid) - before) / (time.monotonic() - start)
        recorder.send_signal(signal.SIGINT)
        recorder.wait()
        with BagReader(f"{folder}/bag") as bag:
            lost = yaml.safe_load(bag.custom_data["lost"])
            if before := yaml.safe_load(bag.custom_data["sent_before_recording"]):
                print(f"  (sent before the recorder listened: {before})")
            return int(published.stdout.split()[-1]), bag.message_count, lost, share


def processor_time(process: int) -> float:
    """Processor time that a process has used [s]."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def report_load(topics: int, rate: float, duration: float) -> bool:
    """One line; returns whether all arrived at the rate that was asked for."""
    sent, recorded, counted, share = record_load(topics, rate, duration)
    worst = max(counted, key=lambda topic: counted[topic], default="")
    by_topic = f" of {len(counted)} topics, most {counted[worst]} of {worst}" if worst else ""
    print(
        f"  {topics:3d} topics, {rate:7.0f} messages/s asked, {sent / duration:7.0f} sent, {duration:g} s:"
        f" {sent} sent, {recorded} in the bag, {sent - recorded} lost, the bag says"
        f" {sum(counted.values())}{by_topic}; recorder {share:.0%} of a core,"
        f" load {os.getloadavg()[0]:.1f}",
        flush=True,
    )
    return recorded == sent and sent > 0.95 * rate * duration


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="little of everything")
    parser.add_argument("--packing", action="store_true", help="only what each way of packing costs")
    parser.add_argument("--limit", action="store_true", help="raise the rate until something is lost")
    parser.add_argument(
        "--load", nargs=3, type=float, metavar=("TOPICS", "RATE", "SECONDS"), help="only this load"
    )
    parser.add_argument("--publish", nargs=3, type=float, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.publish:
        publish(int(arguments.publish[0]), *arguments.publish[1:])
        return
    with own_domain():
        measure(arguments)


def measure(arguments: argparse.Namespace) -> None:
    """What was asked for."""
    print_machine(["numpy", "mcap", "zstandard", "rosbags"])
    if arguments.load:
        report_load(int(arguments.load[0]), *arguments.load[1:])
    elif arguments.limit:
        for topics in (20, 1):
            for rate in (5000, 10_000, 15_000, 20_000, 30_000):
                if not report_load(topics, rate, 20.0):
                    break
    else:
        count, repeats = (1000, 1) if arguments.quick else (10_000, 5)
        compare_packing("a simulated ride at 400 Hz", ride_records(count), repeats)
        if not arguments.packing:
            print("\nrecord what another process publishes, sensor_msgs/Imu")
            for topics in (20, 1):
                report_load(topics, *((200, 1.0) if arguments.quick else (2000, 60.0)))


if __name__ == "__main__":
    main()
