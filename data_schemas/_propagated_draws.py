"""Posterior draws carried through a function of the user: what it returns, with its uncertainty."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from data_schemas._model import Estimate
from data_schemas._record_text import interval_text
from data_schemas.errors import RecordError

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, repr=False)
class PropagatedDraws:
    """What a function made of each posterior draw.

    Attributes
    ----------
    draws
        (N, ...) what the function returned for draw 1 to N, in its own unit.
    """

    draws: Floats

    @property
    def estimate(self) -> Any:
        """Median over the draws: a number, or an array of the shape that the function returns."""
        return np.median(self.draws, axis=0)

    @property
    def sd(self) -> Any:
        """Standard deviation over the draws, shaped as `estimate`."""
        return self.draws.std(axis=0, ddof=1)

    @property
    def low95(self) -> Any:
        """Lower end of the equal-tailed 95 % interval, shaped as `estimate`."""
        return np.quantile(self.draws, 0.025, axis=0)

    @property
    def high95(self) -> Any:
        """Upper end of the equal-tailed 95 % interval, shaped as `estimate`."""
        return np.quantile(self.draws, 0.975, axis=0)

    def as_estimate(self) -> Estimate:
        """Return the summary of a function that returns one number.

        Raises
        ------
        RecordError
            The function returns an array.
        """
        if self.draws.ndim != 1:
            raise RecordError(
                f"an estimate is of one number, and the function returned arrays of shape {self.draws.shape[1:]}; take "
                "estimate, sd, low95 and high95, which have that shape"
            )
        low95, low68, estimate, high68, high95 = np.quantile(self.draws, [0.025, 0.16, 0.5, 0.84, 0.975])
        sd = float(self.draws.std(ddof=1))
        return Estimate(estimate=estimate, sd=sd, low68=low68, high68=high68, low95=low95, high95=high95)

    def __repr__(self) -> str:
        if self.draws.ndim == 1:
            return interval_text(float(self.estimate), float(self.low95), float(self.high95))
        return f"PropagatedDraws: {len(self.draws)} draws of shape {self.draws.shape[1:]}; see estimate, low95, high95"


def propagate_draws(draws: Floats, function: Callable[[Floats], ArrayLike]) -> PropagatedDraws:
    """Call a function once for each draw.

    Parameters
    ----------
    draws
        (N, ...) posterior draws, N at least 2.
    function
        Takes one draw; returns a number or an array, of the same shape each time.

    Raises
    ------
    RecordError
        The function returned different shapes, or what is no finite number.
    """
    made = [np.asarray(function(draw)) for draw in draws]
    shapes = {one.shape for one in made}
    if len(shapes) != 1 or any(one.dtype.kind not in "fuib" for one in made):
        raise RecordError(
            f"the function must return a number, or an array of one shape, for every draw; it returned "
            f"{', '.join(sorted({f'{one.dtype} of shape {one.shape}' for one in made}))}"
        )
    values = np.array(made, dtype=np.float64)
    if not np.isfinite(values).all():
        bad = int((~np.isfinite(values)).reshape(len(values), -1).any(axis=1).sum())
        raise RecordError(
            f"the function returned NaN or an infinite value for {bad} of {len(values)} draws, so that no interval can "
            "be given; make it return a number for every emission, also where a draw is slightly below 0"
        )
    return PropagatedDraws(values)
