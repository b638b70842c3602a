"""Texture of paint and tile under an uneven laser spot."""

from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from data_schemas.storage import camera_response
from finray_calib.radiometry import band_signals, texture_variance_rel
from rigs import paint_plan, simulated_rig
from rigs.capture import SessionRequest, capture_paint_session, read_frame_of
from rigs.simulated import Bench

ERROR_RATE = 1e-4


def test_scatter_of_independent_blocks_is_the_variance_of_their_mean():
    rng = np.random.default_rng(2)
    light = np.linspace(0.5, 1.5, 16)
    share = light / light.sum()
    texture_sd, noise_sd = 0.01, 0.004
    found, means = [], []
    for _ in range(400):
        texture = 1 + texture_sd * rng.standard_normal(16)
        values = texture[:, None] * np.array([3.0, 0.2]) * (1 + noise_sd * rng.standard_normal((16, 2)))
        found.append(texture_variance_rel(values, np.full(2, noise_sd**2), light))
        means.append(share @ texture)
    # The spread of 400 means is known to 3.5 %, its square to 7 %.
    assert np.mean(found) == pytest.approx(np.var(means), rel=0.25)
    assert np.mean(found) == pytest.approx(texture_sd**2 * (share**2).sum(), rel=0.1)


def test_noise_alone_is_no_texture_and_unusable_bands_are_left_out():
    rng = np.random.default_rng(4)
    noisy = 1 + 0.01 * rng.standard_normal((16, 3))
    assert texture_variance_rel(noisy, np.full(3, 1e-4), np.ones(16)) < (0.005 / 4) ** 2
    assert texture_variance_rel(noisy, np.full(3, 0.1), np.ones(16)) == 0.0
    assert texture_variance_rel(noisy * np.nan, np.full(3, 1e-4), np.ones(16)) == 0.0
    assert texture_variance_rel(noisy[:1], np.full(3, 1e-4), np.ones(1)) == 0.0


def test_bands_of_a_textured_paint_cover_the_bench(tmp_path: Path):
    """Eight benches, each with its own texture, filters and noise; the excitation band among the others."""
    chi2, excitation, benches = 0.0, [], 8
    for seed in range(benches):
        rig = simulated_rig("red", seed=seed, width_px=160, height_px=128)
        white = rig.white_reference.model_copy(update={"uncertainty_rel": 0.0})
        rig = rig.model_copy(update={"white_reference": white})
        out = tmp_path / str(seed)
        plan = paint_plan("red", rig.camera).model_copy(update={"filters": ("450", "560", "600", "630")})
        session = capture_paint_session(rig, plan, SessionRequest(out, "pytest"))
        bands = band_signals(session, lambda frame, out=out: read_frame_of(out, frame))
        bench = Bench(rig, Path(), camera_response("assumed", Path()))
        slots = [f.slot for f in bands.optics.filters]

        def signal(radiance, bench=bench, slots=slots):
            return np.array([bench.band_electrons_per_s(radiance, slot) for slot in slots])

        lamp = signal(0.98 * bench.lights["lamp"])
        level = signal(0.98 * bench.lights["laser"])[0] / lamp[0] @ bands.channel_weights
        truth = signal(bench.sample_radiance(bench.lights["laser"])) / lamp / level
        kept = np.array([2, 3, 6, 9])  # blue of the excitation band, red of the others
        deviation = (bands.fluorescence - truth).ravel()[kept]
        covariance = bands.fluorescence_covariance[np.ix_(kept, kept)]
        chi2 += deviation @ np.linalg.solve(covariance, deviation)
        excitation.append(deviation[0] / np.sqrt(covariance[0, 0]))
        assert any(note.startswith("texture of paint") for note in bands.notes)
    freedom = 4 * benches
    # 24-px regions have blocks of 3 cells against a texture of 2 cells: neighbours are alike and the scatter of
    # 16 blocks states a standard deviation some 1.3 times too small; regions of 200 px have none of this.
    assert stats.chi2.sf(chi2 / 1.7, freedom) > ERROR_RATE
    assert stats.chi2.sf(float(np.square(excitation).sum()) / 1.7, benches) > ERROR_RATE
    assert stats.chi2.cdf(chi2, freedom) > ERROR_RATE
