"""Figures: every kind for every bicycle that has it, and what they show is what is computed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from tms_model import ParameterError, bicycle_names, load_bicycle, stability
from tms_model.figures import FIGURES
from tms_model.figures.saving import save_figure

KINDS = ("benchmark", "tms_eq_10_1")  # by parameters, and by matrices alone


@pytest.mark.parametrize("name", bicycle_names())
@pytest.mark.parametrize("kind", FIGURES)
@pytest.mark.quick_for(name=KINDS)
def test_every_figure_is_drawn_or_refused_in_words(kind: str, name: str, tmp_path: Path) -> None:
    bicycle = load_bicycle(name)
    try:
        figure = FIGURES[kind](bicycle)
    except ParameterError as error:
        assert name in str(error)  # noqa: PT017
        assert "expected" in str(error)  # noqa: PT017
        return
    save_figure(figure, tmp_path / "figure.svg")
    assert (tmp_path / "figure.svg").read_text().count("<path") > 5


def lines(figure: Figure) -> list[np.ndarray]:
    return [np.asarray(line.get_xydata()) for axes in figure.axes for line in axes.lines]


def test_figure_5_1_has_its_torque_and_its_dip() -> None:
    figure = FIGURES["torque-step"](load_bicycle("benchmark"))
    title = figure.findobj(lambda artist: "turn right" in getattr(artist, "get_text", str)())
    assert "0.13 N m to the left turn right, after 2.0 cm to the left" in title[0].get_text()
    torque = [line for line in lines(figure) if line[:, 1].min() == pytest.approx(-0.13, abs=1e-6)]
    assert len(torque) == 1


def test_figure_5_2_crosses_at_the_capsize_speed() -> None:
    figure = FIGURES["capsize-regions"](load_bicycle("benchmark"))
    labels = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert "E = 0 at 6.024 m/s" in labels
    (square,) = (line.get_xydata()[0] for line in figure.axes[0].lines if line.get_marker() == "s")
    assert square[0] + square[1] == pytest.approx(0.0, abs=1e-6)  # on the line E = 0


@pytest.mark.parametrize("name", ["tms_table_7_1", "tms_table_7_2"])
def test_bars_of_figures_7_2_and_7_5(name: str) -> None:
    # All positive from the onset on; X is the last to become so, C before it, the others always are.
    figure = FIGURES["coefficients"](load_bicycle(name))
    bars = {}
    for bar in figure.axes[0].patches:
        if bar.get_facecolor()[:3] == pytest.approx((0.0, 0x9E / 255, 0x73 / 255)) and bar.get_y() > -1.0:
            bars[round(bar.get_y() + bar.get_height() / 2)] = (bar.get_x(), bar.get_x() + bar.get_width())
    assert set(bars) == set(range(6))
    assert bars[5] == (pytest.approx(stability(load_bicycle(name)).weave_speed), pytest.approx(10.0))
    assert 0.0 < bars[2][0] < bars[5][0]
    assert all(bars[row] == (0.0, pytest.approx(10.0)) for row in (0, 1, 3, 4))
