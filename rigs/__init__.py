"""Devices and the capture of sessions; of this project it imports data_schemas only.

``with open_rig(rig, folder) as opened:`` turns a rig file into a camera, a filter wheel, a laser, a lamp, an operator
and a clock that keep the protocols of this room, whether they are real, behind a server or simulated. Every exchange
has a deadline, and what a device says is asked afresh.

Drivers lie in ``cameras``, ``filter_wheels`` and ``lights``, one file per make or protocol, over the framed exchanges
of ``transports``, or in other packages (docs/how-to/write-a-driver.md); ``light_guard`` alone holds a light that could
harm; ``capture`` runs the sessions; ``simulated`` is a rig without hardware; ``contracts`` are the tests of every
driver.
"""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from rigs._drivers import (
        Detection,
        Driver,
        FoundDevice,
        Kind,
        detect,
        driver_module,
        driver_notes,
        drivers_of_other_packages,
        find_driver,
        offered,
        open_camera,
        open_lamp,
        open_laser,
        open_wheel,
        rig_drivers,
    )
    from rigs._open_rig import (
        OpenRig,
        device_locked,
        device_title,
        lone_camera,
        lone_lamp,
        lone_laser,
        lone_wheel,
        look_at,
        look_at_tactile,
        open_rig,
        rig_locked,
    )
    from rigs._protocols import (
        AbsentOperator,
        CallThread,
        Camera,
        Clock,
        FilterWheel,
        GuardedSwitch,
        Light,
        LightSwitch,
        NoAnswerError,
        OffWords,
        Operator,
        RawFrame,
        SystemClock,
        TerminalOperator,
        forget_typed_ahead,
        missing_members,
    )
    from rigs._rig_files import (
        DEFAULT_PAINTS,
        Role,
        camera_plan,
        paint_plan,
        paper_rig,
        plan_toml,
        rig_toml,
        simulated_rig,
        to_fill_in,
        write_plan,
        write_rig,
    )
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "DEFAULT_PAINTS",
    "AbsentOperator",
    "CallThread",
    "Camera",
    "Clock",
    "Detection",
    "Driver",
    "FilterWheel",
    "FoundDevice",
    "GuardedSwitch",
    "Kind",
    "Light",
    "LightSwitch",
    "NoAnswerError",
    "OffWords",
    "OpenRig",
    "Operator",
    "RawFrame",
    "Role",
    "SystemClock",
    "TerminalOperator",
    "camera_plan",
    "detect",
    "device_locked",
    "device_title",
    "driver_module",
    "driver_notes",
    "drivers_of_other_packages",
    "find_driver",
    "forget_typed_ahead",
    "lone_camera",
    "lone_lamp",
    "lone_laser",
    "lone_wheel",
    "look_at",
    "look_at_tactile",
    "missing_members",
    "offered",
    "open_camera",
    "open_lamp",
    "open_laser",
    "open_rig",
    "open_wheel",
    "paint_plan",
    "paper_rig",
    "plan_toml",
    "rig_drivers",
    "rig_locked",
    "rig_toml",
    "simulated_rig",
    "to_fill_in",
    "write_plan",
    "write_rig",
]
