"""What the reference integrators and their paints refuse, and how they say it; the door to their variants."""

import numpy as np
import pytest

from data_schemas import LightPanel, MissingExtraError, SimulateError
from sim.optics import PaintOptics, paint_bands
from sim.optics import _renderer as variants
from sim.optics._paint_bands import led_band
from tests.simulate.spectral_paths import FluorescentPaint, fluorescent_paint

W = np.array([400.0, 450.0, 600.0, 700.0])
NONE = np.zeros(4)


def absorbing(paint, peak_nm):
    absorption = np.exp(-0.5 * ((paint.wavelength_nm - peak_nm) / 30.0) ** 2)
    return PaintOptics(paint.name, paint.wavelength_nm, paint.emission_per_nm, paint.reflectance, absorption)


def test_paint_tables_are_checked():
    with pytest.raises(SimulateError, match=r"paint p: .* equally long lists of at least 2 values"):
        FluorescentPaint("p", W, NONE, NONE, np.zeros(3))
    with pytest.raises(SimulateError, match="paint p: all values must be finite and wavelength_nm must increase"):
        FluorescentPaint("p", W[::-1], NONE, NONE, NONE)
    with pytest.raises(SimulateError, match="paint p: emission_per_nm, excitation_rel and reflectance must be >= 0"):
        FluorescentPaint("p", W, NONE, NONE, NONE - 0.1)


def test_a_calibrated_paint_converts_as_much_in_full_spectra_as_in_bands(paints):
    light = LightPanel()
    red, green = absorbing(paints["red"], 470.0), absorbing(paints["green"], 450.0)
    conversion = paint_bands(red, green, light).energy_conversion["red"]
    table, led = fluorescent_paint(red, light), led_band(light)
    emitted = np.trapezoid(table.emission_per_nm, table.wavelength_nm)
    excitation = np.interp(led.wavelength_nm, table.wavelength_nm, table.excitation_rel)
    excited = np.trapezoid(excitation * led.density_per_nm, led.wavelength_nm)
    # the emission's first half step is a ramp here and a cut there
    assert emitted * excited == pytest.approx(conversion, rel=2e-3)


def test_full_spectra_need_the_absorption(paints):
    with pytest.raises(SimulateError, match="paint red has no absorption_rel"):
        fluorescent_paint(paints["red"], LightPanel())


@pytest.mark.renderer
def test_band_matrices_are_checked(llvm):
    from sim.optics._fluorescent_paths import fluorescent_bands

    scene = llvm.load_dict(llvm.cornell_box())
    with pytest.raises(SimulateError, match="paint red: the band matrix must be 3 x 3 finite numbers of 0 or more"):
        fluorescent_bands(scene, {"red": np.eye(2)})
    with pytest.raises(SimulateError, match=r"paint red returns 1\.100 times the energy of one band"):
        fluorescent_bands(scene, {"red": 1.1 * np.eye(3)})
    with pytest.raises(SimulateError, match=r"no surface .* the id purple; valid ids are .*green, .*red"):
        fluorescent_bands(scene, {"purple": np.eye(3)})


@pytest.mark.renderer
def test_each_integrator_needs_its_variant(llvm, llvm_choice, spectral_choice):
    from sim.optics._fluorescent_paths import fluorescent_bands
    from tests.simulate.spectral_paths import fluorescent_spectrum

    with pytest.raises(SimulateError, match=f"full spectra need a spectral variant .*, but {llvm_choice.variant}"):
        fluorescent_spectrum(llvm.load_dict(llvm.cornell_box()), {}, W, NONE)
    spectral = variants.open_renderer(spectral_choice)
    with pytest.raises(SimulateError, match=f"three bands need a rgb variant .*, but {spectral_choice.variant}"):
        fluorescent_bands(spectral.load_dict(spectral.cornell_box()), {})
    scalar = variants.open_renderer(variants.choose_variant("scalar", spectral=True))
    assert scalar.variant() == "scalar_spectral"
    with pytest.raises(MissingExtraError, match=r"level c\) do not run in scalar_spectral.*libllvm19"):
        fluorescent_spectrum(scalar.load_dict(scalar.cornell_box()), {}, W, NONE)


def test_a_gpu_is_proven_before_it_is_opened(monkeypatch):
    asked = []

    def works(variant, llvm_library=None):
        asked.append((variant, llvm_library))

    monkeypatch.setattr(variants, "prove_variant", works)
    assert variants.choose_variant("cuda").variant == "cuda_ad_rgb"
    assert variants.choose_variant("cuda", spectral=True).variant == "cuda_ad_spectral"
    assert asked == [("cuda_ad_rgb", None), ("cuda_ad_spectral", None)]
    monkeypatch.setattr(variants, "prove_variant", lambda variant: "the test picture ended with status -6")
    with pytest.raises(MissingExtraError, match=r"on the GPU was requested, but the test .* status -6; .*NVIDIA"):
        variants.choose_variant("cuda")


def test_without_a_gpu_its_proof_fails_in_the_child_only():
    """On a machine with a GPU the proof passes instead; either way this process goes on."""
    failure = variants.prove_variant("cuda_ad_rgb")
    assert failure is None or failure.startswith("the test picture ")
