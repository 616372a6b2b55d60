"""The parameters of the Whipple bicycle; speed, which belongs to a run, is not among them.

Reference: J. P. Meijaard, J. M. Papadopoulos, A. Ruina and A. L. Schwab, "Linearized dynamics equations for
the balance and steer of a bicycle: a benchmark and review", Proc. R. Soc. A 463 (2007), doi
10.1098/rspa.2007.1857.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields

from tms_model.errors import ParameterError


@dataclass(frozen=True)
class WhippleParameters:
    """Geometry and mass of a bicycle in its upright reference position.

    Model axes (SAE): origin at the rear wheel contact, x forward, y right, z down, so points above the ground
    have negative z. Inertias are about the body's centre of mass. Zero masses, radii and inertias are legal,
    and so are trail, tilt and spin of either sign. NaN says that an inertia about y isn't known, which the
    linear equations don't ask for. Raises ParameterError for another value that is not finite, a wheelbase or
    gravity that is not positive, a mass, radius or inertia that is negative, a mass below the ground, a
    product of inertia that no body has, or a spin inertia on a wheel of zero radius. See also
    `tms_model.physical`.
    """

    wheelbase: float  # w [m], between the wheel contacts
    trail: float  # c [m], positive when the front contact is behind the steer axis
    steer_axis_tilt: float  # lambda_s [rad], 90 deg minus head angle
    gravity: float  # g [m/s^2]
    rear_wheel_radius: float  # r_R [m]
    rear_wheel_mass: float  # m_R [kg]
    rear_wheel_inertia_xx: float  # I_Rxx [kg m^2], about a diameter
    rear_wheel_inertia_yy: (
        float  # I_Ryy [kg m^2], spin; negative: a counter-rotating flywheel outweighs the wheel
    )
    rear_frame_x: float  # x_B [m], centre of mass of rear frame and rigid rider
    rear_frame_z: float  # z_B [m]
    rear_frame_mass: float  # m_B [kg]
    rear_frame_inertia_xx: float  # I_Bxx [kg m^2]
    rear_frame_inertia_xz: float  # I_Bxz [kg m^2]
    rear_frame_inertia_yy: float  # I_Byy [kg m^2], not in the linear equations; NaN: not known
    rear_frame_inertia_zz: float  # I_Bzz [kg m^2]
    front_frame_x: float  # x_H [m], centre of mass of fork and handlebar
    front_frame_z: float  # z_H [m]
    front_frame_mass: float  # m_H [kg]
    front_frame_inertia_xx: float  # I_Hxx [kg m^2]
    front_frame_inertia_xz: float  # I_Hxz [kg m^2]
    front_frame_inertia_yy: float  # I_Hyy [kg m^2], not in the linear equations; NaN: not known
    front_frame_inertia_zz: float  # I_Hzz [kg m^2]
    front_wheel_radius: float  # r_F [m]
    front_wheel_mass: float  # m_F [kg]
    front_wheel_inertia_xx: float  # I_Fxx [kg m^2], about a diameter
    front_wheel_inertia_yy: float  # I_Fyy [kg m^2], spin

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if not math.isfinite(value) and not (name in MAY_BE_UNKNOWN and math.isnan(value)):
                raise ParameterError(f"{name}: expected a finite number, found {value}")
        for name in ("wheelbase", "gravity"):
            if getattr(self, name) <= 0.0:
                raise ParameterError(f"{name}: expected a positive number, found {getattr(self, name)}")
        for name in _NOT_NEGATIVE:
            if getattr(self, name) < 0.0:
                raise ParameterError(f"{name}: expected zero or more, found {getattr(self, name)}")
        for frame in ("rear_frame", "front_frame"):
            self._check_frame(frame)
        if abs(self.steer_axis_tilt) >= math.pi / 2:
            raise ParameterError(
                "steer_axis_tilt: expected less than 90 deg either way, found"
                f" {math.degrees(self.steer_axis_tilt):g} deg"
            )
        for wheel in ("rear_wheel", "front_wheel"):
            if getattr(self, f"{wheel}_inertia_yy") != 0.0 and getattr(self, f"{wheel}_radius") == 0.0:
                raise ParameterError(
                    f"{wheel}_radius: expected a positive radius, found 0 with {wheel}_inertia_yy"
                    f" {getattr(self, f'{wheel}_inertia_yy')}; a wheel without radius must be without spin"
                    " inertia"
                )

    def _check_frame(self, frame: str) -> None:
        height, xx, xz, zz = (getattr(self, f"{frame}_{key}") for key in ("z", *_IN_PLANE))
        if height > 0.0:
            raise ParameterError(
                f"{frame}_z: expected zero or less, for z points down and no mass is below the ground,"
                f" found {height}"
            )
        if xz**2 > xx * zz * (1.0 + 1e-9):
            raise ParameterError(
                f"{frame}_inertia_xz: expected no more than {math.sqrt(xx * zz):g} either way, the root of"
                f" {frame}_inertia_xx times {frame}_inertia_zz, found {xz}; a principal inertia would be"
                " negative"
            )

    @property
    def rear_spin(self) -> float:
        """Spin angular momentum of the rear wheel per unit speed, S_R = I_Ryy / r_R [kg m]."""
        return self.rear_wheel_inertia_yy / self.rear_wheel_radius if self.rear_wheel_inertia_yy else 0.0

    @property
    def front_spin(self) -> float:
        """Spin angular momentum of the front wheel per unit speed, S_F = I_Fyy / r_F [kg m]."""
        return self.front_wheel_inertia_yy / self.front_wheel_radius if self.front_wheel_inertia_yy else 0.0


MAY_BE_UNKNOWN = ("rear_frame_inertia_yy", "front_frame_inertia_yy")  # NaN then
_IN_PLANE = ("inertia_xx", "inertia_xz", "inertia_zz")
_NOT_NEGATIVE = (
    "rear_wheel_radius",
    "rear_wheel_mass",
    "rear_wheel_inertia_xx",
    "rear_frame_mass",
    "rear_frame_inertia_xx",
    "rear_frame_inertia_yy",
    "rear_frame_inertia_zz",
    "front_frame_mass",
    "front_frame_inertia_xx",
    "front_frame_inertia_yy",
    "front_frame_inertia_zz",
    "front_wheel_radius",
    "front_wheel_mass",
    "front_wheel_inertia_xx",
)

PARAMETER_NAMES: tuple[str, ...] = tuple(field.name for field in fields(WhippleParameters))
