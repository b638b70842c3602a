"""What a real load cell's amplifier adds to white noise: a zero that wanders, pick-up of the mains, lost bits.

Slow noise has a spectral density of about 1/f from 0.003 to 3 Hz: the sum of random processes that forget within 0.1
to 100 s, each of the same variance. Pick-up at 50 Hz is folded by the sampling; at 10 readings a second an HX711
rejects it (its data sheet). A lost or doubled clock pulse shifts one reading by a bit, a spike flips one.
"""

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np

FORGETS_WITHIN_S: Final = (0.1, 1.0, 10.0, 100.0)
MAINS_HZ: Final = 50.0
CLOCK_FAST: Final = 1.013
"""The amplifier's own oscillator: its conversions are no whole fraction of the mains' period."""
REJECTS_HZ: Final = 10
BITS: Final = 22


@dataclass(slots=True)
class CellNoise:
    """Add to each reading what is not white.

    Attributes
    ----------
    wander_counts
        Standard deviation of the slow noise.
    hum_counts
        Amplitude of the pick-up.
    lost_every
        Mean number of readings from one lost bit to the next; 0: none is lost.
    """

    wander_counts: float = 0.0
    hum_counts: float = 0.0
    lost_every: float = 0.0
    _slow: list[float] = field(default_factory=lambda: [0.0] * len(FORGETS_WITHIN_S))
    _last_s: float | None = None

    def added(self, now_s: float, rate_hz: int, rng: np.random.Generator) -> float:
        """Return what is added to the reading of this moment (counts)."""
        hum = 0.0 if rate_hz <= REJECTS_HZ else math.sin(2.0 * math.pi * MAINS_HZ * CLOCK_FAST * now_s)
        if self.wander_counts <= 0.0:
            return self.hum_counts * hum
        since_s = math.inf if self._last_s is None else now_s - self._last_s
        self._last_s = now_s
        each = self.wander_counts / math.sqrt(len(FORGETS_WITHIN_S))
        for k, within_s in enumerate(FORGETS_WITHIN_S):
            kept = math.exp(-since_s / within_s)
            self._slow[k] = kept * self._slow[k] + math.sqrt(1.0 - kept**2) * each * rng.standard_normal()
        return sum(self._slow) + self.hum_counts * hum

    def damaged(self, counts: int, rng: np.random.Generator) -> int:
        """Return the count as it arrives: now and then with a bit too many, too few or wrong."""
        if self.lost_every <= 0.0 or rng.random() * self.lost_every >= 1.0:
            return counts
        kind = rng.integers(3)
        return counts * 2 if kind == 0 else counts // 2 if kind == 1 else counts ^ (1 << int(rng.integers(BITS)))
