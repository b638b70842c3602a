r"""Optical proof of the excitation filter: whether the laser's line comes through it and through no other.

In the camera's channel that sees the line best, with response R, the white tile behind the excitation filter x gives
the rate w of the line itself, and the sample under the laser behind a filter f no more light, wherever in its band:

.. math:: \frac{s_f}{w} \le \frac{\max_{\lambda \ge \lambda_L} T_f(\lambda) R(\lambda)}{T_x(\lambda_L) R(\lambda_L)}

because a paint sends back no more than falls on it, and nothing below the line. Were x and f exchanged, the ratio would
be that of the line, reflected by the sample, to what leaks through f: at least rho T_x / T_f at the line, with a
reflectance rho of the sample. A ratio far above the first convicts the wheel; one far below the second shows that x and
f are not exchanged, however alike the lamp makes them look.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from data_schemas.band_pass_filter import BandPassFilter
from data_schemas.capture import FilterProof
from data_schemas.curves import SpectralCurve
from rigs.capture.filter_proof import CLEAR_DIFFERENCE, GRID_NM, LEAST_RELATIVE, LIT_SHARE, MODEL_SD_LN, transmission

CLEAR_FACTOR = float(np.exp(np.sqrt(2.0 * CLEAR_DIFFERENCE) * MODEL_SD_LN))
"""By which a ratio of two rates differs from its prediction before it decides."""
LEAST_REFLECTANCE = 0.01
"""Of a sample at the laser's wavelength: black flocking reflects as much."""
LEAST_RATE_DN_PER_S = 5.0
"""Of the line: dimmer ones may be dark current or stray light."""


class LaserLine:
    """What the laser shows behind the filters of a session.

    Parameters
    ----------
    filters
        (F,) what the wheel is said to hold.
    excitation
        Name of the filter that passes the laser.
    laser_nm
        Wavelength of the laser.
    filter_curves
        Measured transmissions by the filter's name.
    response
        Relative response of red, green and blue.
    white_dn_per_s
        Rates of red, green and blue on the white tile under the laser behind the excitation filter.
    sample_dn_per_s
        (F, 3) those of the sample under the laser behind each filter.
    """

    def __init__(
        self,
        filters: Sequence[BandPassFilter],
        excitation: str,
        laser_nm: float,
        filter_curves: Mapping[str, SpectralCurve],
        response: Sequence[SpectralCurve],
        white_dn_per_s: Sequence[float],
        sample_dn_per_s: Sequence[Sequence[float]],
    ) -> None:
        curves = np.array([curve(GRID_NM) for curve in response])
        line = int(np.abs(GRID_NM - laser_nm).argmin())
        self._channel = channel = int(curves[:, line].argmax())
        passed = {f.name: transmission(f, filter_curves.get(f.name)) for f in filters}
        through = passed[excitation][line]
        others = [(k, f) for k, f in enumerate(filters) if f.name != excitation]
        self._excitation, self._others = excitation, [f.name for _, f in others]
        sent = np.array([(passed[f.name] * curves[channel])[line:].max() for _, f in others])
        # what a filter should not pass at all may still be stray light: never more than the line itself
        self._most = np.maximum(sent / max(through * curves[channel, line], LEAST_RELATIVE), 1.0)
        leaks = np.array([passed[f.name][line] * 10.0**f.blocking_uncertainty_od for _, f in others])
        self._if_exchanged = LEAST_REFLECTANCE * through / leaks
        self._rates = np.array([sample_dn_per_s[k][channel] for k, _ in others])
        self._white = max(float(white_dn_per_s[channel]), LEAST_RATE_DN_PER_S)

    def judge(self, laser_off: Callable[[str], Sequence[float]]) -> FilterProof:
        """Return whether the laser's line comes through the excitation filter.

        Parameters
        ----------
        laser_off
            Returns the 3 rates of the sample behind a filter with the laser off, DN/s. Asked only before a
            conviction: a camera that shows a picture of its own does not see the laser.
        """
        if not self._others:
            return FilterProof(verdict="cannot tell", text="the laser's line has no other filter to come through")
        most = int((self._rates / self._most).argmax())
        name, rate = self._others[most], float(self._rates[most])
        if rate > CLEAR_FACTOR * self._most[most] * self._white:
            if laser_off(name)[self._channel] > LIT_SHARE * rate:
                return FilterProof(verdict="cannot tell", text="the sample looks the same when the laser goes off")
            return FilterProof(
                verdict="contradicted",
                text=f"under the laser the sample behind filter {name} is {rate / self._white:.3g} times as bright as "
                f"the laser's line on the white tile behind filter {self._excitation}, which no paint can be: "
                f"{self._excitation} and {name} are exchanged, or the laser did not reach the tile; look into the "
                "wheel and correct the slots of the rig file, or put filters and tile right",
            )
        if not self._is_seen():
            return FilterProof(verdict="cannot tell", text="the camera does not see the laser's line")
        unclear = [other for other in self._others if other not in self.not_exchanged()]
        if unclear:
            return FilterProof(
                verdict="cannot tell",
                text=f"the laser's line comes through {self._excitation} or {' or '.join(unclear)}",
            )
        return FilterProof(
            verdict="confirmed", text=f"the laser's line comes through filter {self._excitation} and no other"
        )

    def not_exchanged(self) -> frozenset[str]:
        """Return the names of the filters that the line shows not to be in the excitation filter's place."""
        if not self._others or not self._is_seen():
            return frozenset()
        clear = self._rates * CLEAR_FACTOR < self._if_exchanged * self._white
        return frozenset(name for name, is_clear in zip(self._others, clear, strict=True) if is_clear)

    def _is_seen(self) -> bool:
        """Whether the line is there, and fades behind some filter as a picture of the camera's own would not."""
        return self._white > LEAST_RATE_DN_PER_S and float(self._rates.min()) < LIT_SHARE * self._white
