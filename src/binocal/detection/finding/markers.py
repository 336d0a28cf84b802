"""Square markers (ArUco, AprilTag): ids and rough corners, by OpenCV's decoder."""

from __future__ import annotations

import cv2
import numpy as np
from numpy import ndarray

from binocal.shapes import Float, Int, UInt8


def dictionary_names() -> list[str]:
    """Names of the ArUco dictionaries that OpenCV knows."""
    return sorted(name for name in dir(cv2.aruco) if name.startswith("DICT_"))


def get_dictionary(name: str) -> cv2.aruco.Dictionary:
    """OpenCV's dictionary of that name.

    Raises:
        ValueError: There is none.
    """
    if name not in dictionary_names():
        raise ValueError(f"{name} is no ArUco dictionary; known are such as DICT_4X4_50, DICT_5X5_100, DICT_6X6_250")
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def find_markers(
    grey8: UInt8[ndarray, "h w"], dictionary: cv2.aruco.Dictionary, *, border_bits: int = 1
) -> tuple[Int[ndarray, "n"], Float[ndarray, "n 4 2"]]:
    """Ids and corners of the markers seen.

    Corners in the marker's own order (top-left first as printed), good to about 1 px.
    A marker whose id is seen twice is left out, for at least one of the two is wrong.
    """
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = border_bits
    parameters.minMarkerPerimeterRate = min(0.03, 28 / max(grey8.shape))  # markers from 7 px a side on
    parameters.minDistanceToBorder = 1
    detector = cv2.aruco.ArucoDetector(dictionary, parameters)
    corners, ids, _ = detector.detectMarkers(grey8)
    if ids is None or len(ids) == 0:
        return np.zeros(0, int), np.zeros((0, 4, 2))
    ids = ids.ravel().astype(int)
    quads = np.array([corner.reshape(4, 2) for corner in corners], dtype=float)
    unique, counts = np.unique(ids, return_counts=True)
    once = np.isin(ids, unique[counts == 1])
    return ids[once], quads[once]


def to_8_bit(stretched: Float[ndarray, "h w"]) -> UInt8[ndarray, "h w"]:
    """A stretched image (0..255) as OpenCV's marker decoder takes it."""
    return np.clip(stretched, 0, 255).astype(np.uint8)
