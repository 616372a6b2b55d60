import os
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from tms_bag import BagWriter, Record, conversion, topics
from tms_bag.record import merged
from tms_bag.samples import (
    ImuSamples,
    LeanYawSamples,
    RunInfo,
    SpeedSamples,
    StateSamples,
    SteerTorqueSamples,
)

ROOT = Path(__file__).resolve().parents[2]
STEP_NS = 10_000_000
START_NS = 1_700_000_000_123_456_789


class Run:
    """All kinds of samples of one made-up run, with NaN where a sensor would have none."""

    def __init__(self, count: int = 300, seed: int = 1, start_ns: int = START_NS) -> None:
        rng = np.random.default_rng(seed)
        time_ns = start_ns + np.arange(count, dtype=np.int64) * STEP_NS
        force = rng.normal(size=(count, 3))
        force[::7, 1] = np.nan
        lean = rng.normal(size=count)
        lean[3::5] = np.nan
        self.imu = ImuSamples(
            time_ns,
            rng.normal(size=(count, 3)),
            force,
            np.array([1e-6, 2e-6, 3e-6]),
            np.full(3, np.nan),
            "imu_link",
        )
        flags = rng.integers(0, 64, count).astype(np.uint8)
        self.lean_yaw = LeanYawSamples(time_ns, lean, rng.normal(size=count), rng.normal(size=count), flags)
        self.speed = SpeedSamples(time_ns[::5], rng.normal(4.5, 0.1, time_ns[::5].size))
        self.steer_torque = SteerTorqueSamples(time_ns, rng.normal(size=count))
        columns = [rng.normal(size=count) for _ in range(4)]
        self.state = StateSamples(time_ns, columns[0], rng.normal(size=(count, 4)), *columns[1:])
        self.info = RunInfo(
            start_ns=start_ns,
            bicycle="benchmark",
            parameters={"wheelbase": 1.02, "trail": 0.08},
            speed=4.5,
            imu_position=np.array([0.1, -0.02, 0.9]),
            imu_orientation=np.array([0.0, 0.0, 1.0, 0.0]),
            simulated=True,
            seed=seed,
            source="tests",
            version="0.1.0",
            source_sha256="",
            configuration="speed: 4.5\nnote: 'two\n\n  lines'\n",
        )

    def records(self) -> list[Record]:
        return list(
            merged(
                conversion.run_info_records(self.info),
                conversion.imu_records(self.imu),
                conversion.lean_yaw_records(self.lean_yaw),
                conversion.speed_records(self.speed),
                conversion.steer_torque_records(self.steer_torque),
                conversion.state_records(self.state),
            )
        )


@pytest.fixture(scope="session")
def run() -> Run:
    return Run()


@pytest.fixture(scope="session")
def make_run() -> type[Run]:
    return Run


def write(path: Path, records: Sequence[Record], **options: object) -> Path:
    with BagWriter(path, **options) as writer:  # type: ignore[arg-type]
        for record in records:
            writer.write(record, topics.QOS.get(record.topic[1:], topics.QOS[topics.IMU]))
    return path


@pytest.fixture(scope="session")
def write_bag() -> Callable[..., Path]:
    """Writes records to a path and returns it."""
    return write


@pytest.fixture
def bag(tmp_path: Path, run: Run) -> Path:
    """A bag with all topics."""
    return write(
        tmp_path / "bag", run.records(), custom_data={"seed": "1", "configuration": run.info.configuration}
    )


@pytest.fixture
def chunked_records(run: Run) -> list[Record]:
    return run.records()


@pytest.fixture
def unfinished_bag(tmp_path: Path, run: Run) -> Path:
    """What a killed recorder leaves: a chunk every 100 messages, no footer, no metadata.yaml."""
    folder = tmp_path / "unfinished"
    writer = BagWriter(folder, {"seed": "1"}, live=True)
    writer.__enter__()
    for number, record in enumerate(run.records()):
        writer.write(record, topics.QOS[record.topic[1:]])
        if number % 100 == 99:
            writer.flush()
    copy = tmp_path / "killed"
    copy.mkdir()
    (copy / "killed_0.mcap").write_bytes((folder / "unfinished_0.mcap").read_bytes())
    writer.__exit__(None, None, None)
    return copy


@pytest.fixture(scope="session")
def delft_data() -> Path:
    """Folder of the steer-by-wire logs, which aren't part of the project."""
    default = ROOT.parent / "shared" / "data" / "delft_sbw"
    folder = Path(os.environ.get("TMS_DELFT_DATA", default))
    if not folder.is_dir():
        pytest.skip(f"the Delft logs aren't at {folder}; say where they are with TMS_DELFT_DATA")
    return folder
