"""The gel pad of a finger's design: its shape and size, what it is to light, the film on its inner face."""

from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from data_schemas.model import Model
from data_schemas.units import LengthMm

RefractiveIndex = Annotated[float, Field(ge=1.0, le=2.5)]


class Film(Model):
    """Clear polyester (Mylar) sheet on the inner face of the gel."""

    thickness_mm: LengthMm = 0.1
    refractive_index: RefractiveIndex = 1.65


class GelPad(Model):
    """A gel pad; sizes are always length x width, the thickness is that of the crown in the middle.

    Shapes of the coated face: flat; cylindrical with its axis along the pad; a section of an ellipsoid with its
    centre under the middle of the pad. Another shape is one more case of :meth:`drop_mm`, the height function
    that mesh and optics take; the mould's STEP file and the first touch of an STL have cases of their own.
    """

    shape: Literal["flat", "cylindrical", "ellipsoidal"] = "flat"
    length_mm: LengthMm = 70.0
    width_mm: LengthMm = 35.0
    thickness_mm: LengthMm = 6.0
    radius_mm: LengthMm | None = Field(default=None, description="of a cylindrical pad")
    semi_axes_mm: tuple[LengthMm, LengthMm, LengthMm] | None = Field(
        default=None, description="a (across the pad), b (through it), c (along it) of an ellipsoidal pad"
    )
    refractive_index: RefractiveIndex = Field(default=1.41, description="at 589 nm")
    abbe_number: Annotated[float, Field(ge=10.0, le=200.0)] = Field(
        default=50.0, description="(n - 1) / (n at 486 nm - n at 656 nm): how the index falls with wavelength"
    )
    film: Film | None = Field(default=None, description="sheet on the inner face; none without this table")

    @model_validator(mode="after")
    def _shape_is_complete(self) -> "GelPad":
        needs = {"cylindrical": "radius_mm", "ellipsoidal": "semi_axes_mm"}
        for shape, name in needs.items():
            if (getattr(self, name) is not None) != (self.shape == shape):
                state = "missing" if self.shape == shape else f"given for a {self.shape} pad"
                raise ValueError(f'{name} is {state}; it belongs to shape = "{shape}" and only to that')
        half_width, half_length = self.width_mm / 2.0, self.length_mm / 2.0
        if self.radius_mm is not None and self.radius_mm <= half_width:
            raise ValueError(
                f"radius_mm = {self.radius_mm:g} mm must be more than half the width of the pad ({half_width:g} mm)"
            )
        if self.semi_axes_mm is not None:
            a, _, c = self.semi_axes_mm
            if (half_width / a) ** 2 + (half_length / c) ** 2 >= 1.0:
                raise ValueError(
                    f"semi_axes_mm: an ellipsoid of {a:g} mm across and {c:g} mm along does not cover the corners of a "
                    f"pad of {self.length_mm:g} x {self.width_mm:g} mm; needs (width/2a)^2 + (length/2c)^2 < 1"
                )
        edge_mm = self.thickness_mm - self.drop_mm(half_width, half_length)
        if edge_mm <= 0.0:
            raise ValueError(
                f"thickness_mm = {self.thickness_mm:g} mm leaves no gel at the corners, where the face lies "
                f"{self.thickness_mm - edge_mm:.3g} mm below the crown; make the pad thicker or its radii larger"
            )
        return self

    def drop_mm(self, x_mm: ArrayLike, z_from_middle_mm: ArrayLike) -> Any:
        """Return how far the undeformed coated face lies below its crown, shape of the broadcast arguments.

        Cylinder: r - sqrt(r^2 - x^2). Ellipsoid: b (1 - sqrt(1 - (x/a)^2 - (z/c)^2)). Inside the pad only.
        """
        x, z = np.broadcast_arrays(np.asarray(x_mm, dtype=np.float64), np.asarray(z_from_middle_mm, dtype=np.float64))
        if self.radius_mm is not None:
            return self.radius_mm - np.sqrt(self.radius_mm**2 - x**2)
        if self.semi_axes_mm is not None:
            a, b, c = self.semi_axes_mm
            return b * (1.0 - np.sqrt(1.0 - (x / a) ** 2 - (z / c) ** 2))
        return np.zeros(x.shape)

    def index_at(self, wavelength_nm: float) -> float:
        """Return the refractive index by Cauchy's n = A + B / wavelength^2 through index and Abbe number.

        Valid over the visible range, 380 to 780 nm.
        """
        b_nm2 = (self.refractive_index - 1.0) / self.abbe_number / (486.1**-2 - 656.3**-2)
        return self.refractive_index + b_nm2 * (wavelength_nm**-2 - 589.3**-2)
