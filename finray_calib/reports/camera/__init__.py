"""The page of a camera after EMVA Standard 1288, from its characterisation: quantities with expanded uncertainty."""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from finray_calib.reports.camera._camera_page import camera_page, linearity_svg, photon_transfer_svg, snr_svg
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "camera_page",
    "linearity_svg",
    "photon_transfer_svg",
    "snr_svg",
]
