"""What a report rests on: files, bicycle, settings and programs, so that it can be made again."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path

import numpy
import scipy
import vl_convert
from tms_model import Bicycle

from tms_fit import __version__
from tms_fit.parameters import DEFAULT_FREE
from tms_fit.recording_fit import RecordingFit
from tms_fit.report.rounding import significant


def provenance(fit: RecordingFit) -> list[tuple[str, str]]:
    """Names and values for the report's header, in reading order; what is unknown is left out."""
    info, bicycle = fit.recording.run_info, fit.bicycle
    facts = [("recording", str(fit.recording.path))]
    facts += [(f"sha256 of {path.name}", file_sha256(path)) for path in _files(fit.recording.path)]
    if info is not None:
        facts += [
            ("what it is", "a simulated run" if info.simulated else "a measured run"),
            ("made by", " ".join(part for part in (info.source, info.version) if part)),
            ("seed", str(info.seed) if info.seed >= 0 else ""),
            ("sha256 of the log it was imported from", info.source_sha256),
        ]
    facts += [
        ("bicycle", bicycle.name),
        ("source of the bicycle", " ".join(bicycle.source.split())),
        ("sha256 of its matrices", matrices_sha256(bicycle)),
        ("settings", _settings(fit)),
        ("programs", _programs()),
    ]
    return [(name, value) for name, value in facts if value]


def file_sha256(path: Path) -> str:
    """Hash of a file, read in pieces."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while piece := file.read(2**20):
            digest.update(piece)
    return digest.hexdigest()


def matrices_sha256(bicycle: Bicycle) -> str:
    """Hash of `{"M", "C1", "K0", "K2"}` as JSON without spaces, as `tms model matrices --json` has them."""
    matrices = {letter: matrix.tolist() for letter, matrix in bicycle.canonical.items()}
    return hashlib.sha256(json.dumps(matrices, separators=(",", ":")).encode()).hexdigest()


def _files(path: Path) -> list[Path]:
    return sorted(path.glob("*.mcap")) if path.is_dir() else [path]


def _settings(fit: RecordingFit) -> str:
    parts = [_setting(entry.name, getattr(fit.settings, entry.name)) for entry in fields(fit.settings)]
    return "; ".join(part for part in parts if part)


def _setting(name: str, value: object) -> str:
    """One setting in words, whatever its kind; empty where nothing was asked for."""
    words = name.replace("_", " ")
    if name == "free":
        value = value or (*DEFAULT_FREE, "by default")
    if isinstance(value, Mapping):
        return "; ".join(f"{words} {key} = {_plain(one)}" for key, one in value.items())
    return f"{words} {_plain(value)}" if value is not None else ""


def _plain(value: object) -> str:
    if isinstance(value, tuple):
        return ", ".join(_plain(one) for one in value)
    return significant(value, 6) if isinstance(value, float) else str(value)


def _programs() -> str:
    return (
        f"tms_fit {__version__}, Python {platform.python_version()}, numpy {numpy.__version__},"
        f" scipy {scipy.__version__}, Vega {vl_convert.get_vega_version()},"
        f" Vega-Lite {vl_convert.get_vegalite_versions()[-1]}"
    )
