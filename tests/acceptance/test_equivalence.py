"""Equivalence of two tins: the risk of calling different tins equivalent, the power, and what cannot be compared."""

import numpy as np
import pytest
from scipy import stats

from data_schemas import FinrayError, PriorShare
from finray_calib.acceptance import tins_are_equivalent
from tests.acceptance.paints import example, normal, paint

RUNS = 2000
COAT_SD_NM = 2.0


def coats(values_nm):
    """Return coats whose prior has no say."""
    return [paint(mode_nm=normal(value, 0.5)).model_copy(update={"prior_shares": {}}) for value in values_nm]


def verdicts(rng, *, apart_nm: float, margin_nm: float, coats_per_tin: int, sd_nm=(COAT_SD_NM, COAT_SD_NM)):
    found = []
    for _ in range(RUNS):
        tins = [coats(rng.normal(c, sd, coats_per_tin)) for c, sd in zip((600.0, 600.0 + apart_nm), sd_nm, strict=True)]
        found.append(tins_are_equivalent(*tins, {"mode_nm": margin_nm})[0].verdict)
    return {name: found.count(name) / RUNS for name in ("PASS", "FAIL", "UNDECIDED")}


@pytest.fixture(autouse=True)
def same_rig(monkeypatch):
    """Thousands of comparisons of one example's optics with itself tell nothing and take long."""
    monkeypatch.setattr("finray_calib.acceptance._equivalence._in_text", lambda optics: "")


@pytest.mark.parametrize(("coats_per_tin", "sd_nm"), [(3, (2.0, 2.0)), (6, (2.0, 2.0)), (5, (0.7, 3.0))])
def test_tins_at_the_margin_are_called_equivalent_in_at_most_five_percent(coats_per_tin, sd_nm):
    """And different in at most as many; three standard errors of 5 % in 2000 runs are 1.5 %."""
    found = verdicts(np.random.default_rng(1), apart_nm=4.0, margin_nm=4.0, coats_per_tin=coats_per_tin, sd_nm=sd_nm)
    assert found["PASS"] <= 0.065
    assert found["FAIL"] <= 0.065


def test_power_of_equal_tins_is_that_of_the_formula():
    """n = 2 (z.95 + z.95)^2 (s / D)^2 coats of each tin give a power of 0.90 with a known s; Student's t costs some."""
    n = 12
    margin_nm = COAT_SD_NM * np.sqrt(2 * (2 * stats.norm.ppf(0.95)) ** 2 / n)
    found = verdicts(np.random.default_rng(2), apart_nm=0.0, margin_nm=margin_nm, coats_per_tin=n)
    assert 0.84 <= found["PASS"] <= 0.92
    assert found["FAIL"] == 0.0


def test_interval_is_that_of_welch():
    """Against scipy's own interval of the difference of two means."""
    rng = np.random.default_rng(3)
    one, other = rng.normal(600, 2, 5), rng.normal(603, 1, 4)
    found = tins_are_equivalent(coats(one), coats(other), {"mode_nm": 10.0})[0]
    interval = stats.ttest_ind(other, one, equal_var=False).confidence_interval(0.90)
    assert (found.low90, found.high90) == pytest.approx((interval.low, interval.high))


def test_a_prior_that_pulls_tins_together_makes_none_equivalent():
    """With 40 % of the prior's variance left, estimates show 60 % of a difference: it is divided by that."""
    shrunk = [
        [p.model_copy(update={"prior_shares": {"mode_nm": PriorShare(share=0.4, shift_sd=0.0)}}) for p in coats(values)]
        for values in ((600.0, 600.2, 599.8), (603.0, 603.2, 602.8))
    ]
    found = tins_are_equivalent(*shrunk, {"mode_nm": 4.0})[0]
    assert found.difference == pytest.approx(5.0)
    assert found.verdict == "FAIL"


def test_what_is_mostly_prior_is_not_decided():
    of_prior = {"mode_nm": PriorShare(share=0.6, shift_sd=0.0)}
    alike = [p.model_copy(update={"prior_shares": of_prior}) for p in coats((600.0, 600.1))]
    found = tins_are_equivalent(alike, alike, {"mode_nm": 4.0})[0]
    assert (found.verdict, found.basis[:12]) == ("UNDECIDED", "mostly prior")


def test_one_coat_is_judged_by_its_draws_and_says_so():
    found = tins_are_equivalent([example()], [example()], {"reflectance_at_laser": 1.0, "mode_nm": 1e-6})
    assert [one.verdict for one in found] == ["PASS", "UNDECIDED"]
    assert all("not counted at all" in one.basis for one in found)
    sd = np.sqrt(2) * example().parameters["reflectance_at_laser"].sd
    assert found[0].high90 == pytest.approx(stats.norm.ppf(0.95) * sd, rel=0.01)


def shifted(share: float):
    """Return coats whose spectra differ from the example's by a share of its peak at one wavelength, and by chance."""
    rng = np.random.default_rng(5)
    curve, peak = example().emission_per_nm, example().emission_per_nm.max()
    moved = curve + share * peak * (np.arange(curve.size) == curve.argmax())
    return [
        example().model_copy(update={"emission_per_nm": moved + 0.01 * peak * rng.standard_normal(curve.size)})
        for _ in range(6)
    ]


@pytest.mark.parametrize(("share", "verdict"), [(0.0, "PASS"), (0.1, "UNDECIDED"), (0.3, "FAIL")])
def test_a_spectrum_differs_where_one_wavelength_does(share, verdict):
    found = tins_are_equivalent(shifted(0.0), shifted(share), {"spectrum": 0.1})[0]
    assert found.verdict == verdict


def test_spectra_of_one_coat_are_judged_by_their_draws():
    assert tins_are_equivalent([example()], [example()], {"spectrum": 1e3})[0].verdict == "PASS"


def test_what_cannot_be_compared(monkeypatch):
    monkeypatch.undo()
    one = [example()]
    with pytest.raises(FinrayError, match="of at least one coat"):
        tins_are_equivalent(one, [], {"mode_nm": 1.0})
    with pytest.raises(FinrayError, match="no margin"):
        tins_are_equivalent(one, one, {})
    for margin in (0.0, -1.0, float("inf"), float("nan")):
        with pytest.raises(FinrayError, match="must be a number above 0"):
            tins_are_equivalent(one, one, {"mode_nm": margin})
    bad = example().model_copy(update={"diagnostics": example().diagnostics.model_copy(update={"trusted": False})})
    with pytest.raises(FinrayError, match="draws of this fit cannot be trusted"):
        tins_are_equivalent(one, [bad], {"mode_nm": 1.0})
    warm = example().model_copy(update={"optics": example().optics.model_copy(update={"lamp_temperature_k": 3000.0})})
    with pytest.raises(FinrayError, match="on the same rig"):
        tins_are_equivalent(one, [warm], {"mode_nm": 1.0})
    longer = example().model_copy(update={"wavelength_nm": example().wavelength_nm + 1.0})
    with pytest.raises(FinrayError, match="is not tabulated at the wavelengths of the other coats"):
        tins_are_equivalent(one, [longer], {"mode_nm": 1.0})
