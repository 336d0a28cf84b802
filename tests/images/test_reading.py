from __future__ import annotations

import os
import platform
import struct
import subprocess
import sys
import zlib

import cv2
import numpy as np
import pytest

from binocal.errors import FormatError
from binocal.images import read_grey_image, read_image, to_grey
from binocal.images.containers import identify_container
from binocal.images.reading import read_stored_image
from binocal.images.tiff import count_pages

needs_glibc = pytest.mark.skipif(
    platform.libc_ver()[0] != "glibc", reason="what decoders print is caught by the GNU C library only"
)
SHAPES = {"grey": (48, 64), "colour": (48, 64, 3), "alpha": (48, 64, 4)}


def sample_image(kind="grey", dtype=np.uint8):
    rng = np.random.default_rng(5)
    return rng.integers(0, np.iinfo(dtype).max, SHAPES[kind]).astype(dtype)


def encode(suffix, image):
    return cv2.imencode(suffix, image)[1].tobytes()


@pytest.mark.parametrize("suffix", [".png", ".tif", ".bmp", ".pgm"])
def test_lossless_grey_comes_back(tmp_path, suffix):
    (tmp_path / f"a{suffix}").write_bytes(encode(suffix, sample_image()))
    assert np.array_equal(read_image(tmp_path / f"a{suffix}"), sample_image())


@pytest.mark.parametrize("kind", ["grey", "colour", "alpha"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_depth_and_colours_are_kept_and_alpha_is_dropped(tmp_path, suffix, dtype, kind):
    image = sample_image(kind, dtype)
    (tmp_path / f"a{suffix}").write_bytes(encode(suffix, image))
    read = read_image(tmp_path / f"a{suffix}")
    assert read.dtype == dtype and read.shape == (SHAPES[kind] if kind == "grey" else (48, 64, 3))
    if kind != "alpha":
        assert np.array_equal(read, image)
    assert read_grey_image(tmp_path / f"a{suffix}").shape == (48, 64)


def damaged_jpeg():
    """A JPEG file whose container is whole and whose coded pixels are not: a third of them is missing."""
    content = encode(".jpg", sample_image("colour"))
    start = content.index(b"\xff\xda") + 14
    third = (len(content) - start) // 3
    return content[: start + third] + content[start + 2 * third :]


def damaged_png():
    """A PNG file whose checksums hold and whose compressed data are not what they were."""
    content = encode(".png", sample_image())
    at = content.index(b"IDAT")
    (length,) = struct.unpack(">I", content[at - 4 : at])
    data = bytearray(content[at + 4 : at + 4 + length])
    data[length // 2 : length // 2 + 40] = bytes(40)
    chunk = b"IDAT" + bytes(data)
    return content[:at] + chunk + struct.pack(">I", zlib.crc32(chunk)) + content[at + 8 + length :]


@needs_glibc
@pytest.mark.parametrize(
    ("name", "make", "words"),
    [
        ("a.jpg", damaged_jpeg, "damaged JPEG file .Corrupt JPEG data"),
        ("a.png", damaged_png, "damaged PNG file .libpng error"),
    ],
)
def test_damage_that_only_the_decoder_sees_is_refused_in_one_line_of_ours(tmp_path, capfd, name, make, words):
    """OpenCV gives an image of it, grey from there on, and libjpeg printed its own line past Python's stderr."""
    (tmp_path / name).write_bytes(make())
    for read in (read_image, read_grey_image):
        with pytest.raises(FormatError, match=words) as caught:
            read(tmp_path / name)
        assert "\n" not in str(caught.value) and "again" in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_padding_before_the_end_of_a_jpeg_is_no_damage(tmp_path, capfd):
    """Some cameras pad their files; the pixels are whole."""
    content = encode(".jpg", cv2.GaussianBlur(sample_image("colour"), (0, 0), 4))
    (tmp_path / "a.jpg").write_bytes(content)
    (tmp_path / "b.jpg").write_bytes(content[:-2] + bytes(5) + content[-2:])
    assert np.array_equal(read_image(tmp_path / "a.jpg"), read_image(tmp_path / "b.jpg"))
    if platform.libc_ver()[0] == "glibc":
        assert capfd.readouterr() == ("", "")


def test_a_jpegs_luma_is_its_grey(tmp_path):
    smooth = cv2.GaussianBlur(sample_image("colour"), (0, 0), 4)
    (tmp_path / "a.jpg").write_bytes(encode(".jpg", smooth))
    direct, by_colour = read_grey_image(tmp_path / "a.jpg"), to_grey(read_image(tmp_path / "a.jpg"))
    assert np.abs(direct.astype(int) - by_colour).max() <= 2


def test_an_orientation_tag_does_not_turn_the_sensors_pixels(tmp_path):
    jpeg = encode(".jpg", np.repeat(np.arange(64, dtype=np.uint8)[None] * 4, 32, axis=0))
    exif = (
        b"Exif\0\0" + b"MM\0*" + struct.pack(">IHHHIHHI", 8, 1, 0x0112, 3, 1, 6, 0, 0)
    )  # orientation 6: turn by 90 degrees
    tagged = jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + jpeg[2:]
    (tmp_path / "a.jpg").write_bytes(tagged)
    assert read_image(tmp_path / "a.jpg").shape == (32, 64)
    assert read_grey_image(tmp_path / "a.jpg").shape == (32, 64)


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9, 0.99])
@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif", ".bmp", ".pgm"])
def test_truncated_images_are_refused_and_nothing_is_printed(tmp_path, suffix, share, capfd):
    content = encode(suffix, sample_image())
    path = tmp_path / f"a{suffix}"
    path.write_bytes(content[: int(share * len(content))])
    for read in (read_image, read_grey_image):
        with pytest.raises(FormatError, match=r"truncated") as caught:
            read(path)
        assert str(path) in str(caught.value) and "again" in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_a_flipped_byte_in_a_png_is_noticed(tmp_path):
    content = bytearray(encode(".png", sample_image()))
    content[len(content) // 2] ^= 0x10
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(FormatError, match=r"checksum"):
        read_image(tmp_path / "a.png")


@pytest.mark.parametrize(
    ("content", "reason"),
    [(b"", "empty file"), (b"just words\n", "not an image but text"), (bytes(range(256)), "not an image;")],
)
def test_what_is_no_image_says_so(tmp_path, content, reason):
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(FormatError, match=reason):
        read_image(tmp_path / "a.png")


def test_missing_files_and_folders(tmp_path):
    with pytest.raises(FormatError, match=r"no such file"):
        read_image(tmp_path / "nothing.png")
    with pytest.raises(FormatError, match=r"is a folder"):
        read_image(tmp_path)


def test_floating_point_pixels_are_named(tmp_path):
    cv2.imwrite(str(tmp_path / "a.tif"), np.zeros((20, 20), np.float32))
    with pytest.raises(FormatError, match=r"float32 pixels.*8- and 16-bit"):
        read_image(tmp_path / "a.tif")


def test_the_callers_log_level_comes_back(tmp_path):
    from cv2.utils import logging

    before = logging.getLogLevel()
    (tmp_path / "a.png").write_bytes(encode(".png", sample_image()))
    read_image(tmp_path / "a.png")
    assert logging.getLogLevel() == before


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize("image", [np.zeros((4, 4)), np.zeros((4, 4, 2), np.uint8), np.zeros((0, 4), np.uint8)])
def test_grey_of_what_is_no_image(image):
    with pytest.raises(ValueError, match=r"an image is"):
        to_grey(image)


def test_containers_are_known_by_their_content():
    assert [identify_container(encode(s, sample_image())) for s in (".png", ".jpg", ".tif", ".bmp", ".pgm")] == [
        "PNG", "JPEG", "TIFF", "BMP", "PNM",
    ]  # fmt: skip
    assert identify_container(b"GIF89a") is None


def tiff_with(content, tag, value):
    """A little-endian TIFF with one more tag, its directory moved to the end."""
    (at,) = struct.unpack_from("<I", content, 4)
    (n_entries,) = struct.unpack_from("<H", content, at)
    entries = [content[at + 2 + 12 * i : at + 14 + 12 * i] for i in range(n_entries)]
    entries = [entry for entry in entries if struct.unpack_from("<H", entry)[0] != tag]
    entries.append(struct.pack("<HHIHH", tag, 3, 1, value, 0))
    directory = struct.pack("<H", len(entries)) + b"".join(sorted(entries)) + struct.pack("<I", 0)
    return content[:4] + struct.pack("<I", len(content)) + content[8:] + directory


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("kind", ["grey", "colour"])
def test_a_tiffs_orientation_does_not_turn_the_sensors_pixels_either(tmp_path, orientation, kind):
    image = sample_image(kind)
    (tmp_path / "a.tif").write_bytes(tiff_with(encode(".tif", image), 274, orientation))
    assert np.array_equal(read_image(tmp_path / "a.tif"), image)
    assert np.array_equal(read_grey_image(tmp_path / "a.tif"), to_grey(image))


def test_pages_of_a_tiff_are_counted(tmp_path):
    path = tmp_path / "a.tif"
    cv2.imwritemulti(str(path), [sample_image(), sample_image()[::-1], sample_image()])
    stored = read_stored_image(path)
    assert stored.n_pages == 3 and np.array_equal(stored.grey, sample_image())
    path.write_bytes(encode(".tif", sample_image()))
    assert read_stored_image(path).n_pages == 1
    circle = bytearray(tiff_with(encode(".tif", sample_image()), 274, 1))
    circle[-4:] = circle[4:8]  # the next directory is this one
    path.write_bytes(circle)
    assert read_stored_image(path).n_pages == 1


def test_a_reduced_copy_in_a_tiff_is_no_page_of_its_own():
    first = tiff_with(encode(".tif", sample_image()), 254, 0)
    reduced = tiff_with(first, 254, 1)[len(first) :]
    (at,) = struct.unpack_from("<I", first, 4)
    content = first[:-4] + struct.pack("<I", len(first)) + reduced
    assert at and count_pages(content) == 1
    assert count_pages(first[:-4] + struct.pack("<I", len(first)) + tiff_with(first, 254, 0)[len(first) :]) == 2


FF_TAIL = """
import sys
from binocal.errors import FormatError
from binocal.images import read_image
try:
    read_image(sys.argv[1])
except FormatError as error:
    print(error.problem)
"""


def test_a_long_tail_of_fill_bytes_is_read_once(tmp_path):
    path = tmp_path / "a.jpg"
    content = encode(".jpg", sample_image())
    path.write_bytes(content[:-2] + b"\xff" * 1_000_000)  # hours where each of them began another search
    done = subprocess.run(
        [sys.executable, "-c", FF_TAIL, str(path)], capture_output=True, text=True, timeout=60, check=True
    )
    assert "truncated JPEG" in done.stdout
    path.write_bytes(content[:-2] + b"\xff" * 1000 + content[-2:])  # fill bytes before a marker are allowed
    assert read_grey_image(path).shape == (48, 64)


def test_comments_without_end_in_a_pnm_are_read_once(tmp_path):
    (tmp_path / "a.pgm").write_bytes(b"P5\n" + b"#\n" * 1900 + b" " * 90 + b"x")
    with pytest.raises(FormatError, match="damaged PNM"):
        read_image(tmp_path / "a.pgm")


def with_png_size(width, height):
    content = bytearray(encode(".png", sample_image()))
    struct.pack_into(">II", content, 16, width, height)
    struct.pack_into(">I", content, 29, zlib.crc32(content[12:29]))
    return bytes(content)


def with_jpeg_size(width, height):
    content = bytearray(encode(".jpg", sample_image()))
    struct.pack_into(">HH", content, content.index(b"\xff\xc0") + 5, height, width)
    return bytes(content)


def plain_tiff():
    return cv2.imencode(".tif", sample_image("colour"), [cv2.IMWRITE_TIFF_COMPRESSION, 1])[1].tobytes()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (with_png_size(100_000, 100_000), "100000 x 100000 pixels"),
        (with_png_size(20_000, 10_000), "damaged PNG file"),
        (with_png_size(0, 48), "damaged PNG file"),
        (with_jpeg_size(65_000, 65_000), "65000 x 65000 pixels"),
        (with_jpeg_size(60_000, 4_000), "damaged JPEG file"),
        (tiff_with(plain_tiff(), 256, 70), "damaged TIFF file"),
        (tiff_with(plain_tiff(), 257, 65_000), "damaged TIFF file"),
        (b"P2 90000 90000 255\n1 2 3\n", "too large"),
        (b"P5 99999999999 3 255\n1 2 3\n", "damaged PNM"),
    ],
)
def test_a_header_that_claims_a_huge_image_is_refused_before_room_is_made(tmp_path, content, words):
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(FormatError, match=words):
        read_image(tmp_path / "a.png")


def test_pipes_and_devices_are_named_not_read(tmp_path):
    os.mkfifo(tmp_path / "a.png")
    (tmp_path / "b.png").symlink_to("/dev/zero")
    with pytest.raises(FormatError, match="is a pipe"):
        read_image(tmp_path / "a.png")
    with pytest.raises(FormatError, match="is a device"):
        read_image(tmp_path / "b.png")
    with pytest.raises(FormatError, match="name too long"):
        read_image(tmp_path / ("x" * 300))


@pytest.mark.parametrize(("channel", "plane"), [("blue", 0), ("green", 1), ("red", 2)])
def test_a_channel_is_that_colours_own_levels(tmp_path, channel, plane):
    image = np.random.default_rng(0).integers(0, 65535, (40, 50, 3), dtype=np.uint16)
    cv2.imwrite(str(tmp_path / "a.png"), image)
    assert np.array_equal(read_stored_image(tmp_path / "a.png", channel).grey, image[..., plane])


def test_a_grey_image_has_no_channel(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((40, 50), np.uint8))
    with pytest.raises(FormatError, match="no red channel"):
        read_stored_image(tmp_path / "a.png", "red")
