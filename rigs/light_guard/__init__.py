"""Keep a light from staying on: three processes watch each other while it is lit; if one is missing, it goes off.

The owner is the program that captures; ``with light.lit():`` switches off however the block is left. The guard is a
process that alone holds the light's connection. The watch is a third one with a line of its own to the light. Each
sees within hundredths of a second that another is killed or stopped, and switches off. None of them covers a computer
that hangs or loses its cable: then only a layer outside of it helps, such as a dead-man in the light's controller.
"""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from rigs.light_guard._guarded_light import (
        LEASE_S,
        TEST_VALID_DAYS,
        GuardedLight,
        guarded_light,
        has_dead_man,
        is_hazardous,
        off_lines,
        require_outside_layer,
        safety_lines,
    )
    from rigs.light_guard._photodiode import FULL_SCALE_LEVEL, LightLevel, LightMeter, open_photodiode
    from rigs.light_guard._reconnecting_light import LightLostError
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "FULL_SCALE_LEVEL",
    "LEASE_S",
    "TEST_VALID_DAYS",
    "GuardedLight",
    "LightLevel",
    "LightLostError",
    "LightMeter",
    "guarded_light",
    "has_dead_man",
    "is_hazardous",
    "off_lines",
    "open_photodiode",
    "require_outside_layer",
    "safety_lines",
]
