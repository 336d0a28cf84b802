"""The ArUco and AprilTag dictionaries that OpenCV decodes, known here without OpenCV."""

from __future__ import annotations

_SIZES = {f"DICT_{n}X{n}_{size}": size for n in (4, 5, 6, 7) for size in (50, 100, 250, 1000)}
_APRILTAG = {"16h5": 30, "25h9": 35, "36h10": 2320, "36h11": 587}
_OTHERS = {"DICT_ARUCO_ORIGINAL": 1024, "DICT_ARUCO_MIP_36h12": 250, "DICT_ARUCO_MIP_36H12": 250}
DICTIONARY_SIZES = (
    _SIZES
    | _OTHERS
    | {f"DICT_APRILTAG_{name}": size for family, size in _APRILTAG.items() for name in (family, family.upper())}
)
"""Number of markers of each dictionary, by its name in OpenCV."""

TAG_FAMILIES = {f"tag{name}": size for name, size in _APRILTAG.items()}
"""Number of tags of each AprilTag family, by its own name."""


def check_tag_family(name: str, n_tags: int) -> None:
    """Refuses a family that is not known, or has no tag with so high an id.

    Raises:
        ValueError: It is unknown or too small.
    """
    if name not in TAG_FAMILIES:
        raise ValueError(f"{name[:40]!r} is not a known tag family; those are {', '.join(TAG_FAMILIES)}")
    if n_tags > TAG_FAMILIES[name]:
        raise ValueError(f"the family {name} has {TAG_FAMILIES[name]} tags, but the board needs ids up to {n_tags - 1}")


def check_dictionary(name: str, n_markers: int = 0) -> None:
    """Refuses a dictionary that does not exist, or has fewer markers than a board's ids, from 0 to ``n_markers`` - 1, need.

    Raises:
        ValueError: It is unknown or too small; the text names ones that fit.
    """
    if name in DICTIONARY_SIZES and n_markers <= DICTIONARY_SIZES[name]:
        return
    fitting = sorted((known for known, size in _SIZES.items() if size >= n_markers), key=DICTIONARY_SIZES.__getitem__)
    if name not in DICTIONARY_SIZES:
        same = [known for known in fitting if known.startswith(f"{name}_")] or fitting[:4]
        raise ValueError(
            f"{name[:40]!r} is not an ArUco dictionary; OpenCV's own end in their size, such as {', '.join(same)}"
        )
    family = name.rpartition("_")[0]
    same = [known for known in fitting if known.startswith(f"{family}_")]
    remedy = f"; {(same or fitting)[0]} would have enough" if fitting else ""
    raise ValueError(
        f"{name} has {DICTIONARY_SIZES[name]} markers, but the board needs ids up to {n_markers - 1}{remedy}"
    )
