import math

import numpy as np
import pytest

from data_schemas.errors import CompareError
from finray_calib.compare.photometric_error import photometric_error
from finray_calib.compare.regions import Region, disc
from finray_calib.compare.skill import skill_score
from finray_calib.compare.structural_similarity import structural_similarity
from tests.compare.scenes import CENTER_PX, RADIUS_PX, SHAPE, press


@pytest.fixture
def scene():
    rng = np.random.default_rng(0)
    no_contact, captured, _ = press(rng)
    repeat = no_contact + rng.standard_normal(no_contact.shape)
    regions = [Region(f"k = {k}", disc(SHAPE, CENTER_PX, k * RADIUS_PX), k) for k in (1.0, 2.0)]
    return no_contact, captured, repeat, regions


def compare(simulated, scene, **options):
    no_contact, captured, repeat, regions = scene
    settings = {"data_range_dn": 255, "linear": True, "rng": np.random.default_rng(1)} | options
    return photometric_error(simulated, captured, no_contact, settings.pop("repeat", repeat), regions, **settings)


def test_the_three_rows(scene):
    no_contact, captured, repeat, regions = scene
    simulated = no_contact + 0.9 * (captured - no_contact)
    report = compare(simulated, scene, fit_exposure=False)
    assert report.exposure is None
    assert [r.region.factor for r in report.regions] == [1.0, 2.0]
    for region, asked in zip(report.regions, regions, strict=True):
        assert region.pixels_used == asked.mask.sum()
        assert region.clipped_fraction_rel == 0
        assert (region.do_nothing.skill.estimate, region.do_nothing.skill.low, region.do_nothing.skill.high) == (
            0,
            0,
            0,
        )
        assert region.do_nothing.per_channel_skill.tolist() == [0, 0, 0]
        assert region.simulation.skill.estimate == pytest.approx(0.99, abs=1e-9)
        weight = 1 / no_contact[asked.mask].mean(axis=0) ** 2
        cost = ((repeat - no_contact)[asked.mask] ** 2).sum(axis=0) @ weight
        signal = ((no_contact - captured)[asked.mask] ** 2).sum(axis=0) @ weight
        assert region.floor.skill.estimate == pytest.approx(1 - cost / signal, rel=1e-12)
        assert region.channel_weights == pytest.approx(weight, rel=1e-12)
        mean_square = ((repeat - no_contact)[asked.mask] ** 2).mean()
        assert region.floor.psnr_db == pytest.approx(10 * np.log10(255**2 / mean_square), rel=1e-12)
        assert region.do_nothing.relative_rms[0].estimate == pytest.approx(
            np.sqrt(((no_contact - captured)[asked.mask][:, 0] ** 2).mean()) / captured[asked.mask][:, 0].mean()
        )
        expected = structural_similarity(simulated, captured, 255)
        assert region.simulation.ssim_full_frame == expected.mean
        assert region.simulation.ssim_in_region == expected.mean_within(asked.mask)


def test_a_perfect_simulation(scene):
    report = compare(scene[1], scene, fit_exposure=False)
    row = report.regions[0].simulation
    assert row.skill.estimate == 1.0
    assert math.isinf(row.psnr_db)
    assert row.ssim_full_frame == pytest.approx(1, abs=1e-12)


def test_without_repeat_there_is_no_floor(scene):
    report = compare(scene[0], scene, repeat=None)
    assert all(region.floor is None for region in report.regions)


def test_encoded_values_have_no_relative_error(scene):
    report = compare(scene[0], scene, linear=False)
    assert not report.linear
    for region in report.regions:
        assert region.do_nothing.relative_rms is None
        assert region.simulation.relative_rms is None
        assert region.floor.relative_rms is None


def test_one_exposure_factor_serves_all_regions_and_not_the_do_nothing_row(scene):
    no_contact, captured, *_ = scene
    simulated = (no_contact + 0.9 * (captured - no_contact)) / 1.6
    report = compare(simulated, scene, simulated_no_contact=no_contact / 1.6)
    assert report.exposure.k == pytest.approx(1.6, rel=1e-12)
    assert [r.simulation.skill.estimate for r in report.regions] == pytest.approx([0.99, 0.99], abs=1e-9)
    assert [r.do_nothing.skill.estimate for r in report.regions] == [0, 0]


def test_exposure_from_the_no_contact_pair_cannot_buy_contact(scene):
    """The no-contact image as the simulation: a factor fitted to the press dims all of it towards the contact."""
    no_contact = scene[0]
    from_press = compare(no_contact, scene)
    from_no_contact = compare(no_contact, scene, simulated_no_contact=no_contact)
    assert from_no_contact.exposure.k == pytest.approx(1, abs=1e-12)
    assert from_no_contact.regions[0].simulation.skill.estimate == pytest.approx(0, abs=1e-9)
    # Fitted to the press, the same empty prediction scores well above nothing: hence the other way is preferred.
    assert from_press.exposure.k < 0.95
    assert from_press.regions[0].simulation.skill.estimate > 0.3


def test_clipped_captures_and_missing_renders_are_left_out_of_every_row(scene):
    no_contact, captured, repeat, regions = scene
    simulated = no_contact + 0.9 * (captured - no_contact)
    clipped, missing = disc(SHAPE, (40, 45), 2), disc(SHAPE, (40, 55), 2)
    captured = captured.copy()
    captured[clipped, 0] = 255
    simulated[missing] = np.nan
    report = compare(simulated, (no_contact, captured, repeat, regions), fit_exposure=False)
    contact = report.regions[0]
    left = regions[0].mask & ~clipped & ~missing
    assert contact.pixels_used == left.sum()
    assert contact.clipped_fraction_rel == pytest.approx(clipped.sum() / regions[0].mask.sum())
    for row, image in ((contact.do_nothing, no_contact), (contact.simulation, simulated)):
        assert row.skill.estimate == skill_score(image, captured, no_contact, left).skill
    assert contact.simulation.skill.estimate == pytest.approx(0.99, abs=1e-9)


def test_an_over_bright_simulation_is_wrong_not_left_out(scene):
    simulated = scene[1].copy()
    simulated[disc(SHAPE, (40, 50), 3)] = 300
    report = compare(simulated, scene, fit_exposure=False)
    assert report.regions[0].clipped_fraction_rel == 0
    assert report.regions[0].simulation.skill.estimate < 0.5


def test_given_weights_are_used(scene):
    report = compare(scene[0] * 0.9, scene, fit_exposure=False, weights=np.ones(3))
    region = report.regions[0]
    expected = skill_score(scene[0] * 0.9, scene[1], scene[0], region.region.mask, np.ones(3))
    assert region.simulation.skill.estimate == expected.skill
    assert region.channel_weights.tolist() == [1, 1, 1]


def test_wrong_input_is_refused(scene):
    no_contact, captured, repeat, _ = scene
    with pytest.raises(CompareError, match="No region to compare"):
        compare(no_contact, (no_contact, captured, repeat, []))
    with pytest.raises(CompareError, match=r"All images must have one shape"):
        compare(no_contact[:-1], scene)
    small = [Region("contact", np.ones((3, 3), bool), 1.0)]
    with pytest.raises(CompareError, match=r"mask has shape \(3, 3\) but the images are 80 x 100 px"):
        compare(no_contact, (no_contact, captured, repeat, small))
    with pytest.raises(CompareError, match=r"None of the .* pixels of the region is usable"):
        compare(no_contact, scene, data_range_dn=5)
