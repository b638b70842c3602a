"""``finray`` on the simulated rig whose devices write down what happens to them: FILE, a mode, and the command.

Modes: "plain"; "slow", where an exposure takes its time; "manual", with a lamp that a person switches; "broken", where
drawing fails once the lamp is on; "stubborn", where the lamp is not confirmed off.
"""

import sys
import time
from contextlib import contextmanager
from dataclasses import replace

import rigs
from data_schemas import UnsafeError
from finray_calib.cli.main import main
from rigs.lights.manual import ManualSwitch, PlainLight
from rigs.live_view import _terminal_view
from rigs.simulated import SimulatedCamera, SimulatedFilterWheel, SimulatedLight


def watch(file: str, mode: str) -> None:
    """Have the devices write to a file."""
    log = open(file, "a", buffering=1, encoding="utf-8")  # noqa: SIM115 - until the process ends
    lit, go_to, expose = SimulatedLight.lit, SimulatedFilterWheel.go_to, SimulatedCamera.expose

    @contextmanager
    def watched_lit(self):
        with lit(self):
            log.write(f"{time.monotonic()} {self.name} on\n")
            yield
        if mode == "stubborn":
            raise UnsafeError("lamp: NOT CONFIRMED OFF; pull its plug")
        log.write(f"{time.monotonic()} {self.name} off\n")

    def watched_go_to(self, slot, deadline_s):
        go_to(self, slot, deadline_s)
        log.write(f"{time.monotonic()} slot {slot}\n")

    def watched_expose(self, exposure_s, deadline_s):
        log.write(f"{time.monotonic()} exposure {exposure_s!r}\n")
        if mode == "slow":
            time.sleep(exposure_s)
        return expose(self, exposure_s, deadline_s)

    SimulatedLight.lit, SimulatedFilterWheel.go_to = watched_lit, watched_go_to
    SimulatedCamera.expose = watched_expose
    if mode == "manual":
        rigs.open_rig = with_a_lamp_by_hand
    if mode == "broken":
        _terminal_view.panel_lines = fails_with_light(_terminal_view.panel_lines)


open_rig = rigs.open_rig


@contextmanager
def with_a_lamp_by_hand(rig, folder, operator=None):
    """Open a rig whose lamp is switched by hand."""
    switch = ManualSwitch(operator)
    switch.switch(False, 5.0)
    with open_rig(rig, folder, operator) as opened:
        yield replace(opened, lamp=PlainLight(switch))


def fails_with_light(draw):
    """Return a function that fails where the lamp is on."""

    def draws(screen, numbers, live):
        if numbers.lamp:
            raise RuntimeError("drawing failed")
        return draw(screen, numbers, live)

    return draws


if __name__ == "__main__":
    watch(sys.argv[1], sys.argv[2])
    sys.argv = ["finray", *sys.argv[3:]]
    sys.exit(main())
