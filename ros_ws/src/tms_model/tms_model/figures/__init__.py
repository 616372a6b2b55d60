"""Figures of a bicycle: `tms model plot NAME --figure KIND -o FILE`.

A new kind is one file with a function from a bicycle to a figure, and one line in `FIGURES`.
"""

from __future__ import annotations

from collections.abc import Callable

from matplotlib.figure import Figure

from tms_model.bicycle import Bicycle
from tms_model.figures.drawing import drawing_figure
from tms_model.figures.eigenvalues import eigenvalue_figure
from tms_model.supplement.capsize_regions_figure import capsize_regions_figure
from tms_model.supplement.coefficients_figure import coefficients_figure
from tms_model.supplement.front_mass_figure import front_mass_figure
from tms_model.supplement.torque_step_figure import torque_step_figure

__all__ = ["FIGURES"]

FIGURES: dict[str, Callable[[Bicycle], Figure]] = {
    "capsize-regions": capsize_regions_figure,  # SOM Figure 5.2
    "coefficients": coefficients_figure,  # SOM Figures 7.2b and 7.5b
    "drawing": drawing_figure,  # SOM Figure 7.4, in the manner of JBike6
    "eigenvalues": eigenvalue_figure,  # SOM Figures 3A, 7.2a and 7.5a, with the drawing
    "front-mass": front_mass_figure,  # SOM Figure 7.3
    "torque-step": torque_step_figure,  # SOM Figure 5.1
}
