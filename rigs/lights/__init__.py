"""Drive lights: a switch whose state is asked each time; :mod:`rigs.light_guard` turns it into a guarded light.

One file per make or protocol, named after it, with ``HAS_DEAD_MAN``, ``open_switch(address, role, operator)`` and,
where devices can be looked for, ``found()``. What is offered here serves more than one driver: a light behind a server
that keeps it on when its client dies. ``firmware`` is the source of the Arduino's dead-man.
"""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from rigs.lights._server_light import Panel, ServerLight
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = ["Panel", "ServerLight"]
