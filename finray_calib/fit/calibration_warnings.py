"""What a reader of a paint calibration must know before its numbers."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from data_schemas.fit import BandResidual, ChainCheck
from data_schemas.reradiation import Reradiation
from finray_calib.fit.calibration_records import LARGEST_CHAIN_SHIFT_SD, SMALLEST_P
from finray_calib.fit.emission import EmissionPosterior

LARGEST_SHARE_BELOW_LASER: Final = 0.05
LARGEST_VIOLATING_SHARE: Final = 0.01
_CLOSE_MAXIMA_NATS: Final = 5.0


def fit_warnings(
    posterior: EmissionPosterior, bands: Sequence[BandResidual], check: ChainCheck | None, check_asked: bool
) -> tuple[str, ...]:
    """Say what the fit could not explain, leaves open, or could not sample.

    Parameters
    ----------
    posterior
        What was fitted.
    bands
        How well each filter is explained.
    check
        The independent run of emcee, if there was one.
    check_asked
        Whether one was asked for.
    """
    said = []
    bad = [r.filter_name for r in bands if not r.explained]
    if bad:
        said.append(
            f"the model cannot explain filter{'s' if len(bad) > 1 else ''} {', '.join(bad)} (posterior predictive p < "
            f"{SMALLEST_P:g}): check these frames; the intervals are too narrow"
        )
    maxima = posterior.maxima.log_posterior
    if len(maxima) > 1 and maxima[0] - maxima[1] < _CLOSE_MAXIMA_NATS:
        modes = ", ".join(f"{theta[0]:.0f}" for theta in posterior.maxima.theta)
        said.append(f"the bands leave an ambiguity: {len(maxima)} maxima of the posterior, modes at {modes} nm")
    if not posterior.sampling.trusted:
        said.append("the sampling cannot be trusted: importance sampling, moved draws and emcee all fall short")
    if check is not None and max(map(abs, check.mean_shift_sd.values())) > LARGEST_CHAIN_SHIFT_SD:
        said.append("emcee disagrees with the stored draws: do not quote the intervals")
    if check_asked and check is None:
        said.append("the check by emcee was left out: emcee made the draws, a second run would not be independent")
    below = float(np.median(posterior.share_below_laser))
    if below > LARGEST_SHARE_BELOW_LASER:
        said.append(f"{below:.0%} of the fitted curve lies below the laser line, where no paint can emit; it was cut")
    return tuple(said)


def absorption_warnings(reradiation: Reradiation) -> tuple[str, ...]:
    """Say where draws emit more light than the paint can absorb."""
    share = reradiation.violating_share
    if share <= LARGEST_VIOLATING_SHARE:
        return ()
    return (
        f"{share:.0%} of the draws emit more light than the paint can absorb beside its reflectance: emission or "
        "reflectance is too high; check the white reference and the laser's level",
    )
