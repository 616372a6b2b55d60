"""The report and its figures reach the disk: each file whole or not at all."""

from __future__ import annotations

import copy
import sys
from pathlib import Path
from typing import Any

import vl_convert
from tms_model import ParameterError
from tms_model.atomic_write import atomic_write
from tqdm import tqdm

from tms_fit.recording_fit import RecordingFit
from tms_fit.report.chart import CONFIG, CURSOR, Chart, Columns, Spec
from tms_fit.report.document import report_html, sections
from tms_fit.report.section import Section

WIDTH = 504  # [points] of a figure's panels: 7 in, a page's two columns
PIXELS_PER_INCH = 300


def write_report(fit: RecordingFit, output: Path, figures: Path | None = None) -> None:
    """Write the HTML file, and PNG, SVG and PDF of every figure into the folder `figures`.

    Raises ParameterError for another suffix or a place that can't be written.
    """
    if output.suffix.lower() not in (".html", ".htm"):
        raise ParameterError(f"{output}: expected a name that ends in .html")
    parts = sections(fit)
    atomic_write(output, report_html(fit, parts).encode())
    if figures is not None:
        charts = [(part, chart) for part in parts for chart in part.charts]
        for part, chart in tqdm(
            charts, desc="figures", unit=" figures", leave=False, disable=not sys.stderr.isatty()
        ):
            _write_figure(part, chart, figures)


def _write_figure(part: Section, chart: Chart, folder: Path) -> None:
    svg = vl_convert.vegalite_to_svg(static_spec(chart, part.data))
    path = folder / f"{part.name.replace('-', '_')}_{chart.name}"
    atomic_write(path.with_suffix(".svg"), svg.encode())
    atomic_write(path.with_suffix(".pdf"), vl_convert.svg_to_pdf(svg))
    atomic_write(path.with_suffix(".png"), vl_convert.svg_to_png(svg, ppi=PIXELS_PER_INCH))


def static_spec(chart: Chart, data: dict[str, Columns]) -> Spec:
    """A chart on its own, numbers included, for print."""
    panels = [_sized(spec) for spec in chart.panels]
    whole: Spec = {
        "$schema": "https://vega.github.io/schema/vega-lite/v6.json",
        "config": CONFIG,
        "datasets": {name: rows(data[name]) for name in sorted(_named(panels)) if name in data},
    }
    return {**whole, **panels[0]} if len(panels) == 1 else {**whole, "vconcat": panels, "spacing": 12}


def rows(columns: Columns) -> list[dict[str, Any]]:
    """Columns as the rows that Vega-Lite takes."""
    return [dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)]


def _sized(spec: Spec) -> Spec:
    """A panel of fixed width without a cursor: nobody points at paper."""
    kept = [one for one in spec["layer"] if one.get("transform") != CURSOR]
    other = {key: value for key, value in spec.items() if key not in ("params", "layer", "width")}
    return copy.deepcopy({**other, "width": WIDTH, "layer": kept})


def _named(panels: list[Spec]) -> set[str]:
    return {one["data"]["name"] for spec in panels for one in spec["layer"] if "name" in one["data"]}
