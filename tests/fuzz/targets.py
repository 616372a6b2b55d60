"""What reads files of strangers: for each kind of file, good ones to start from, and all readings of it.

A reading may end in one of ALLOWED: one clear line. Anything else is a defect.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import yaml
import zstandard
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.rosbag2 import Writer as Db3Writer
from rosbags.rosbag2.enums import StoragePlugin
from rosbags.typesys import Stores, get_typestore
from tms_bag import BagReader, Record, RecordingError, conversion, read_recording
from tms_bag.checks import findings, survey
from tms_bag.checks.poses import read_pose
from tms_bag.logs.csv_export import export_csv
from tms_bag.logs.csv_import import log_records, read_csv, run_info
from tms_bag.logs.mapping import FOLDER as MAPPINGS
from tms_bag.logs.mapping import LogMapping, adapted, load_mapping
from tms_bag.messages import schema_text
from tms_bag.samples import (
    ImuSamples,
    LeanYawSamples,
    RunInfo,
    SpeedSamples,
    StateSamples,
    SteerTorqueSamples,
)
from tms_bag.writing.repair import repair
from tms_model import ParameterError, load_bicycle
from tms_model.catalogue import FOLDER as BICYCLES
from tms_sim.scenario import FOLDER as SCENARIOS
from tms_sim.scenario import load_scenario

ALLOWED = (RecordingError, ParameterError)
ZSTD = b"\x28\xb5\x2f\xfd"  # what its files start with
COUNT = 12  # messages of a topic in a bag to start from
CSV = b"lean_angle,lean_rate,speed,sil_command,y_acceleration,t\n" + b"0.1,-0.2,3.0,1e-3,-1,0.01\n" * 5


@dataclass(frozen=True)
class Target:
    """A kind of file."""

    seeds: Callable[[], list[bytes]]
    read: Callable[[bytes, Path], None]  # the content, and an empty folder to put it into


def _read_bag(data: bytes, folder: Path, name: str = "a.mcap") -> None:
    path = folder / name
    path.write_bytes(data)
    _read_all(path)
    with suppress(*ALLOWED):
        repair(path, folder / f"new_{name}")


def _read_all(path: Path) -> None:
    """By every way there is."""
    with suppress(*ALLOWED), BagReader(path) as bag:
        for topic in bag.topics:
            with suppress(*ALLOWED):
                bag.columns({topic.name: None})
        for _ in bag.records():
            pass
    with suppress(*ALLOWED):
        read_recording(path)
    with suppress(*ALLOWED):
        findings(survey(path))
    with suppress(*ALLOWED):
        export_csv(path, path.with_suffix(".csv"), overwrite=True)


def _read_db3(data: bytes, folder: Path) -> None:
    _read_bag(data, folder, "a.db3")


def _read_packed(data: bytes, folder: Path) -> None:
    """A file packed as a whole; the same bytes packed well, so that damages reach what is in it."""
    _read_bag(data, folder, "a.mcap.zstd")
    if not data.startswith(ZSTD):
        _read_bag(zstandard.compress(data), folder, "b.mcap.zstd")


def _read_metadata(data: bytes, folder: Path) -> None:
    (folder / "a.mcap").write_bytes(_mcap_seeds()[0])
    (folder / "metadata.yaml").write_bytes(data)
    with suppress(*ALLOWED), BagReader(folder) as bag:
        for _ in bag.records():
            pass


def _read_csv(data: bytes, folder: Path) -> None:
    path = folder / "a.csv"
    path.write_bytes(data)
    for mapping in _log_mappings():
        with suppress(*ALLOWED):
            log = read_csv(path, mapping)
            for _ in log_records(log, run_info(log, mapping)):
                pass
    with suppress(*ALLOWED):
        read_pose(f"z={path}")


@cache
def _log_mappings() -> list[LogMapping]:
    """By rate, by stamps, and with decimal commas; without bicycles, whose files are read elsewhere."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "timed.yaml"
        document = yaml.safe_load((MAPPINGS / "delft_sbw.yaml").read_text())
        document.pop("rate")
        document |= {"time": {"column": "t", "unit": "s", "zero": "epoch"}, "missing": "skip", "decimal": ","}
        path.write_text(yaml.safe_dump(document))
        mappings = load_mapping("delft_sbw"), load_mapping("export"), load_mapping(path)
        return [adapted(mapping, bicycle="") for mapping in mappings]


def _read_yaml(load: Callable[[str], object]) -> Callable[[bytes, Path], None]:
    def read(data: bytes, folder: Path) -> None:
        path = folder / "a.yaml"
        path.write_bytes(data)
        with suppress(*ALLOWED):
            load(str(path))

    return read


@cache
def _records() -> list[Record]:
    rng = np.random.default_rng(1)
    time = 10**18 + 10_000_000 * np.arange(COUNT, dtype=np.int64)

    def some(*shape: int) -> np.ndarray:
        return rng.normal(size=(COUNT, *shape))

    return [
        *conversion.run_info_records(RunInfo(int(time[0]), "benchmark", {"wheelbase": 1.0}, 4.5)),
        *conversion.imu_records(ImuSamples(time, some(3), some(3))),
        *conversion.speed_records(SpeedSamples(time[::3], some()[::3])),
        *conversion.lean_yaw_records(LeanYawSamples(time, some(), some(), some(), np.zeros(COUNT, np.uint8))),
        *conversion.steer_torque_records(SteerTorqueSamples(time, some())),
        *conversion.state_records(StateSamples(time, some(), some(4), some(), some(), some())),
    ]


@cache
def _mcap_seeds() -> list[bytes]:
    """With and without chunks, compression, index and checksums."""
    ways: list[dict[str, object]] = [
        {"compression": CompressionType.ZSTD},
        {"compression": CompressionType.NONE, "enable_crcs": False},
        {"compression": CompressionType.LZ4, "enable_crcs": False, "chunk_size": 2000},
        {"use_chunking": False, "enable_crcs": False},
        {"use_chunking": False, "enable_crcs": False, "index_types": IndexType.NONE, "use_statistics": False},
    ]
    return [*(_mcap(options) for options in ways), *_begun_seeds()]


def _begun_seeds() -> list[bytes]:
    """Files that end in the middle of their only chunk, in each compression."""
    whole = [_mcap({"compression": kind}) for kind in CompressionType]
    return [data[: len(data) // 2] for data in whole]


@cache
def _packed_seeds() -> list[bytes]:
    """Files packed as a whole, with and without their size told; one whose messages are packed."""
    plain = _mcap({"compression": CompressionType.NONE, "enable_crcs": False})
    telling, silent = (zstandard.ZstdCompressor(write_content_size=told) for told in (True, False))
    messages = _mcap({"compression": CompressionType.NONE, "enable_crcs": False}, zstandard.compress)
    return [telling.compress(plain), silent.compress(plain), messages]


def _mcap(options: dict[str, object], pack: Callable[[bytes], bytes] = bytes) -> bytes:
    file = BytesIO()
    writer = Writer(file, **options)  # type: ignore[arg-type]
    writer.start(profile="ros2", library="seed")
    channels: dict[str, int] = {}
    for record in _records():
        if record.topic not in channels:
            schema = writer.register_schema(record.type, "ros2msg", schema_text(record.type).encode())
            channels[record.topic] = writer.register_channel(record.topic, "cdr", schema, {})
        writer.add_message(channels[record.topic], record.time_ns, pack(record.data), record.time_ns)
    writer.add_metadata("rosbag2", {"serialized_metadata": "custom_data: {a: b}"})
    writer.add_attachment(1, 2, "a", "text/plain", b"x")
    writer.finish()
    return file.getvalue()


@cache
def _db3_seeds() -> list[bytes]:
    store = get_typestore(Stores.ROS2_JAZZY)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "bag"
        with Db3Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
            imu = [record for record in _records() if record.topic == "/imu/data_raw"]
            connection = writer.add_connection(imu[0].topic, imu[0].type, typestore=store)
            for record in imu:
                writer.write(connection, record.time_ns, record.data)
        return [next(path.glob("*.db3")).read_bytes()]


def _metadata_seeds() -> list[bytes]:
    information = {
        "version": 9,
        "storage_identifier": "mcap",
        "relative_file_paths": ["a.mcap"],
        "compression_mode": "",
        "custom_data": {"seed": "1", "text": "a\\nb"},
    }
    bomb = "a: &a [x, x]\n" + "".join(
        f"{n}: &{n} [*{p}, *{p}]\n" for p, n in zip("abcdefghij", "bcdefghijk", strict=True)
    )
    return [
        yaml.safe_dump({"rosbag2_bagfile_information": information}).encode(),
        (bomb + yaml.safe_dump({"rosbag2_bagfile_information": information})).encode(),
    ]


def _yaml_seeds(folder: Path) -> Callable[[], list[bytes]]:
    return lambda: [path.read_bytes() for path in sorted(folder.glob("*.yaml"))[:6]]


TARGETS: dict[str, Target] = {
    "mcap": Target(_mcap_seeds, _read_bag),
    "packed": Target(_packed_seeds, _read_packed),
    "db3": Target(_db3_seeds, _read_db3),
    "metadata": Target(_metadata_seeds, _read_metadata),
    "csv": Target(
        lambda: [CSV, CSV.replace(b",", b";"), b"acc_x,acc_y,acc_z\n" + b"0,0,9.8\n" * 12], _read_csv
    ),
    "mapping": Target(_yaml_seeds(MAPPINGS), _read_yaml(load_mapping)),
    "scenario": Target(_yaml_seeds(SCENARIOS), _read_yaml(load_scenario)),
    "bicycle": Target(_yaml_seeds(BICYCLES), _read_yaml(load_bicycle)),
}


def read(name: str, data: bytes) -> None:
    """Read a file of a kind by all ways; whatever isn't allowed comes through."""
    with TemporaryDirectory() as folder:
        TARGETS[name].read(data, Path(folder))
