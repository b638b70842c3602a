"""What switches a light off outside of the computer, and lasers that must not be lit without it.

Three processes cover the death and the freezing of each other. A computer that hangs, a cable that is pulled, or all
three killed at once leaves a light on, unless hardware switches it off: a dead-man in the controller, an interlock, a
relay that opens unless it is pulsed.
"""

import datetime
from importlib import import_module
from typing import Final

from data_schemas.devices import LampSettings, LaserSettings, OutsideLayer
from data_schemas.errors import RefusedError

HAZARDOUS_CLASSES: Final = ("3R", "3B", "4")
TEST_HOLDS_DAYS: Final = 90


def is_hazardous(laser: LaserSettings) -> bool:
    """Whether the label says class 3R or above (IEC 60825-1)."""
    return laser.laser_class in HAZARDOUS_CLASSES


def refusal(laser: LaserSettings, has_dead_man: bool, today: datetime.date | None = None) -> str | None:
    """Return why a laser must not go on, with the way out; None when it may.

    Parameters
    ----------
    laser
        What the rig file says.
    has_dead_man
        Whether its driver speaks to a controller with a dead-man, which is tested before the laser is first lit.
    today
        For the age of the test; by the computer's clock when left out.
    """
    layer = laser.outside_layer
    if not is_hazardous(laser) or has_dead_man:
        return None
    if layer is None:
        return (
            f"a class {laser.laser_class} laser does not go on without a layer outside the computer that switches it "
            "off: nothing does when the computer hangs or the processes of finray are killed together. Drive it by an "
            "Arduino with our firmware, which has a dead-man, or build an interlock or a relay that opens unless it is "
            "pulsed into its supply, test it, and declare it in the rig file as [laser.outside_layer] "
            "(docs/how-to/connect-a-laser.md)"
        )
    age_days = ((today or datetime.date.today()) - datetime.date.fromisoformat(layer.tested_on)).days
    if 0 <= age_days <= TEST_HOLDS_DAYS:
        return None
    when = "in the future" if age_days < 0 else f"{age_days} days ago"
    return (
        f"the test of its outside layer ({layer.kind}) on {layer.tested_on} is {when}, at most {TEST_HOLDS_DAYS} days "
        f"are allowed for a class {laser.laser_class} laser; test the {layer.kind} again and correct tested_on of "
        "[laser.outside_layer] in the rig file"
    )


def require_outside_layer(laser: LaserSettings) -> None:
    """Refuse a laser that must not go on, before anything is opened.

    Raises
    ------
    RefusedError
        It is of class 3R or above, and nothing outside the computer switches it off.
    """
    if laser.driver != "simulated" and (why := refusal(laser, has_dead_man(laser))):
        raise RefusedError(f"laser at {laser.address}: {why}")


def has_dead_man(settings: LaserSettings | LampSettings) -> bool:
    """Whether the driver of a light speaks to a controller with a dead-man."""
    # rigs.drivers names this package; the table of lights is looked up when it is there.
    from rigs.drivers import LIGHTS

    return bool(import_module(LIGHTS[settings.driver]).HAS_DEAD_MAN)


def off_lines(has_dead_man: bool, layer: OutsideLayer | None = None) -> tuple[str, str]:
    """Return, in two sentences, what switches a light off when a process fails and when the whole computer does."""
    first = "off when a process of finray is killed or stopped: yes, by the others, within 1 s"
    all_of_them = "off when the computer hangs, its cable is pulled or all processes are killed"
    if has_dead_man:
        return first, f"{all_of_them}: yes, by the dead-man in its controller, within 1 s"
    if layer is not None:
        return first, f"{all_of_them}: only by the {layer.kind} (tested on {layer.tested_on}: {layer.test})"
    return first, f"{all_of_them}: NO, it stays on; it has no dead-man and no other layer outside the computer"
