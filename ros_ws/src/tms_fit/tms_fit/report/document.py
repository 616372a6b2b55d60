"""The report as one HTML file that needs no network: page, style, script, plotting library and data."""

from __future__ import annotations

import base64
import hashlib
import json
import sys
from functools import cache
from importlib.resources import files
from string import Template
from typing import Any

import vl_convert
from tqdm import tqdm

from tms_fit.comparison import source_of
from tms_fit.recording_fit import RecordingFit
from tms_fit.report.chart import CONFIG, Chart, Spec
from tms_fit.report.element import Element, element, markup, plain
from tms_fit.report.overview import overview
from tms_fit.report.provenance import provenance
from tms_fit.report.section import Section
from tms_fit.report.strike_section import strike_section
from tms_fit.report.timeline import timeline

SNIPPET = "window.vegaEmbed = vegaEmbed;"


def sections(fit: RecordingFit) -> list[Section]:
    """Overview, recording and strikes, in reading order."""
    strikes = tqdm(
        range(len(fit.strikes)),
        desc="report",
        unit=" strikes",
        leave=False,
        disable=not sys.stderr.isatty(),
    )
    return [overview(fit), timeline(fit), *(strike_section(fit, index) for index in strikes)]


def report_html(fit: RecordingFit, parts: list[Section]) -> str:
    """The whole file."""
    templates = files("tms_fit.report") / "templates"
    style, script, page = (
        (templates / name).read_text(encoding="utf-8") for name in ("style.css", "report.js", "page.html")
    )
    library = _library()
    specs: list[Spec] = []
    body = [_header(fit), _contents(parts), *(_section(part, specs) for part in parts)]
    data = {
        "config": CONFIG,
        "specs": specs,
        "data": {part.name: part.data for part in parts},
        "motions": {part.name: part.motions for part in parts if part.motions},
    }
    return Template(page).substitute(
        title=markup(
            element("title", f"{fit.recording.path.name}: {source_of(fit)} run of {fit.bicycle.name}")
        ),
        policy=_policy(style, library, script),
        style=style,
        body="\n".join(markup(node) for node in body),
        data=_json(data),
        library=library,
        script=script,
    )


@cache
def _library() -> str:
    """Vega, Vega-Lite and Vega-Embed; bundling them takes a second."""
    return _inert(vl_convert.javascript_bundle(SNIPPET))


def _policy(style: str, *scripts: str) -> str:
    """Nothing runs and nothing is shown but what this file holds: its style and scripts by their hashes."""
    hashes = " ".join(_hash(script) for script in scripts)
    allowed = f"script-src {hashes}; style-src {_hash(style)}"
    return f"default-src 'none'; {allowed}; base-uri 'none'; form-action 'none'"


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def _inert(script: str) -> str:
    """A script whose own strings do not end the element that holds it."""
    return script.replace("\r\n", "\n").replace("</script", "<\\/script").replace("<!--", "<\\!--")


def _json(value: Any) -> str:
    """JSON inside a script element: no '<' can end it."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def _header(fit: RecordingFit) -> Element:
    rows = []
    for name, value in provenance(fit):
        rows += [element("dt", name), element("dd", value)]
    simulated = source_of(fit) == "simulated"
    return element(
        "header",
        element("h1", fit.recording.path.name),
        element(
            "p",
            "This run is simulated. Nothing in it was measured on a bicycle."
            if simulated
            else "A measured run.",
            class_="source simulated" if simulated else "source",
        ),
        element("details", element("summary", "What this report rests on"), element("dl", *rows), open=""),
    )


def _contents(parts: list[Section]) -> Element:
    links = [element("li", element("a", part.title, href=f"#{part.name}")) for part in parts]
    return element("nav", element("ul", *links), aria_label="sections")


def _section(part: Section, specs: list[Spec]) -> Element:
    return element(
        "section",
        element("h2", part.title),
        *part.words,
        *(_figure(part, chart, specs) for chart in part.charts),
        *part.tables,
        id=part.name,
        class_="part",
    )


def _figure(part: Section, chart: Chart, specs: list[Spec]) -> Element:
    plots = []
    for spec in chart.panels:
        if spec not in specs:
            specs.append(spec)
        plots.append(
            element(
                "div",
                class_="plot",
                data_spec=str(specs.index(spec)),
                data_section=part.name,
                data_height=str(spec["height"]),
                role="img",
                aria_label=chart.alternative,
            )
        )
    return element(
        "figure",
        element("h3", chart.title),
        *plots,
        element("figcaption", plain(chart.caption)),
        class_=f"chart {chart.name}",
    )
