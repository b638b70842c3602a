"""Imported folders of band images: known signals come back, whatever the camera; mistakes are named."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
import tifffile

from data_schemas import (
    BandFolder,
    CurveError,
    FinrayError,
    ImportedCamera,
    ImportFormatError,
    RadiometryError,
    RecordError,
)
from finray_calib.exchange import import_band_folder
from finray_calib.exchange._band_folder import read_image
from tests.exchange.band_folders import (
    CENTER_NM,
    EXPOSURE_S,
    FILTERS,
    FLUORESCENCE,
    REFLECTANCE,
    SIDE_PX,
    WHITE,
    edit,
    frame,
    write_folder,
)

COLOUR_LAYOUTS = ["RGB", "Bayer RGGB", "Bayer BGGR", "Bayer GRBG", "Bayer GBRG"]
# Counts are rounded to 1 DN: half a count of the dimmest signal (0.01 x 2000 DN in the best channel) is 3 %, of the
# others far less. A value may be off by what half a count on top and below is worth.


def rounding(values, white):
    signal_dn = values[:, None] * white * EXPOSURE_S
    return 0.6 / signal_dn + 0.6 / (white * EXPOSURE_S) + 2e-3


@pytest.mark.parametrize("layout", COLOUR_LAYOUTS)
def test_known_signals_come_back(tmp_path, layout):
    bands, _ = import_band_folder(write_folder(tmp_path / "f", layout))
    np.testing.assert_array_less(
        np.abs(bands.fluorescence / FLUORESCENCE[:, None] - 1), rounding(FLUORESCENCE, WHITE * 0.9)
    )
    np.testing.assert_array_less(np.abs(bands.reflectance / REFLECTANCE[:, None] - 1), rounding(REFLECTANCE, WHITE))
    assert bands.usable().all()
    np.testing.assert_array_equal([f.center_nm for f in bands.optics.filters], CENTER_NM)


def test_monochrome_camera_fills_one_column(tmp_path):
    bands, _ = import_band_folder(write_folder(tmp_path / "f", "monochrome"))
    np.testing.assert_array_equal(bands.usable(), np.tile([False, True, False], (len(FILTERS), 1)))
    error = np.abs(bands.fluorescence[:, 1] / FLUORESCENCE - 1)
    np.testing.assert_array_less(error, rounding(FLUORESCENCE, WHITE * 0.9)[:, 1])
    np.testing.assert_array_equal(bands.channel_weights, [0.0, 1.0, 0.0])
    assert np.linalg.eigvalsh(bands.fluorescence_covariance).min() > 0


def test_monochrome_noise_is_that_of_all_pixels(tmp_path):
    """The green column of a Bayer camera holds half as many pixels, so twice the photon variance."""
    white = np.repeat(WHITE[:, 1:2], 3, axis=1)
    mono, _ = import_band_folder(write_folder(tmp_path / "m", "monochrome", white=white))
    bayer, _ = import_band_folder(write_folder(tmp_path / "b", "Bayer RGGB", white=white))
    shared = bayer.fluorescence_covariance[7, 6]  # of filter 560, green with red
    own = bayer.fluorescence_covariance[7, 7] - shared
    # dark level and light are shared by all pixels; rounding of the images differs a little
    np.testing.assert_allclose(mono.fluorescence_covariance[7, 7], shared + own / 2, rtol=0.02)


def test_dark_frames_are_used_and_files_are_named(tmp_path):
    folder = write_folder(tmp_path / "f", "Bayer RGGB")
    plain, _ = import_band_folder(folder)
    (folder / "dark").mkdir()
    for n in (1, 2):
        tifffile.imwrite(folder / "dark" / f"{n}.tif", frame(np.zeros(3), "Bayer RGGB"))
    edit(folder, "[files]", f'[[darks]]\nexposure_s = {EXPOSURE_S}\nfiles = "dark/*.tif"\n\n[files]')
    dark, digests = import_band_folder(folder)
    np.testing.assert_allclose(dark.fluorescence, plain.fluorescence)
    assert (dark.fluorescence_covariance.diagonal() < plain.fluorescence_covariance.diagonal()).all()
    assert {"dark/1.tif", "bands.toml", "white/450nm.tif", "laser_white.tif"} <= set(digests)
    assert any("no dark frames" in note for note in plain.notes)
    # the level that stands in for dark frames has no drift that was measured
    assert not any("drift of the dark level" in note for note in plain.notes)
    assert any("drift of the dark level" in note for note in dark.notes)


def test_dark_current_that_is_not_subtracted_is_told(tmp_path):
    folder = write_folder(tmp_path / "f", "Bayer RGGB")
    with (folder / "bands.toml").open("a") as file:
        file.write('files = { "laser/500nm.tif" = 30.0 }\n')
    bands, _ = import_band_folder(folder)
    assert any("dark current of exposures of up to 30 s is not subtracted" in note for note in bands.notes)


def test_declared_black_level_uncertainty_is_carried(tmp_path):
    folder = write_folder(tmp_path / "f", "Bayer RGGB")
    edit(folder, "black_level_uncertainty_dn = 0.1", "black_level_uncertainty_dn = 0.0")
    certain, _ = import_band_folder(folder)
    edit(folder, "black_level_uncertainty_dn = 0.0", "black_level_uncertainty_dn = 2.0")
    uncertain, _ = import_band_folder(folder)
    added = uncertain.fluorescence_covariance[4, 4] - certain.fluorescence_covariance[4, 4]
    # filter 500, green: y = F / W / V with F 0.01 x 2700 DN: 2 DN on top are 2 / 27 of y; below it is 2 / 3000
    signal_dn = FLUORESCENCE[1] * WHITE[1, 1] * 0.9 * EXPOSURE_S
    np.testing.assert_allclose(np.sqrt(added), FLUORESCENCE[1] * 2.0 / signal_dn, rtol=0.1)


def test_own_exposure_of_a_file_and_of_a_filter(tmp_path):
    folder = write_folder(tmp_path / "f", "Bayer RGGB")
    before, _ = import_band_folder(folder)
    short = frame(WHITE[1] * 0.9 * FLUORESCENCE[1], "Bayer RGGB", 8.0)
    tifffile.imwrite(folder / "laser" / "500nm.tif", short)
    with (folder / "bands.toml").open("a") as file:
        file.write('files = { "laser/500nm.tif" = 8.0 }\n')
    times = ", ".join(f'"{name}" = {EXPOSURE_S}' for name in FILTERS)
    edit(folder, f"white = {EXPOSURE_S}", f"white = {{ {times} }}")
    after, _ = import_band_folder(folder)
    # sixteen times the exposure: rounding is sixteen times finer
    np.testing.assert_allclose(after.fluorescence[1], FLUORESCENCE[1], rtol=0.01)
    np.testing.assert_allclose(after.fluorescence[2:], before.fluorescence[2:])


def test_own_exposure_of_a_dark_frame(tmp_path):
    folder = write_folder(tmp_path / "f", "Bayer RGGB")
    (folder / "dark").mkdir()
    for n in (1, 2):
        tifffile.imwrite(folder / "dark" / f"{n}.tif", frame(np.zeros(3), "Bayer RGGB"))
    edit(folder, "[files]", '[[darks]]\nexposure_s = 8.0\nfiles = "dark/*.tif"\n\n[files]')
    with pytest.raises(ImportFormatError, match=r"was exposed for 0\.5 s, but the dark frames were exposed for 8 s"):
        import_band_folder(folder)
    with (folder / "bands.toml").open("a") as file:
        file.write(f'files = {{ "dark/1.tif" = {EXPOSURE_S}, "dark/2.tif" = {EXPOSURE_S} }}\n')
    import_band_folder(folder)


def test_left_aligned_values(tmp_path):
    folder = write_folder(tmp_path / "f", "Bayer RGGB")
    before, _ = import_band_folder(folder)
    for file in folder.rglob("*.tif"):
        tifffile.imwrite(file, tifffile.imread(file) << 2)
    edit(folder, "bit_depth = 14", "bit_depth = 14\nleft_aligned_bits = 2")
    after, _ = import_band_folder(folder)
    np.testing.assert_array_equal(after.fluorescence, before.fluorescence)


def test_measured_curves_are_read(tmp_path):
    folder = write_folder(tmp_path / "f", "monochrome")
    x = np.arange(530.0, 590.5, 0.5)
    passed = 0.9 * np.exp2(-(np.abs(2 * (x - 561.2) / 12.5) ** 4)) + 1e-4
    (folder / "f560.csv").write_text(
        "wavelength_nm,transmission\n" + "".join(f"{a:g},{b:.8f}\n" for a, b in zip(x, passed, strict=True))
    )
    (folder / "qe.csv").write_text("wavelength_nm,response_percent\n380,40\n600,60\n780,30\n")
    (folder / "lamp.csv").write_text("wavelength_nm,power_rel\n380,0.2\n780,2.0\n")
    edit(folder, 'name = "560"\ncenter_nm = 560\nfwhm_nm = 10', 'name = "560"\ncurve = "f560.csv"')
    edit(folder, 'layout = "monochrome"', 'layout = "monochrome"\nresponse = "qe.csv"')
    edit(folder, 'paint_name = "orange"', 'paint_name = "orange"\nlamp = "lamp.csv"')
    bands, digests = import_band_folder(folder)
    found = bands.optics.filters[2]
    # crossings are interpolated linearly between samples 0.5 nm apart
    np.testing.assert_allclose([found.center_nm, found.fwhm_nm], [561.2, 12.5], atol=0.02)
    assert (found.center_uncertainty_nm, found.fwhm_uncertainty_nm, found.blocking_od) == (0.15, 0.15, 5.0)
    assert (bands.optics.filters[1].center_uncertainty_nm, bands.optics.filters[1].fwhm_uncertainty_nm) == (0.9, 0.6)
    np.testing.assert_allclose(bands.optics.filter_curves["560"](x), passed, atol=1e-8)
    assert list(bands.optics.filter_curves) == ["560"]
    note = next(note for note in bands.notes if "f560.csv" in note)
    assert note.endswith("blocking_od is used below 10^-5 and outside 530 to 590 nm")
    assert bands.optics.camera_response[1]([600.0]) == pytest.approx([0.6])
    assert bands.optics.lamp([780.0]) == pytest.approx([2.0])
    assert {"f560.csv", "qe.csv", "lamp.csv"} <= set(digests)


@pytest.mark.parametrize(
    ("old", "new", "kind", "message"),
    [
        ('encoding = "linear"', 'encoding = "srgb"', RecordError, "'camera.encoding': must be 'linear'"),
        ('layout = "RGB"', 'layout = "RGBA"', RecordError, "'camera.layout'"),
        ('"450"\nregion', '"451"\nregion', RecordError, "excitation_filter '451' is not one of the filters"),
        ('name = "500"', 'name = "450"', RecordError, "'450' is listed twice"),
        ("center_nm = 500\n", "", RecordError, "filter '500' has neither a curve nor both center_nm and fwhm_nm"),
        ("center_nm = 500\n", 'center_nm = 500\ncurve = "x.csv"\n', RecordError, "could contradict it"),
        ("center_nm = 500\n", "center_nm = 450\n", CurveError, "center_nm 450 is used by two filters"),
        ('"white/{filter}nm.tif"', '"white/450nm.tif"', RecordError, "must contain {filter}"),
        ('"white/{filter}nm.tif"', '"../{filter}nm.tif"', ImportFormatError, "points outside the folder"),
        ('layout = "RGB"', 'layout = "RGB"\nresponse = "../camera.csv"', CurveError, "'../camera.csv' points outside"),
        ('"white/{filter}nm.tif"', '"w/{filter}nm.tif"', ImportFormatError, "no file matches 'w/450nm.tif'"),
        ('"lamp/{filter}nm.tif"', '"white/{filter}nm.tif"', ImportFormatError, "as 'white' .* and as 'reflectance'"),
        ("reflectance = 0.5", 'reflectance = { "450" = 0.5 }', RecordError, "filter '500' is missing"),
        (
            "laser_white = 0.5",
            'laser_white = 0.5\nfiles = { "x.tif" = 1 }',
            ImportFormatError,
            "matches the file 'x.tif'",
        ),
        ("bit_depth = 14", "bit_depth = 8", ImportFormatError, "above the 255 DN of camera.bit_depth = 8"),
        ("bit_depth = 14", "bit_depth = 14\nleft_aligned_bits = 4", RecordError, "together exceed the 16 bits"),
        ("black_level_dn = 20", "black_level_dn = 16383", RecordError, "not below full scale, which is 16383 DN"),
        ("black_level_dn = 20", "black_level_dn = 200", ImportFormatError, r"450nm.tif: .* 35.0 DN, below .* = 200 DN"),
        ('filter = "450"', 'filter = "500"', ImportFormatError, "'500' passes 495 to 505 nm, but .* 450 nm"),
        (
            "[files]",
            "[laser]\nfwhm_nm = 300\n[files]",
            ImportFormatError,
            r"laser\.fwhm_nm is 300 nm, .* at most 60 nm",
        ),
        ('"laser/{filter}nm.tif"', '"lamp/{filter}nm.tif"', ImportFormatError, r"'\{filter\}nm\.tif' instead of '\{f"),
        (
            "reflectance = 0.5",
            'reflectance = { "450" = 0, "500" = 1, "560" = 1, "600" = 1, "660" = 1 }',
            RecordError,
            r"'exposure_s\.reflectance' \(in s\): .*'exposure_s\.reflectance\.450' \(in s\): must be above 0",
        ),
        ("height_px = 40", "height_px = 400", FinrayError, "reach beyond the frame of 48 x 48 px"),
        (
            "[files]",
            '[[darks]]\nexposure_s = 9.0\nfiles = "laser_white.tif"\n[files]',
            ImportFormatError,
            "as 'dark' and as 'laser white'",
        ),
    ],
)
def test_mistakes_in_the_description(tmp_path, old, new, kind, message):
    folder = write_folder(tmp_path / "f", "RGB")
    edit(folder, old, new)
    with pytest.raises(kind, match=message):
        import_band_folder(folder)


def test_dark_of_another_exposure(tmp_path):
    folder = write_folder(tmp_path / "f", "RGB")
    tifffile.imwrite(folder / "dark.tif", frame(np.zeros(3), "RGB"))
    edit(folder, "[files]", '[[darks]]\nexposure_s = 9.0\nfiles = "dark.tif"\n\n[files]')
    with pytest.raises(ImportFormatError, match=r"was exposed for 0\.5 s, but the dark frames were exposed for 9 s"):
        import_band_folder(folder)


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros((SIDE_PX, SIDE_PX, 3), np.float32), "contains float32 of shape"),
        (np.zeros((SIDE_PX, SIDE_PX), np.uint16), "needs one 8- or 16-bit image of rows x columns x 3"),
        (np.zeros((SIDE_PX, SIDE_PX + 2, 3), np.uint16), "take all images with the same camera settings"),
    ],
)
def test_wrong_images(tmp_path, image, message):
    folder = write_folder(tmp_path / "f", "RGB")
    tifffile.imwrite(folder / "laser" / "600nm.tif", image, photometric="rgb" if image.ndim == 3 else None)
    with pytest.raises(ImportFormatError, match=message):
        import_band_folder(folder)


def test_an_odd_last_row_and_column_are_left_out(tmp_path):
    image = np.arange(35, dtype=np.uint8).reshape(5, 7)
    tifffile.imwrite(tmp_path / "x.tif", image)
    camera = ImportedCamera(encoding="linear", layout="Bayer BGGR", bit_depth=8, gain_e_per_dn=1, read_noise_e=1)
    mosaic = read_image(tmp_path / "x.tif", camera)
    assert mosaic.shape == (4, 6)
    # red stands at the lower right of a BGGR cell and at the upper left of an RGGB cell
    np.testing.assert_array_equal(mosaic[:2, :2], [[8, 7], [1, 0]])


def test_foreign_image_and_missing_description(tmp_path):
    folder = write_folder(tmp_path / "f", "RGB")
    (folder / "laser" / "600nm.tif").write_bytes(b"no image")
    with pytest.raises(ImportFormatError, match=r"600nm\.tif: cannot be read as TIFF"):
        import_band_folder(folder)
    # cut off within its compressed data, which is a fault of the decompressor, not of the TIFF
    tifffile.imwrite(folder / "laser" / "600nm.tif", np.zeros((48, 48, 3), np.uint16), compression="zlib")
    whole = (folder / "laser" / "600nm.tif").read_bytes()
    (folder / "laser" / "600nm.tif").write_bytes(whole[:-4])
    with pytest.raises(ImportFormatError, match=r"600nm\.tif: cannot be read as TIFF"):
        import_band_folder(folder)
    with pytest.raises(ImportFormatError, match=r"bands\.toml, which tells what each image shows, is missing"):
        import_band_folder(tmp_path)


def test_errors_of_the_reduction_name_what_the_folder_has(tmp_path):
    """Not the plan and the frames of a session: whoever imports has neither."""
    folder = write_folder(tmp_path / "f", "RGB")
    edit(folder, "width_px = 40", "width_px = 400")
    with pytest.raises(RadiometryError, match=r"^bands\.toml: region: rows 4 to 44 .* correct the region$"):
        import_band_folder(folder)
    edit(folder, "width_px = 400", "width_px = 40")
    full = np.full((SIDE_PX, SIDE_PX, 3), 2**14 - 1, np.uint16)
    laser_white = tifffile.imread(folder / "laser_white.tif")
    tifffile.imwrite(folder / "laser_white.tif", np.full_like(laser_white, 20))
    with pytest.raises(
        RadiometryError, match=r"and that excitation_filter in bands\.toml names the filter of the laser"
    ):
        import_band_folder(folder)
    tifffile.imwrite(folder / "laser_white.tif", laser_white)
    tifffile.imwrite(folder / "laser" / "600nm.tif", full)
    with pytest.raises(
        RadiometryError, match=r"^laser/600nm\.tif: filter 600 is saturated .*; add an image .* to the f"
    ):
        import_band_folder(folder)


def test_an_image_whose_name_is_like_a_field_of_the_plan_keeps_it_in_errors(tmp_path):
    folder = write_folder(tmp_path / "f", "RGB")
    edit(folder, "laser_white.tif", "plan.tif")
    full = np.full((SIDE_PX, SIDE_PX, 3), 2**14 - 1, np.uint16)
    tifffile.imwrite(folder / "plan.tif", full)
    with pytest.raises(RadiometryError, match=r"^plan\.tif: filter 450 is saturated"):
        import_band_folder(folder)


def test_a_note_on_the_region_names_the_description(tmp_path):
    folder = write_folder(tmp_path / "f", "RGB")
    for file in sorted((folder / "white").iterdir()):
        image = tifffile.imread(file)
        image[:, : SIDE_PX // 2] = 20 + (image[:, : SIDE_PX // 2] - 20) // 10
        tifffile.imwrite(file, image)
    bands, _ = import_band_folder(folder)
    assert any(note.endswith("all values are biased; correct region in bands.toml") for note in bands.notes)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("f.csv", "wavelength_nm,percent\n400,1\n500,2\n", "a filter needs wavelength_nm,transmission"),
        ("f.csv", "wavelength_nm,transmission\n500,0.1\n400,0.2\n", "wavelengths must increase"),
        ("f.csv", "wavelength_nm,transmission\n400,0\n500,90\n600,0\n", "divide by 100 if it is in per cent"),
        ("f.csv", "wavelength_nm,transmission\n400,0\n500,0\n600,0\n", "with at least one value above 0"),
        ("f.csv", "wavelength_nm,transmission\n400,0.2\n500,0.9\n", "does not fall to 50 % of its peak"),
        ("f.csv", "wavelength_nm,transmission\n0.4,0\n0.5,0.9\n0.6,0\n", "check that they are in nm"),
        ("q.csv", "wavelength_nm,response_percent\n450,1\n500,2\n", "of the weight of filter 450 lies outside"),
        ("q.csv", "wavelength_nm,qe\n400,1\n500,2\n", "a monochrome response needs wavelength_nm,response_percent"),
        ("q.csv", "wavelength_nm,response_percent\n400,0\n500,0\n", "above 0 in one or more"),
        ("q.csv", "wavelength_nm,response_percent\n500,1\n400,2\n", "wavelengths must increase"),
    ],
)
def test_bad_curve_files(tmp_path, name, content, message):
    folder = write_folder(tmp_path / "f", "monochrome")
    (folder / name).write_text(content)
    if name == "f.csv":
        edit(folder, "center_nm = 560\nfwhm_nm = 10", 'curve = "f.csv"')
    else:
        edit(folder, 'layout = "monochrome"', 'layout = "monochrome"\nresponse = "q.csv"')
    with pytest.raises(CurveError, match=message):
        import_band_folder(folder)


def test_the_documented_description_is_valid():
    text = (Path(__file__).resolve().parents[2] / "docs" / "how-to" / "import-band-images.md").read_text()
    example = tomllib.loads(text.split("```toml\n")[1].split("```")[0])
    # the example shows two filters of many
    assert BandFolder.model_validate(example).filters[1].curve == "fb600.csv"
