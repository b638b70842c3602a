"""Pictures: size and wholeness before decoding."""

import struct
import time
import zlib

import cv2
import numpy as np
import pytest
import tifffile

from data_schemas import BadFrameError, ImportFormatError
from data_schemas.storage import tiff_image
from rigs.cameras import read_picture

PICTURE = cv2.GaussianBlur(np.random.default_rng(2).integers(0, 255, (48, 64, 3)).astype(np.uint8), (0, 0), 3)


@pytest.mark.parametrize("suffix", ["png", "jpg"])
def test_whole_pictures_are_as_opencv_reads_them(tmp_path, suffix):
    path = tmp_path / f"a.{suffix}"
    cv2.imwrite(str(path), PICTURE)
    np.testing.assert_array_equal(read_picture(path), cv2.imread(str(path), cv2.IMREAD_UNCHANGED))
    sixteen = PICTURE[..., 0].astype(np.uint16) << 8
    cv2.imwrite(str(tmp_path / "b.png"), sixteen)
    np.testing.assert_array_equal(read_picture(tmp_path / "b.png"), sixteen)


@pytest.mark.parametrize("suffix", ["png", "jpg"])
def test_a_picture_that_is_cut_off_is_refused_at_every_length(tmp_path, suffix):
    path = tmp_path / f"a.{suffix}"
    cv2.imwrite(str(path), PICTURE)
    content = path.read_bytes()
    for length in range(1, len(content) - 1, 37):
        path.write_bytes(content[:length])
        with pytest.raises(BadFrameError, match=r"truncated|neither PNG nor JPEG"):
            read_picture(path)


@pytest.mark.parametrize("flags", [[], [cv2.IMWRITE_JPEG_PROGRESSIVE, 1], [cv2.IMWRITE_JPEG_RST_INTERVAL, 2]])
def test_any_data_may_follow_a_whole_jpeg(tmp_path, flags):
    """Phones append a film of the moment, whose bytes look like any mark of a JPEG."""
    path = tmp_path / "a.jpg"
    cv2.imwrite(str(path), PICTURE, flags)
    content, seen = path.read_bytes(), read_picture(path)
    for more in (b"\xff\xda a film", b"\xff\xd8\xff\xda", b"\r\n\0"):
        path.write_bytes(content + more)
        np.testing.assert_array_equal(read_picture(path), seen)
        path.write_bytes(content[:-2] + more)
        with pytest.raises(BadFrameError, match="truncated"):
            read_picture(path)


def test_a_cut_jpeg_whose_rest_was_never_written_is_refused_at_once(tmp_path):
    """Flash memory that holds nothing reads as 0xFF; they were searched again from each one on."""
    path = tmp_path / "a.jpg"
    cv2.imwrite(str(path), PICTURE)
    path.write_bytes(path.read_bytes()[:-2] + b"\xff" * 2**16)
    start_s = time.process_time()
    with pytest.raises(BadFrameError, match="truncated"):
        read_picture(path)
    # 1 ms on one core, and half a minute when each is searched from
    assert time.process_time() - start_s < 3.0


def test_every_changed_byte_of_a_png_is_noticed(tmp_path):
    path = tmp_path / "a.png"
    cv2.imwrite(str(path), PICTURE)
    content = path.read_bytes()
    for at in range(0, len(content), 11):
        path.write_bytes(content[:at] + bytes([content[at] ^ 4]) + content[at + 1 :])
        with pytest.raises(BadFrameError, match=r"corrupted|neither PNG nor JPEG"):
            read_picture(path)


def png_of(width, height):
    """A PNG whose checksums are right and whose header promises this size."""

    def chunk(name, body):
        return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b"")


def test_a_picture_that_promises_too_many_pixels_is_not_decoded(tmp_path):
    path = tmp_path / "a.png"
    for width, height in ((100_000, 100_000), (2**31 - 1, 2**31 - 1), (0, 5)):
        path.write_bytes(png_of(width, height))
        with pytest.raises(BadFrameError, match=r"MB when decoded, but must take more than 0 and at most 256 MB"):
            read_picture(path)
    path.write_bytes(png_of(8, 8))
    with pytest.raises(BadFrameError, match="cannot be decoded"):
        read_picture(path)
    cv2.imwrite(str(tmp_path / "a.jpg"), PICTURE)
    content = bytearray((tmp_path / "a.jpg").read_bytes())
    at = content.index(b"\xff\xc0") + 5
    content[at : at + 4] = b"\xff\xff\xff\xff"
    path.write_bytes(content)
    with pytest.raises(BadFrameError, match="MB when decoded"):
        read_picture(path)


def test_tiff_plain_packed_stacked_and_too_large(tmp_path):
    counts = np.arange(48 * 64, dtype=np.uint16).reshape(48, 64)
    path = tmp_path / "a.tiff"
    for compression in (None, "zlib"):
        tifffile.imwrite(path, counts, compression=compression)
        np.testing.assert_array_equal(tiff_image(path.read_bytes(), path, ImportFormatError), counts)
    tifffile.imwrite(path, np.stack([counts, counts]), photometric="minisblack")
    with pytest.raises(ImportFormatError, match=r"cannot be read as TIFF \(contains a stack of 2 images"):
        tiff_image(path.read_bytes(), path, ImportFormatError)
    tifffile.imwrite(path, counts)
    content = bytearray(path.read_bytes())
    for tag in (256, 257):  # width and length
        at = content.index(struct.pack("<HH", tag, 3)) if struct.pack("<HH", tag, 3) in content else -1
        at = at if at >= 0 else content.index(struct.pack("<HH", tag, 4))
        content[at + 2 : at + 12] = struct.pack("<HII", 4, 1, 1_000_000)
    with pytest.raises(ImportFormatError, match="MB when decoded, but only sizes above 0 and up to 256 MB"):
        tiff_image(bytes(content), path, ImportFormatError)
