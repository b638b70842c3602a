"""Load cells that say how hard a finger is pressed, one file for each protocol; a driver is named in the rig file."""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from rigs.load_cells.hx711 import Hx711Cell
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = ["Hx711Cell"]
