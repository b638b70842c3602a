"""Measured filter curves: read, checked against the filter that names them, and never left out in silence."""

from pathlib import Path

import numpy as np
import pytest

from data_schemas import (
    BandPassFilter,
    CurveError,
    FieldError,
    LaserSettings,
    Optics,
    RecordError,
    RigFile,
    SpectralCurve,
    WhiteReference,
    coverage_notes,
    half_maximum_nm,
)
from data_schemas.storage import assumed_camera_response, halogen_lamp, read_filter_curve, read_filter_curves, read_toml

FLAT = SpectralCurve(name="flat", wavelength_nm=np.array([300.0, 900.0]), values=np.ones(2), source="flat")


def band(center_nm: float = 600.0, **fields: object) -> BandPassFilter:
    return BandPassFilter.model_validate({"slot": 1, "name": "600", "center_nm": center_nm, "curve": "f.csv", **fields})


def triangle(low_nm: float = 590.0, high_nm: float = 610.0) -> SpectralCurve:
    x = np.array([low_nm, 0.5 * (low_nm + high_nm), high_nm])
    return SpectralCurve(name="f", wavelength_nm=x, values=np.array([0.0, 0.8, 0.0]), source="f.csv")


def test_half_maxima_of_a_triangle_and_of_a_rippled_top():
    assert half_maximum_nm(triangle()) == pytest.approx((595.0, 605.0))
    x = np.array([590.0, 594.0, 597.0, 600.0, 603.0, 606.0, 610.0])
    rippled = SpectralCurve(
        name="f", wavelength_nm=x, values=np.array([0.0, 0.8, 0.3, 0.8, 0.3, 0.8, 0.0]), source="f.csv"
    )
    assert half_maximum_nm(rippled) == pytest.approx((592.0, 608.0))


def test_curves_are_read_by_the_name_of_the_filter(tmp_path: Path):
    (tmp_path / "f.csv").write_text("wavelength_nm,transmission\n590,0\n600,0.8\n610,0\n")
    curves = read_filter_curves([band(), BandPassFilter(slot=2, name="500", center_nm=500.0)], tmp_path)
    assert list(curves) == ["600"]
    assert curves["600"]([600.0, 595.0]) == pytest.approx([0.8, 0.4])
    (tmp_path / "g.csv").write_text("wavelength_nm,transmission\n590,0\n600,80\n610,0\n")
    (tmp_path / "h.csv").write_text("wavelength_nm,percent\n590,0\n600,80\n610,0\n")
    with pytest.raises(CurveError, match="divide by 100"):
        read_filter_curve(tmp_path / "g.csv")
    with pytest.raises(CurveError, match="a filter needs wavelength_nm,transmission"):
        read_filter_curve(tmp_path / "h.csv")


def test_note_says_what_holds_where():
    (note,) = coverage_notes([band()], {"600": triangle()}, [FLAT])
    assert "half of its peak at 595.00 and 605.00 nm" in note
    assert note.endswith("blocking_od is used below 10^-5 and outside 590 to 610 nm")


@pytest.mark.parametrize(
    ("given", "curve", "message"),
    [
        (
            band(594.9),
            triangle(),
            r"centred at 600 nm, but filter 600 has center_nm = 594\.9, and they may differ by at most 5",
        ),
        (band(fwhm_nm=40.0), triangle(), r"of the weight of filter 600 lies outside \(at most 20 % is allowed\)"),
        (band(), triangle(600.0, 601.0).model_copy(update={"values": np.array([0.5, 0.8, 0.0])}), "fall to 50 %"),
    ],
)
def test_curve_of_another_filter_is_refused(given: BandPassFilter, curve: SpectralCurve, message: str):
    with pytest.raises(CurveError, match=message):
        coverage_notes([given], {"600": curve}, [FLAT])


def test_other_curves_must_cover_the_measured_band_not_the_nominal_one():
    short = SpectralCurve(name="short", wavelength_nm=np.array([300.0, 602.0]), values=np.ones(2), source="s.csv")
    with pytest.raises(CurveError, match="32 % of the weight of filter 600 lies outside"):  # (8/10)^2 / 2 of a triangle
        coverage_notes([band()], {"600": triangle()}, [short])
    assert coverage_notes([band(597.0)], {"600": triangle(587.0, 607.0)}, [short])[1].startswith("short covers")


@pytest.mark.parametrize(
    ("curve", "curves", "message"),
    [
        ("f.csv", {}, "the curve f.csv of filter '600' is missing"),
        (None, {"600": triangle()}, "'600' is not a filter with a curve assigned to it"),
    ],
)
def test_record_refuses_a_curve_too_few_or_too_many(curve: str | None, curves: dict[str, SpectralCurve], message: str):
    with pytest.raises(FieldError, match=message):
        Optics(
            filters=(band(curve=curve),),
            excitation_filter="600",
            laser=LaserSettings(),
            lamp=halogen_lamp(),
            white_reference=WhiteReference(),
            camera_response=assumed_camera_response(),
            filter_curves=curves,
        )


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({"curve": None}, (0.9, 0.6)),
        ({}, (0.15, 0.15)),
        ({"center_uncertainty_nm": 0.3, "fwhm_uncertainty_nm": 0.4}, (0.3, 0.4)),
    ],
)
def test_uncertainty_that_is_not_given_is_that_of_a_catalogue_or_of_a_measurement(fields, expected):
    given = band(**fields)
    assert (given.center_uncertainty_nm, given.fwhm_uncertainty_nm) == expected


def test_a_wrong_centre_is_one_fault(tmp_path: Path):
    (tmp_path / "rig.toml").write_text('name = "r"\n[[filter_wheel.filters]]\nslot = 1\nname = "a"\ncenter_nm = 0.6\n')
    with pytest.raises(RecordError) as raised:
        read_toml(tmp_path / "rig.toml", RigFile)
    assert "center_nm' (in nm)" in str(raised.value)
    assert "uncertainty" not in str(raised.value)
