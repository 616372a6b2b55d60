"""The experimental two-mass-skate bicycle beyond its parameters: mass budget and how little gyroscopic it is.

Reference: Kooijman et al. 2011, supplement (SOM), table 8.2 and Eqs. (9.1)-(9.2), doi
10.1126/science.1201959.
"""

from __future__ import annotations

from tms_model.bicycle import Bicycle
from tms_model.errors import ParameterError

MASS_BUDGET_GRAMS: dict[str, dict[str, int]] = {  # table 8.2 [g]
    "wheel set": {"rotating": 174, "counter rotating": 168},
    "rear frame": {
        "point mass at front": 2197,
        "point mass at rear contact point": 2013,
        "supporting construction": 1873,
        "wheels": 342,
    },
    "front frame": {"point mass": 1452, "supporting construction": 618, "wheels": 342},
}
PRINTED_TOTALS_GRAMS = {"wheel set": 342, "rear frame": 6425, "front frame": 2412, "total bicycle": 8837}


def totals_grams() -> dict[str, int]:
    """Sums of the parts of table 8.2 [g], by the names of `PRINTED_TOTALS_GRAMS`."""
    sums = {name: sum(parts.values()) for name, parts in MASS_BUDGET_GRAMS.items()}
    return {**sums, "total bicycle": sums["rear frame"] + sums["front frame"]}


def angular_momentum_ratio(spin_inertia: float, radius: float, mass: float, height: float) -> float:
    """C_ang (9.1): a wheel's spin angular momentum J v / r, by mass, speed and height of the bicycle.

    spin_inertia J [kg m^2], radius r of the wheel [m], mass m [kg] and height h [m] of the bicycle: J / (r m
    h). The last step of (9.2) as printed, J v / (r m h r), has lost the bicycle's speed and has one r too
    many; it isn't a pure number.
    """
    return spin_inertia / radius / (mass * height)


def angular_momentum_ratio_of(bicycle: Bicycle) -> float:
    """C_ang of a bicycle's front wheel, with the height of the centre of mass for h: S_F / |m_T z_T|.

    Raises ParameterError for a bicycle that is given by matrices only.
    """
    if bicycle.parameters is None:
        raise ParameterError(f"bicycle {bicycle.name}: expected parameters, found matrices only")
    return bicycle.parameters.front_spin / abs(float(bicycle.stiffness0[0, 0]))
