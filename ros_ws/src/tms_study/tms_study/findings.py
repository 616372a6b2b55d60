"""What a validation finds: one figure, the band it should lie in, how many runs it rests on."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tms_model.atomic_write import atomic_write

from tms_study import __version__


@dataclass(frozen=True)
class Finding:
    """One figure of the validation."""

    topic: str  # white noise, shimmy, ...
    figure: str  # in words
    value: float
    low: float  # the band aimed at
    high: float
    runs: int
    spread: float = 0.0  # by which the figure may be off its expectation by chance (two or three deviations)

    @property
    def reached(self) -> bool:
        """Whether the figure lies in its band, chance allowed for."""
        return bool(self.low - self.spread <= self.value <= self.high + self.spread)


def findings_json(found: list[Finding], seed: int, quick: bool) -> dict[str, Any]:
    """The document of `study validate --json`."""
    return {
        "version": __version__,
        "seed": seed,
        "quick": quick,
        "findings": [
            {
                "topic": one.topic,
                "figure": one.figure,
                "value": one.value,
                "band": [one.low, one.high],
                "spread": one.spread,
                "runs": one.runs,
                "reached": one.reached,
            }
            for one in found
        ],
    }


def findings_text(found: list[Finding]) -> str:
    """The table for the terminal."""
    lines = [f"{'':24} {'figure':52} {'found':>9}  {'aimed at':17} {'runs':>6}"]
    for one in found:
        band = f"{one.low:g} to {one.high:g}"
        mark = "" if one.reached else "  MISSED"
        lines.append(f"{one.topic:24} {one.figure:52} {one.value:9.4g}  {band:17} {one.runs:6}{mark}")
    missed = sum(not one.reached for one in found)
    lines.append(f"{len(found) - missed} of {len(found)} figures as aimed at")
    return "\n".join(lines)


def write_markdown(path: Path, found: list[Finding], seed: int, quick: bool) -> None:
    """The table as a Markdown file. Raises ParameterError for a place that can't be written."""
    command = "./tms study validate" + (" --quick" if quick else "") + f" --seed {seed} -o {path.name}"
    lines = [
        "# Validation",
        "",
        f"Made by `{command}`, version {__version__}. The runs are simulated, so their truth is known. A",
        "figure counts as reached when it lies in its band, or off it by no more than chance (two standard",
        "deviations for so many runs, three for the two means of the Kalman filter).",
        "",
        "| runs of | figure | found | aimed at | runs | |",
        "|---|---|---|---|---|---|",
    ]
    for one in found:
        mark = "reached" if one.reached else "**missed**"
        lines.append(
            f"| {one.topic} | {one.figure} | {one.value:.4g} | {one.low:g} to {one.high:g} | {one.runs} |"
            f" {mark} |"
        )
    atomic_write(path, ("\n".join(lines) + "\n").encode())
