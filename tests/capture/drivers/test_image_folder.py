"""Replay of images: stored sessions, and raw files of others (TIFF, PNG, DNG by LibRaw, legacy Pi JPEG)."""

import struct
import sys
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
from hypothesis import given
from hypothesis import strategies as st

from data_schemas import BadFrameError, CameraSettings, CaptureSession, MissingExtraError, RefusedError
from data_schemas.storage import rggb_frame
from rigs.cameras import read_dng, read_raw
from rigs.cameras._image_files import BRCM_ORDERS, read_exposure_s
from rigs.cameras.image_folder import open_camera
from rigs.capture import read_frame_of
from tests.capture.drivers.programs import require_module

HEIGHT_PX, WIDTH_PX, BIT_DEPTH = 64, 96, 10
DEADLINE_S = 5.0
RAW_BLOCK_BYTES = 32768 + 64 * 128  # 96 px of 10 bits are 120 bytes, padded to 128
COUNTS = np.random.default_rng(1).integers(0, 2**BIT_DEPTH, (HEIGHT_PX, WIDTH_PX)).astype(np.uint16)


def settings(folder: Path, **more: Any) -> CameraSettings:
    size = {"width_px": WIDTH_PX, "height_px": HEIGHT_PX, "bit_depth": BIT_DEPTH}
    return CameraSettings(driver="folder", address=str(folder), **size | more)


def write_tiff(path: Path, counts: np.ndarray, exposure: tuple[int, int] | None = None) -> None:
    tags = [] if exposure is None else [(33434, "2I", 1, exposure, True)]
    tifffile.imwrite(path, counts, photometric="minisblack", metadata=None, extratags=tags)


def write_dng(path: Path, counts: np.ndarray, pattern: tuple[int, ...], *more: tuple[Any, ...]) -> None:
    """Write a plain DNG: the tags that Adobe's specification demands of a raw image."""
    matrix = tuple(number for value in np.eye(3).ravel() for number in (int(1000 * value), 1000))
    tags = [
        (33421, "H", 2, (2, 2), True),  # CFARepeatPatternDim
        (33422, "B", 4, bytes(pattern), True),  # CFAPattern
        (50706, "B", 4, bytes([1, 4, 0, 0]), True),  # DNGVersion
        (50708, "s", 0, "Test", True),  # UniqueCameraModel
        (50717, "H", 1, 2**BIT_DEPTH - 1, True),  # WhiteLevel
        (50721, "2i", 9, matrix, True),  # ColorMatrix1
        (50778, "H", 1, 21, True),  # CalibrationIlluminant1
        (33434, "2I", 1, (1, 50), True),  # ExposureTime
        *more,
    ]
    tifffile.imwrite(path, counts, photometric=32803, planarconfig=1, metadata=None, extratags=tags)


def test_every_image_is_delivered_once_in_order_of_names(tmp_path: Path) -> None:
    for name, shift in (("b.tiff", 1), ("a.tif", 0), ("c.TIFF", 2)):
        write_tiff(tmp_path / name, np.roll(COUNTS, shift))
    (tmp_path / "frames.csv").write_text("file,exposure_s\nb.tiff,0.01\na.tif,0.02\nc.TIFF,0.0102\n")
    (tmp_path / "notes.txt").write_text("not an image")
    with open_camera(settings(tmp_path), Path()) as camera:
        identity = camera.identity()
        frames = [camera.expose(t, DEADLINE_S) for t in (0.01, 0.01, 0.02)]
        with pytest.raises(RefusedError, match="all 3 images are used"):
            camera.expose(0.01, DEADLINE_S)
    assert (identity.driver, identity.model) == ("folder", "raw images")
    assert [f.settings["file"] for f in frames] == ["b.tiff", "c.TIFF", "a.tif"]
    assert [f.exposure_s for f in frames] == [0.01, 0.0102, 0.02]
    assert len({f.frame_id for f in frames}) == 3
    for frame, shift in zip(frames, (1, 2, 0), strict=True):
        np.testing.assert_array_equal(frame.counts, np.roll(COUNTS, shift))


def test_exposure_that_no_image_has_is_refused(tmp_path: Path) -> None:
    write_tiff(tmp_path / "a.tiff", COUNTS, (1, 50))
    with open_camera(settings(tmp_path), Path()) as camera:
        with pytest.raises(
            RefusedError, match=r"none of the 1 unused images has an exposure of 0\.04 s, only of 0\.02 s"
        ):
            camera.expose(0.04, DEADLINE_S)
        np.testing.assert_array_equal(camera.expose(0.02, DEADLINE_S).counts, COUNTS)


@pytest.mark.parametrize(("exposure_s", "fits"), [(0.0194, True), (0.01895, False), (0.02099, True), (0.02104, False)])
def test_image_fits_where_a_capture_takes_its_exposure(tmp_path: Path, exposure_s: float, fits: bool) -> None:
    """Within 5 % of what is asked for, as the capture engine counts it: its refusal would end the capture."""
    write_tiff(tmp_path / "a.tiff", COUNTS)
    (tmp_path / "frames.csv").write_text(f"file,exposure_s\na.tiff,{exposure_s}\n")
    with (
        open_camera(settings(tmp_path), Path()) as camera,
        nullcontext() if fits else pytest.raises(RefusedError, match="none of the 1 unused images"),
    ):
        assert camera.expose(0.02, DEADLINE_S).exposure_s == exposure_s


def test_stored_session_comes_back_as_it_was(captured: tuple[Path, CaptureSession, list[Any]]) -> None:
    folder, session, _ = captured
    stored = session.rig.camera
    with open_camera(stored.model_copy(update={"driver": "folder", "address": str(folder)}), Path()) as camera:
        for frame in session.frames:
            replayed = camera.expose(frame.exposure_s, DEADLINE_S)
            assert replayed.exposure_s == frame.exposure_s
            assert replayed.settings["file"] == frame.file
            np.testing.assert_array_equal(replayed.counts, read_frame_of(folder, frame))
        with pytest.raises(RefusedError, match=f"all {len(session.frames)} images are used"):
            camera.expose(session.frames[0].exposure_s, DEADLINE_S)


def test_changed_frame_of_a_session_is_refused(
    captured: tuple[Path, CaptureSession, list[Any]], tmp_path: Path
) -> None:
    folder, session, _ = captured
    (tmp_path / "frames").mkdir()
    (tmp_path / "session.json").write_bytes((folder / "session.json").read_bytes())
    first = session.frames[0]
    content = bytearray((folder / first.file).read_bytes())
    content[-1] ^= 1
    (tmp_path / first.file).write_bytes(content)
    with open_camera(settings(tmp_path, bit_depth=16), Path()) as camera:
        for message in ("SHA-256 differs", "frame is missing"):
            with pytest.raises(BadFrameError, match=message):
                camera.expose(first.exposure_s, DEADLINE_S)
    (tmp_path / "session.json").write_text("{}")
    with (
        pytest.raises(RefusedError, match="contains no record of a known kind"),
        open_camera(settings(tmp_path), Path()),
    ):
        pass


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("file,exposure_s\na.tiff,-1\n", r"gives a\.tiff an exposure of -1 s, but exposures must be above 0"),
        ("file,exposure_s\na.tiff,nan\n", r"frames\.csv cannot be read \('nan' is not a finite number\)"),
        ("file,exposure_s\na.tiff,long\n", r"frames\.csv cannot be read .*needs the columns 'file' and 'exposure_s'"),
        ("file,exposure_s\na.tiff,1\na.tiff,2\n", r"a\.tiff is listed twice, the second time in line 3"),
        ("file,exposure_s\na.tiff,1,5\n", r"line 2: has 3 columns, but the header has 2"),
        ("name,time\na.tiff,1\n", r"frames\.csv cannot be read .*needs the columns 'file' and 'exposure_s'"),
        ("file,exposure_s\nz.tiff,1\n", r"frames\.csv names z\.tiff, but z\.tiff is missing from"),
        ("file,exposure_s\n", r"the exposure of a\.tiff is unknown; add frames\.csv"),
    ],
)
def test_list_of_exposures_that_cannot_be_used_is_refused(tmp_path: Path, table: str, message: str) -> None:
    write_tiff(tmp_path / "a.tiff", COUNTS)
    (tmp_path / "frames.csv").write_text(table)
    with pytest.raises(RefusedError, match=message), open_camera(settings(tmp_path), Path()):
        pass


def test_folder_that_is_missing_or_empty_is_refused(tmp_path: Path) -> None:
    with (
        pytest.raises(RefusedError, match=r"the folder .*no does not exist"),
        open_camera(settings(tmp_path / "no"), Path()),
    ):
        pass
    with (
        pytest.raises(RefusedError, match=r"contains no images; supported file name endings are \.dng"),
        open_camera(settings(tmp_path), Path()),
    ):
        pass


def test_counts_beyond_the_bits_are_refused(tmp_path: Path) -> None:
    write_tiff(tmp_path / "a.tiff", COUNTS << 6, (1, 50))
    with (
        open_camera(settings(tmp_path), Path()) as camera,
        pytest.raises(BadFrameError, match="but 10 bits allow less; correct bit_depth"),
    ):
        camera.expose(0.02, DEADLINE_S)


def test_png_by_another_writer(tmp_path: Path) -> None:
    for name, counts in (("wide.png", COUNTS), ("narrow.png", (COUNTS >> 2).astype(np.uint8))):
        cv2.imwrite(str(tmp_path / name), counts)
        np.testing.assert_array_equal(read_raw(tmp_path / name), counts)


# CFAPattern 0 red, 1 green, 2 blue
PATTERNS = {"RGGB": (0, 1, 1, 2), "BGGR": (2, 1, 1, 0), "GRBG": (1, 0, 2, 1), "GBRG": (1, 2, 0, 1)}


def libraw_counts(path: Path) -> np.ndarray:
    """The oracle: counts of the active area as LibRaw reads them."""
    import rawpy

    with rawpy.imread(str(path)) as raw:
        return np.array(raw.raw_image_visible)


@pytest.mark.parametrize("order", PATTERNS)
def test_dng_is_read_as_by_libraw_and_begins_with_red(tmp_path: Path, order: str) -> None:
    require_module("rawpy", "rawpy")
    write_dng(tmp_path / "a.dng", COUNTS, PATTERNS[order])
    found = read_raw(tmp_path / "a.dng")
    assert read_exposure_s(tmp_path / "a.dng") == pytest.approx(0.02)
    np.testing.assert_array_equal(libraw_counts(tmp_path / "a.dng"), COUNTS)
    row, column = divmod(PATTERNS[order].index(0), 2)
    np.testing.assert_array_equal(found[:2, :2], COUNTS[row : row + 2, column : column + 2])
    assert found.shape == (HEIGHT_PX - 2 * row, WIDTH_PX - 2 * column)


def packed_dng(counts: np.ndarray, more: tuple[tuple[Any, ...], ...] = ()) -> bytes:
    """A DNG of 10 bits without gaps, most significant bit first, as PiDNG writes it: tags in order, then the strip."""
    bits = np.unpackbits(counts.astype(">u2").view(np.uint8).reshape(*counts.shape, 2), axis=2)[..., 6:]
    strip = np.packbits(bits.reshape(counts.shape[0], -1), axis=1).tobytes()
    matrix = [number for value in np.eye(3).ravel() for number in (int(1000 * value), 1000)]
    codes = {"B": 1, "H": 3, "I": 4, "i": 10}
    tags = [
        (254, "I", [0]), (256, "I", [counts.shape[1]]), (257, "I", [counts.shape[0]]), (258, "H", [10]),
        (259, "H", [1]), (262, "H", [32803]), (273, "I", [0]), (277, "H", [1]), (278, "I", [counts.shape[0]]),
        (279, "I", [len(strip)]), (33421, "H", [2, 2]), (33422, "B", [2, 1, 1, 0]), (50706, "B", [1, 4, 0, 0]),
        (50717, "H", [1023]), (50721, "i", matrix), *more,
    ]  # fmt: skip
    extra_at = 8 + 2 + 12 * len(tags) + 4
    strip_at = extra_at + sum(len(v) * struct.calcsize(k) for _, k, v in tags if len(v) * struct.calcsize(k) > 4)
    entries, extra = b"", b""
    for number, kind, values in tags:
        values = [strip_at] if number == 273 else values
        content = struct.pack(f"<{len(values)}{kind}", *values)
        if len(content) > 4:
            content, extra = struct.pack("<I", extra_at + len(extra)), extra + content
        count = len(values) // (2 if kind == "i" else 1)  # a rational has two
        entries += struct.pack("<HHI", number, codes[kind], count) + content.ljust(4, b"\0")
    return b"II*\0" + struct.pack("<IH", 8, len(tags)) + entries + bytes(4) + extra + strip


def test_packed_dng_is_read_by_libraw(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    require_module("rawpy", "rawpy")
    image = read_dng(packed_dng(COUNTS), Path("a.dng"))
    assert (image.order, image.white_dn) == ("BGGR", 1023)
    np.testing.assert_array_equal(image.counts, COUNTS)
    with pytest.raises(BadFrameError, match="cannot be read as DNG"):
        read_dng(packed_dng(COUNTS)[:200], Path("a.dng"))
    monkeypatch.setitem(sys.modules, "rawpy", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'finray-calib\[dng\]'"):
        read_dng(packed_dng(COUNTS), Path("a.dng"))


ACTIVE_AREA = (50829, "I", 4, (3, 5, 63, 95), True)


def test_active_area_of_a_dng_is_cut_out(tmp_path: Path) -> None:
    """An odd margin turns the pattern, which the file gives for the active area."""
    require_module("rawpy", "rawpy")
    write_dng(tmp_path / "a.dng", COUNTS, PATTERNS["BGGR"], ACTIVE_AREA)
    found = read_dng((tmp_path / "a.dng").read_bytes(), tmp_path / "a.dng")
    assert found.order == "BGGR"
    np.testing.assert_array_equal(found.counts, COUNTS[3:63, 5:95])
    # LibRaw begins a row and a column later, with red: the same frame after the cut.
    by_libraw = read_dng(packed_dng(COUNTS, ((50829, "I", [3, 5, 63, 95]),)), tmp_path / "a.dng")
    np.testing.assert_array_equal(rggb_frame(by_libraw.counts, by_libraw.order), rggb_frame(found.counts, found.order))


def test_coded_counts_of_a_dng_are_linear_again(tmp_path: Path) -> None:
    """Eight bits that a table makes more of (DNG 1.6, LinearizationTable): the codes are not proportional to light."""
    require_module("rawpy", "rawpy")
    table = np.arange(256, dtype=np.uint16) ** 2 // 64
    codes = (COUNTS >> 2).astype(np.uint8)
    write_dng(tmp_path / "a.dng", codes, PATTERNS["RGGB"], (50712, "H", 256, tuple(table.tolist()), True))
    np.testing.assert_array_equal(read_dng((tmp_path / "a.dng").read_bytes(), tmp_path / "a.dng").counts, table[codes])


def test_broken_and_missing_dng(tmp_path: Path) -> None:
    (tmp_path / "a.dng").write_bytes(b"no raw file at all")
    with pytest.raises(BadFrameError, match="cannot be read as DNG"):
        read_raw(tmp_path / "a.dng")
    with pytest.raises(BadFrameError, match=r"none\.dng: no such file; give the path of an image"):
        read_raw(tmp_path / "none.dng")


def packed(counts: np.ndarray, bits: int) -> np.ndarray:
    """Pack counts as MIPI CSI-2 does: high bytes of 4 (10 bits) or 2 (12 bits) pixels, then their low bits."""
    pixels = {10: 4, 12: 2}[bits]
    groups = counts.reshape(counts.shape[0], -1, pixels)
    low = np.zeros(groups.shape[:2], dtype=np.uint16)
    for i in range(pixels):
        low |= (groups[..., i] & (2 ** (bits - 8) - 1)) << (i * (bits - 8))
    return np.concatenate((groups >> (bits - 8), low[..., None]), axis=2).astype(np.uint8).reshape(len(counts), -1)


def raw_jpeg(counts: np.ndarray, bits: int, order: int) -> bytes:
    """A small JPEG with the raw block that raspistill appends: header at 176, rows of 32 n bytes at 32768."""
    rows = packed(counts, bits)
    padded = np.zeros((-(-rows.shape[0] // 16) * 16, -(-rows.shape[1] // 32) * 32), dtype=np.uint8)
    padded[: rows.shape[0], : rows.shape[1]] = rows
    block = bytearray(32768)
    block[:4] = b"BRCM"
    fields = (b"ov5647", counts.shape[1], counts.shape[0], 0, 0, b"", 0, 33, order, {10: 3, 12: 4}[bits])
    struct.pack_into("<32s4H24s2H2B", block, 176, *fields)
    picture = cv2.imencode(".jpg", np.zeros((8, 8, 3), dtype=np.uint8))[1].tobytes()
    return picture + bytes(block) + padded.tobytes()


@pytest.mark.parametrize("bits", [10, 12])
@pytest.mark.parametrize("order", range(4))
def test_raw_behind_a_legacy_jpeg(tmp_path: Path, bits: int, order: int) -> None:
    counts = (COUNTS << (bits - 10)) | (COUNTS & (2 ** (bits - 10) - 1))
    (tmp_path / "a.jpg").write_bytes(raw_jpeg(counts, bits, order))
    np.testing.assert_array_equal(read_raw(tmp_path / "a.jpg"), rggb_frame(counts, BRCM_ORDERS[order]))


@pytest.mark.parametrize("cut", [1, 100, 32768])
def test_jpeg_without_whole_raw_data_is_refused(tmp_path: Path, cut: int) -> None:
    (tmp_path / "a.jpg").write_bytes(raw_jpeg(COUNTS, 10, 0)[:-cut])
    with pytest.raises(BadFrameError, match="no raw data follow the JPEG, but a processed picture is not proportional"):
        read_raw(tmp_path / "a.jpg")


def test_exposure_of_a_jpeg_is_that_of_its_exif(tmp_path: Path) -> None:
    """Pillow writes the EXIF block."""
    require_module("PIL", "pillow")
    from PIL import Image

    exif = Image.Exif()
    exif.get_ifd(0x8769)[33434] = 1 / 50
    Image.new("RGB", (8, 8)).save(tmp_path / "p.jpg", exif=exif)
    with_raw = (tmp_path / "p.jpg").read_bytes() + raw_jpeg(COUNTS, 10, 0)[-RAW_BLOCK_BYTES:]
    (tmp_path / "a.jpg").write_bytes(with_raw)
    found = read_raw(tmp_path / "a.jpg")
    assert read_exposure_s(tmp_path / "a.jpg") == pytest.approx(0.02)
    np.testing.assert_array_equal(found, COUNTS)


def test_pictures_are_no_raw_counts(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((8, 8, 3), dtype=np.uint8))
    with pytest.raises(BadFrameError, match=r"is uint8 of shape \(8, 8, 3\), but raw Bayer counts must be one number"):
        read_raw(tmp_path / "a.png")
    (tmp_path / "a.png").write_bytes(b"nothing")
    with pytest.raises(BadFrameError, match="is neither PNG nor JPEG"):
        read_raw(tmp_path / "a.png")
    (tmp_path / "a.tiff").write_bytes(b"nothing")
    with pytest.raises(BadFrameError, match="cannot be read as TIFF"):
        read_raw(tmp_path / "a.tiff")


def test_dng_without_a_known_pattern_is_refused(tmp_path: Path) -> None:
    write_dng(tmp_path / "a.dng", COUNTS, (0, 0, 0, 0))
    with pytest.raises(BadFrameError, match=r"Bayer pattern \[0, 0, 0, 0\] of an image .* is not supported"):
        read_raw(tmp_path / "a.dng")


@given(st.sampled_from([".jpg", ".png", ".tiff", ".dng"]), st.data())
def test_any_bytes_give_counts_or_the_declared_error(
    tmp_path_factory: pytest.TempPathFactory, suffix: str, data: st.DataObject
) -> None:
    whole = raw_jpeg(COUNTS, 10, 0)
    damaged = bytearray(whole[-RAW_BLOCK_BYTES:])
    for _ in range(data.draw(st.integers(0, 6))):
        damaged[data.draw(st.integers(0, 260))] = data.draw(st.integers(0, 255))
    content = data.draw(st.one_of(st.binary(max_size=64), st.just(bytes(damaged))))
    path = tmp_path_factory.mktemp("fuzz") / f"a{suffix}"
    path.write_bytes(content)
    try:
        found = read_raw(path)
    except BadFrameError:
        return
    assert found.ndim == 2
    assert read_exposure_s(path) is None
