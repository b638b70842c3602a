"""A filter with a measured curve: what a session stores of it, and what the simulated bench makes of it."""

from pathlib import Path

import numpy as np
import pytest

from data_schemas import BandPassFilter, BandUncertainty, CurveError, PaintPlan, RigFile, SpectralCurve, half_maximum_nm
from data_schemas.storage import sha256_of
from finray_calib.radiometry import rig_optics
from rigs import open_rig
from rigs.capture import SessionRequest, capture_paint_session, read_session
from rigs.simulated._bench import FILTER_TOLERANCE_NM, filter_transmission

CSV = "wavelength_nm,transmission\n590,0\n594,0.1\n598,0.8\n604,0.9\n607,0.3\n615,0\n"


def with_curve(rig: RigFile, name: str, curve: str) -> RigFile:
    """Return the rig with a measured curve of one filter."""
    filters = tuple(f.model_copy(update={"curve": curve}) if f.name == name else f for f in rig.filter_wheel.filters)
    return rig.model_copy(update={"filter_wheel": rig.filter_wheel.model_copy(update={"filters": filters})})


def test_session_stores_the_curve_and_hands_it_to_the_band_signals(rig: RigFile, plan: PaintPlan, tmp_path: Path):
    (tmp_path / "f600.csv").write_text(CSV)
    few = plan.model_copy(update={"filters": ("450", "600"), "bracket": (1.0,), "darks_per_exposure": 1})
    rig = rig.model_copy(update={"band_uncertainty": BandUncertainty(stray_light_rel=0.001)})
    capture_paint_session(
        with_curve(rig, "600", "f600.csv"), few, SessionRequest(tmp_path / "out", "finray capture", rig_folder=tmp_path)
    )
    session = read_session(tmp_path / "out")
    assert list(session.filter_curves) == ["600"]
    np.testing.assert_array_equal(session.filter_curves["600"].values, [0.0, 0.1, 0.8, 0.9, 0.3, 0.0])
    assert session.provenance is not None
    assert session.provenance.input_sha256["f600.csv"] == sha256_of(tmp_path / "f600.csv")
    assert any("transmission measured (f600.csv)" in note for note in session.notes)
    optics = rig_optics(session)
    assert [f.curve for f in optics.filters] == [None, "f600.csv"]
    assert optics.filter_curves["600"]([598.0]) == pytest.approx([0.8])
    assert optics.band_uncertainty.stray_light_rel == 0.001
    # a filter that was not captured takes its curve with it
    assert (
        rig_optics(session.model_copy(update={"plan": plan.model_copy(update={"filters": ("450",)})})).filter_curves
        == {}
    )


def test_curve_of_another_filter_is_refused_before_anything_is_captured(rig: RigFile, tmp_path: Path):
    (tmp_path / "f600.csv").write_text(CSV)
    with (
        pytest.raises(CurveError, match="filter 630 has center_nm = 630"),
        open_rig(with_curve(rig, "630", "f600.csv"), tmp_path),
    ):
        pass
    with pytest.raises(CurveError, match="no such file"), open_rig(with_curve(rig, "630", "f630.csv"), tmp_path):
        pass


def test_bench_filter_follows_its_curve_within_the_tolerance():
    x = np.array([590.0, 594.0, 598.0, 604.0, 607.0, 615.0])
    curve = SpectralCurve(name="f", wavelength_nm=x, values=np.array([0.0, 0.1, 0.8, 0.9, 0.3, 0.0]), source="f.csv")
    optic = BandPassFilter(slot=1, name="600", center_nm=600.0, curve="f.csv")
    fine_nm = np.linspace(560.0, 640.0, 16_001)
    edges = []
    for seed in range(20):
        passed = filter_transmission(fine_nm, optic, np.random.default_rng(seed), curve)
        assert passed.max() == pytest.approx(0.9, abs=1e-3)
        assert -np.log10(passed[0]) == pytest.approx(5.0, abs=0.6)  # 4 sd of the blocking
        seen = SpectralCurve(name="seen", wavelength_nm=fine_nm, values=passed, source="bench")
        edges.append(half_maximum_nm(seen))
    # the monotone cubic crosses the half maximum elsewhere than the straight line between samples 3 and 4 nm apart
    low_nm, high_nm = half_maximum_nm(curve)
    assert np.abs(np.mean(edges, axis=1) - 0.5 * (low_nm + high_nm)).max() < FILTER_TOLERANCE_NM + 0.4
    assert np.std([low for low, _ in edges]) > 0.05
