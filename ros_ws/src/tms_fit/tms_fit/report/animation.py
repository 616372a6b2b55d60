"""The animated bicycle: seen from behind and from above, at the time of the section's cursor."""

from __future__ import annotations

from tms_fit.comparison import SHOWN_BEFORE_S, Comparison
from tms_fit.report.element import Element, element


def animation(section: str, both: Comparison, with_truth: bool) -> Element:
    """The drawing's places; the page's script draws in them and moves them with slider, plots and keys."""
    last = float(both.time[-1])
    slider = element(
        "input",
        type="range",
        min=f"{-SHOWN_BEFORE_S:g}",
        max=f"{last:.3f}",
        step="0.01",
        value="0",
        class_="time",
        id=f"{section}-time",
    )
    bicycle = both.used.bicycle
    wheelbase = bicycle.wheelbase if bicycle else 1.0
    return element(
        "section",
        element(
            "div",
            _view("behind", "from behind: lean"),
            _view("above", "from above: steer"),
            _view("path", "path of the rear wheel on the floor"),
            class_="views",
        ),
        element(
            "div",
            element("button", "Play", type="button", class_="play"),
            element("label", "time", for_=f"{section}-time"),
            slider,
            element("output", "", class_="readout"),
            class_="controls",
        ),
        element(
            "p",
            "Blue: predicted from the estimate."
            + (" Orange, dashed: the true motion." if with_truth else "")
            + " Move the time with the slider, the arrow keys, or by pointing at a plot.",
            class_="hint",
        ),
        class_="animation",
        data_section=section,
        data_wheelbase=f"{wheelbase:.6g}",
    )


def _view(name: str, words: str) -> Element:
    return element(
        "figure",
        element("div", class_=f"view {name}", role="img", aria_label=f"bicycle {words}"),
        element("figcaption", words),
    )
