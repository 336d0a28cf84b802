"""What is done to an image before a board is looked for: a colour channel chosen, and the paper's filter and stronger edges."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy import ndarray

from binocal.images.reading import StoredImage, read_stored_image

SMOOTHING_PX = 0.7
EDGE_SCALE_PX = 1.6
EDGE_GAIN = 0.8


@dataclass(frozen=True, slots=True)
class Preparation:
    """How images are read for their corners: the channel (:data:`binocal.images.CHANNELS`), and whether edges are strengthened."""

    channel: str = "grey"
    strengthens: bool = False

    def read(self, path: Path) -> StoredImage:
        """An image file, prepared.

        Raises:
            FormatError: As in :func:`binocal.images.reading.read_stored_image`.
        """
        image = read_stored_image(path, self.channel)
        return replace(image, grey=strengthen_edges(image.grey)) if self.strengthens else image


def strengthen_edges(image: ndarray) -> ndarray:
    """The image lightly smoothed (Gaussian, 0.7 px), then unsharp-masked (1.6 px, gain 0.8); same shape and depth.

    The paper prepares its images so but names no filter; this one is linear and symmetric, so that it moves no
    straight edge and no symmetric corner. It helps to find faint boards and adds no information: corners are not
    expected to become more precise.

    Raises:
        ValueError: The array is not uint8 or uint16.
    """
    if image.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"an image is uint8 or uint16; got {image.dtype}")
    import cv2

    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), SMOOTHING_PX)
    sharp = smooth + EDGE_GAIN * (smooth - cv2.GaussianBlur(smooth, (0, 0), EDGE_SCALE_PX))
    return np.clip(np.rint(sharp), 0, np.iinfo(image.dtype).max).astype(image.dtype)
