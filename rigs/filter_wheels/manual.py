"""A filter wheel without a motor: the operator turns it from outside the closed box and confirms."""

from collections.abc import Iterator
from contextlib import contextmanager

from data_schemas import DeviceIdentity, FilterWheelSettings, RefusedError
from rigs import FilterWheel, Operator


class ManualWheel:
    """A wheel that the operator turns; only the frames can tell whether the right filter is in the beam.

    Parameters
    ----------
    settings
        Filters and the slots they are in.
    operator
        Who turns the wheel.
    """

    def __init__(self, settings: FilterWheelSettings, operator: Operator) -> None:
        self._model = settings.model
        self._filters = {optic.slot: optic for optic in settings.filters}
        self._operator = operator
        self._confirmed: int | None = None

    def identity(self) -> DeviceIdentity:
        """Return what the rig file says of the wheel."""
        return DeviceIdentity(role="filter wheel", driver="manual", model=self._model)

    @property
    def slots(self) -> tuple[int, ...]:
        """Numbers of the slots that hold a filter."""
        return tuple(sorted(self._filters))

    def position(self) -> int | None:
        """Return the slot that the operator confirmed last; None before the first and after a request that failed."""
        return self._confirmed

    def go_to(self, slot: int, deadline_s: float) -> None:
        """Have `slot` turned into the beam; people take their time, `deadline_s` does not hold for them.

        Raises
        ------
        RefusedError
            No filter is in such a slot; nobody was asked.
        CaptureError
            Nobody can answer.
        """
        if slot not in self._filters:
            raise RefusedError(
                f"filter wheel: has no filter in slot {slot}, only in {', '.join(map(str, self.slots))}; correct the "
                "slot numbers in the rig file"
            )
        optic = self._filters[slot]
        self._confirmed = None
        self._operator.do(f"Turn the filter wheel to slot {slot}: filter '{optic.name}', {optic.center_nm:g} nm.")
        self._confirmed = slot


@contextmanager
def open_wheel(settings: FilterWheelSettings, operator: Operator) -> Iterator[FilterWheel]:
    """Return the wheel of a rig for a ``with`` block; its position is unknown until the operator confirms one."""
    yield ManualWheel(settings, operator)
