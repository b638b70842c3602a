"""The folder of a press's images: whole or absent, and every number comes back from its file."""

import json
import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
import OpenEXR
import pytest

from data_schemas import FingerDesign, MissingExtraError, RecordError, SimulatedPress, SimulateError, provenance
from data_schemas._design_parts import TactileCamera
from data_schemas.storage import ProductSet
from finray_calib.exchange import _render_files as render_files
from finray_calib.exchange import write_optics_folder
from finray_calib.exchange._render_files import png, spectral_channel
from finray_calib.reports import denoised
from sim.experiments import OpticsProducts, simulated_capture
from sim.experiments._optics_products import colour_spread
from sim.optics import BAND_NAMES, choose_variant, exr_image, open_renderer, pixel_maps
from sim.surface_meshes import pressed_shape, rest_shape

DESIGN = FingerDesign(camera=TactileCamera(width_px=160, height_px=120))
SHAPE = (60, 80)
ROOT = Path(__file__).resolve().parents[2]
CHAINS = ("led>red", "led>green", "led", "led>green>red")


def read_exr(path):
    """Channels by the OpenEXR package, which had no part in writing them."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: np.array(channel.pixels) for name, channel in file.channels().items()}


@pytest.fixture(scope="module")
def products() -> OpticsProducts:
    rng = np.random.default_rng(6)
    bands = {state: rng.random((*SHAPE, 3)).astype(np.float32) for state in ("contact", "no_contact")}
    maps = pixel_maps(DESIGN, pressed_shape(DESIGN), rest_shape(DESIGN), open_renderer(choose_variant("scalar")))
    press = SimulatedPress(
        name="press", label="rendered, level b, test", method="rendered", encoding="linear", **bands,
        distance=maps.contact_distance.astype(np.float32), variance=np.full((*SHAPE, 3), 1e-4, np.float32),
        no_contact_bands=bands["no_contact"], contact_bands=bands["contact"], bands=BAND_NAMES,
        camera_matrix=np.eye(3), light_angle_deg=30.0, design=DESIGN,
    )  # fmt: skip
    return OpticsProducts(
        press=press,
        capture=simulated_capture(press, 1),
        basis={state: np.concatenate([image, image[..., :1]], axis=-1) for state, image in bands.items()},
        basis_names=CHAINS,
        band_sd={state: 0.1 * image for state, image in bands.items()},
        maps=maps,
        wavelength_nm=np.array([450.0, 537.5]),
        spectral=rng.random((*SHAPE, 2)).astype(np.float32),
        colours=colour_spread(press, 1),
        timings_s={"total": 1.5},
    )


def written(folder, products, views):
    with ProductSet(folder) as stored:
        write_optics_folder(folder, products, views, provenance("x", {}, 1), stored)
    return folder


WRITE_ON_ONE_CORE = """
import os
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
import numpy as np
from sim.optics import choose_variant, exr_image, open_renderer
open_renderer(choose_variant("scalar"))
print(len(exr_image({"Y": np.ones((64, 64))}, {})))
"""


def test_images_are_written_on_a_machine_of_one_core():
    """The renderer's writer waits forever for a second thread; a computer or container of one core has none."""
    done = subprocess.run(
        [sys.executable, "-P", "-c", WRITE_ON_ONE_CORE], capture_output=True, text=True, timeout=300.0, check=False,
        env={**os.environ, "PYTHONPATH": os.fspath(ROOT)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 100


def test_every_number_comes_back(tmp_path, products):
    view = np.random.default_rng(1).integers(0, 255, (*SHAPE, 3), dtype=np.uint8)
    folder = written(tmp_path / "new" / "press.optics", products, {"contact-view": view})
    assert sorted(p.name for p in folder.iterdir()) == [
        "README.txt", "bands.exr", "contact-raw.png", "contact-view.png", "contact.png", "depth.png", "geometry.exr",
        "no_contact-raw.png", "normal.png", "spectral.exr", "timings.json",
    ]  # fmt: skip
    bands = read_exr(folder / "bands.exr")
    assert len(bands) == 14
    for k, name in enumerate(CHAINS):
        np.testing.assert_array_equal(bands[f"contact.{name}"], products.basis["contact"][..., k])
    for k, name in enumerate(BAND_NAMES):
        np.testing.assert_array_equal(bands[f"no_contact_sd.{name}"], products.band_sd["no_contact"][..., k])
    geometry = read_exr(folder / "geometry.exr")
    np.testing.assert_array_equal(geometry["normal.Y"], products.maps.normal[..., 1].astype(np.float32))
    np.testing.assert_array_equal(geometry["part"], products.maps.part)
    np.testing.assert_array_equal(geometry["depth.mm"], products.maps.depth_mm.astype(np.float32))
    assert len(geometry) == 12
    assert {values.dtype for values in (*bands.values(), *geometry.values())} == {np.dtype(np.float32)}
    raw = cv2.imread(str(folder / "contact-raw.png"), cv2.IMREAD_UNCHANGED)
    assert raw.dtype == np.uint16
    np.testing.assert_array_equal(raw, products.capture.contact[..., 0])
    depth = cv2.imread(str(folder / "depth.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_allclose(depth * 1e-3, np.maximum(np.nan_to_num(products.maps.depth_mm), 0.0), atol=0.51e-3)
    contact = cv2.imread(str(folder / "contact.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(contact == 255, products.maps.contact)
    shown = cv2.imread(str(folder / "contact-view.png"))[..., ::-1]
    np.testing.assert_array_equal(shown, view)
    assert json.loads((folder / "timings.json").read_text())["seconds"] == {"total": 1.5}


def test_spectra_follow_the_layout_of_fichet(tmp_path, products):
    folder = written(tmp_path / "press.optics", products, {})
    assert spectral_channel(450.0) == "S0.450,000000nm"
    spectral = read_exr(folder / "spectral.exr")
    assert set(spectral) == {"S0.450,000000nm", "S0.537,500000nm"}
    np.testing.assert_array_equal(spectral["S0.537,500000nm"], products.spectral[..., 1])
    with OpenEXR.File(str(folder / "spectral.exr"), separate_channels=True) as file:
        header = dict(file.header())
    assert header["spectralLayoutVersion"] == "1.0"
    assert header["emissiveUnits"] == "W.m^-2.sr^-1"
    assert "rendered, level b, test; made by" in header["comments"]
    assert "EV 0" in header["comments"]
    assert header["type"] == OpenEXR.scanlineimage
    # both are lossless; PXR24, B44 and DWA are not
    assert header["compression"] in (OpenEXR.PIZ_COMPRESSION, OpenEXR.ZIP_COMPRESSION)


def test_an_image_keeps_every_number_and_every_name():
    rng = np.random.default_rng(2)
    awkward = [np.nan, np.inf, -np.inf, 0.0, -0.0, 1e-42, 3.4e38, -1.5]
    for count in (1, 2, 3, 4, 41):
        channels = {f"layer {k}.led>green,{k}": rng.choice(awkward, (3, 5)).astype(np.float32) for k in range(count)}
        with TemporaryDirectory() as folder:
            path = Path(folder) / "image.exr"
            path.write_bytes(exr_image(channels, {"comments": "Messung \N{LATIN SMALL LETTER U WITH DIAERESIS}"}))
            read = read_exr(path)
            with OpenEXR.File(str(path)) as file:
                assert file.header()["comments"] == "Messung \N{LATIN SMALL LETTER U WITH DIAERESIS}"
        assert set(read) == set(channels)
        for name, values in channels.items():
            np.testing.assert_array_equal(read[name].view(np.uint32), values.view(np.uint32))


def test_a_folder_is_never_overwritten_and_never_half_written(tmp_path, products, monkeypatch):
    target = tmp_path / "press.optics"
    target.mkdir()
    with pytest.raises(RecordError, match=r"press\.optics: exists already"):
        written(target, products, {})
    target.rmdir()

    def fail(image):
        raise OSError("disk full")

    monkeypatch.setattr(render_files, "png", fail)
    with pytest.raises(OSError, match="disk full"):
        written(target, products, {})
    assert list(tmp_path.iterdir()) == []


def test_a_missing_denoiser_is_named(monkeypatch):
    def without(name):
        raise ImportError(name)

    monkeypatch.setattr("finray_calib.reports._images.import_module", without)
    with pytest.raises(MissingExtraError, match=r"pip install 'finray-calib\[denoise\]'"):
        denoised(np.ones((4, 4, 3), np.float32), 64)


def test_denoiser_gets_each_band_as_grey_and_enough_paths(monkeypatch):
    seen = []

    class Denoiser:
        @staticmethod
        def denoise(image, hdr):
            seen.append((image.copy(), hdr))
            return 0.5 * image

    monkeypatch.setattr("finray_calib.reports._images.import_module", lambda name: Denoiser)
    bands = np.random.default_rng(1).random((5, 6, 3)).astype(np.float32)
    np.testing.assert_allclose(denoised(bands, 64), 0.5 * bands, rtol=1e-6)
    assert len(seen) == 3
    for image, hdr in seen:
        assert hdr
        assert image.shape == (5, 6, 3)
        np.testing.assert_array_equal(image[..., 0], image[..., 2])
    with pytest.raises(SimulateError, match="at least 64 paths per pixel, got 32"):
        denoised(bands, 32)


@pytest.mark.renderer
def test_the_real_denoiser_removes_noise():
    pytest.importorskip("pyoidn", reason="NO DENOISER: pip install 'finray-calib[denoise]'")
    rng = np.random.default_rng(1)
    clean = np.tile(np.linspace(0.2, 1.0, 96, dtype=np.float32)[None, :, None], (96, 1, 3))
    noisy = (clean * rng.gamma(4.0, 0.25, clean.shape)).astype(np.float32)
    error = [np.sqrt(np.mean((image - clean) ** 2)) for image in (noisy, denoised(noisy, 64))]
    assert error[1] < 0.5 * error[0]


def test_png_keeps_sixteen_bits():
    image = np.array([[0, 1, 1023], [65535, 256, 7]], np.uint16)
    np.testing.assert_array_equal(cv2.imdecode(np.frombuffer(png(image), np.uint8), cv2.IMREAD_UNCHANGED), image)
