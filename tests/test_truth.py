"""The truth of a simulated run stays out of the estimators' reach: tms_fit reads it in its report only."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

FIT = Path(__file__).parents[1] / "ros_ws" / "src" / "tms_fit" / "tms_fit"
REPORT = FIT / "report"
NAMES = {"StateSamples", "state_samples", "state_records", "event_records", "events", "true_motion"}
TOPICS = {"STATE", "EVENTS"}
TEXTS = ("bicycle/state", "bicycle/events", "truth.json")
MODULES = sorted(path for path in FIT.rglob("*.py") if REPORT not in path.parents)


def readings(tree: ast.AST) -> list[str]:
    """Every place in a syntax tree that reaches for the truth."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute):
            owner = (
                node.value.attr if isinstance(node.value, ast.Attribute) else getattr(node.value, "id", "")
            )
            if (node.attr == "state" and owner == "recording") or (node.attr in TOPICS and owner == "topics"):
                found.append(f"{owner}.{node.attr}, line {node.lineno}")
        if isinstance(node, ast.ImportFrom):
            found += [f"import {a.name}" for a in node.names if a.name in NAMES]
        if isinstance(node, ast.Attribute) and node.attr in NAMES:
            found.append(f"{node.attr}, line {node.lineno}")
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            found += [f"{text!r}, line {node.lineno}" for text in TEXTS if text in node.value]
    return found


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(FIT)))
def test_no_estimator_reads_the_truth(path: Path) -> None:
    assert readings(ast.parse(path.read_text(encoding="utf-8"))) == []


@pytest.mark.parametrize(
    "source",
    [
        "x = recording.state.state",
        "x = fit.recording.state",
        "from tms_bag.samples import StateSamples",
        "x = conversion.state_samples(records)",
        "x = topics.EVENTS",
        "x = '/bicycle/state'",
    ],
)
def test_the_search_finds_what_it_is_for(source: str) -> None:
    assert len(readings(ast.parse(source))) == 1


def test_the_report_compares_with_the_truth() -> None:
    # Else the exception above would be there for nothing.
    assert any(readings(ast.parse(path.read_text(encoding="utf-8"))) for path in REPORT.rglob("*.py"))
