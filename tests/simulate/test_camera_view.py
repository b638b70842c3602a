"""What the camera sees of the pad, as numbers and as a picture."""

import cv2
import numpy as np
import pytest

from data_schemas import FingerDesign, ImportFormatError
from data_schemas._design_parts import TactileCamera
from finray_calib.reports._finger_pictures import draw_camera_view
from finray_calib.reports._style import new_figure, png_bytes, styled
from sim.optics import camera_view
from tests.simulate.closed_form_view import coat_positions

DESIGN = FingerDesign(camera=TactileCamera(width_px=160, height_px=120))


def test_resolution_and_share_are_those_of_the_closed_form(scalar, tmp_path):
    view = camera_view(DESIGN, tmp_path, scalar)
    z = coat_positions(DESIGN.model_copy(update={"indenter": DESIGN.indenter.model_copy(update={"depth_mm": 0.0})}))
    row = 30  # the middle of the picture looks along the middle of the pad
    along = 2.0 / np.abs(np.gradient(z[row, :, 0]))
    known = np.isfinite(along) & np.isfinite(view.px_per_mm_along[row])
    assert known.sum() > 20
    np.testing.assert_allclose(view.px_per_mm_along[row][known], along[known], rtol=0.02)
    # the picture ends at z = 66.5 mm of 70 mm and holds the whole width
    assert view.coat_share == pytest.approx(66.5 / 70.0, abs=0.03)
    wide = camera_view(
        DESIGN.model_copy(update={"camera": TactileCamera(width_px=320, height_px=240)}), tmp_path, scalar
    )
    assert wide.coat_share == pytest.approx(view.coat_share, abs=0.02)  # cells that reach over the edge
    assert np.nanmedian(wide.px_per_mm_across) == pytest.approx(2.0 * np.nanmedian(view.px_per_mm_across), rel=0.05)
    assert "fin-ray-70x35: the camera sees" in str(view)
    assert "px/mm" in str(view)


def test_a_place_that_is_seen_twice_counts_once(scalar, tmp_path):
    """The camera of this finger sees the last 5 mm of its coat twice; the share was 1.08."""
    pad = DESIGN.pad.model_copy(update={"length_mm": 50.0, "width_mm": 30.0})
    ball = DESIGN.indenter.model_copy(update={"position_mm": 25.0})
    view = camera_view(DESIGN.model_copy(update={"pad": pad, "indenter": ball}), tmp_path, scalar)
    # cells of about 1 mm, which reach over the edge by half
    assert view.coat_share == pytest.approx(1.0, abs=0.02)
    assert view.coat_share <= 1.0


def test_a_narrow_camera_sees_less(scalar, tmp_path):
    narrow = DESIGN.model_copy(update={"camera": TactileCamera(width_px=160, height_px=120, field_of_view_deg=70.0)})
    assert camera_view(narrow, tmp_path, scalar).coat_share < 0.7 * camera_view(DESIGN, tmp_path, scalar).coat_share


def test_picture_is_drawn(scalar, tmp_path):
    with styled():
        figure = new_figure(11.0, 4.6)
        draw_camera_view(figure, camera_view(DESIGN, tmp_path, scalar))
        png = png_bytes(figure)
    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape[:2] == (552, 1320)
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 50


def test_a_calibration_is_read_beside_the_design(scalar, tmp_path):
    calibrated = DESIGN.model_copy(
        update={"camera": TactileCamera(width_px=160, height_px=120, calibration="lens.yaml")}
    )
    with pytest.raises(ImportFormatError, match=r"lens\.yaml: no such file"):
        camera_view(calibrated, tmp_path, scalar)
    storage = cv2.FileStorage(str(tmp_path / "lens.yaml"), cv2.FILE_STORAGE_WRITE)
    storage.write("camera_matrix", np.array([[50.0, 0, 80], [0, 50.0, 60], [0, 0, 1]]))
    storage.write("dist_coeffs", np.array([-0.01, 0.001, 0.0, 0.0]))
    for name, value in (("image_width", 160), ("image_height", 120), ("distortion_model", "fisheye")):
        storage.write(name, value)
    storage.release()
    assert camera_view(calibrated, tmp_path, scalar).coat_share > 0.5
