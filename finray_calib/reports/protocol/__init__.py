"""The printed sheet of a press protocol: what a lab prints, presses and photographs in an hour."""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from finray_calib.reports.protocol._protocol_page import protocol_page
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = ["protocol_page"]
