"""How a path left its last surface that was not a smooth interface: it decides whether a panel it meets was counted.

Import this module only after a compiled variant has been set (see :mod:`sim.optics.variants`).
"""

from typing import Any

import drjit as dr
import mitsuba as mi

# from a surface; from it straight out through the inner face; any other way; from the eye, all smooth since; from the
# start in a wall; from that start straight out
FROM_SURFACE, STRAIGHT_OUT, OTHER_WAY, FROM_EYE, FROM_START, DIRECT = range(6)


def state_after(state: Any, smooth: Any, out: Any) -> Any:
    """Return the state after a surface, by whether it was smooth, and whether the path went out by the inner face."""
    after = dr.select(out & (state == FROM_SURFACE), mi.UInt32(STRAIGHT_OUT), mi.UInt32(OTHER_WAY))
    after = dr.select(out & (state == FROM_START), mi.UInt32(DIRECT), after)
    after = dr.select(state == FROM_EYE, mi.UInt32(FROM_EYE), after)
    return dr.select(smooth, after, mi.UInt32(FROM_SURFACE))
