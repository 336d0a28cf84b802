import numpy as np
import pytest

from binocal.formats.ply import ply_content


def test_the_file_is_what_its_header_says():
    points = np.arange(9, dtype=np.float32).reshape(3, 3)
    colours = np.arange(9, dtype=np.uint8).reshape(3, 3)
    content = ply_content(points, colours, np.array([0.1, 0.2, 0.3], np.float32), ("frame: left camera",))
    header, _, body = content.partition(b"end_header\n")
    lines = header.decode().splitlines()
    assert lines[:4] == ["ply", "format binary_little_endian 1.0", "comment frame: left camera", "element vertex 3"]
    names = [line.split()[2] for line in lines if line.startswith("property")]
    assert names == ["x", "y", "z", "red", "green", "blue", "sigma"] and len(body) == 3 * 19
    assert np.frombuffer(body[19:31], "<f4").tolist() == [3, 4, 5] and list(body[31:34]) == [3, 4, 5]
    assert np.frombuffer(body[34:38], "<f4")[0] == np.float32(0.2)


def test_a_comment_is_one_line():
    points, colours = np.zeros((2, 3), np.float32), np.zeros((2, 3), np.uint8)
    with pytest.raises(ValueError, match="one line"):
        ply_content(points, colours, np.zeros(2, np.float32), ("a\nb",))
