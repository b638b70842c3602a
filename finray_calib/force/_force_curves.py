"""A force over the displacement of an indenter: simulated between the increments of a press, and measured.

Also how the simulated one depends on the numbers of the design, and how well these are known.
"""

import math
from dataclasses import dataclass
from operator import attrgetter
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from data_schemas import CompareError, FingerDesign, ForceSlope, PressSensitivities, VariedPress

Floats = NDArray[np.float64]

# of a depth: small against its increments, large against rounding
_SLOPE_STEP = 1e-5
_BEYOND = 1.05
_SAME_DEPTH = 1.0 + 1e-9


@dataclass(frozen=True, slots=True)
class ForceCurve:
    """Force over push through the increments of a press; exact for every power F = a d^p.

    A monotone cubic (PCHIP) of ln F over ln d; outside the increments the power law of the two nearest ones; 0 above
    the pad (d <= 0). Valid to a twentieth beyond the last increment, so that a first touch can be fitted to points that
    reach as deep as the press.

    Parameters
    ----------
    name
        Of the press, for messages.
    depth_mm, force_n
        Of its increments (k,), from first touch.

    Raises
    ------
    CompareError
        When there are fewer than two increments, or a force is not above 0.
    """

    name: str
    depth_mm: Floats
    force_n: Floats

    def __post_init__(self) -> None:
        if len(self.depth_mm) < 2:
            raise CompareError(
                f"{self.name}: has {len(self.depth_mm)} increment(s), too few for a curve; simulate with --increments 4"
            )
        if (self.force_n <= 0.0).any() or (self.depth_mm <= 0.0).any() or (np.diff(self.depth_mm) <= 0.0).any():
            raise CompareError(
                f"{self.name}: all depths must be above 0 mm and increase, and all forces must be above 0 N"
            )

    @property
    def reach_mm(self) -> float:
        """The deepest push at which the curve may be read."""
        return float(_BEYOND * self.depth_mm[-1])

    def at(self, depth_mm: Floats) -> Floats:
        """Return the force in N at pushes of any shape."""
        x, y = np.log(self.depth_mm), np.log(self.force_n)
        inside = depth_mm > 0.0
        at = np.log(np.where(inside, depth_mm, 1.0))
        outside = [y[k] + (y[k] - y[k + step]) / (x[k] - x[k + step]) * (at - x[k]) for k, step in ((0, 1), (-1, -1))]
        between = PchipInterpolator(x, y)(np.clip(at, x[0], x[-1]))
        return np.where(inside, np.exp(np.select([at < x[0], at > x[-1]], outside, between)), 0.0)

    def slope_at(self, depth_mm: Floats) -> Floats:
        """Return dF/dd in N/mm at pushes of any shape."""
        step = _SLOPE_STEP * self.reach_mm
        high = np.minimum(depth_mm + step, self.reach_mm)
        return (self.at(high) - self.at(high - 2.0 * step)) / (2.0 * step)

    def interpolation_error(self, depth_mm: Floats) -> Floats:
        """Return the difference in N to another curve through the increments: how free the curve is between them.

        The other one is a monotone cubic of F over d from the origin, continued on a straight line.
        """
        depth, force = np.r_[0.0, self.depth_mm], np.r_[0.0, self.force_n]
        slope = (force[-1] - force[-2]) / (depth[-1] - depth[-2])
        beyond = slope * np.maximum(depth_mm - depth[-1], 0.0)
        other = PchipInterpolator(depth, force)(np.clip(depth_mm, 0.0, depth[-1])) + beyond
        return np.asarray(np.abs(self.at(depth_mm) - other))


def log_sensitivity(press: PressSensitivities, effect: VariedPress | ForceSlope, depth_mm: Floats) -> Floats:
    """Return d ln F / d ln x at pushes (n,): the derivative at the increments, or the secant of a varied press there.

    Straight lines over ln d between the increments, constant beyond them.

    Raises
    ------
    CompareError
        When the varied press has no two increments.
    """
    if isinstance(effect, ForceSlope):
        shared, slopes = press.depth_mm, effect.ln_force_per_ln_number
    else:
        one = ForceCurve("unchanged press", press.depth_mm, press.force_n)
        other = ForceCurve(f"press with {effect.field} changed", effect.depth_mm, effect.force_n)
        shared = one.depth_mm[one.depth_mm <= other.depth_mm[-1] * _SAME_DEPTH]
        if not len(shared):
            shared = other.depth_mm[-1:]
        slopes = np.log(other.at(shared) / one.at(shared)) / np.log1p(effect.change_rel)
    return np.asarray(np.interp(np.log(np.maximum(depth_mm, shared[0])), np.log(shared), slopes))


# an elastomer's or plastic's modulus from the literature, for another batch, cure and rate
ASSUMED_MODULUS_REL: Final = 0.2
# K / mu is measured for hardly any silicone: from nu = 0.475 to 0.49975, even in its logarithm. The force changes less
# and less with it, so that this sensitivity, taken where the design is, makes the interval too wide rather than short
ASSUMED_BULK_OVER_SHEAR: Final = (20.0, 2000.0)
_BULK_LN = math.log(ASSUMED_BULK_OVER_SHEAR[1] / ASSUMED_BULK_OVER_SHEAR[0]) / math.sqrt(12.0)
ASSUMED_BULK_REL: Final = math.sqrt(math.expm1(_BULK_LN**2))
# rolled and cast sheets are sold to about a tenth of their thickness
ASSUMED_SHEET_REL: Final = 0.1
# a print's or mould's limits; a rectangular distribution within them (JCGM 100, 4.3.7)
PRINT_LIMIT_MM: Final = 0.1
_SHEETS: Final = ("pad.film.thickness_mm", "skeleton.mirror_thickness_mm")


def input_uncertainty(design: FingerDesign, field: str) -> tuple[float, str]:
    """Return the relative standard uncertainty of a field, and where it is from."""
    if field in design.uncertainty_rel:
        return design.uncertainty_rel[field], "stated by the design"
    if field.endswith("_mpa"):
        return ASSUMED_MODULUS_REL, f"assumed: {100 * ASSUMED_MODULUS_REL:.0f} % of a modulus"
    if field.endswith("bulk_over_shear"):
        low, high = ASSUMED_BULK_OVER_SHEAR
        return ASSUMED_BULK_REL, f"assumed: K / mu from {low:g} to {high:g}, evenly in its logarithm"
    if field in _SHEETS:
        return ASSUMED_SHEET_REL, f"assumed: {100 * ASSUMED_SHEET_REL:.0f} % of the thickness of a sheet"
    value_mm = float(attrgetter(field)(design))
    return PRINT_LIMIT_MM / math.sqrt(3.0) / value_mm, f"assumed: printed to +-{PRINT_LIMIT_MM:g} mm"


FEWEST_POINTS = 5
_UNITS_APART = 300.0  # mN for N is 1000, g for N is 102; no finger of the right unit is this far off


@dataclass(frozen=True, slots=True)
class MeasuredForce:
    """Points of a loading curve, in any order.

    Attributes
    ----------
    name
        For example of the file.
    displacement_mm
        Of the indenter along the pad's normal, (n,); the compliance of the testing machine taken off.
    force_n
        Along the pad's normal, (n,); pushing counts positive.
    u_force_n, u_displacement_mm
        Standard uncertainties (n,), independent from point to point; None where they are not stated.
    """

    name: str
    displacement_mm: Floats
    force_n: Floats
    u_force_n: Floats | None = None
    u_displacement_mm: Floats | None = None

    def __post_init__(self) -> None:
        count = len(self.displacement_mm)
        if count < FEWEST_POINTS:
            raise CompareError(f"{self.name}: has only {count} points, but a comparison needs {FEWEST_POINTS} or more")
        for what, values in (("force", self.u_force_n), ("displacement", self.u_displacement_mm)):
            if values is not None and (values < 0.0).any():
                raise CompareError(f"{self.name}: an uncertainty of the {what} is negative; give 0 or more")
        if self.force_n.mean() <= 0.0:
            raise CompareError(
                f"{self.name}: the mean force is {self.force_n.mean():.3g} N, but pushing must count as positive; "
                "change the sign of the force"
            )

    def variance_n2(self, slope_n_per_mm: Floats) -> Floats:
        """Return the variance of each force, with that of its displacement through the slope of the curve (n,)."""
        of_force, of_displacement = (
            np.zeros_like(self.force_n) if u is None else u**2 for u in (self.u_force_n, self.u_displacement_mm)
        )
        return of_force + slope_n_per_mm**2 * of_displacement

    def check_units(self, depth_mm: float, force_n: float) -> None:
        """Refuse numbers of another magnitude than a press of this depth and largest force, both above 0.

        Raises
        ------
        CompareError
            When displacement or force seem to be in another unit.
        """
        for what, unit, own, other in (
            ("displacement", "mm", float(np.abs(self.displacement_mm).max()), depth_mm),
            ("force", "N", float(self.force_n.max()), force_n),
        ):
            if not 1.0 / _UNITS_APART < own / other < _UNITS_APART:
                raise CompareError(
                    f"{self.name}: the largest {what} is {own:.3g} {unit}, but {other:.3g} {unit} in the simulated "
                    f"press, so the unit may be wrong; give the {what} in {unit}"
                )
