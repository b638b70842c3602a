"""Certified results: coverage factors and conformity of known distributions, and traceability."""

from datetime import date

import numpy as np
import pytest
from scipy import stats

from data_schemas import (
    CertificateDetails,
    CertifiedLimits,
    FinrayError,
    PriorShare,
    RecordError,
    ReferenceCertificate,
)
from data_schemas.storage import read_toml
from finray_calib.acceptance import NO_REFERENCE, ToleranceInterval, certified_results
from finray_calib.acceptance import _conformity as module
from finray_calib.fit import estimate
from tests.acceptance.paints import MEASURED_ON, example, normal, paint


def certificate(of: str, calibrated_on: str = "2026-03-02", valid_until: str | None = "2027-03-02"):
    return ReferenceCertificate(
        of=of, number=f"no. {of}", issued_by="institute", calibrated_on=calibrated_on, valid_until=valid_until
    )


def result(name: str, details: CertificateDetails | None = None, of=None, day: date | None = MEASURED_ON):
    results = certified_results(of or example(), details or CertificateDetails(), day)
    return next(r for r in results if r.name == name)


def test_normal_draws_have_a_coverage_factor_of_1_96():
    found = result("mode_nm", of=paint(mode_nm=normal(600.0, 2.0)))
    assert found.coverage_factor == pytest.approx(1.959964)
    assert found.expanded == pytest.approx(2.0 * 1.959964)


def test_rectangular_draws_have_a_coverage_factor_of_1_65():
    """JCGM 100, G.1.3 note: 95 % of a rectangular distribution lie within 1.65 standard deviations."""
    draws = np.linspace(-1.0, 1.0, 20001)
    assert result("mode_nm", of=paint(mode_nm=estimate(draws))).coverage_factor == pytest.approx(1.645, abs=2e-3)


@pytest.mark.parametrize("limit", [0.3, 0.7, 1.0, 1.6, 2.6])
def test_conformity_of_skewed_draws(limit):
    """A log-normal quantity: within 0.02 of its true probability, exact at the quantiles that the record holds."""
    truth = stats.lognorm(0.4)
    found = estimate(truth.ppf((np.arange(4000) + 0.5) / 4000))
    assert module.conformity_of(found, ToleranceInterval(None, limit)) == pytest.approx(truth.cdf(limit), abs=0.02)
    for level in (0.025, 0.16, 0.5, 0.84, 0.975):
        ends = ToleranceInterval(None, float(truth.ppf(level)))
        assert module.conformity_of(found, ends) == pytest.approx(level, abs=2e-3)


def test_a_quantity_without_width_on_one_side():
    """A reflectance at 0: nothing lies below it."""
    at_end = normal(0.0, 0.1).model_copy(update={"low95": 0.0, "low68": 0.0})
    assert module.conformity_of(at_end, ToleranceInterval(-0.1, None)) == 1.0
    assert module.conformity_of(at_end, ToleranceInterval(None, -0.1)) == 0.0


def test_at_the_limit_five_percent_pass_and_five_fail():
    """20,000 measurements of a quantity that lies at its limit; 4 standard errors of a share are 0.6 %."""
    rng = np.random.default_rng(4)
    limits = ToleranceInterval(None, 600.0)
    p = np.array([module.conformity_of(normal(y, 2.0), limits) for y in rng.normal(600.0, 2.0, 20_000)])
    assert (p >= module.CONFORMS_FROM).mean() == pytest.approx(0.05, abs=0.006)
    assert (p <= 1 - module.CONFORMS_FROM).mean() == pytest.approx(0.05, abs=0.006)


def test_limits_give_a_verdict():
    limits = CertificateDetails(limits=(CertifiedLimits(quantity="mode_nm", low=590.0, high=610.0),))
    for mode_nm, verdict in ((600.0, "PASS"), (609.0, "UNDECIDED"), (620.0, "FAIL")):
        found = result("mode_nm", limits, paint(mode_nm=normal(mode_nm, 2.0)))
        assert found.verdict == verdict
        assert 0.0 <= found.p_conform <= 1.0
    assert result("fwhm_nm", limits).verdict is None


def test_what_is_mostly_prior_is_not_certified():
    share = {"mode_nm": PriorShare(share=0.6, shift_sd=0.0)}
    of = example().model_copy(update={"prior_shares": share})
    limits = CertificateDetails(limits=(CertifiedLimits(quantity="mode_nm", low=0.0, high=2000.0),))
    found = result("mode_nm", limits, of)
    assert not found.is_measured
    assert (found.p_conform, found.verdict) == (None, "UNDECIDED")


def test_traceable_only_through_certificates_of_that_day():
    whole = tuple(map(certificate, ("white reference", "filters", "lamp")))
    assert result("mode_nm").traceability == NO_REFERENCE
    assert result("mode_nm", CertificateDetails(references=whole)).traceability.startswith("traceable through white")
    white = CertificateDetails(references=whole[:1])
    assert result("mode_nm", white).traceability.startswith("not traceable: no certificate valid")
    assert result("reflectance_at_laser", white).traceability.startswith("traceable through")
    for late in (
        certificate("white reference", valid_until="2026-11-23"),
        certificate("white reference", "2026-11-25"),
    ):
        details = CertificateDetails(references=(late,))
        assert result("reflectance_at_laser", details).traceability.startswith("not traceable")


def test_an_unknown_day_is_within_no_validity():
    ends = CertificateDetails(references=(certificate("white reference"),))
    endless = CertificateDetails(references=(certificate("white reference", valid_until=None),))
    assert result("reflectance_at_laser", ends, day=None).traceability.startswith("not traceable")
    assert result("reflectance_at_laser", endless, day=None).traceability.startswith("traceable")


def test_draws_that_cannot_be_trusted_are_not_certified():
    bad = example().model_copy(update={"diagnostics": example().diagnostics.model_copy(update={"trusted": False})})
    with pytest.raises(FinrayError, match="draws of this fit cannot be trusted"):
        certified_results(bad, CertificateDetails(), None)
    with pytest.raises(FinrayError, match="mode_nm has no uncertainty"):
        certified_results(paint(mode_nm=normal(600.0, 0.0)), CertificateDetails(), None)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ('[[limits]]\nquantity = "mode_nm"', "neither low nor high is given"),
        ('[[limits]]\nquantity = "mode_nm"\nlow = 2\nhigh = 1', "must not be above"),
        ('[[limits]]\nquantity = "mode_nm"\nlow = 2\n[[limits]]\nquantity = "mode_nm"\nlow = 2', "given twice"),
        ('[[references]]\nof = "sun"\nnumber = "1"\nissued_by = "i"\ncalibrated_on = 2026-01-01', "white reference"),
    ],
)
def test_mistakes_in_the_file_of_a_laboratory(tmp_path, text, match):
    path = tmp_path / "laboratory.toml"
    path.write_text(text)
    with pytest.raises(RecordError, match=match):
        read_toml(path, CertificateDetails)
