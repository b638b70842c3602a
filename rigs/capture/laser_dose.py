"""How much laser light has fallen on the sample: fluorescent paint bleaches with it."""

from collections.abc import Iterator
from contextlib import contextmanager

from rigs.protocols import Clock


class LaserDose:
    """Meter of the laser energy on the sample: power x time with the laser on and the sample in view.

    Parameters
    ----------
    power_mw
        Power of the laser (mW).
    clock
        Its monotonic time is used.
    before_j
        Energy that fell on the sample before (J), in the interrupted part of a resumed session.
    """

    def __init__(self, power_mw: float, clock: Clock, before_j: float = 0.0):
        self._power_w, self._clock = 1e-3 * power_mw, clock
        self._energy_j = before_j
        self._on_since_s: float | None = None

    @contextmanager
    def shining(self) -> Iterator[None]:
        """Count the time of a ``with`` block."""
        self._on_since_s = self._clock.monotonic_s()
        try:
            yield
        finally:
            self._energy_j, self._on_since_s = self.energy_j(), None

    def energy_j(self, ago_s: float = 0.0) -> float:
        """Return the energy (J) until `ago_s` seconds before now, a moment within the running block if there is one."""
        if self._on_since_s is None:
            return self._energy_j
        return self._energy_j + self._power_w * max(self._clock.monotonic_s() - ago_s - self._on_since_s, 0.0)
