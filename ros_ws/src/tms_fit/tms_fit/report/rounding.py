"""Numbers for people: as many digits as their uncertainty lets mean something."""

from __future__ import annotations

import math
import re

from tms_fit.report.element import Element, element

MINUS = "\u2212"
NONE = "\u2013"
MOST_DECIMALS = 9


def decimals(std: float) -> int:
    """Decimals that show two significant digits of a standard error; 4 where there is none."""
    if not (math.isfinite(std) and std > 0.0):
        return 4
    shown = 1 - math.floor(math.log10(std))
    if round(std, shown) >= 10.0 ** (2 - shown):  # 0.0996 is 0.10
        shown -= 1
    return min(max(shown, 0), MOST_DECIMALS)


def fixed(value: float, places: int) -> str:
    """A number with so many decimals and a proper minus; a dash for none."""
    if not math.isfinite(value):
        return NONE
    text = f"{value:.{places}f}"
    if float(text) == 0.0:
        text = text.lstrip("-")
    return text.replace("-", MINUS)


def significant(value: float, digits: int = 3) -> str:
    """A number with so many significant digits, for figures without an uncertainty."""
    if not math.isfinite(value):
        return NONE
    return f"{value:.{digits}g}".replace("-", MINUS)


def typeset(text: str) -> str:
    """A text of the terminal as it is printed: proper minus and plus-minus signs."""
    return re.sub(r"(?<![\w.])-(?=\d)", MINUS, text.replace("+-", "\u00b1"))


def as_sentence(text: str) -> str:
    """A clause as a sentence: a capital first, a full stop last."""
    return f"{text[:1].upper()}{typeset(text[1:])}."


def number(value: float, places: int) -> Element:
    """The rounded number; the unrounded one, as `fit run --json` gives it, is its machine-readable value."""
    return element("data", fixed(value, places), value=repr(float(value)))
