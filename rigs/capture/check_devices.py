"""Acceptance of the devices one by one: who they say they are, and where the wheel goes."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import Final, Protocol

import numpy as np

from data_schemas.band_pass_filter import BandPassFilter
from data_schemas.check import CheckPlan, Handshake, WheelMove
from data_schemas.devices import DeviceIdentity
from data_schemas.errors import CaptureError, WrongPositionError
from data_schemas.rig import RigFile
from rigs.capture.exchange import WHEEL_DEADLINE_S
from rigs.open_rig import OpenRig

HANDSHAKES: Final = 3


class _Named(Protocol):
    """What every device of a rig is."""

    def identity(self) -> DeviceIdentity:
        """Return what it says it is."""
        ...


def handshakes(opened: OpenRig, rig: RigFile) -> tuple[Handshake, ...]:
    """Ask every device who it is and how it stands."""
    return (
        _handshake(opened, "camera", rig.camera.driver, opened.camera, lambda: None),
        _handshake(opened, "filter wheel", rig.filter_wheel.driver, opened.wheel, opened.wheel.position),
        _handshake(opened, "laser", rig.laser.driver, opened.laser, opened.laser.state),
        _handshake(opened, "lamp", rig.lamp.driver, opened.lamp, opened.lamp.state),
    )


def _handshake(opened: OpenRig, role: object, driver: str, device: _Named, state: Callable[[], object]) -> Handshake:
    """Ask one device some times."""
    durations_s: list[float] = []
    identity, error = None, None
    try:
        for _ in range(HANDSHAKES):
            start_s = opened.clock.monotonic_s()
            identity = device.identity()
            state()
            durations_s.append(opened.clock.monotonic_s() - start_s)
    except CaptureError as raised:
        error = str(raised)
    return Handshake.model_validate(
        {"role": role, "driver": driver, "identity": identity, "durations_s": durations_s, "error": error}
    )


def wheel_moves(opened: OpenRig, plan: CheckPlan, filters: Sequence[BandPassFilter]) -> Iterator[WheelMove]:
    """Turn the wheel to filters drawn at random, never to the one in the beam; arrival is asked afresh."""
    opened.operator.place("white")
    rng = np.random.default_rng(plan.seed)
    slots = [band.slot for band in filters]
    for _ in range(plan.wheel_moves):
        here = opened.wheel.position()
        elsewhere = [slot for slot in slots if slot != here]
        if not elsewhere:
            return
        slot = int(rng.choice(elsewhere))
        start_s = opened.clock.monotonic_s()
        # where it stands is asked below, and is what the check is about
        with suppress(WrongPositionError):
            opened.wheel.go_to(slot, WHEEL_DEADLINE_S)
        duration_s = opened.clock.monotonic_s() - start_s
        arrived = opened.wheel.position()
        yield WheelMove(from_slot=here, to_slot=slot, arrived_slot=arrived, duration_s=duration_s)
