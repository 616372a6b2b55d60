"""The same content gives the same files, whatever process writes it."""

import dataclasses
import hashlib
import os
import subprocess
import sys
from pathlib import Path

import pytest
from tms_bag import conversion, messages

WRITE = """
import importlib.util, sys
from pathlib import Path
spec = importlib.util.spec_from_file_location("made_up", sys.argv[1])
made_up = importlib.util.module_from_spec(spec)
spec.loader.exec_module(made_up)
run = made_up.Run(seed=int(sys.argv[3]))
data = {"seed": sys.argv[3], "configuration": run.info.configuration}
made_up.write(Path(sys.argv[2]), run.records(), custom_data=data)
"""


def digests(folder: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(folder.iterdir())}


def write(path: Path, seed: int, hash_seed: str) -> dict[str, str]:
    conftest = Path(__file__).with_name("conftest.py")
    environment = os.environ | {"PYTHONHASHSEED": hash_seed, "TZ": f"UTC+{hash_seed}"}
    subprocess.run(
        [sys.executable, "-c", WRITE, str(conftest), str(path), str(seed)], env=environment, check=True
    )
    return digests(path)


def test_two_processes_write_the_same_bytes(tmp_path):
    first = write(tmp_path / "a" / "bag", seed=1, hash_seed="1")
    second = write(tmp_path / "b" / "bag", seed=1, hash_seed="2")
    assert set(first) == {"bag_0.mcap", "metadata.yaml"}
    assert first == second


def test_other_content_gives_other_bytes(tmp_path):
    first = write(tmp_path / "a" / "bag", seed=1, hash_seed="1")
    second = write(tmp_path / "b" / "bag", seed=2, hash_seed="1")
    assert first["bag_0.mcap"] != second["bag_0.mcap"]


def test_padding_is_zero(run):
    # 4 bytes encapsulation; then, counted from there, stamp 8, length 4, 'rear_frame' and its end 11, 1 of
    # padding up to 24, three doubles, three bools and one byte.
    data = next(conversion.lean_yaw_records(run.lean_yaw)).data
    assert data[:4] == b"\x00\x01\x00\x00"
    assert data[16:27] == b"rear_frame\x00"
    assert data[27:28] == b"\x00"
    assert len(data) == 28 + 3 * 8 + 4


@pytest.mark.parametrize("length", range(9))
def test_messages_end_at_a_multiple_of_four_bytes(run, length):
    # As DDS makes them on the way.
    record = next(conversion.run_info_records(dataclasses.replace(run.info, configuration="x" * length)))
    unpadded = messages._store().serialize_cdr(messages.deserialize(record.data, record.type), record.type)
    assert len(record.data) % 4 == 0
    assert 0 <= len(record.data) - len(unpadded) < 4
    assert record.data == bytes(unpadded).ljust(len(record.data), b"\0")
    assert conversion.run_info(record).configuration == "x" * length
