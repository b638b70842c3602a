"""``finray sense scale``: from picture files to the record and the lens, and what it refuses."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from data_schemas import CharucoBoard, PixelScale, TactileFrame, TactileSession, provenance
from data_schemas.storage import read_record, write_frame, write_record
from finray_calib.exchange import read_board_picture
from sim.optics import read_calibration
from tests.capture.finger_session import PLAN, RIG, plan_of, rig_of
from tests.command_line.running import finray, load, succeed
from tests.compare.board_scenes import FISHEYE, SIZE_PX, picture, poses, true_scale

SEED = 5
BOARD = "--squares 7x5 --square-mm 3 --marker-mm 2.2"


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with board-0.png (on the pad) to board-6.png, and blank.png."""
    folder = tmp_path_factory.mktemp("boards")
    rng = np.random.default_rng(SEED)
    for k, pose in enumerate(poses("fisheye", FISHEYE, rng, 6)):
        noisy = picture("fisheye", FISHEYE, pose) + rng.normal(0.0, 2.0, SIZE_PX[::-1])
        cv2.imwrite(str(folder / f"board-{k}.png"), np.clip(np.rint(noisy), 0, 255).astype(np.uint8))
    blank = np.tile(np.arange(640, dtype=np.uint8) // 4, (480, 1))
    cv2.imwrite(str(folder / "blank.png"), blank)
    cv2.imwrite(str(folder / "black.png"), np.zeros((480, 640), np.uint8))
    cv2.imwrite(str(folder / "small.png"), blank[:100])
    (folder / "words.png").write_text("no picture")
    return folder


def lens(folder: Path, last: int = 6) -> str:
    """Return the files of the tilted boards."""
    return " ".join(f"{folder}/board-{k}.png" for k in range(1, last + 1))


def test_pictures_become_a_record_and_a_lens(pictures: Path, tmp_path: Path) -> None:
    out = tmp_path / "scale.json"
    command = (
        f"sense scale {lens(pictures)} {pictures}/blank.png --pad {pictures}/board-0.png {BOARD} "
        f"--square-u-mm 0.003 --out {out}"
    )
    outcome = finray(command)
    assert outcome.status == 0
    assert re.match(rf"left out: {pictures}/blank.png: only 0 of the 24 corners", outcome.err)
    record = read_record(out, PixelScale)
    places = poses("fisheye", FISHEYE, np.random.default_rng(SEED), 6)
    truth = true_scale("fisheye", FISHEYE, places[0], np.array([record.middle.column_px, record.middle.row_px]))
    assert record.middle.along_x_mm_per_px == pytest.approx(truth[0], rel=1e-3)
    assert record.square_u_rel == pytest.approx(0.001)
    assert len(record.lens_pictures) == 6
    assert f"mm_per_px = {record.middle.mean_mm_per_px:.5g}" in outcome.out
    assert re.search(r"along x +0\.0\d+ mm/px, u = 0\.1\d %", outcome.out)
    # what designs read
    assert read_calibration(tmp_path / "scale.lens.yaml").focal_px == pytest.approx(record.calibration.focal_px)
    assert load(out)["record"]["provenance"]["seed"] == 1
    before = out.read_bytes()
    again = finray(command)
    assert again.status == 2
    assert "exists already and is not overwritten" in again.err
    assert out.read_bytes() == before


def test_a_plan_may_say_what_was_printed(pictures: Path, tmp_path: Path) -> None:
    plan = tmp_path / "plan.toml"
    head = (
        'kind = "tactile"\nname = "a"\ndesign = "b"\nexposures_s = [0.01]\nled_current_ma = 20.0\n'
        "light_angle_deg = 30.0\nlight_angle_uncertainty_deg = 0.5\n"
        '[indenter]\nshape = "ball"\nradius_mm = 4.0\n[[presses]]\ndepth_mm = 1.0\nposition_mm = 35.0\n'
        "depth_uncertainty_mm = 0.02\nposition_uncertainty_mm = 0.1\n"
    )
    plan.write_text(head)
    rest = f"{lens(pictures)} --pad {pictures}/board-0.png --plan {plan} --square-u-mm 0.003"
    refused = finray(f"sense scale {rest} --out {tmp_path}/a.json")
    assert refused.status == 2
    assert "has no [board] table" in refused.err
    plan.write_text(f'{head}[board]\nsquares = [7, 5]\nsquare_mm = 3.0\nmarker_mm = 2.2\ndictionary = "DICT_4X4_50"\n')
    said = succeed(f"sense scale {rest} --lens-model fisheye --out {tmp_path}/b.json")
    assert "fisheye lens from 6 pictures" in said
    both = finray(f"sense scale {rest} {BOARD} --out {tmp_path}/c.json")
    assert both.status == 2
    assert "--plan already describes the board" in both.err
    other = finray(f"sense scale {rest} --dictionary DICT_5X5_50 --out {tmp_path}/c.json")
    assert other.status == 2
    assert "--plan already describes the board" in other.err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--pad {0}/board-0.png --square-u-mm 0.003", "--squares, --square-mm, --marker-mm: missing"),
        ("--pad {0}/board-0.png --squares 7x5 --marker-mm 2 --square-u-mm 0.003", "--square-mm: missing"),
        (
            "--pad {0}/board-0.png --squares 7 --square-mm 3 --marker-mm 2 --square-u-mm 0.003",
            "must be two whole numbers such as 7x5",
        ),
        (
            "--pad {0}/board-0.png --squares \u00b2x5 --square-mm 3 --marker-mm 2 --square-u-mm 0.003",
            "--squares \u00b2x5: must be two whole numbers such as 7x5",
        ),
        (
            "--pad {0}/board-0.png --squares 7x5 --square-mm 0 --marker-mm 2 --square-u-mm 0.003",
            "'square_mm' .in mm.: must be above 0",
        ),
        (
            "--pad {0}/board-0.png --squares 7x5 --square-mm 0.003 --marker-mm 0.0022 --square-u-mm 0.000003",
            r"square_mm = 0\.003 mm must be 0\.2 to 100 mm; if it was given in metres",
        ),
        ("--pad {0}/board-0.png " + BOARD, "--square-u-mm is missing; measure all squares"),
        ("--pad {0}/board-0.png --square-u-mm 3 " + BOARD, r"--square-u-mm 3: must be 0 to 0\.3 mm"),
        ("--pad {0}/board-0.png --square-u-mm nan " + BOARD, "--square-u-mm nan: must be"),
        (
            "--pad {0}/board-0.png --square-u-mm 0.003 --coat-behind-mm 1000 " + BOARD,
            "--coat-behind-mm 1000, --coat-behind-u-mm 0: the first must be -100 to 100 mm",
        ),
        ("--pad {0}/blank.png --square-u-mm 0.003 " + BOARD, "blank.png: only 0 of the 24 corners of the board"),
        ("--pad {0}/black.png --square-u-mm 0.003 " + BOARD, "black.png: every pixel has the same value"),
        (
            "--pad {0}/words.png --square-u-mm 0.003 " + BOARD,
            "words.png: is neither PNG nor JPEG; give a PNG or JPEG picture",
        ),
        ("--pad {0}/none.png --square-u-mm 0.003 " + BOARD, "none.png: no such file; give the path of an image"),
        ("--pad {0}/small.png --square-u-mm 0.003 " + BOARD, r"have different sizes .*\[\(100, 640\), \(480, 640\)\]"),
    ],
)
def test_what_is_wrong_is_named(pictures: Path, tmp_path: Path, options: str, message: str) -> None:
    outcome = finray(f"sense scale {lens(pictures, 4)} {options.format(pictures)} --out {tmp_path}/s.json")
    assert outcome.status == 2
    assert outcome.out == ""
    assert re.search(message, outcome.err), outcome.err
    assert not list(tmp_path.iterdir())


def test_few_pictures_are_refused(pictures: Path, tmp_path: Path) -> None:
    outcome = finray(
        f"sense scale {lens(pictures, 3)} --pad {pictures}/board-0.png {BOARD} --square-u-mm 0.003 "
        f"--out {tmp_path}/s.json"
    )
    assert outcome.status == 2
    assert "give at least 4" in outcome.err


def test_raw_grey_and_colour_pictures_show_the_same(pictures: Path, tmp_path: Path) -> None:
    grey = read_board_picture(pictures / "board-0.png")
    counts = grey.astype(np.uint16) * 16
    tifffile.imwrite(tmp_path / "raw.tiff", counts)
    cv2.imwrite(str(tmp_path / "colour.png"), np.repeat(grey[..., None], 3, axis=2))
    assert np.array_equal(read_board_picture(tmp_path / "raw.tiff", monochrome=True), grey)
    assert np.array_equal(read_board_picture(tmp_path / "colour.png"), grey)
    # what a Bayer mosaic does to a grey scene is a blur of a pixel
    demosaiced = read_board_picture(tmp_path / "raw.tiff")
    assert np.median(np.abs(demosaiced.astype(int) - grey)) <= 5
    tifffile.imwrite(tmp_path / "two.tiff", np.zeros((8, 8, 2), np.uint16) + np.arange(8, dtype=np.uint16)[:, None])
    refused = finray(f"sense scale {tmp_path}/two.tiff --pad {tmp_path}/two.tiff {BOARD} --square-u-mm 0.003")
    assert refused.status == 2


def session_of(folder: Path, pictures: Path, on_pad: bool) -> Path:
    """Write a tactile session whose board images are the pictures; of the second place there is a clipped one too."""
    board = CharucoBoard(
        squares=(7, 5), square_mm=3.0, marker_mm=2.2, dictionary="DICT_4X4_50", images=7, on_pad=on_pad
    )
    (folder / "frames").mkdir(parents=True)
    plan = plan_of(folder, PLAN).model_copy(update={"board": board})
    frames = []
    for place in range(1, 8):
        grey = cv2.imread(str(pictures / f"board-{place - 1}.png"), cv2.IMREAD_GRAYSCALE)
        exposures = [(0.01, grey.astype(np.uint16) * 4, 0.0)]
        if place == 2:
            exposures.append((0.1, np.full_like(exposures[0][1], 1023), 1.0))
        for exposure_s, counts, saturated in exposures:
            file = f"frames/{len(frames):05d}_board_{place}.tiff"
            digest = write_frame(folder / file, counts, "a board")
            frames.append(
                TactileFrame(
                    sequence=len(frames), file=file, frame_type="board", place=place, exposure_requested_s=exposure_s,
                    exposure_s=exposure_s,
                    captured_utc="2026-01-01T00:00:00Z", captured_s=0.0, saturated_fraction=saturated, sha256=digest,
                )
            )  # fmt: skip
    session = TactileSession(
        plan=plan, rig=rig_of(folder, RIG), presses=plan.presses, frames=tuple(frames), captures=()
    )
    write_record(session, folder / "session.json", provenance("pytest"))
    return folder


def test_a_session_knows_its_pictures(pictures: Path, tmp_path: Path) -> None:
    folder = session_of(tmp_path / "session", pictures, on_pad=True)
    said = succeed(f"sense scale {folder} --square-u-mm 0.003 --monochrome --out {tmp_path}/s.json")
    assert "from 6 pictures" in said
    record = read_record(tmp_path / "s.json", PixelScale)
    assert Path(record.pad_picture.file).name == "00000_board_1.tiff"
    places = poses("fisheye", FISHEYE, np.random.default_rng(SEED), 6)
    truth = true_scale("fisheye", FISHEYE, places[0], np.array([record.middle.column_px, record.middle.row_px]))
    assert record.middle.along_x_mm_per_px == pytest.approx(truth[0], rel=1e-3)
    both = finray(f"sense scale {folder} {BOARD} --square-u-mm 0.003 --out {tmp_path}/t.json")
    assert both.status == 2
    assert "is a session, which already contains its pictures and its board" in both.err
    for option in ("--square-mm 3.02", "--marker-mm 2.21", "--dictionary DICT_5X5_50"):
        ignored = finray(f"sense scale {folder} {option} --square-u-mm 0.003 --out {tmp_path}/t.json")
        assert ignored.status == 2
        assert "is a session, which already contains its pictures and its board; leave out --pad" in ignored.err
    (folder / "frames/00000_board_1.tiff").write_bytes(b"changed")
    changed = finray(f"sense scale {folder} --square-u-mm 0.003 --out {tmp_path}/t.json")
    assert changed.status == 2
    assert "SHA-256 differs" in changed.err


def test_a_session_whose_first_picture_lies_anywhere_is_refused(pictures: Path, tmp_path: Path) -> None:
    folder = session_of(tmp_path / "session", pictures, on_pad=False)
    outcome = finray(f"sense scale {folder} --square-u-mm 0.003 --out {tmp_path}/s.json")
    assert outcome.status == 2
    assert "does not state that the first picture shows the board on the pad" in outcome.err
    missing = finray(f"sense scale {lens(pictures)} {BOARD} --square-u-mm 0.003 --out {tmp_path}/s.json")
    assert missing.status == 2
    assert "--pad is missing; give the picture of the board" in missing.err


def test_a_session_without_the_board_on_the_pad_is_refused(pictures: Path, tmp_path: Path) -> None:
    folder = session_of(tmp_path / "session", pictures, on_pad=True)
    session = read_record(folder / "session.json", TactileSession)
    frames = tuple(frame for frame in session.frames if frame.place != 1)
    (folder / "session.json").unlink()
    write_record(session.model_copy(update={"frames": frames}), folder / "session.json", provenance("pytest"))
    outcome = finray(f"sense scale {folder} --square-u-mm 0.003 --monochrome --out {tmp_path}/s.json")
    assert outcome.status == 2
    assert "the picture of the board on the pad is missing, perhaps because the session was interrupted" in outcome.err


def test_the_picture_on_the_pad_may_be_among_the_others(pictures: Path, tmp_path: Path) -> None:
    every = f"{lens(pictures)} {pictures}/../{pictures.name}/board-0.png --pad {pictures}/board-0.png"
    out = tmp_path / "s.json"
    succeed(f"sense scale {every} {BOARD} --square-u-mm 0.003 --lens-model fisheye --out {out}")
    assert len(read_record(out, PixelScale).lens_pictures) == 6
    twice = finray(f"sense scale {pictures}/board-1.png {every} {BOARD} --square-u-mm 0.003 --out {tmp_path}/t.json")
    assert twice.status == 2
    assert "board-1.png: is given twice; give each picture once" in twice.err
