from __future__ import annotations

import struct

import cv2
import numpy as np
import pytest

from binocal.errors import FormatError
from binocal.images import read_grey_image, read_image, to_grey
from binocal.images.containers import identify_container

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
