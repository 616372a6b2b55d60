"""A bicycle: the matrices of its linearised equations of motion and the geometry that gives its yaw.

    M q'' + v C1 q' + (g K0 + v^2 K2) q = [T_lean, T_steer],  q = [lean, steer]               (SOM Eq. 3.1)
    yaw rate = (v / w) cos(lambda_s) steer + (c / w) cos(lambda_s) steer rate                 (SOM Eq. 10.2)

References: Kooijman et al. 2011, doi 10.1126/science.1201959, supplement (SOM); Meijaard et al. 2007, doi
10.1098/rspa.2007.1857, appendix A (equation numbers "A n" below).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tms_model.calibrated import Calibrated
from tms_model.errors import ParameterError
from tms_model.parameters import WhippleParameters
from tms_model.steer_elements import SteerElements

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Bicycle:
    """Linearised Whipple bicycle. Matrices are (2, 2), rows and columns [lean, steer], SAE signs.

    Raises ParameterError if M is not symmetric positive definite, or if the first column of K2 is not zero:
    lean alone turns no corner, only gravity acts on it.
    """

    name: str
    mass: Array  # M [kg m^2]
    damping: Array  # C1 [kg m], times speed
    stiffness0: Array  # K0 [kg m], times gravity
    stiffness2: Array  # K2 [kg], times speed squared
    wheelbase: float  # w [m]
    trail: float  # c [m]
    steer_axis_tilt: float  # lambda_s [rad]
    gravity: float  # g [m/s^2]
    parameters: WhippleParameters | None = None  # None: the matrices are given, not assembled
    steer_elements: SteerElements = field(default_factory=SteerElements)  # springs, dampers, feedback
    description: str = ""
    source: str = ""
    uncertainty: str = ""
    standard_deviations: Mapping[str, float] = field(default_factory=dict)  # of parameters, where stated
    calibrated: Calibrated | None = None  # covariance and provenance, of a bicycle made from recordings

    def __post_init__(self) -> None:
        for letter, matrix in self.canonical.items():
            if not np.isfinite(matrix).all():
                raise ParameterError(
                    f"bicycle {self.name}: expected finite matrices, found {letter} {matrix.tolist()};"
                    " some number of the bicycle is too large"
                )
        if (
            not np.allclose(self.mass, self.mass.T, rtol=1e-12, atol=0.0)
            or np.linalg.eigvalsh(self.mass)[0] <= 0.0
        ):
            raise ParameterError(
                f"bicycle {self.name}: expected a symmetric positive definite mass matrix M, found"
                f" {self.mass.tolist()}; {_massless(self.mass)}"
            )
        if self.stiffness2[:, 0].any():
            raise ParameterError(
                f"bicycle {self.name}: expected zeros in the first column of K2, found"
                f" {self.stiffness2.tolist()}; lean alone turns no corner: is the order of rows and"
                " columns lean, steer?"
            )

    def damping_at(self, speed: float | Array) -> Array:
        """Factor of q' in (3.1): v C1 and the steer elements' part [N m s/rad], (2, 2).

        speed: [m/s], or n of them for (n, 2, 2).
        """
        return np.multiply.outer(speed, self.damping) + self.steer_elements.damping

    def stiffness_at(self, speed: float | Array) -> Array:
        """Factor of q in (3.1): g K0 + v^2 K2 and the steer elements' part [N m/rad]; shapes as above."""
        dynamic = np.multiply.outer(speed**2, self.stiffness2)
        return self.gravity * self.stiffness0 + dynamic + self.steer_elements.stiffness

    @property
    def numbers(self) -> dict[str, float]:
        """All numbers that define this bicycle by name, SI units and radians, in a fixed order.

        Steer elements that do something stand at the end. Inertias that aren't known are left out.
        """
        elements = self.steer_elements.acting
        if self.parameters is not None:
            known = {k: value for k, value in asdict(self.parameters).items() if not math.isnan(value)}
            return {**known, **elements}
        numbers = {name: getattr(self, name) for name in ("wheelbase", "trail", "steer_axis_tilt", "gravity")}
        for letter, matrix in self.canonical.items():
            for row, i in enumerate(("lean", "steer")):
                for column, j in enumerate(("lean", "steer")):
                    numbers[f"{letter}_{i}_{j}"] = float(matrix[row, column])
        return {**numbers, **elements}

    @property
    def canonical(self) -> dict[str, Array]:
        """The four matrices under the letters of Eq. (3.1)."""
        return {"M": self.mass, "C1": self.damping, "K0": self.stiffness0, "K2": self.stiffness2}


def _massless(mass: Array) -> str:
    """Which motion moves no mass, and the parameters that may be why."""
    if mass[0, 0] <= 0.0:
        return "leaning moves no mass: check rear_frame_mass, rear_frame_z and rear_frame_inertia_xx"
    if mass[1, 1] <= 0.0:
        return "steering moves no mass: check front_frame_mass, front_frame_x and front_frame_inertia_zz"
    return (
        "some combination of lean and steer moves no mass: check that rear_frame_z and front_frame_z are"
        " above the ground, and the inertias"
    )


def assemble(
    name: str,
    parameters: WhippleParameters,
    *,
    steer_elements: SteerElements | None = None,
    description: str = "",
    source: str = "",
    uncertainty: str = "",
    standard_deviations: Mapping[str, float] | None = None,
) -> Bicycle:
    """Bicycle from its parameters, by the algorithm of Meijaard et al. 2007, appendix A.

    standard_deviations: of some or all parameters by name, in their units.
    """
    tilt = parameters.steer_axis_tilt
    spins = parameters.rear_spin, parameters.front_spin
    mass, damping, stiffness0, stiffness2 = whipple_matrices(
        parameters, math.cos(tilt), math.sin(tilt), *spins
    )
    return Bicycle(
        name=name,
        mass=mass,
        damping=damping,
        stiffness0=stiffness0,
        stiffness2=stiffness2,
        wheelbase=parameters.wheelbase,
        trail=parameters.trail,
        steer_axis_tilt=parameters.steer_axis_tilt,
        gravity=parameters.gravity,
        parameters=parameters,
        steer_elements=steer_elements or SteerElements(),
        description=description,
        source=source,
        uncertainty=uncertainty,
        standard_deviations=dict(standard_deviations or {}),
    )


def whipple_matrices(p: Any, cos: Any, sin: Any, S_R: Any, S_F: Any) -> tuple[Array, Array, Array, Array]:
    """M, C1, K0, K2 in the letters of the paper, (2, 2), or (n, 2, 2) for n parameter sets at once.

    p: WhippleParameters, or whatever has its attributes as arrays (n,) (`tms_model.ensemble`). cos, sin: of
    the steer axis tilt. S_R, S_F: spin angular momenta of the wheels per unit speed [kg m].
    """
    w, c = p.wheelbase, p.trail
    r_R, m_R, I_Rxx = p.rear_wheel_radius, p.rear_wheel_mass, p.rear_wheel_inertia_xx
    x_B, z_B, m_B = p.rear_frame_x, p.rear_frame_z, p.rear_frame_mass
    x_H, z_H, m_H = p.front_frame_x, p.front_frame_z, p.front_frame_mass
    r_F, m_F, I_Fxx = p.front_wheel_radius, p.front_wheel_mass, p.front_wheel_inertia_xx
    I_Bxx, I_Bxz, I_Bzz = p.rear_frame_inertia_xx, p.rear_frame_inertia_xz, p.rear_frame_inertia_zz
    I_Hxx, I_Hxz, I_Hzz = p.front_frame_inertia_xx, p.front_frame_inertia_xz, p.front_frame_inertia_zz

    # Whole bicycle: first moments, then inertia about the rear contact (A 1-A 6).
    mx_T = x_B * m_B + x_H * m_H + w * m_F
    mz_T = -r_R * m_R + z_B * m_B + z_H * m_H - r_F * m_F
    I_Txx = I_Rxx + I_Bxx + I_Hxx + I_Fxx + m_R * r_R**2 + m_B * z_B**2 + m_H * z_H**2 + m_F * r_F**2
    I_Txz = I_Bxz + I_Hxz - m_B * x_B * z_B - m_H * x_H * z_H + m_F * w * r_F
    I_Tzz = I_Rxx + I_Bzz + I_Hzz + I_Fxx + m_B * x_B**2 + m_H * x_H**2 + m_F * w**2

    # Front assembly: centre of mass and inertia about it (A 7-A 12).
    m_A = m_H + m_F
    x_A = _centre(x_H * m_H + w * m_F, m_A, w)
    z_A = _centre(z_H * m_H - r_F * m_F, m_A, 0.0)
    I_Axx = I_Hxx + I_Fxx + m_H * (z_H - z_A) ** 2 + m_F * (r_F + z_A) ** 2
    I_Axz = I_Hxz - m_H * (x_H - x_A) * (z_H - z_A) + m_F * (w - x_A) * (r_F + z_A)
    I_Azz = I_Hzz + I_Fxx + m_H * (x_H - x_A) ** 2 + m_F * (w - x_A) ** 2

    # The same about the steer axis (A 13-A 16).
    u_A = (x_A - w - c) * cos - z_A * sin
    I_All = m_A * u_A**2 + I_Axx * sin**2 + 2.0 * I_Axz * sin * cos + I_Azz * cos**2
    I_Alx = -m_A * u_A * z_A + I_Axx * sin + I_Axz * cos
    I_Alz = m_A * u_A * x_A + I_Axz * sin + I_Azz * cos

    mu = c / w * cos  # (A 17)
    S_T = S_R + S_F  # (A 18)
    S_A = m_A * u_A + mu * mx_T  # (A 19)

    M_pd = I_Alx + mu * I_Txz
    mass = _matrix(I_Txx, M_pd, M_pd, I_All + 2.0 * mu * I_Alz + mu**2 * I_Tzz)  # (A 20)
    stiffness0 = _matrix(mz_T, -S_A, -S_A, -S_A * sin)  # (A 22)
    stiffness2 = _matrix(0.0, (S_T - mz_T) / w * cos, 0.0, (S_A + S_F * sin) / w * cos)  # (A 24)
    damping = _matrix(  # (A 26)
        0.0,
        mu * S_T + S_F * cos + I_Txz / w * cos - mu * mz_T,
        -(mu * S_T + S_F * cos),
        I_Alz / w * cos + mu * (S_A + I_Tzz / w * cos),
    )
    return mass, damping, stiffness0, stiffness2


def _centre(moment: Any, mass: Any, otherwise: Any) -> Any:
    """First moment by mass; `otherwise` where there is no mass."""
    massless = np.equal(mass, 0.0)
    return np.where(massless, otherwise, moment / np.where(massless, 1.0, mass))


def _matrix(*entries: Any) -> Array:
    """Row by row, (2, 2) or (n, 2, 2)."""
    columns = np.broadcast_arrays(*entries)
    return np.stack(columns, axis=-1).reshape(*columns[0].shape, 2, 2)
