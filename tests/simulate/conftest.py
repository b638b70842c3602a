"""Paints and renderers of the optics tests.

Tests of the compiled renderer run with LLVM; with FINRAY_TEST_ENGINE=cuda, as `make test-gpu` sets it, on a GPU.
"""

import os
from collections.abc import Callable
from types import ModuleType

import numpy as np
import pytest

from data_schemas import MissingExtraError
from sim.optics import PaintOptics, RendererChoice, choose_variant, open_renderer

ON_GPU = os.environ.get("FINRAY_TEST_ENGINE") == "cuda"

collect_ignore = [] if ON_GPU else ["test_gpu.py"]


def gaussian(wavelength_nm, center_nm, sigma_nm, peak):
    return peak * np.exp(-0.5 * ((wavelength_nm - center_nm) / sigma_nm) ** 2)


@pytest.fixture
def paints() -> dict[str, PaintOptics]:
    """Plausible fluorescent red and green acrylic paint."""
    w = np.arange(400.0, 751.0, 5.0)
    red = 0.05 + 0.8 / (1.0 + np.exp(-(w - 590.0) / 12.0))
    green = 0.06 + gaussian(w, 530.0, 40.0, 0.5)
    return {
        "red": PaintOptics("red", w, gaussian(w, 610.0, 18.0, 0.0066), red),
        "green": PaintOptics("green", w, gaussian(w, 520.0, 15.0, 0.0066), green),
    }


@pytest.fixture
def scalar() -> ModuleType:
    return open_renderer(choose_variant("scalar"))


def compiled(spectral: bool) -> RendererChoice:
    """Return the compiled renderer that is tested."""
    try:
        choice = choose_variant("cuda" if ON_GPU else "auto", spectral=spectral)
    except MissingExtraError as error:
        pytest.skip(f"NO GPU: {error}")
    if choice.variant.startswith("scalar"):
        pytest.skip(f"NO LLVM: {choice.note}")
    return choice


@pytest.fixture(scope="session")
def llvm_choice() -> RendererChoice:
    return compiled(spectral=False)


@pytest.fixture(scope="session")
def gpu(llvm_choice: RendererChoice) -> RendererChoice:
    assert llvm_choice.variant == "cuda_ad_rgb"
    return llvm_choice


@pytest.fixture(scope="session")
def spectral_choice(llvm_choice: RendererChoice) -> RendererChoice:
    return compiled(spectral=True)


@pytest.fixture
def spectral(spectral_choice: RendererChoice) -> ModuleType:
    return open_renderer(spectral_choice)


@pytest.fixture
def llvm(llvm_choice: RendererChoice) -> ModuleType:
    return open_renderer(llvm_choice)


@pytest.fixture
def black_paints() -> Callable[[], dict[str, PaintOptics]]:
    """Paints that reflect nothing and emit next to nothing."""

    def make() -> dict[str, PaintOptics]:
        w = np.array([400.0, 500.0, 600.0, 750.0])
        return {
            name: PaintOptics(name, w, np.array([0.0, 1e-12, 1e-12, 0.0]), np.zeros(4)) for name in ("red", "green")
        }

    return make
