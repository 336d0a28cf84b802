"""Square markers (ArUco, AprilTag): ids and rough corners, by OpenCV's decoder."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import cv2
import numpy as np
from numpy import ndarray

from binocal.shapes import Float, Int, UInt8

FAMILIES = (
    "DICT_4X4_1000",
    "DICT_5X5_1000",
    "DICT_6X6_1000",
    "DICT_7X7_1000",
    "DICT_ARUCO_ORIGINAL",
    "DICT_ARUCO_MIP_36h12",
    "DICT_APRILTAG_16h5",
    "DICT_APRILTAG_25h9",
    "DICT_APRILTAG_36h11",
)
"""The largest dictionary of each family that boards are printed with."""

N_COMPARED = 60  # markers of each family


def dictionary_names() -> list[str]:
    """Names of the ArUco dictionaries that OpenCV knows."""
    return sorted(name for name in dir(cv2.aruco) if name.startswith("DICT_"))


@lru_cache(maxsize=32)
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
    detector = cv2.aruco.ArucoDetector(dictionary, _parameters(grey8, border_bits))
    corners, ids, _ = detector.detectMarkers(grey8)
    return _seen_once(ids, corners)


def find_family(grey8: UInt8[ndarray, "h w"]) -> tuple[str, Int[ndarray, "n"], Float[ndarray, "n 4 2"]]:
    """The family of which most markers are seen, by its largest dictionary's name, and these as of :func:`find_markers`.

    Families are compared by their first markers, for looking up a thousand of each takes a second; without any the name is "".
    """
    first = [get_dictionary(name) for name in FAMILIES]
    for dictionary in first:
        dictionary.bytesList = dictionary.bytesList[:N_COMPARED]
    _, ids, _, of_family = cv2.aruco.ArucoDetector(first, _parameters(grey8, 1)).detectMarkersMultiDict(grey8)
    if ids is None or len(ids) == 0:
        return "", np.zeros(0, int), np.zeros((0, 4, 2))
    name = FAMILIES[int(np.bincount(of_family.ravel()).argmax())]
    return name, *find_markers(grey8, get_dictionary(name))


def smallest_dictionary(family: str, n_markers: int) -> str:
    """The least of a family's dictionaries that has so many markers; they share their first ones."""
    stem, _, most = family.rpartition("_")
    if not most.isdigit():
        return family
    return f"{stem}_{next((n for n in (50, 100, 250) if n >= n_markers), int(most))}"


def _parameters(grey8: UInt8[ndarray, "h w"], border_bits: int) -> cv2.aruco.DetectorParameters:
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = border_bits
    parameters.minMarkerPerimeterRate = min(28 / max(grey8.shape), 1.0)  # from 7 px a side on: below, no cell is seen
    parameters.minDistanceToBorder = 1
    return parameters


def _seen_once(ids: ndarray | None, corners: Sequence[ndarray]) -> tuple[Int[ndarray, "n"], Float[ndarray, "n 4 2"]]:
    """Without the markers whose id is seen twice."""
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
