"""The mappings of loggers' columns that are shipped: one YAML file each, in the folder `mappings/`."""

from __future__ import annotations

from pathlib import Path

FOLDER = Path(__file__).parent / "mappings"
DECIMALS = (".", ",")  # decimal marks of numbers in a log


def mapping_names() -> list[str]:
    """Names of the shipped mappings, sorted."""
    return sorted(path.stem for path in FOLDER.glob("*.yaml"))
