# ruff: noqa: E501
"""Comparison of the command line's answers with the recorded ones: exit code 3 where they differ.

`python tests/golden/compare.py --only tms_strike --tolerance 1e-3`. Statuses, names, counts and structure must be the same;
a value with a standard error within --tolerance of it (2e-2 where steer_coulomb_friction is free), other numbers within
the same fraction of themselves. Added keys are allowed, texts are compared and listed, neither counts as a difference.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from record import answers, cases, chosen, parser, path_of

TEXTS = {
    "message",
    "why",
    "sentence",
    "verdict",
    "warnings",
    "text",
    "errors",
    "findings",
    "note",
    "chosen",
    "effect",
    "action",
    "evidence",
    "ended_by",
}
FRICTION_TOLERANCE = 2e-2  # [standard errors], as far as today's loops converge
REPORT_TOLERANCE = 1e-5  # reports hold six digits
SMALL = 1e-3  # numbers below are compared as if they were that large


@dataclass
class Comparison:
    """Differences of one answer: path and what differs; added keys; changed texts; the largest deviation in tolerances."""

    tolerance: float
    permitted: list[tuple[str, float]] = field(default_factory=list)
    differences: list[str] = field(default_factory=list)
    added: list[str] = field(default_factory=list)
    texts: list[str] = field(default_factory=list)
    largest: float = 0.0

    def compare(self, old: Any, new: Any, path: str = "", key: str = "") -> None:
        """Compare two values that stand at the same place."""
        if key in TEXTS:
            if old != new:
                self.texts.append(f"{path}: {old!r} -> {new!r}")
        elif isinstance(old, dict) and isinstance(new, dict):
            self._dictionaries(old, new, path)
        elif isinstance(old, list) and isinstance(new, list):
            if len(old) != len(new):
                self.differences.append(f"{path}: {len(old)} entries -> {len(new)}")
            for index, (one, other) in enumerate(zip(old, new, strict=False)):
                label = next(
                    (one[k] for k in ("estimator", "name", "channel") if isinstance(one, dict) and k in one),
                    index,
                )
                self.compare(one, other, f"{path}[{label}]", key)
        elif _number(old) and _number(new):
            if key.endswith(("_ns", "window")) and isinstance(old, int):
                self._within(old, new, 1e6 * self._at(path), path)
            elif isinstance(old, int) and isinstance(new, int):
                self._within(old, new, 0.0, path)
            else:
                self._within(old, new, self._at(path) * (max(abs(old), abs(new)) + SMALL), path)
        elif old != new:
            self.differences.append(f"{path}: {old!r} -> {new!r}")

    def _dictionaries(self, old: dict[str, Any], new: dict[str, Any], path: str) -> None:
        self.added += [f"{path}/{name}" for name in new if name not in old]
        std = old.get("std")
        scaled = _number(old.get("value")) and _number(std) and std > 0.0
        for name, one in old.items():
            where = f"{path}/{name}"
            if name not in new:
                self.differences.append(f"{where}: missing")
            elif scaled and name in ("value", "std", "ci95") and _numbers(one) and _numbers(new[name]):
                for a, b in zip(_list(one), _list(new[name]), strict=True):
                    self._within(
                        a,
                        b,
                        self._at(where) * std + 1e-12 * abs(a),
                        where,
                        f" standard errors of {std:.3g}",
                        std,
                    )
            else:
                self.compare(one, new[name], where, name)

    def _at(self, path: str) -> float:
        return max(
            [self.tolerance, *(limit for pattern, limit in self.permitted if re.search(pattern, path))]
        )

    def _within(
        self, old: float, new: float, limit: float, path: str, unit: str = "", scale: float = 1.0
    ) -> None:
        distance = abs(new - old)
        if limit:
            self.largest = max(self.largest, distance / limit)
        if not distance <= limit:
            self.differences.append(f"{path}: {old!r} -> {new!r}, by {distance / scale:.3g}{unit}")


def _number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _numbers(value: Any) -> bool:
    return all(_number(one) for one in _list(value))


def _tolerance(name: str, old: Any, asked: float) -> float:
    free = '"steer_coulomb_friction":{"value"' in json.dumps(old, separators=(",", ":"))
    return max(
        asked, FRICTION_TOLERANCE if free else 0.0, REPORT_TOLERANCE if name.startswith("report/") else 0.0
    )


def _permission(text: str) -> tuple[str, float]:
    pattern, _, limit = text.rpartition("=")
    return pattern, float(limit)


def main() -> int:
    """Compare the chosen cases and print a table; returns the exit code."""
    declared = parser("Compare the answers of the command line with the recorded ones.")
    declared.add_argument(
        "--tolerance",
        type=float,
        default=1e-6,
        help="in standard errors, else a fraction (default %(default)s)",
    )
    declared.add_argument("--permit", action="append", default=[], type=_permission, metavar="REGEX=TOLERANCE",
                          help="tolerance where a path matches, e.g. kalman_rts=0.1; may be repeated")  # fmt: skip
    declared.add_argument(
        "--show", type=int, default=6, help="differences shown of each case (default %(default)s)"
    )
    declared.add_argument("--texts", action="store_true", help="show changed texts")
    options = declared.parse_args()
    options.runs = options.runs.resolve()
    counts: Counter[str] = Counter()
    slow: list[tuple[float, str]] = []
    added: set[str] = set()
    unrecorded = {name for name in cases() if not path_of(name, options).exists()}
    counts["not recorded"] = len([name for name in unrecorded if chosen(name, options)])
    for name, new, seconds in answers(options, unrecorded):
        old = json.loads(path_of(name, options).read_text())
        found = Comparison(_tolerance(name, old, options.tolerance), options.permit)
        found.compare(old, new)
        slow.append((seconds, name))
        counts["differ" if found.differences else "same"] += 1
        counts["with changed texts"] += bool(found.texts)
        counts["with added keys"] += bool(found.added)
        added |= {re.sub(r"\[.*?\]", "[]", path) for path in found.added}
        _show(name, found, options, old, new)
    if added:
        print("\nadded keys:", *sorted(added)[: 5 * options.show])
    print(
        ", ".join(f"{count} {state}" for state, count in counts.items()),
        "| slowest:",
        *(f"{n} {s:.0f} s" for s, n in sorted(slow)[-3:]),
    )
    return 3 if counts["differ"] else 0


def _show(name: str, found: Comparison, options: argparse.Namespace, old: Any, new: Any) -> None:
    if found.differences or (found.texts and options.texts):
        print(f"\n{name}: {len(found.differences)} differences (largest {found.largest:.3g} tolerances), {len(found.texts)} texts,"
              f" {len(found.added)} added")  # fmt: skip
        lines = found.differences[: options.show]
        if found.differences and old.get("exit") != new.get("exit"):
            lines.append(new.get("errors", "")[-600:])
        print(
            *(f"    {line}" for line in lines + (found.texts[: options.show] if options.texts else [])),
            sep="\n",
        )


if __name__ == "__main__":
    sys.exit(main())
