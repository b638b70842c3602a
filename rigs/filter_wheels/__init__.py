"""Drive filter wheels: a move ends when the wheel itself has reported the slot twice.

One file per make or protocol, named after it, with ``open_wheel(settings, operator)`` and, where devices can be looked
for, ``found()``. What is offered here serves more than one driver: arrival at a slot, and slots that a wheel lacks.
"""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from rigs.filter_wheels._arrival import Arrival, require_slot, require_slots
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = ["Arrival", "require_slot", "require_slots"]
