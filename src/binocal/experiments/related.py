"""The related work's calibrators on input that suits each, and what the cited works report of themselves."""

from __future__ import annotations

from binocal.experiments import related_cases as cases
from binocal.experiments.case import Case, by_calibrator

LM, OPENCV = by_calibrator("lm"), by_calibrator("opencv")
JOINT = (LM, by_calibrator("alternating"), OPENCV, by_calibrator("opencv", intrinsics="free"))
SVD = (by_calibrator("absolute-orientation"), by_calibrator("absolute-orientation", refine=True))
HETEROGENEOUS, WIDE = by_calibrator("heterogeneous"), by_calibrator("wide-field")
RECTANGLES, ZOOM = by_calibrator("rectangles"), by_calibrator("zoom")
WANG_2019 = {"attitude, rms": "0.12", "translation, rms": "7.2", "coordinates, rms": "1.6"}
WANG_2020 = {
    "binocular mean reprojection error": "0.620-0.754",
    "the same, mean of the views' poses": "0.782-0.943",
}


def related_groups() -> dict[str, tuple[Case, ...]]:
    """The cases by group, which is the name of their table too."""
    rectangles = tuple(
        Case(
            f"{'another rectangle each' if another else 'one rectangle'}, {n} pairs, attitude {sigma:g} deg"
            + (f", pivot {1e3 * pivot:g} mm behind" if pivot else ""),
            cases.Turning(n, sigma, another, pivot),
            cases.turning_errors,
            (RECTANGLES,),
            WANG_2019,
            "rectangles",
        )
        for another, n, sigma, pivot in (
            (False, 5, 1.0, 0.0), (False, 20, 0.3, 0.0), (False, 20, 1.0, 0.0), (False, 20, 3.0, 0.0), (False, 50, 1.0, 0.0),
            (False, 20, 1.0, 0.02), (True, 20, 0.1, 0.0), (True, 20, 0.3, 0.0), (True, 20, 1.0, 0.0),
        )
    )  # fmt: skip
    return {
        "boards": (
            Case(
                "table-2 rig, 20 pairs, 0.2 px",
                cases.board_corners,
                cases.rig_errors,
                (*JOINT, *SVD, HETEROGENEOUS),
                table="boards",
            ),
        ),
        "heterogeneous": (
            Case(
                "colour and thermal, rendered, 12 pairs",
                cases.Rendered("colour-thermal", "chessboard:11x8:30mm", "brown4"),
                cases.rig_errors,
                (HETEROGENEOUS, LM, OPENCV, SVD[0]),
                table="heterogeneous",
            ),
        ),
        "wide": tuple(
            Case(
                f"thermal, {degrees} deg, rendered, 12 pairs",
                cases.Rendered(f"thermal-{degrees}", "chessboard:11x8:30mm", "fisheye4"),
                cases.wide_errors,
                (WIDE, LM, OPENCV),
                WANG_2020,
                "wide",
            )
            for degrees in (180, 210)
        ),
        "rectangles": rectangles,
        "zoom": tuple(
            Case(
                f"zoom 4:1, {n} settings of 12 pairs, 0.1 px", cases.Zoomed(n), cases.zoom_errors, (ZOOM,), table="zoom"
            )
            for n in (9, 13)
        ),
    }


def own_input_cases() -> list[Case]:
    """The groups whose input is no table 3's: other cameras, other evidence."""
    return [case for name, group in related_groups().items() if name != "boards" for case in group]
