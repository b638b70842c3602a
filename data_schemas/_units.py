"""Annotated scalars: every number that crosses a file carries its bounds and its unit into the JSON Schema.

One mechanical system: mm, N, MPa, s. Angles in degrees, wavelengths in nm, camera signals in DN (raw counts) or
e (electrons). Ratios (``Fraction``, ``RelativeUncertainty``) are 0..1 and never per cent.
"""

from typing import Annotated, Any

from pydantic import Field


def _unit(unit: str, **bounds: Any) -> Any:
    """Return a pydantic field with bounds and the unit as JSON Schema keyword."""
    return Field(json_schema_extra={"unit": unit}, allow_inf_nan=False, **bounds)


WavelengthNm = Annotated[float, _unit("nm", ge=200.0, le=2500.0)]
WidthNm = Annotated[float, _unit("nm", gt=0.0, le=1000.0)]
LengthMm = Annotated[float, _unit("mm", gt=0.0, le=1000.0)]
PositionMm = Annotated[float, _unit("mm", ge=-1000.0, le=1000.0)]
AngleDeg = Annotated[float, _unit("deg", ge=-180.0, le=180.0)]
ExposureS = Annotated[float, _unit("s", gt=0.0, le=3600.0)]
DurationS = Annotated[float, _unit("s", ge=0.0)]
EnergyJ = Annotated[float, _unit("J", ge=0.0)]
PowerMw = Annotated[float, _unit("mW", gt=0.0, le=1e5)]
SignalDn = Annotated[float, _unit("DN", ge=0.0, le=65535.0)]
ChargeE = Annotated[float, _unit("e", ge=0.0)]
Fraction = Annotated[float, _unit("1", ge=0.0, le=1.0)]
RelativeUncertainty = Annotated[float, _unit("1", ge=0.0, le=10.0)]
FilterUncertaintyNm = Annotated[float, _unit("nm", ge=0.0, le=10.0)]
TypeBUncertainty = Annotated[float, _unit("1", ge=1e-4, le=0.2)]
OpticalDensity = Annotated[float, _unit("1 (10^-OD)", ge=0.0, le=12.0)]
Seed = Annotated[int, Field(ge=0, le=2**63 - 1)]
