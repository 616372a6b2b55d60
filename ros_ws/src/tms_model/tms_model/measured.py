"""A number with its standard deviation, as it is written in parameter files: 0.0686+/-0.0017.

The form is that of the Python package uncertainties: `value+/-deviation`, and `(1.80+/-0.02)e-05` when both
have an exponent.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from tms_model.errors import ParameterError

_DIGITS = r"[-+]?(?:\d+\.?\d*|\.\d+)"
_EXPONENT = r"[eE][-+]?\d+"
_PLAIN = re.compile(
    rf"(?P<value>{_DIGITS}(?:{_EXPONENT})?)(?:\s*(?:\+/-|\u00b1)\s*(?P<deviation>{_DIGITS}(?:{_EXPONENT})?))?"
)
_BRACKETS = re.compile(
    rf"\(\s*(?P<value>{_DIGITS})\s*(?:\+/-|\u00b1)\s*(?P<deviation>{_DIGITS})\s*\)(?P<exponent>{_EXPONENT})?"
)


@dataclass(frozen=True)
class Measured:
    """A number and its standard deviation, 0 when none is stated."""

    value: float
    deviation: float = 0.0


def parse(text: str, where: str) -> Measured:
    """Read a number, or the mean of several with commas between them, taken for independent.

    Raises ParameterError for anything else, a number that is not finite, or a negative standard deviation.
    """
    parts = [_parse_one(part.strip(), where) for part in text.split(",")]
    value = math.fsum(part.value for part in parts) / len(parts)
    return Measured(value, math.hypot(*(part.deviation for part in parts)) / len(parts))


def _parse_one(text: str, where: str) -> Measured:
    found = _PLAIN.fullmatch(text) or _BRACKETS.fullmatch(text)
    if not found:
        raise ParameterError(f"{where}: expected a number such as 0.08 or 0.08+/-0.01, found {text!r}")
    groups = found.groupdict()
    exponent = groups.get("exponent") or ""
    value, deviation = (float((groups[name] or "0") + exponent) for name in ("value", "deviation"))
    if not (math.isfinite(value) and math.isfinite(deviation) and deviation >= 0.0):
        raise ParameterError(
            f"{where}: expected a finite number and a standard deviation of zero or more, found {text!r}"
        )
    return Measured(value, deviation)
