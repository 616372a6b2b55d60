"""Calibrated bicycle file in the catalogue's format, with covariance and provenance."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import tms_fit
from tms_fit.recording_fit import RecordingFit
from tms_model.atomic_write import atomic_write
from tms_model.calibrated import Calibrated, calibration_yaml, yaml_text

from tms_calibrate.calibration import Calibration
from tms_calibrate.calibration_output import in_word
from tms_calibrate.pooled_fit import Strike


def sources_of(fits: Sequence[RecordingFit], strikes: Sequence[Strike]) -> list[dict[str, Any]]:
    """Name, SHA-256 and number of strikes used of each recording; an imported log has the hash of the log."""
    sources = []
    for fit in fits:
        path = fit.recording.path
        count = sum(one.recording == path.name for one in strikes)
        digest = fit.recording.custom_data.get("source_sha256") or _digest(path)
        sources.append({"name": path.name, "sha256": digest, "strikes": count})
    return sources


def _digest(path: Path) -> str:
    """SHA-256 of all MCAP files of a bag, in the order of their names."""
    total = hashlib.sha256()
    for file in sorted(path.glob("*.mcap")) if path.is_dir() else [path]:
        with file.open("rb") as stream:
            while chunk := stream.read(1 << 20):
                total.update(chunk)
    return total.hexdigest()


def document_of(
    calibration: Calibration, parent: str, command: str, recordings: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """Contents of the file: the parent bicycle, the changed parameters and their calibration."""
    values = {name: float(f"{v:.7g}") for name, v in calibration.solution.shared_values.items()}
    strikes = sum(int(one["strikes"]) for one in recordings)
    contraction = dict(zip(calibration.names, calibration.contraction.tolist(), strict=True))
    held = [name for name, share in contraction.items() if in_word(share) == "prior"]
    calibrated = Calibrated(
        names=calibration.names,
        covariance=calibration.covariance,
        priors=calibration.priors,
        recordings=tuple(recordings),
        command=command,
        version=tms_fit.__version__,
    )
    return {
        "description": f"{calibration.bicycle.description}; calibrated by {strikes} free responses",
        "source": f"{calibration.bicycle.source}; changed numbers from recordings, see calibration",
        "uncertainty": (
            "covariance of the changed numbers, priors included, under calibration; "
            + (f"held by the priors alone: {', '.join(held)}" if held else "all told by the recordings")
        ),
        "parent": parent,
        "changes": values,
        "calibration": calibration_yaml(calibrated),
    }


def write_calibration(
    calibration: Calibration,
    path: Path,
    parent: str,
    command: str,
    recordings: Sequence[Mapping[str, Any]],
) -> None:
    """Write the calibrated bicycle; the file appears whole or not at all. Raises ParameterError.

    parent: catalogue name, or path of a file, to which the new file refers by a relative path.
    """
    if parent.endswith((".yaml", ".yml", ".txt")):
        parent = os.path.relpath(parent, path.parent)
    atomic_write(path, yaml_text(document_of(calibration, parent, command, recordings)).encode())
