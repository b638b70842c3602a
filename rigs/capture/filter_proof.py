r"""Optical proof of the filters: whether the lamp-lit white frames show what the wheel claims.

The rate of channel c behind filter f on the white tile is, up to one factor (aperture, lamp level, exposure),

.. math:: r_{fc} = \int T_f(\lambda) \, R_c(\lambda) \, L(\lambda) \, d\lambda

with the filter's nominal or measured transmission T, the camera's response R and the lamp's spectrum L. An exchange of
two filters that explains the measured logarithms clearly better than the claimed order convicts the wheel, and so does
one filter in the beam at all slots (a wheel that counts and does not turn). An exchange that explains them about as
well cannot be told from the claimed order, and is named.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from data_schemas.band_pass_filter import BandPassFilter
from data_schemas.capture import CaptureSession, FilterProof
from data_schemas.curves import SpectralCurve

FloatArray = NDArray[np.float64]

GRID_NM = np.arange(380.0, 781.0)
MODEL_SD_LN = 0.30
"""Standard deviation of ln(rate) around its prediction: response, lamp and filter data of a catalogue (about 30 %)."""
FLOOR_FRACTION = 0.02
"""Of a filter's brightest channel, which fills most of the camera's range: dimmer ones are mostly dark noise."""
TRUSTED_FRACTION = 0.1  # of a filter's brightest channel: bright enough, in one session, to be compared with the other
CLEAR_DIFFERENCE = 12.0
"""Of chi-square: an exchange this much better or worse is decided (odds of e^6)."""
LIT_SHARE = 0.5  # of the rate with the lamp on: what is left of it without the lamp, when the lamp lights the picture
LEAST_RATE_DN_PER_S = 1.0
LEAST_RELATIVE = 1e-6  # of all rates: a filter that passes nothing at all
FEWEST_COMMON = 3
LARGEST_DRIFT_LN = 0.15
"""Of one filter against the median of all: lamps age and filters gather dust by a few per cent."""


def predicted_rates(
    filters: Sequence[BandPassFilter],
    filter_curves: Mapping[str, SpectralCurve],
    lamp: SpectralCurve,
    response: Sequence[SpectralCurve],
) -> FloatArray:
    """Return the relative rates of filters and channels on the white tile under the lamp, (F, 3).

    Parameters
    ----------
    filters
        What the wheel is said to hold.
    filter_curves
        Measured transmissions by the filter's name.
    lamp
        Relative spectral irradiance.
    response
        Relative response of red, green and blue.
    """
    light = lamp(GRID_NM) * np.array([curve(GRID_NM) for curve in response])
    return np.array([light @ transmission(f, filter_curves.get(f.name)) for f in filters])


def judge_filters(
    names: Sequence[str],
    measured: FloatArray,
    predicted: FloatArray,
    lamp_off: Callable[[], Sequence[float]] = lambda: (0.0, 0.0, 0.0),
    apart: Collection[frozenset[str]] = (),
) -> FilterProof:
    """Return whether the measured rates show the filters in the claimed order.

    All exchanges of two filters are tried, and each filter at all slots. Another wrong order is seen as the exchange
    that undoes most of it.

    Parameters
    ----------
    names
        (F,) names of the filters in the claimed order.
    measured
        (F, 3) rates above the dark level, DN/s.
    predicted
        (F, 3) relative rates.
    lamp_off
        Returns the 3 rates behind the first filter with the lamp off, DN/s. Asked only when all slots look alike: a
        camera that shows a picture of its own looks so, too.
    apart
        Pairs of filters that are known not to be exchanged, from the laser's line.
    """
    if measured.max() < LEAST_RATE_DN_PER_S:
        return FilterProof(
            verdict="cannot tell",
            text="the white tile is dark through every filter: the lamp is off, or this camera sees nothing",
        )
    if len(names) < 2:
        return FilterProof(verdict="cannot tell", text="one filter alone has nothing to be compared with")
    ln_measured, ln_predicted = _levels(measured), _levels(predicted)
    stuck = _only_filter(ln_measured, ln_predicted)
    if stuck is not None:
        still_lit = bool(sum(lamp_off()) > LIT_SHARE * measured[0].sum())
        return _alike_at_every_slot(names[stuck], still_lit)
    better, unclear_pairs = _exchanges(names, ln_measured, ln_predicted)
    if better:
        return FilterProof(
            verdict="contradicted",
            text=f"the frames fit much better with filters {max(better)[1]} exchanged; look into the wheel and "
            "correct the slots of the rig file, or put the filters right",
        )
    unclear = [" and ".join(pair) for pair in unclear_pairs if frozenset(pair) not in apart]
    if unclear:
        return FilterProof(
            verdict="cannot tell",
            text="the frames cannot tell apart filters " + ", ".join(unclear) + "; the others are where they should be",
        )
    return FilterProof(verdict="confirmed", text="the frames show every filter in its slot")


def _alike_at_every_slot(name: str, still_lit: bool) -> FilterProof:
    """Return what frames prove that show one filter at every slot, whether or not the lamp is on."""
    if still_lit:
        return FilterProof(
            verdict="cannot tell",
            text="the picture is alike at every slot and hardly changes when the lamp goes off: this camera does not "
            "see it, or other light does the work",
        )
    return FilterProof(
        verdict="contradicted",
        text=f"the frames show filter {name} at every slot: the wheel counts and does not turn; look at its motor, "
        "belt and filters",
    )


def _exchanges(
    names: Sequence[str], measured: FloatArray, predicted: FloatArray
) -> tuple[list[tuple[float, str]], list[tuple[str, str]]]:
    """Return the exchanges of two filters that explain the frames clearly better, and those that do so about as well.

    The former with what chi-square falls by.
    """
    order = np.arange(len(names))
    better: list[tuple[float, str]] = []
    unclear: list[tuple[str, str]] = []
    for first, second in combinations(range(len(names)), 2):
        exchanged = order.copy()
        exchanged[[first, second]] = exchanged[[second, first]]
        gain = _chi_square(measured, predicted) - _chi_square(measured, predicted[exchanged])
        pair = names[first], names[second]
        if gain > CLEAR_DIFFERENCE:
            better.append((gain, " and ".join(pair)))
        elif gain > -CLEAR_DIFFERENCE:
            unclear.append(pair)
    return better, unclear


def compare_with_last(names: Sequence[str], measured: FloatArray, last: CaptureSession) -> FilterProof:
    """Return whether the white rates are those of an earlier session, up to one factor (aperture, lamp level).

    Parameters
    ----------
    names
        (F,) names of the filters.
    measured
        (F, 3) rates above the dark level, DN/s.
    last
        The earlier session on the same rig.
    """
    if measured.max() < LEAST_RATE_DN_PER_S:
        return FilterProof(
            verdict="cannot tell", text="the white tile is dark, so that it cannot repeat an earlier session"
        )
    before = dict(zip(_white_filters(last), last.white_rates_dn_per_s, strict=False))
    common = [name for name in names if name in before]
    if len(common) < FEWEST_COMMON:
        return FilterProof(
            verdict="cannot tell", text=f"the earlier session shares only {len(common)} filters with this one"
        )
    now, then = measured[[list(names).index(name) for name in common]], np.array([before[name] for name in common])
    bright = (_share_of_brightest(now) > TRUSTED_FRACTION) | (_share_of_brightest(then) > TRUSTED_FRACTION)
    apart = _levels(now) - _levels(then)
    off = np.where(bright, np.abs(apart - np.median(apart[bright])), 0.0).max(axis=1)
    worst = int(off.argmax())
    if off[worst] > LARGEST_DRIFT_LN:
        return FilterProof(
            verdict="contradicted",
            text=f"behind filter {common[worst]} the white tile differs from the earlier session by a factor of "
            f"{np.exp(off[worst]):.2f} (up to {np.exp(LARGEST_DRIFT_LN):.2f} is drift): a filter was changed, soiled "
            "or slipped, or the lamp was replaced",
        )
    return FilterProof(
        verdict="confirmed",
        text=f"the white frames repeat those of the earlier session within {np.expm1(off[worst]):.1%} behind "
        f"{len(common)} filters",
    )


def _white_filters(session: CaptureSession) -> list[str]:
    """Return the filters of a session's white frames in their order."""
    return list(dict.fromkeys(str(f.filter_name) for f in session.frames if f.frame_type == "white"))


def _only_filter(measured: FloatArray, predicted: FloatArray) -> int | None:
    """Return the filter that explains the frames of all slots, clearly better than the claimed order; None without."""
    alike = [_chi_square(measured, np.broadcast_to(row, measured.shape)) for row in predicted]
    best = int(np.argmin(alike))
    # one filter has one set of three errors of the model: a grey picture, of no camera that sees the lamp, fits none
    fits = _chi_square(measured.mean(axis=0), predicted[best]) < CLEAR_DIFFERENCE
    return best if fits and _chi_square(measured, predicted) - alike[best] > CLEAR_DIFFERENCE else None


def _levels(rates: FloatArray) -> FloatArray:
    """Return ln(rate) with the dim channels of each filter held at a floor."""
    brightest = np.maximum(rates.max(axis=1, keepdims=True), LEAST_RELATIVE * rates.max())
    return np.asarray(np.log(np.maximum(rates, FLOOR_FRACTION * brightest)))


def _share_of_brightest(rates: FloatArray) -> FloatArray:
    """Return each rate over the brightest of its filter."""
    brightest = np.maximum(rates.max(axis=1, keepdims=True), LEAST_RELATIVE * rates.max())
    return np.asarray(rates / brightest)


def _chi_square(measured: FloatArray, predicted: FloatArray) -> float:
    """Return the squared deviations over their variance after the best common factor."""
    apart = measured - predicted
    return float(np.square((apart - apart.mean()) / MODEL_SD_LN).sum())


def transmission(band: BandPassFilter, curve: SpectralCurve | None) -> FloatArray:
    """Return the transmission of a filter on the grid: the measured one where there is a curve."""
    floor = 10.0**-band.blocking_od
    if curve is not None:
        inside = (curve.wavelength_nm[0] <= GRID_NM) & (curve.wavelength_nm[-1] >= GRID_NM)
        return np.asarray(np.where(inside, np.maximum(curve(GRID_NM), floor), floor))
    off = np.abs(2 * (GRID_NM - band.center_nm) / band.fwhm_nm) ** (2 * band.shape_order)
    return np.asarray(band.peak_transmission * np.exp2(-np.minimum(off, 1000.0)) + floor)
