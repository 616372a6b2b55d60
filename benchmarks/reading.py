"""How fast bags are read into arrays, against rosbags and mcap-ros2-support. See benchmarks/README.md."""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer
from measure import in_turn, print_machine, print_timings
from tms_bag import BagReader, conversion, read_recording
from tms_bag.messages import schema_text
from tms_bag.samples import ImuSamples

try:
    from mcap_ros2.reader import read_ros2_messages
    from rosbags.rosbag2 import Reader
    from rosbags.typesys import Stores, get_typestore
except ImportError as error:
    sys.exit(f"benchmarks/reading.py needs mcap-ros2-support and rosbags ({error})")

TOPIC, TYPE = "/imu/data_raw", "sensor_msgs/msg/Imu"
ROSBAGS, MCAP_ROS2 = "rosbags", "mcap-ros2-support"
# As rosbag2 writes them: its default, its presets zstd_fast and fastwrite.
FILES: dict[str, dict[str, Any]] = {
    "not compressed, chunks of 768 KiB": {"compression": CompressionType.NONE, "chunk_size": 786_432},
    "zstd, chunks of 768 KiB": {"compression": CompressionType.ZSTD, "chunk_size": 786_432},
    "lz4, chunks of 768 KiB": {"compression": CompressionType.LZ4, "chunk_size": 786_432},
    "without chunks": {"use_chunking": False},
}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few repeats and small sizes: does it run?")
    parser.add_argument("--messages", type=int, default=300_000, help="in the bag (default %(default)s)")
    arguments = parser.parse_args()
    count = 5000 if arguments.quick else arguments.messages
    few = min(count, 20_000)
    print_machine(("numpy", "rosbags", "mcap", "mcap-ros2-support"))
    print(f"{TYPE} of 324 bytes, all numbers decoded, file and decompression included")
    with tempfile.TemporaryDirectory() as folder:
        for title, options in FILES.items():
            ours, theirs = (Path(folder) / f"{number}.mcap" for number in (count, few))
            write(ours, count, options)
            write(theirs, few, options)
            measure(title, ours, count, theirs, few, 2 if arguments.quick else 7)
            ours.unlink()


def measure(title: str, ours: Path, count: int, theirs: Path, few: int, repeats: int) -> None:
    """Time per message: ours of the large bag, theirs of a smaller one, since they take the same for each."""
    ways: dict[str, Callable[[], object]] = {
        ROSBAGS: lambda: by_rosbags(theirs),
        MCAP_ROS2: lambda: by_mcap_ros2(theirs),
        "BagReader.columns": lambda: by_columns(ours),
        "read_recording": lambda: read_recording(ours),
    }
    timings = in_turn(ways, repeats)
    print_timings(f"{title}: {count} messages, of {ROSBAGS} and {MCAP_ROS2} {few}", timings, ROSBAGS)
    sizes = {name: few if name in (ROSBAGS, MCAP_ROS2) else count for name in timings}
    for name in ("BagReader.columns", "read_recording"):
        for clock, of in (("wall", "median"), ("least processor", "least_processor")):
            taken = {other: getattr(timing, of) / sizes[other] for other, timing in timings.items()}
            ratios = ", ".join(
                f"{taken[other] / taken[name]:.1f} times faster than {other}"
                for other in (ROSBAGS, MCAP_ROS2)
            )
            print(f"  {name}, {clock} time: {1e9 * taken[name]:.0f} ns for each message; {ratios}")
    found = by_columns(theirs)
    same = all(
        found["angular_velocity.x"][row] == message.angular_velocity.x
        and found["linear_acceleration_covariance"][row].tolist()
        == message.linear_acceleration_covariance.tolist()
        for row, message in enumerate(by_rosbags(theirs))
    )
    print(f"  the numbers are those of {ROSBAGS}: {same}")


def by_columns(path: Path) -> Any:
    """All numbers as arrays."""
    with BagReader(path) as bag:
        return bag.columns({TOPIC: None})[TOPIC]


def by_rosbags(path: Path) -> list[Any]:
    """All messages as objects."""
    store = get_typestore(Stores.ROS2_JAZZY)
    with Reader(path) as reader:
        return [store.deserialize_cdr(data, connection.msgtype) for connection, _, data in reader.messages()]


def by_mcap_ros2(path: Path) -> list[Any]:
    """All messages as objects."""
    return [message.ros_msg for message in read_ros2_messages(str(path))]


def write(path: Path, count: int, options: dict[str, Any]) -> None:
    """Readings of white noise at 400 Hz."""
    rng = np.random.default_rng(1)
    with path.open("wb") as file:
        writer = Writer(file, **options)
        writer.start(profile="ros2", library="benchmark")
        schema = writer.register_schema(TYPE, "ros2msg", schema_text(TYPE).encode())
        channel = writer.register_channel(TOPIC, "cdr", schema, {})
        for first in range(0, count, 10_000):
            time = 10**18 + 2_500_000 * np.arange(first, min(first + 10_000, count), dtype=np.int64)
            samples = ImuSamples(
                time, *(rng.normal(size=(time.size, 3)) for _ in range(2)), np.full(3, 1e-6), np.full(3, 1e-4)
            )
            for record in conversion.imu_records(samples):
                writer.add_message(channel, record.time_ns, record.data, record.time_ns)
        writer.finish()


if __name__ == "__main__":
    main()
