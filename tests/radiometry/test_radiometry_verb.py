"""``finray radiometry`` with a characterised camera, with pixel maps, and on a camera session."""

from pathlib import Path

import numpy as np
import pytest

from data_schemas import (
    BandSignals,
    CameraCharacterisation,
    CameraPlan,
    PaintPlan,
    PixelSignals,
    RadiometryError,
    RecordError,
    RigFile,
)
from data_schemas.storage import read_record
from finray_calib.cli.main import build_parser
from rigs import paint_plan, simulated_rig
from rigs.capture import SessionRequest, capture_camera_session, capture_paint_session


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, RigFile, PaintPlan]:
    rig = simulated_rig("red", seed=3, width_px=160, height_px=128)
    plan = paint_plan("red", rig.camera).model_copy(update={"filters": ("450", "560", "600", "660")})
    folder = tmp_path_factory.mktemp("verb") / "session"
    capture_paint_session(rig, plan, SessionRequest(folder, "pytest"))
    return folder, rig, plan


def run(*arguments: object) -> None:
    parsed = build_parser().parse_args(["radiometry", *map(str, arguments)])
    parsed.run(parsed)


def test_maps_are_written_beside_the_bands(session, tmp_path, capsys) -> None:
    folder, _, plan = session
    run(folder, "--pixels", "--out", tmp_path / "red.bands.json")
    bands = read_record(tmp_path / "red.bands.json", BandSignals)
    pixels = read_record(tmp_path / "red.pixels.json", PixelSignals)
    assert pixels.fluorescence.shape == (4, plan.region.height_px & ~1, plan.region.width_px & ~1)
    assert pixels.optics.filters == bands.optics.filters
    said = capsys.readouterr().out
    assert f"red.pixels.json: {int(pixels.usable.sum())} usable of {pixels.usable.size} pixels" in said
    assert "bleaching through filter" in said
    run(folder, "--pixels", "--whole-frame", "--out", tmp_path / "whole.bands.json")
    whole = read_record(tmp_path / "whole.pixels.json", PixelSignals)
    assert whole.fluorescence.shape == (4, 128, 160)
    row, column = plan.region.row_px, plan.region.column_px
    cut = whole.fluorescence[2, row : row + pixels.area.height_px, column : column + pixels.area.width_px]
    both = np.isfinite(cut) & np.isfinite(pixels.fluorescence[2])
    assert both.sum() > 100
    # The dark offsets are referred to the mean of another area and the profile knows more of the spot's surroundings.
    assert np.median(np.abs(cut[both] / pixels.fluorescence[2][both] - 1)) < 0.02


def test_maps_are_not_begun_when_their_name_is_taken(session, tmp_path) -> None:
    (tmp_path / "red.pixels.json").write_text("{}")
    with pytest.raises(RecordError, match=r"red\.pixels\.json: exists already"):
        run(session[0], "--pixels", "--out", tmp_path / "red.bands.json")
    assert not (tmp_path / "red.bands.json").exists()


def test_whole_frame_without_a_map_is_refused(session, tmp_path) -> None:
    with pytest.raises(RadiometryError, match=r"--whole-frame works only with --pixels, .* add --pixels"):
        run(session[0], "--whole-frame", "--out", tmp_path / "x.json")


@pytest.fixture(scope="module")
def camera_folder(session, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A camera session on the same rig."""
    _, rig, plan = session
    folder = tmp_path_factory.mktemp("camera") / "session"
    camera = CameraPlan(camera_name="bench", region=plan.region, repeats=2, filter_name="600")
    capture_camera_session(rig, camera, SessionRequest(folder, "pytest"))
    return folder


def test_camera_session_becomes_a_characterisation_that_the_paint_session_uses(
    session, camera_folder, tmp_path, capsys
) -> None:
    out = tmp_path / "bench.camera.json"
    run(camera_folder, "--out", out)
    measured = read_record(out, CameraCharacterisation)
    said = capsys.readouterr().out
    assert f"{out}: camera 'bench'" in said
    assert said.count("e/DN, read noise") == 3
    run(session[0], "--camera", out, "--out", tmp_path / "a.bands.json")
    run(session[0], "--out", tmp_path / "b.bands.json")
    used, nominal = (read_record(tmp_path / f"{name}.bands.json", BandSignals) for name in "ab")
    gain = measured.applied_to(session[1].camera).gain_e_per_dn
    assert gain == pytest.approx(6.5, rel=0.1)
    assert any(note.startswith(f"camera characterisation 'bench' used: gain {gain:.4g} e/DN") for note in used.notes)
    assert used.provenance is not None
    assert set(used.provenance.input_sha256) == {f"{session[0].as_posix()}/session.json", out.as_posix()}
    # The gain cancels in the signals: only the weights of the exposures and the variances move.
    good = used.usable()
    np.testing.assert_allclose(used.fluorescence[good], nominal.fluorescence[good], rtol=0.01)
    assert not np.array_equal(used.fluorescence_covariance, nominal.fluorescence_covariance)


def test_what_is_for_paint_sessions_is_refused_for_a_camera_session(camera_folder, tmp_path) -> None:
    for option in (["--pixels"], ["--accept-repeat"], ["--camera", tmp_path / "x.json"]):
        with pytest.raises(
            RadiometryError, match="is a camera session, but --camera, --pixels and --accept-repeat are only for paint"
        ):
            run(camera_folder, *option)


def test_the_page_of_a_camera_is_stored_with_its_record(camera_folder, tmp_path, capsys) -> None:
    out, page = tmp_path / "bench.camera.json", tmp_path / "bench.html"
    run(camera_folder, "--out", out, "--report", page)
    assert f"{page}: the camera after EMVA Standard 1288" in capsys.readouterr().out
    html = page.read_text(encoding="utf-8")
    measured = read_record(out, CameraCharacterisation)
    assert measured.provenance is not None
    for digest in measured.provenance.input_sha256.values():
        assert digest in html
    assert f"{100 * measured.channels[0].prnu_rel.estimate:.2f}"[:3] in html
    with pytest.raises(RecordError, match=r"bench\.html: exists already"):
        run(camera_folder, "--out", tmp_path / "again.json", "--report", page)
    assert not (tmp_path / "again.json").exists()


def test_record_and_page_cannot_be_one_file(camera_folder, tmp_path) -> None:
    with pytest.raises(RecordError, match=r"x\.json: must be a page: choose a --report that ends in \.html"):
        run(camera_folder, "--out", tmp_path / "x.json", "--report", tmp_path / "x.json")
    assert not (tmp_path / "x.json").exists()


def test_the_page_of_a_paint_session_is_refused(session, tmp_path) -> None:
    with pytest.raises(RadiometryError, match="is a paint session, but --report is only for camera sessions"):
        run(session[0], "--report", tmp_path / "page.html")
