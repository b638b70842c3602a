"""The calibration rig as its owner describes it (TOML): camera, filter wheel, lights, white reference.

Every device names its ``driver`` and, unless it is simulated, the ``address`` at which it is found.
``driver = "simulated"`` opens the simulated bench; the ``[simulated]`` table then says what is painted on it.
"""

from typing import Annotated, ClassVar

from pydantic import Field, model_validator

from data_schemas.devices import CameraSettings, FilterWheelSettings, LampSettings, LaserSettings
from data_schemas.model import Model, Record
from data_schemas.units import Fraction, RelativeUncertainty, Seed, WavelengthNm, WidthNm


class WhiteReference(Model):
    """Diffuse white tile with its reflectance (spectrally flat) and standard uncertainty."""

    reflectance: Fraction = 0.98
    uncertainty_rel: RelativeUncertainty = 0.005


class HiddenPaint(Model):
    """A paper-family paint on the simulated bench; its numbers are the truth the fitter does not see."""

    name: str
    mode_nm: WavelengthNm
    fwhm_nm: WidthNm
    asinh_skewness: Annotated[float, Field(ge=-6.0, le=6.0)]
    energy_yield: Fraction = Field(description="emitted over incident energy at the laser line")
    absorption_peak_nm: WavelengthNm
    reflectance_at_laser: Fraction = 0.05
    reflectance_long_wavelength: Fraction = 0.75
    bleaching_per_j: Annotated[float, Field(ge=0.0, le=100.0, json_schema_extra={"unit": "1/J"})] = Field(
        default=0.0, description="relative loss of emission per joule of laser light on the sample"
    )


class SimulatedBench(Model):
    """What the simulated bench holds; ignored by real drivers."""

    seed: Seed = 1
    paint: HiddenPaint | None = None
    material: str | None = Field(default=None, description="CSV file of a measured re-radiation matrix")

    @model_validator(mode="after")
    def _one_sample(self) -> "SimulatedBench":
        if (self.paint is None) == (self.material is None):
            raise ValueError("needs exactly one of 'paint' (hidden parameters) and 'material' (a CSV file)")
        return self


class RigFile(Record):
    """A whole rig."""

    schema_version: ClassVar[int] = 2

    name: str
    camera: CameraSettings = CameraSettings()
    filter_wheel: FilterWheelSettings
    laser: LaserSettings = LaserSettings()
    lamp: LampSettings = LampSettings()
    white_reference: WhiteReference = WhiteReference()
    simulated: SimulatedBench | None = None

    @model_validator(mode="after")
    def _simulated_needs_a_bench(self) -> "RigFile":
        drivers = (self.camera.driver, self.filter_wheel.driver, self.laser.driver, self.lamp.driver)
        if 0 < drivers.count("simulated") < len(drivers):
            raise ValueError(
                "simulated and real devices cannot share a rig: the simulated bench does not see what real ones do; "
                "name a real driver for the camera, filter_wheel, laser and lamp, or for none of them"
            )
        if "simulated" in drivers and self.simulated is None:
            raise ValueError("a simulated device needs a [simulated] table that names a paint or a material")
        return self

    @model_validator(mode="after")
    def _one_address_each(self) -> "RigFile":
        laser, lamp = ((light.driver, light.address) for light in (self.laser, self.lamp))
        if laser == lamp and self.laser.address:
            raise ValueError(
                f"laser and lamp are both driver '{laser[0]}' at {laser[1]}: one switch cannot be both; correct the "
                "address of one of them"
            )
        wheel = self.filter_wheel
        for role, light in (("laser", self.laser), ("lamp", self.lamp)):
            if (wheel.driver, light.driver) == ("thorlabs", "arduino") and wheel.address == light.address:
                raise ValueError(
                    f"filter_wheel and {role} are both at {wheel.address}: a serial port holds one device; correct the "
                    "address of one of them"
                )
        return self

    @property
    def is_simulated(self) -> bool:
        """Whether the simulated bench stands in for all devices."""
        return self.camera.driver == "simulated"
