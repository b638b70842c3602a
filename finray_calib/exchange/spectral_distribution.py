"""A paint's emission as a spectral distribution of colour-science, and as an IES TM-27-14 file (.spdx)."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from data_schemas.fit import PaintCalibration
from data_schemas.provenance import Provenance
from finray_calib.exchange.paint_text import origin_lines

if TYPE_CHECKING:
    from colour import SpectralDistribution


def as_spectral_distribution(paint: PaintCalibration) -> "SpectralDistribution":
    """Return the mean emission as ``colour.SpectralDistribution`` (1/nm on a grid in nm).

    Parameters
    ----------
    paint
        Record written by ``finray fit``. The class holds no uncertainty.
    """
    from colour import SpectralDistribution

    pairs = dict(zip(paint.wavelength_nm.tolist(), paint.emission_per_nm.tolist(), strict=True))
    return SpectralDistribution(pairs, name=f"emission of {paint.paint_name}")


def spdx_bytes(paint: PaintCalibration, origin: Provenance) -> bytes:
    """Return the mean emission as an IES TM-27-14 XML file.

    The layout has no field for uncertainty nor a quantity for a radiance factor: the quantity is "other" and the
    comments say what it is and what is missing.

    Parameters
    ----------
    paint
        Record written by ``finray fit``.
    origin
        Provenance of the export.
    """
    from colour import SpectralDistribution_IESTM2714

    missing = "missing here: uncertainty (export csv, json or netcdf)"
    with TemporaryDirectory() as folder:
        file = Path(folder) / "paint.spdx"
        distribution = SpectralDistribution_IESTM2714(
            str(file),
            data=as_spectral_distribution(paint),
            spectral_quantity="other",
            reflection_geometry="other",
            transmission_geometry="other",
            bandwidth_FWHM=float(paint.wavelength_nm[1] - paint.wavelength_nm[0]),
            bandwidth_corrected=True,
        )
        header = distribution.header
        header.description = f"emission of fluorescent paint {paint.paint_name}"
        header.document_creator = f"finray-calib {origin.package_version}"
        header.document_creation_date = origin.created_utc
        header.comments = "; ".join((*origin_lines(paint, origin), missing))
        for unknown in ("manufacturer", "catalog_number", "unique_identifier", "laboratory"):
            setattr(header, unknown, "unknown")
        for unknown in ("measurement_equipment", "report_number", "report_date"):
            setattr(header, unknown, "unknown")
        distribution.write()
        return file.read_bytes()
