from __future__ import annotations

import numpy as np
import pytest

from binocal.images.png import encode_png


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(1, 1), (7, 13), (48, 64)])
def test_opencv_reads_the_same_pixels(dtype, shape):
    cv2 = pytest.importorskip("cv2")
    image = np.random.default_rng(0).integers(0, np.iinfo(dtype).max, shape, dtype=dtype, endpoint=True)
    content = np.frombuffer(encode_png(image), dtype=np.uint8)
    np.testing.assert_array_equal(cv2.imdecode(content, cv2.IMREAD_UNCHANGED), image)


@pytest.mark.usefixtures("unchecked_types")
def test_anything_else_is_refused():
    with pytest.raises(ValueError, match="grey image"):
        encode_png(np.zeros((3, 3, 3), dtype=np.uint8))
    with pytest.raises(ValueError, match="grey image"):
        encode_png(np.zeros((3, 3)))
