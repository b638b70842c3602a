"""A paint of closed forms, so that every export has a truth from outside."""

import numpy as np
import pytest

from data_schemas import Provenance
from finray_calib.exchange import PaintSpectra
from tests.documentation.example_records import example_results

MODE_NM, SD_NM, PEAK_PER_NM = 600.0, 20.0, 4e-3
EDGE_NM, EDGE_WIDTH_NM, LASER_NM = 560.0, 12.0, 450.0
DRAWS = 400
# All draws are the mean curve times a factor of this standard deviation: every linear functional has the same.
SD_REL = 0.1


def emission(wavelength_nm):
    return PEAK_PER_NM * np.exp(-0.5 * ((np.asarray(wavelength_nm) - MODE_NM) / SD_NM) ** 2)


def absorption(excitation_nm):
    def edge(x_nm):
        return 1 / (1 + np.exp((np.asarray(x_nm) - EDGE_NM) / EDGE_WIDTH_NM))

    return edge(excitation_nm) / edge(LASER_NM)


def reflectance(wavelength_nm):
    return np.interp(wavelength_nm, [405.0, 450.0, 600.0, 660.0], [0.05, 0.08, 0.5, 0.8])


@pytest.fixture(scope="session")
def spectra() -> PaintSpectra:
    wavelength_nm, excitation_nm = np.arange(380.0, 781.0), np.arange(300.0, 781.0)
    factor = 1 + SD_REL * np.random.default_rng(3).standard_normal(DRAWS)
    factor = 1 + SD_REL * (factor - factor.mean()) / factor.std(ddof=1)
    return PaintSpectra(
        name="closed form",
        statement="made up",
        warnings=("made-up warning",),
        laser_nm=LASER_NM,
        wavelength_nm=wavelength_nm,
        emission_per_nm=emission(wavelength_nm),
        emission_draws_per_nm=factor[:, None] * emission(wavelength_nm),
        excitation_nm=excitation_nm,
        absorption_rel=absorption(excitation_nm),
        absorption_rel_draws=np.repeat(absorption(excitation_nm)[None], DRAWS, axis=0),
        reflectance_nm=np.array([405.0, 450.0, 600.0, 660.0]),
        reflectance=np.array([0.05, 0.08, 0.5, 0.8]),
        reflectance_sd=np.array([0.01, 0.02, 0.03, 0.04]),
    )


@pytest.fixture(scope="session")
def paint():
    return example_results().paints["red"].calibration


@pytest.fixture
def origin() -> Provenance:
    return Provenance(
        created_utc="2026-01-01T00:00:00+00:00",
        command="finray export red.paint.json",
        package_version="0.1.0",
        git_commit=None,
        python_version="3.11",
        input_sha256={"red.paint.json": "ab" * 32},
        seed=None,
    )
