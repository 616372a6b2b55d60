"""Figures of a bicycle: `tms model plot NAME --figure KIND -o FILE`.

A new kind is one file with a function from a bicycle to a figure, and one line in `FIGURES`.
"""

from __future__ import annotations

from collections.abc import Callable

from matplotlib.figure import Figure

from tms_model.bicycle import Bicycle
from tms_model.figures.capsize_regions import capsize_regions_figure
from tms_model.figures.coefficients import coefficients_figure
from tms_model.figures.drawing import drawing_figure
from tms_model.figures.eigenvalues import eigenvalue_figure
from tms_model.figures.front_mass import front_mass_figure
from tms_model.figures.torque_step import torque_step_figure

__all__ = ["FIGURES"]

FIGURES: dict[str, Callable[[Bicycle], Figure]] = {
    "capsize-regions": capsize_regions_figure,  # SOM Figure 5.2
    "coefficients": coefficients_figure,  # SOM Figures 7.2b and 7.5b
    "drawing": drawing_figure,  # SOM Figure 7.4, in the manner of JBike6
    "eigenvalues": eigenvalue_figure,  # SOM Figures 3A, 7.2a and 7.5a, with the drawing
    "front-mass": front_mass_figure,  # SOM Figure 7.3
    "torque-step": torque_step_figure,  # SOM Figure 5.1
}
