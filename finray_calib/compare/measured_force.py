"""A measured force over the displacement of an indenter."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import CompareError

Floats = NDArray[np.float64]

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
            raise CompareError(f"{self.name}: has {count} points; a comparison needs {FEWEST_POINTS} or more")
        for what, values in (("force", self.u_force_n), ("displacement", self.u_displacement_mm)):
            if values is not None and (values < 0.0).any():
                raise CompareError(f"{self.name}: an uncertainty of the {what} is negative; give 0 or more")
        if self.force_n.mean() <= 0.0:
            raise CompareError(
                f"{self.name}: the force is {self.force_n.mean():.3g} N on average; pushing counts positive, turn the "
                "sign"
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
                    f"{self.name}: the largest {what} is {own:.3g} {unit}, that of the simulated press {other:.3g} "
                    f"{unit}; is it in another unit? Give {unit}"
                )
