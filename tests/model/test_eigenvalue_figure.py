"""The figure of eigenvalues and bicycle shows what the model says, and no text covers another."""

from __future__ import annotations

from functools import cache
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Rectangle
from tms_model import Bicycle, bicycle_names, eigenvalues, load_bicycle, stability
from tms_model.figures.drawing import drawing_figure
from tms_model.figures.eigenvalues import eigenvalue_figure

KINDS = ("tms_eq_10_1", "counterexample_7_rear_steering")

NAMES = bicycle_names()


@cache
def parts(name: str) -> tuple[Bicycle, Figure, Axes, Axes]:
    figure = eigenvalue_figure(load_bicycle(name))
    left, right = figure.axes
    return load_bicycle(name), figure, left, right


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.quick_for(name=KINDS)
def test_every_eigenvalue_is_drawn_at_every_speed(name: str) -> None:
    bicycle, _, left, _ = parts(name)
    curves = [line for line in left.lines if len(line.get_xdata()) > 100]
    solid = [np.asarray(line.get_ydata(), dtype=float) for line in curves if line.get_linestyle() == "-"]
    speeds = np.asarray(curves[0].get_xdata(), dtype=float)
    for place in range(0, len(speeds), 97):
        drawn = [values[place] for values in solid if np.isfinite(values[place])]
        for real in eigenvalues(bicycle, float(speeds[place])).real:
            assert min(abs(value - real) for value in drawn) < 1e-6 * (1.0 + abs(real)), (place, real)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.quick_for(name=KINDS)
def test_stable_ranges_are_shaded_and_weave_and_capsize_marked(name: str) -> None:
    bicycle, _, left, _ = parts(name)
    answer, highest = stability(bicycle), left.get_xlim()[1]
    # A span is a Rectangle or, before matplotlib 3.9, a Polygon; its bounding box is the same.
    spans = [patch for patch in left.patches if isinstance(patch, Rectangle | Polygon)]
    boxes = [(span.get_path().get_extents(span.get_patch_transform())) for span in spans]
    found = [(float(box.x0), float(box.x1)) for box in boxes]
    expected = [(low, min(high, highest)) for low, high in answer.stable_speed_ranges if low < highest]
    np.testing.assert_allclose(np.array(found).reshape(-1, 2), np.array(expected).reshape(-1, 2), rtol=1e-12)
    texts = [text.get_text() for text in left.texts]
    for mode, speed in (("weave", answer.weave_speed), ("capsize", answer.capsize_speed)):
        shown = speed is not None and speed < highest
        assert (f"{mode} {speed or 0.0:.2f} m/s" in texts) == shown


def test_modes_are_named_in_the_legend() -> None:
    _, figure, _, _ = parts("benchmark")
    (legend,) = figure.legends
    named = [text.get_text() for text in legend.get_texts()]
    assert {"weave", "capsize", "castering", "imaginary part", "self-stable", "steer axis"} <= set(named)
    assert len(named) == len(set(named))


def test_the_benchmark_is_drawn_to_scale() -> None:
    _, _, _, right = parts("benchmark")
    assert right.get_aspect() == 1.0
    circles = [(*patch.center, patch.radius) for patch in right.patches if type(patch) is Circle]
    assert (0.0, 0.3, 0.3) in circles
    assert (1.02, 0.35, 0.35) in circles
    centres = [circle[:2] for circle in circles]
    assert (0.3, 0.9) in centres  # rear frame and rider
    assert (0.9, 0.7) in centres  # front frame
    assert sorted(text.get_text() for text in right.texts) == ["B 85 kg", "F 3 kg", "H 4 kg", "R 2 kg"]
    axis = next(line for line in right.lines if line.get_label() == "steer axis")
    (x0, x1), (z0, z1) = axis.get_xdata(), axis.get_ydata()
    # The axis meets the ground 80 mm in front of the front contact and leans back by 18 degrees.
    assert x0 + (x1 - x0) * (0.0 - z0) / (z1 - z0) == pytest.approx(1.10, rel=1e-12)
    assert (x0 - x1) / (z1 - z0) == pytest.approx(np.tan(np.pi / 10.0), rel=1e-12)


def test_massless_wheels_have_no_mass_and_given_matrices_have_no_bodies() -> None:
    _, _, _, skate = parts("tms_table_8_1")
    assert sorted(text.get_text() for text in skate.texts) == ["B 6.425 kg", "H 2.412 kg"]
    _, _, _, given = parts("tms_eq_10_1")
    assert len(given.patches) == 0
    assert "masses and\ntheir places are not given" in given.texts[0].get_text()


def boxes(figure: Figure, texts: list[Any]) -> list[Any]:
    figure.draw_without_rendering()
    return [text.get_window_extent() for text in texts]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.quick_for(name=KINDS)
def test_no_text_covers_another_or_leaves_its_picture(name: str) -> None:
    for figure in (parts(name)[1], drawing_figure(load_bicycle(name))):
        for axes in figure.axes:
            labels = [axes.xaxis.label, axes.yaxis.label, axes.title]
            found = boxes(figure, [*axes.texts, *labels])
            for one, other in combinations(found, 2):
                assert not one.overlaps(other)
            for box in found[: len(axes.texts)]:
                assert axes.bbox.x0 <= box.x0
                assert box.x1 <= axes.bbox.x1
            legend = figure.legends[0].get_window_extent()
            for box in found:
                assert not legend.overlaps(box)
                assert figure.bbox.x0 <= box.x0
                assert box.x1 <= figure.bbox.x1
                assert box.y1 <= figure.bbox.y1


def test_kinds_of_figures_by_name(command: Any, refused: Any, tmp_path: Path) -> None:
    path = tmp_path / "bicycle.svg"
    assert command("tms_model", "plot", "benchmark", "--figure", "drawing", "-o", path).code == 0
    assert path.read_text().startswith("<?xml")
    said = refused("tms_model", "plot", "benchmark", "--figure", "portrait", "-o", tmp_path / "other.svg")
    assert "expected one of capsize-regions, " in said
    assert "drawing, eigenvalues" in said
    assert list(tmp_path.iterdir()) == [path]
