"""A part of the page."""

from __future__ import annotations

from dataclasses import dataclass, field

from tms_fit.report.chart import Chart, Columns
from tms_fit.report.element import Element


@dataclass(frozen=True)
class Section:
    """A part of the page with its charts and their data."""

    name: str  # of its anchor, such as strike-1
    title: str
    words: tuple[Element, ...]  # above the charts
    charts: tuple[Chart, ...] = ()
    tables: tuple[Element, ...] = ()  # below the charts
    data: dict[str, Columns] = field(default_factory=dict)
    motions: dict[str, Columns] = field(default_factory=dict)  # of the animation, predicted and true
