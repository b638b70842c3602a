"""Estimates with 68 % and 95 % intervals from a value and its standard deviation; upper limits where unresolved."""

from collections.abc import Callable

from data_schemas.camera import Resolvable
from data_schemas.estimate import Estimate

Z68, Z95, Z95_ONE_SIDED = 0.9944578832, 1.9599639845, 1.6448536270


def normal_estimate(mean: float, sd: float) -> Estimate:
    """Return the estimate of a normally distributed value, in its unit."""
    return Estimate(
        estimate=mean,
        sd=sd,
        low68=mean - Z68 * sd,
        high68=mean + Z68 * sd,
        low95=mean - Z95 * sd,
        high95=mean + Z95 * sd,
    )


def non_negative(mean: float, sd: float, low: float = 0.0) -> Resolvable:
    """Return the estimate of a quantity that cannot be negative, with its upper limit when it is not resolved.

    Parameters
    ----------
    mean, sd
        Measured value, negative by noise perhaps, and its standard deviation.
    low
        What noise alone would give on average; the lower ends of the intervals are lowered by it.
    """
    return _limited(mean, sd, low, lambda value: value)


def root_of(mean: float, sd: float, factor: float = 1.0) -> Resolvable:
    """Return `factor` times the square root of a measured variance, which noise may have made negative.

    Parameters
    ----------
    mean, sd
        Measured variance and its standard deviation, in the square of the result's unit over `factor`.
    factor
        Conversion to the result's unit.
    """
    return _limited(mean, sd, 0.0, lambda variance: factor * float(variance**0.5))


def _limited(mean: float, sd: float, low: float, scale: Callable[[float], float]) -> Resolvable:
    """Cut the intervals at zero and bring their ends to `scale`, which grows from 0."""

    def end(z: float) -> float:
        return scale(max(mean + z * sd - low * (z < 0), 0.0))

    resolved = end(-Z95) > 0.0
    low68, high68 = end(-Z68), end(Z68)
    return Resolvable(
        estimate=scale(max(mean, 0.0)),
        sd=0.5 * (high68 - low68),
        low68=low68,
        high68=high68,
        low95=end(-Z95),
        high95=scale(max(mean, 0.0) + (Z95 if resolved else Z95_ONE_SIDED) * sd),
        resolved=resolved,
    )
