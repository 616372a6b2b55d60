"""Whether bodies with the given masses and inertias can exist: what the parameters' own checks leave open.

A frame's inertias must obey the triangle inequality, I_1 <= I_2 + I_3 in any order, along its principal axes:
two of these lie in the plane of symmetry, turned by the xz product, the third is y. Wheels are not asked:
their spin inertia is an effective one, with gears and counter-rotating flywheels in it, and may have either
sign.

Published bicycles break it: swinging a bicycle as a pendulum gives I_yy with an error of its own. As long as
their centre of mass and their in-plane inertias can exist, the linear equations, which don't contain I_yy,
don't suffer. So files of BicycleParameters are read as they are, and `objections` says what is wrong with
them.
"""

from __future__ import annotations

import math

from tms_model.errors import ParameterError
from tms_model.parameters import WhippleParameters

FRAMES = ("rear_frame", "front_frame")
ROUNDING = 1e-9  # share of the inertias that printing and parallel axes may have taken


def objections(parameters: WhippleParameters) -> tuple[str, ...]:
    """One line for each parameter that no body can have; none for an unknown inertia about y."""
    found = []
    for frame in FRAMES:
        xx, xz, yy, zz = (getattr(parameters, f"{frame}_inertia_{axes}") for axes in ("xx", "xz", "yy", "zz"))
        total, difference = xx + zz, 2.0 * math.hypot(xz, (xx - zz) / 2.0)
        slack = ROUNDING * total
        if yy > total + slack:
            found.append(
                f"{frame}_inertia_yy: expected no more than {frame}_inertia_xx + {frame}_inertia_zz ="
                f" {total:g}, found {yy:g}; no body has more about one axis than about the two others"
            )
        if yy < difference - slack:
            found.append(
                f"{frame}_inertia_yy: expected {difference:g} or more, the difference of the principal"
                f" inertias in the xz plane, found {yy:g}; leave it out if it isn't known"
            )
        if getattr(parameters, f"{frame}_mass") == 0.0 and max(xx, zz) > 0.0:
            found.append(f"{frame}_mass: expected a positive mass for a frame with inertia, found 0")
    return tuple(found)


def check_physical(parameters: WhippleParameters, before: WhippleParameters | None = None) -> None:
    """Raise ParameterError with the first of the objections; those that `before` had already don't count."""
    known = {line.partition(":")[0] for line in objections(before)} if before is not None else set()
    for line in objections(parameters):
        if line.partition(":")[0] not in known:
            raise ParameterError(line)
