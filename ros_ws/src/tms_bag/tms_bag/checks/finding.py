"""What a check found."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

ERROR, WARNING, NOTE = "error", "warning", "note"
SEVERITIES = (ERROR, WARNING, NOTE)  # the gravest first


@dataclass(frozen=True)
class Finding:
    """Something that a colleague would tell before the recording is trusted."""

    severity: str  # error: results would be wrong or impossible; warning: they may be; note: good to know
    topic: str  # with its leading slash; empty: the whole bag
    evidence: str  # what was seen, with its numbers
    consequence: str  # what it does to an analysis
    remedy: str  # what to do
    command: str = ""  # what to type, if a command helps
    values: dict[str, Any] = field(default_factory=dict)  # the numbers, in SI units and radians

    def as_dict(self, check: str) -> dict[str, Any]:
        """For JSON."""
        return {"check": check, **asdict(self)}
