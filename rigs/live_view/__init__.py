"""Look through a rig while it is set up: a live view in the browser of this computer, or in a terminal.

One thread owns the devices and exposes without end; pages and the terminal ask for the newest frame. The lamp and the
filter wheel follow them; the laser is never lit here, because nothing in this view proves that it goes off.
"""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from rigs.live_view._live_server import LiveNumbers, LiveRig, LiveServer, focus_measure, live_server
    from rigs.live_view._terminal_view import TerminalViewOperator, require_terminal, terminal_view
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "LiveNumbers",
    "LiveRig",
    "LiveServer",
    "TerminalViewOperator",
    "focus_measure",
    "live_server",
    "require_terminal",
    "terminal_view",
]
