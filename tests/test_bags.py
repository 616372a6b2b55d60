"""The reference bags are what their command makes."""

from __future__ import annotations

import hashlib
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from tms_bag import BagReader, read_recording

ROOT = Path(__file__).parents[1]
BAGS = ROOT / "bags"
NAMES = sorted(path.name for path in BAGS.iterdir() if path.is_dir())


@pytest.fixture(scope="module")
def remade(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bags")
    subprocess.run([BAGS / "remake", folder], check=True, capture_output=True)
    return folder


def test_there_are_bags_and_they_are_small() -> None:
    assert NAMES
    for name in NAMES:
        assert sum(path.stat().st_size for path in (BAGS / name).iterdir()) < 1_000_000


@pytest.mark.long
@pytest.mark.parametrize("name", NAMES)
def test_remade_values_agree(remade: Path, name: str) -> None:
    ours, theirs = read_recording(BAGS / name), read_recording(remade / name)
    for kind in ("imu", "speed", "state", "lean_yaw", "steer_torque"):
        one, other = getattr(ours, kind), getattr(theirs, kind)
        assert (one is None) == (other is None)
        for field, values in vars(one).items() if one is not None else ():
            if isinstance(values, np.ndarray):
                np.testing.assert_allclose(getattr(other, field), values, rtol=1e-12, atol=1e-12)
    assert ours.custom_data == theirs.custom_data
    with BagReader(BAGS / name) as bag, BagReader(remade / name) as again:
        assert [r.time_ns for r in bag.records()] == [r.time_ns for r in again.records()]


def sums(folder: Path) -> tuple[list[str], dict[str, str]]:
    """Comments, which say what the bags were made with, and sums by file of a folder's SHA256SUMS."""
    text = (folder / "SHA256SUMS").read_text()
    lines = [line.split() for line in text.splitlines() if not line.startswith("#")]
    return re.findall(r"^# .*$", text, re.MULTILINE), {name: digest for digest, name in lines}


def test_sums_hold() -> None:
    _, expected = sums(BAGS)
    assert sorted({name.split("/")[0] for name in expected}) == NAMES
    for name, digest in expected.items():
        assert hashlib.sha256((BAGS / name).read_bytes()).hexdigest() == digest, name


@pytest.mark.long
def test_remade_bytes_agree_where_they_must(remade: Path) -> None:
    (made_with, expected), (again_with, again) = sums(BAGS), sums(remade)
    if made_with == again_with:
        assert again == expected
