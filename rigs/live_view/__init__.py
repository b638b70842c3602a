"""Look through a rig while it is set up or captures: in the browser of this computer, or in a terminal.

In the live view one thread owns the devices and exposes continuously; pages and the terminal ask for the newest frame.
The lamp and the filter wheel follow them; the laser is never lit there, because nothing in it proves that it goes off.
A session is the one of :mod:`rigs.capture`: views show its frames and numbers, answer its questions, and can switch
its lights off.
"""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from rigs.live_view._live_server import LiveNumbers, LiveRig, LiveServer, focus_measure, live_server
    from rigs.live_view._session_page import shown_session
    from rigs.live_view._terminal_page import require_terminal
    from rigs.live_view._terminal_view import TerminalViewOperator, terminal_view
    from rigs.live_view._watched_session import SessionNumbers, WatchedSession
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "LiveNumbers",
    "LiveRig",
    "LiveServer",
    "SessionNumbers",
    "TerminalViewOperator",
    "WatchedSession",
    "focus_measure",
    "live_server",
    "require_terminal",
    "shown_session",
    "terminal_view",
]
