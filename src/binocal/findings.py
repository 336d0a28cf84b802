"""What binocal has to say about a calibration: findings, each with a stable code, and the one table of all codes.

A finding is what a check found: figures, the sentence that a person reads, and what to do. Its code never changes its meaning, so
that programs may depend on it; sentences may be reworded. Checks and their thresholds are in :mod:`binocal.acceptance` (a solved
rig) and :mod:`binocal.initialization.diagnosis` (views that no rig can be solved from).
"""

from __future__ import annotations

import string
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from binocal.errors import (
    BinocalError,
    CalibrationError,
    DataError,
    DegenerateGeometryError,
    DetectionError,
    InconsistentViewsError,
    NotConvergedError,
    TooFewViewsError,
)


class Severity(StrEnum):
    """How grave a finding is: there is no result; there is one with a weakness; something was repaired or left out."""

    REFUSAL = "refusal"
    WARNING = "warning"
    NOTE = "note"


@dataclass(frozen=True, slots=True)
class Finding:
    """One finding.

    ``figures`` hold what was found by name, the unit in the name (``sigma_percent``). ``text`` is the whole sentence, ``remedy`` the
    part of it that says what to do.
    """

    code: str
    severity: Severity
    text: str
    remedy: str = ""
    figures: Mapping[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        return self.text


def finding_document(found: Finding) -> dict[str, Any]:
    """A finding as plain data, as files and ``--json`` hold it."""
    return {
        "code": found.code,
        "severity": str(found.severity),
        "text": found.text,
        "remedy": found.remedy,
        "figures": dict(found.figures),
    }


@dataclass(frozen=True, slots=True)
class FindingKind:
    """One row of the table of codes.

    ``sentence`` takes the figures, and the remedy as ``{remedy}``. ``{n_pairs:pair|pairs}`` is the word for that number, one or many.
    """

    code: str
    severity: Severity
    title: str
    sentence: str
    remedy: str
    error: type[BinocalError] | None = None
    """What is raised, of a refusal."""


UNCODED = "uncoded"
"""The code of a sentence read from a file of release 0.1, which had no codes."""

TILTS = "add views with the board tilted 20-45 deg about both axes, at different distances"
_TILT_THREE = "tilt the board 20-45 deg about both axes in at least 3 views"
_SIZE_OF_CORNERS = "give the size of the image in which the corners were found"

_R, _W, _N = Severity.REFUSAL, Severity.WARNING, Severity.NOTE

_KINDS = (
    # --- natural images
    FindingKind(
        "matches-too-few", _R, "Too few points are seen by both cameras",
        "{n_matches} {n_matches:point|points} of {n_pairs} {n_pairs:pair|pairs} {n_matches:was|were} matched, {n_needed} are needed: "
        "the images show too little texture, are black or blurred, or do not show one scene; {remedy}.",
        "give sharp pairs of one moment with texture at several depths", DegenerateGeometryError,
    ),
    FindingKind(
        "matches-on-whole-rows", _R, "Matches lie on whole rows of a pixel grid",
        "{share_percent:.0f} % of the matches lie on exactly equal rows, as points that were measured to whole pixels of rectified "
        "images do: they tell the grid, not the rig; {remedy}.",
        "give matches measured to a fraction of a pixel", InconsistentViewsError,
    ),
    FindingKind(
        "matches-contradict", _R, "Matches agree with no pose between the cameras",
        "only {n_right} of {n_matches} matches agree with one pose of the cameras (noise {noise_px:.2f} px): the images of a pair are not "
        "of one moment, left and right were exchanged in some, or the cameras are others; {remedy}.",
        "check the pairs and that the rig is of these cameras", InconsistentViewsError,
    ),
    FindingKind(
        "scene-tells-too-little", _R, "The scene does not tell the pose",
        "the scene does not tell {what} (standard deviations: turn {turn_sigma_deg:.1f} deg, direction of the translation "
        "{direction_sigma_deg:.0f} deg); {remedy}.",
        "take pairs with near and far things all over the image, or give the old rig, whose values are kept then",
        DegenerateGeometryError,
    ),
    FindingKind(
        "scene-tells-too-little-kept", _W, "What the scene does not tell was kept as it was",
        "the scene does not tell {what} (standard deviations: turn {turn_sigma_deg:.1f} deg, direction of the translation "
        "{direction_sigma_deg:.0f} deg): {kept}; {remedy}.",
        "take pairs with near and far things all over the image",
    ),
    FindingKind(
        "image-shows-nothing", _R, "An image shows nothing that could be matched",
        "{image}: {n_features} points stand out, {n_needed} are needed: it is black, white, covered, without texture or out of focus; "
        "{remedy}.",
        "give sharp pairs of one moment with texture at several depths", DegenerateGeometryError,
    ),
    FindingKind(
        "image-blurred", _R, "An image is blurred",
        "{image} is blurred: edges have a spread of {blur_px:.1f} px (standard deviation), {other_px:.1f} px in the other image of its "
        "pair, so that points cannot be placed; {remedy}.",
        "focus both cameras alike, hold the rig still, or expose for a shorter time", DegenerateGeometryError,
    ),
    FindingKind(
        "image-mirrored", _R, "One image of a pair is mirrored against the other",
        "{right} is mirrored against {left}: {n_mirrored} points match where one of them is mirrored back, {n_matches} as they are; "
        "{remedy}.",
        "give both images as the cameras took them, neither flipped nor transposed", DegenerateGeometryError,
    ),
    FindingKind(
        "images-already-rectified", _R, "The images are rectified already",
        "matching points lie on equal {lines} ({apart_px:.2f} px apart, median), where raw images of this rig would have them "
        "{by_rig_px:.1f} px off: the images are rectified and the rig's file is of the raw ones, or of other cameras; {remedy}.",
        "give the images as the cameras took them, or the rig of the rectified cameras", InconsistentViewsError,
    ),
    FindingKind(
        "rig-is-another", _R, "The images show another rig than the one given",
        "the images show a right camera turned by {turn_deg:.1f} deg against the rig given and a translation that points {direction_deg:.0f} "
        "deg away from it: {cause}; {remedy}.",
        "check the images, their sides and the rig's file; `binocal recalibrate --start none` takes no pose for granted", InconsistentViewsError,
    ),
    FindingKind(
        "pose-unlike-file", _W, "The pose found is far from that of the rig's file",
        "the right camera is turned by {turn_deg:.1f} deg against the rig's file and the translation points {direction_deg:.0f} deg away from "
        "it: cameras mounted anew have that, and so do images of a pair that are not of one moment; {remedy}.",
        "check that both cameras exposed together",
    ),
    FindingKind(
        "baseline-unlike-file", _W, "The baseline given is far from that of the rig's file",
        "by {said} the cameras stand {given_m:.4g} m apart, by the rig's file {filed_m:.4g} m: with the rig written all lengths and depths "
        "are {ratio:.3g} times what they were; {remedy}.",
        "check the number, its unit, and where the ends of a known length lie; nothing is wrong if the file's length was a guess",
    ),
    FindingKind(
        "cameras-are-others", _R, "The images are not of the cameras given",
        "the cameras' own parameters do not fit the images: by the best pose matches are {held_px:.2f} px off (RMS), and {pattern_px:.2f} px "
        "of it, {share_percent:.0f} % of the squares, are a pattern that only other cameras would not leave: the rig's file is of other "
        "cameras, or the images were cropped, resized or rectified; {remedy}.",
        "give the file of the cameras that took these images, and images as they take them; or calibrate them anew with a board",
        InconsistentViewsError,
    ),
    FindingKind(
        "pairs-contradict", _R, "Pairs of images show different rigs",
        "{n_odd} of {n_pairs} {n_pairs:pair|pairs} {n_odd:does|do} not fit together: {what}; {remedy}.",
        "give pairs of one moment each, taken by one rig, left images as left", InconsistentViewsError,
    ),
    FindingKind(
        "pairs-left-out", _W, "Pairs of images were left out",
        "{n_odd} of {n_pairs} {n_pairs:pair|pairs} {n_odd:was|were} left out: {what}; {remedy}.",
        "see what is wrong with them, or leave them out",
    ),
    FindingKind(
        "pairs-disagree", _W, "Pairs of images differ by more than their matches' errors",
        "the pairs do not show one pose: with a pose of its own each, matches would be {apart_px:.2f} px nearer (RMS, {share_percent:.0f} % of "
        "the squares, {over_regions:.0f} times what the errors of matches explain): the cameras moved between the exposures of a pair, or the "
        "rig flexes; {remedy}.",
        "check that both cameras expose together, or take pairs while they stand still",
    ),
    FindingKind(
        "matches-ask-for-other-cameras", _W, "Matches would fit better with other cameras",
        "the matches ask for {what}, which would save {saved_percent:.0f} % of the squared residuals: the cameras' parameters are not quite "
        "those of these images, and the pose bears their error; {remedy}.",
        "calibrate the cameras anew with a board, and check that the images are as these cameras take them",
    ),
    # --- lines of natural images
    FindingKind(
        "lines-too-few", _R, "Too few straight lines are seen",
        "the image with most straight edges shows {n_segments} of them ({n_images} {n_images:image|images}), {n_needed} are needed: the "
        "images are black, blurred, or do not show what people build; {remedy}.",
        "give sharp images of a street or a room", DegenerateGeometryError,
    ),
    FindingKind(
        "lines-without-families", _R, "The straight lines run in no common directions",
        "no image shows lines that are parallel in the scene (up to {n_segments} {n_segments:segment|segments} in {n_images} "
        "{n_images:image|images}, which meet as chance has it): texture and plants tell nothing of a camera; {remedy}.",
        "give images of a street or a room", DegenerateGeometryError,
    ),
    FindingKind(
        "lines-in-one-family", _R, "All parallel lines run in one direction",
        "the images show one family of parallel lines ({n_segments} segments in {image}), and two at right angles are needed; {remedy}.",
        "turn the camera so that it sees a second wall, or the floor with a wall", DegenerateGeometryError,
    ),
    FindingKind(
        "lines-not-at-right-angles", _R, "No camera makes the families of lines orthogonal",
        "in {n_images} images lines run in two or more directions, but one camera sees them at right angles in {n_agreeing} only; "
        "{remedy}.",
        "give uncropped images of one camera, of things built at right angles, or the rig's file so that the lens can be taken out",
        InconsistentViewsError,
    ),
    FindingKind(
        "right-angles-unchecked", _R, "Nothing checks that two families are at right angles",
        "lines run in two directions ({images}); a focal length follows if they are at right angles, but neither a third direction nor a "
        "view turned by 10 degrees checks that; {remedy}.",
        "add views that show a third direction or are turned, or state --right-angles if you know that they are", DegenerateGeometryError,
    ),
    FindingKind(
        "vanishing-points-far", _R, "The vanishing points are too far away to tell a camera",
        "the lines tell neither focal length nor principal point (standard deviations: focal length {focal_sigma_percent:.0f} %, cx "
        "{cx_sigma_px:.0f} px, cy {cy_sigma_px:.0f} px, where {assumed_sigma_px:.0f} px were assumed): they look nearly parallel in the "
        "image; {remedy}.",
        "turn the camera by 20 to 45 degrees against walls and floor", DegenerateGeometryError,
    ),
    FindingKind(
        "lens-from-bent-lines", _W, "A lens was taken out by the bend of lines",
        "lines bend as a lens would make them, by {corner_px:+.1f} ± {sigma_px:.1f} px at the image's corners: one coefficient of radial "
        "distortion was taken out; {remedy}.",
        "give the rig's file with --rig, whose lens is better known",
    ),
    FindingKind(
        "vanishing-points-far-focal-untold", _W, "The lines tell the principal point, not the focal length",
        "the lines tell {what}, but not the focal length (standard deviation {focal_sigma_percent:.0f} %): only one vanishing point is "
        "near; {remedy}.",
        "turn the camera by 20 to 45 degrees against walls and floor",
    ),
    FindingKind(
        "stream-too-few", _R, "Too few pairs of a stream tell the rig's turn",
        "{n_told} of the stream's pairs, or groups of pairs, {n_told:tells|tell} the rig's turn, {n_needed} are needed; {remedy}.",
        "give more pairs, or look at them without --stream", DegenerateGeometryError,
    ),
    FindingKind(
        "stream-jumped", _W, "The rig turned at once during a stream",
        "{angle} jumped by {size_deg:+.3f} ± {sigma_deg:.3f} deg at pair {pair} (noticed at pair {told_at}); {remedy}.",
        "see what knocked the rig, and run `binocal recalibrate` on pairs from after it",
    ),
    FindingKind(
        "stream-pairs-skipped", _N, "Pairs of a stream that do not tell the rig's turn",
        "{n_skipped} {n_skipped:pair does|pairs do} not tell the turn and {n_skipped:was|were} skipped, {n_used} {n_used:was|were} "
        "used: {names}; the first: {reason}", "",
    ),
    FindingKind(
        "stream-without-times", _N, "A stream without times",
        "nothing says when the pairs were taken, so that there is no rate of drift; {remedy}.",
        "give the pairs per second with --fps",
    ),
    # --- a solved rig that is no result
    FindingKind(
        "corners-do-not-fit", _R, "Residuals are large against the spacing of the corners",
        "the corners do not fit the board: residuals of {noise_px:.2f} px where corners are {spacing_px:.1f} px apart; {remedy}.",
        "check the board's columns, rows and corner order, and that left and right images were taken together",
        InconsistentViewsError,
    ),
    FindingKind(
        "too-many-outliers", _R, "A large share of the corners contradicts the rest",
        "{n_outliers} of {n_corners} corners contradict the rest; {remedy}.",
        "check the corner order, the pairing of left and right, and the camera model",
        InconsistentViewsError,
    ),
    FindingKind(
        "focal-length-undetermined", _R, "The views do not determine a focal length",
        "the views do not determine the {camera} focal length (standard deviation {sigma_percent:.1f} %): "
        "the board's directions differ by only {spread_deg:.1f} deg; {remedy}.",
        TILTS, DegenerateGeometryError,
    ),
    FindingKind(
        "principal-point-impossible", _R, "A principal point lies where no lens has it",
        "the {camera} principal point ({x_px:.0f}, {y_px:.0f}) comes out far from the middle of the {width_px}x{height_px} image, "
        "which no lens does: the boards say too little about the camera, or the images are cropped; {remedy}.",
        f"move the board over the whole image and {TILTS}", DegenerateGeometryError,
    ),
    FindingKind(
        "rotation-undetermined", _R, "The views do not determine the rotation between the cameras",
        "the views do not determine the rotation between the cameras (standard deviation {sigma_deg:.1f} deg); {remedy}.",
        f"move the board over the whole of both images and {TILTS}", DegenerateGeometryError,
    ),
    FindingKind(
        "translation-undetermined", _R, "The views do not determine the translation between the cameras",
        "the views do not determine the translation between the cameras (standard deviation {sigma_percent:.0f} % of the "
        "baseline); {remedy}.",
        TILTS, DegenerateGeometryError,
    ),
    FindingKind(
        "not-converged", _R, "The joint solve did not reach a minimum",
        "{solver} did not reach a minimum{ended}; the views may leave parameters undetermined: "
        "{remedy}.",
        TILTS, NotConvergedError,
    ),
    FindingKind(
        "views-of-one-pose", _R, "All views show the board in nearly one pose",
        "the {n_views} views show the board in nearly one pose: all are within {turned_deg:.0f} deg and {moved_percent:.0f} % of the "
        "board's size of view {view} ({n_same} of them the same), which leaves focal lengths and positions open; {remedy}.",
        "from view to view turn the board by 30 deg and more, about both of its axes, and move it into the corners of the image",
        DegenerateGeometryError,
    ),
    FindingKind(
        "parameters-undetermined", _R, "Some parameters cannot be separated from others",
        "the views leave parameters undetermined (mostly {parameters}); {remedy}.",
        TILTS, DegenerateGeometryError,
    ),
    FindingKind(
        "too-few-measurements", _R, "Fewer measurements than unknowns",
        "fewer measurements than unknowns; {remedy}.",
        "add views or corners", DegenerateGeometryError,
    ),
    FindingKind(
        "prior-contradicted", _R, "The prior and the new views are not of one rig",
        "the prior contradicts the views: over its {n_parameters} parameters they differ by {difference_sigma:.1f} standard "
        "deviations (RMS); {remedy}.",
        "calibrate without it, or let it inform only of what has not changed (parts)", InconsistentViewsError,
    ),
    FindingKind(
        "pairs-not-together", _R, "Left and right images were not taken at the same moment, and no rig can be trusted",
        "left and right were not taken together: each camera alone fits to {alone_px:.2f} px, both together only to {pair_px:.2f} "
        "px, so the board moved by about {moved_px:.2g} px between the exposures{also}; {remedy}.",
        "trigger the cameras together, or put the board on a stand and take each pair while nothing moves",
        InconsistentViewsError,
    ),
    FindingKind(
        "corner-lists-shifted", _R, "One camera's corner lists are off by a row or column in all views",
        "the left corner lists are off by one {line} against the right ones in all views: put right, the corners fit to "
        "{repaired_px:.3f} px instead of {noise_px:.3f} px; {remedy}.",
        "{what} the {line} number of every left corner, or detect both cameras' corners anew", InconsistentViewsError,
    ),
    # --- images in which the board was not found
    FindingKind(
        "board-not-found", _R, "The board was found in no image",
        "{board} was found in none of {n_images} {n_images:image|images} ({n_pairs} {n_pairs:pair|pairs}): {reason} ({n_reason} of "
        "them, first {first}); {remedy}",
        "check the board SPEC, the light and the focus", DetectionError,
    ),
    FindingKind(
        "board-is-another", _R, "Most images show another board than the one given",
        "{board} was found in {n_found} of {n_images} images; {n_other} of {n_tried} looked at again show {what}: {remedy}",
        "give the board as it is printed", DetectionError,
    ),
    FindingKind(
        "markers-too-small", _R, "The board's squares are seen, its markers are too small to be read",
        "{board} was found in {n_found} of {n_images} images; {n_other} of {n_tried} looked at again show its squares, {square_px:.0f} px "
        "wide, and cannot tell its markers of {marker_px:.0f} px ({cell_px:.1f} px for each cell of their code): {remedy}.",
        "move nearer, or print fewer and larger squares, so that a cell has 3 px", DetectionError,
    ),
    FindingKind(
        "board-in-one-camera-only", _R, "One camera never sees the board",
        "{board} was found in {n_found} of {n_pairs} {other} images and in none of the {n_pairs} {camera} ones: {reason} ({n_reason} of "
        "them, first {first}); {remedy}",
        "see that these images show the whole board, sharp and well lit", DetectionError,
    ),
    FindingKind(
        "board-in-too-few-pairs", _R, "Too few pairs show the board in both images",
        "{board} was found in {n_left} of {n_pairs} left and {n_right} of {n_pairs} right images, in both of only {n_both} {n_both:pair|pairs} "
        "({n_needed} needed); where it was not: {reason} ({n_reason} {n_reason:image|images}, first {first}); {remedy}",
        "take pairs in which both cameras see the whole board, sharp and well lit", DetectionError,
    ),
    FindingKind(
        "several-boards", _R, "The images show several boards",
        "{n_several} of {n_images} images ({n_pairs} pairs) show more than one board, and one {board} was looked for; {remedy}.",
        "show one at a time, or let `binocal calibrate` or binocal.detect_boards find every one of them", DetectionError,
    ),
    FindingKind(
        "boards-not-paired", _R, "Boards that look alike cannot be paired between the cameras",
        "{n_left} boards in the left and {n_right} in the right images ({n_pairs} pairs) are {board}, and which of them are one is not "
        "clear: {reason}; {remedy}.",
        "show boards of different sizes, hang them unevenly and tilted differently, or give more pairs", DetectionError,
    ),
    # --- views that no rig can be solved from
    FindingKind(
        "too-few-views", _R, "Too few usable views",
        "{n_found} usable view{plural}, {n_needed} needed{why}; {remedy}.",
        "add views with the board tilted 20-45 deg in different directions", CalibrationError,
    ),
    FindingKind(
        "corners-outside-image", _R, "Corners that fit their board lie outside the image",
        "{camera} view {view}, corner {corner} at ({x_px:.1f}, {y_px:.1f}) px lies outside the {width_px}x{height_px} image "
        "({n_corners} such corners in {n_views} views); {remedy}.",
        _SIZE_OF_CORNERS, DataError,
    ),
    FindingKind(
        "rectangle-outside-image", _R, "A rectangle's corner lies outside its image",
        "pair {pair}: {camera} corner {corner} at ({x_px:.1f}, {y_px:.1f}) px lies outside the {width_px}x{height_px} image of the prior's "
        "camera ({n_pairs} such {n_pairs:pair|pairs}); {remedy}.",
        "check that the prior is of these cameras, and leave out pairs whose rectangle is not whole in both images", DataError,
    ),
    FindingKind(
        "rectangles-misread", _R, "The corners of rectangles fit far better when they are read another way",
        "the corners fit no rectangle to better than {noise_px:.1f} px, and to {other_px:.2g} px when read another way: {remedy}.",
        "check the order of the arrays", InconsistentViewsError,
    ),
    FindingKind(
        "attitudes-contradict-corners", _R, "The attitudes contradict what the corners tell",
        "the attitudes lie {off_deg:.2g} deg from the angles that the corners tell, and are stated to {stated_deg:.2g} deg "
        "({n_used} of {n_pairs} {n_pairs:pair|pairs} would fit); {remedy}.",
        "state the sensor's true standard deviation, and check the unit, signs and order of the angles", InconsistentViewsError,
    ),
    FindingKind(
        "rectangles-do-not-fit", _R, "Most pairs show no rectangle of these cameras",
        "{n_used} of {n_pairs} {n_pairs:pair|pairs} {n_used:fits|fit} a rectangle, with a noise of {noise_px:.2g} px of {extent_px:.0f} px; "
        "{remedy}.",
        "check that pairs with one number show one rectangle that stands still, that left and right are of one moment, and that the prior "
        "is of these cameras", InconsistentViewsError,
    ),
    FindingKind(
        "attitudes-less-certain", _W, "The attitudes are less certain than stated",
        "the attitudes lie {off_deg:.2g} deg from the angles that the corners tell, and are stated to {stated_deg:.2g} deg: the former was "
        "taken for their standard deviation; {remedy}.",
        "state the sensor's true standard deviation",
    ),
    FindingKind(
        "points-off-target", _R, "The corners are no image of the target's points in most views",
        "the {camera} corners are no image of the target's points in {n_off} of {n_views} views (first: {view}): the points' places, "
        "their units or their order are wrong; {remedy}.",
        "give each point's x, y and z in one unit, and the corners in the order of the points", InconsistentViewsError,
    ),
    FindingKind(
        "solid-target-seen-flat", _R, "No view shows enough points of a target that is no plane",
        "none of the {n_views} {camera} views shows six points or more that do not lie in one plane, and so none determines the camera; "
        "{remedy}.",
        "show more sides of the target, or calibrate with a flat board", DegenerateGeometryError,
    ),
    FindingKind(
        "columns-and-rows-exchanged", _R, "The corners fit the board only column by column",
        "columns and rows are exchanged in the {camera} corners ({n_fitting} of {n_views} views fit the board only when read "
        "column by column): {remedy}.",
        "exchange the board's columns and rows, or give the corners row by row", InconsistentViewsError,
    ),
    FindingKind(
        "corners-off-grid", _R, "The corners are no image of the board in most views",
        "the {camera} corners do not lie on the board's grid in {n_off} of {n_views} views (first: {view}): the board's columns, "
        "rows or corner order are wrong; {remedy}.",
        "give the board as it is printed", InconsistentViewsError,
    ),
    FindingKind(
        "too-few-views-beside-copies", _R, "Most views are copies of a few",
        "{n_copies} of {n_given} views are copies of others (first: {view} of {original}): {n_left} different view{plural}, no rig "
        "follows from so few; {remedy}.",
        "take pairs with the board elsewhere and tilted otherwise in each", DegenerateGeometryError,
    ),
    FindingKind(
        "too-few-poses", _R, "The board stands in the same few poses in all views",
        "the {camera} camera sees the board in only {n_poses} different pose{plural} in {n_views} views: focal length and "
        "principal point are undetermined; {remedy}.",
        _TILT_THREE, DegenerateGeometryError,
    ),
    FindingKind(
        "boards-parallel", _R, "All boards are parallel",
        "all boards seen by the {camera} camera are {parallel_to} within the noise (orientations scatter by {spread_deg:.2g} deg): "
        "focal length and principal point are undetermined; {remedy}.",
        _TILT_THREE, DegenerateGeometryError,
    ),
    FindingKind(
        "no-perspective", _R, "The boards are tilted, but show no perspective",
        "the boards seen by the {camera} camera are tilted by {tilt_deg:.0f} deg in the median, and not alike, yet show no perspective "
        "beyond the noise, as through a telephoto lens: focal length and principal point are undetermined; {remedy}.",
        "use a board that is larger or nearer, so that its near side looks larger than its far side", DegenerateGeometryError,
    ),
    FindingKind(
        "tilts-too-small", _R, "The boards' tilts leave a focal length open",
        "the {camera} camera's focal length is known to ± {sigma_percent:.0f} % only: the boards are tilted too little or all "
        "alike; {remedy}.",
        _TILT_THREE, DegenerateGeometryError,
    ),
    FindingKind(
        "image-size-wrong", _R, "The stated image size is far too large",
        "the {camera} corners fill only the first {far_x_px:.0f}x{far_y_px:.0f} px of a {width_px}x{height_px} image, and the "
        "principal point ({x_px:.0f}, {y_px:.0f}) is far from its middle: the image size looks wrong, about "
        "{implied_width_px:.0f}x{implied_height_px:.0f} would fit; {remedy}.",
        _SIZE_OF_CORNERS, DataError,
    ),
    FindingKind(
        "resolution-mismatch", _R, "One camera's corners are at a fraction of its image's resolution",
        "the {camera} corners keep to the first {far_x_px:.0f}x{far_y_px:.0f} px of the {width_px}x{height_px} image and the boards "
        "look {share:.2f} times as large as in the {other} camera: the {camera} corners are at about {share:.2f} of the image's "
        "resolution; {remedy}.",
        "scale them, or give the {camera} image size that belongs to them", DataError,
    ),
    FindingKind(
        "pairs-shifted", _R, "Left and right sequences are off by some images",
        "pairs are off by {shift}: left view {left_view} matches right view {right_view} ({n_agreeing} of {n_views} pairs agree when "
        "moved so); {remedy}.",
        "pair the images again", InconsistentViewsError,
    ),
    FindingKind(
        "one-side-mirrored", _R, "The images of one side are mirrored",
        "the left images are mirrored against the right ones ({n_agreeing} of {n_views} pairs agree on a rig when one side is mirrored "
        "back, within {mended_px:.2g} px in place of {miss_px:.2g} px): {remedy}.",
        "give the images of both sides as the cameras took them, neither flipped nor transposed",
        InconsistentViewsError,
    ),
    FindingKind(
        "left-and-right-contradict", _R, "No rig explains the pairs",
        "left and right contradict each other: the best rig misses the corners of the {n_views} {n_views:pair|pairs} by {miss_px:.2g} "
        "px in the median, where each camera alone fits them to {own_px:.2g} px, and {n_agreeing} {n_agreeing:pair agrees|pairs agree} "
        "on it: {remedy}.",
        "check that the pairs are of the same moment, that the rig is rigid, and that both cameras number the same board alike",
        InconsistentViewsError,
    ),
    FindingKind(
        "images-mixed-up", _R, "The images fit the rig only otherwise than given",
        "the images do not fit the rig as given (views are missed by {given_px:.3g} px), but do ({mended_px:.2g} px) if {how}: {remedy}.",
        "{cure}", DataError,
    ),
    # --- data sets
    FindingKind(
        "dataset-kind-unknown", _R, "A data set is not named as KIND:PATH",
        "{given!r} names no data set: the kinds are {kinds}; {remedy}.",
        "write KIND:PATH, such as kitti:PATH or euroc:PATH", DataError,
    ),
    FindingKind(
        "dataset-layout-unknown", _R, "A folder is not laid out as the data set is",
        "{path} is not laid out as {kind} data: {problem}; {remedy}.",
        "name the folder as the data set's own archives unpack it", DataError,
    ),
    FindingKind(
        "dataset-part-not-chosen", _R, "A folder holds several parts of a data set",
        "{path} holds {n_parts} drives or sequences ({names}); {remedy}.",
        "name one of them", DataError,
    ),
    FindingKind(
        "dataset-side-missing", _R, "One camera's images are missing",
        "the {side} images are missing: {path}: {problem}; {remedy}.",
        "unpack that camera's archive into the same folder", DataError,
    ),
    FindingKind(
        "dataset-calibration-missing", _R, "A calibration file of a data set is missing",
        "the calibration is missing: there is no {path}; {remedy}.",
        "unpack the data set's calibration archive into the same folder", DataError,
    ),
    FindingKind(
        "dataset-calibration-broken", _R, "A calibration file of a data set is damaged",
        "{where}: {problem}; {remedy}.",
        "unpack the file again from the data set's archive", DataError,
    ),
    FindingKind(
        "dataset-frames-unmatched", _R, "Images of one camera have no partner of the other",
        "{n_unmatched} {n_unmatched:image has|images have} no partner among {n_left} left and {n_right} right ones ({names}): {first} has "
        "none in {place}; {remedy}.",
        "unpack both cameras' archives completely", DataError,
    ),
    FindingKind(
        "dataset-image-size-differs", _R, "An image has another size than its calibration",
        "{path} has {width_px}x{height_px} pixels, {source} is for {calibrated}; {remedy}.",
        "use the images as published, not resized or cropped, with their own calibration", DataError,
    ),
    FindingKind(
        "dataset-frame-unknown", _R, "A data set has no pair of that name",
        "{path}: no pair is called {frame}, nor does a name begin so; there are {names}; {remedy}.",
        "give the name of a pair, or how it begins", DataError,
    ),
    FindingKind(
        "dataset-has-several-rigs", _R, "The pairs of a data set are of several rigs",
        "the {n_pairs} pairs of {path} are of {n_rigs} different rigs; {remedy}.",
        "name a part with one calibration, or take the parts of Dataset.by_rig() one by one", DataError,
    ),
    FindingKind(
        "known-length-not-found", _R, "An end of a known length is not found in the right image",
        "the {end} end ({x_px:g}, {y_px:g}) of the known length in pair {pair} is not found in the right image: {why}; {remedy}.",
        "point at ends with texture around them, such as corners of something flat, that both cameras see", DataError,
    ),
    FindingKind(
        "known-length-tells-too-little", _R, "The known lengths hardly tell the rig's own",
        "by the known lengths the cameras stand {baseline_m:.3g} ± {sigma_m:.2g} m apart, which is no measurement; {remedy}.",
        "give a length that is nearer, longer in the image, or lies across the view", DataError,
    ),
    # --- a result with a weakness
    FindingKind(
        "focal-length-uncertain", _W, "A focal length is poorly known",
        "the {camera} focal length is known only to {sigma_percent:.1f} % (one standard deviation); {remedy}.", TILTS,
    ),
    FindingKind(
        "image-size-doubtful", _W, "Both principal points lie short of the middle",
        "both principal points lie short of the middle of the {width_px:.0f}x{height_px:.0f} images and no corner lies beyond: "
        "{remedy}.",
        "check the image size, about {implied_width_px:.0f}x{implied_height_px:.0f} would fit",
    ),
    FindingKind(
        "lens-model-folds", _W, "The lens model has no ray for part of the image",
        "the {camera} lens model has no ray for {share_percent:.1f} % of the image: it folds back from {radius_px:.0f} px off the "
        "principal point on, and the corners reach only {reach_px:.0f} px; {remedy}.",
        "move the board into the image's corners, or choose another camera model; nothing can be measured in those pixels",
    ),
    FindingKind(
        "image-size-suspect", _W, "One principal point lies far off the middle, and no corner beyond",
        "the {camera} principal point ({x_px:.0f}, {y_px:.0f}) is far from the middle of the {width_px}x{height_px} image and the "
        "corners end at ({far_x_px:.0f}, {far_y_px:.0f}): {remedy}.",
        "check the image size; about {implied_width_px:.0f}x{implied_height_px:.0f} would fit",
    ),
    FindingKind(
        "cameras-exchanged", _W, "The camera called right stands to the left",
        "left and right look exchanged: seen from either camera, the one called right stands to the left (T.x > 0); {remedy}.",
        "the calibration holds for the images as given; exchange --left and --right for the usual order, or, where both cameras "
        "mirror their images, turn that off",
    ),
    FindingKind(
        "corner-orders-repaired", _W, "Most views had their corner order repaired",
        "the corner order of {n_views} {n_views:view was|views was} repaired: one camera numbers the board's corners from the other end.", "",
    ),
    FindingKind(
        "start-simplified", _W, "The closed-form start had to do with fewer parameters",
        "{camera} camera: {note}.", "",
    ),
    FindingKind(
        "prior-doubtful", _W, "The prior and the new views differ by more than chance",
        "the prior and the views differ by {difference_sigma:.1f} standard deviations (RMS over {n_parameters} parameters), more "
        "than chance explains: the rig has changed, or the stated standard deviations are too small; {remedy}.",
        "compare with a calibration without the prior",
    ),
    FindingKind(
        "exposures-apart", _W, "The cameras did not see the board at the same moment",
        "left and right were not taken together: each camera alone fits to {alone_px:.3f} px, both together only to {pair_px:.3f} "
        "px; {how}; {remedy}.",
        "trigger the cameras together, or put the board on a stand for each pair",
    ),
    FindingKind(
        "rig-changed", _W, "The rig changed in the middle of the recording",
        "from view {view} on the {camera} camera (or the other the opposite way) is {what}: the rig changed; {remedy}.",
        "calibrate the views before {view} and those from it on apart",
    ),
    FindingKind(
        "rig-drifts", _W, "The rig changed slowly over the recording",
        "over the recording the {camera} camera (or the other the opposite way) is slowly {what}: the rig drifts; {remedy}.",
        "let it warm up, fix the mounts, and use views of a shorter time",
    ),
    FindingKind(
        "rig-has-two-states", _W, "Some views are of another state of the rig",
        "in {n_views} {n_views:view|views} ({views}) the {camera} camera (or the other the opposite way) is {what}, in the others it is not; "
        "{remedy}.",
        "calibrate both groups apart; look for a loose lens or mount, a stabiliser, or mixed recordings",
    ),
    FindingKind(
        "changed-from-view", _W, "Views at one end of the recording contradict the others",
        "views {first} to {last}, all at {end} of the recording, contradict the others and were left out: the rig or its setting "
        "changed there; {remedy}.",
        "calibrate them apart, and keep the result that is of the rig as it is now",
    ),
    FindingKind(
        "many-views-left-out", _W, "Many views contradict the others",
        "{n_out} of {n_given} views contradict the others and were left out ({views}): the rig, its setting or the "
        "triggering may not have held still; {remedy}.",
        "see what these views have in common, and record anew if it is not the images",
    ),
    FindingKind(
        "rests-on-few-views", _W, "The rig rests on few of the views",
        "the rig rests on {weight:.1f} views' worth of pairs ({n_used} of {n_given} views used, {n_shared} seen by both cameras): "
        "a single wrong one would go unnoticed; {remedy}.",
        "add views that both cameras see, the board in different places and tilts, and see why others were left out",
    ),
    FindingKind(
        "views-copied", _W, "Some views are copies of others",
        "{n_copies} of {n_given} views are copies of others (first: {view} of {original}) and count once; {remedy}.",
        "give every pair once",
    ),
    FindingKind(
        "few-different-poses", _W, "Many views show the board in the same place",
        "the {n_given} views show the board in only {n_poses} different poses: repeated poses average noise, and show nothing "
        "new; {remedy}.",
        "add views with the board elsewhere and tilted otherwise",
    ),
    FindingKind(
        "points-beyond-their-sigma", _W, "The target's points lie farther from where they were given than stated",
        "the target's points lie {ratio:.1f} times as far from where they were given as their standard deviations say (RMS), point {worst} "
        "{worst_ratio:.1f} times; {remedy}.",
        "state larger ones (object_sigma_m), or see to the order and the places of the points",
    ),
    FindingKind(
        "points-not-as-given", _W, "The target's points are not where they were given",
        "the target's points are not where they were given: corners fit to {free_px:.2f} px where the points may move and to "
        "{given_px:.2f} px where they are held; they move by {rms:.3g} {unit} (RMS), point {worst} by {worst_off:.3g}; {remedy}.",
        "measure the points again, or state how well they are known (object_sigma_m)",
    ),
    FindingKind(
        "board-scale-uncertain", _W, "The print is off by so much that its scale is in doubt",
        "the board's print is off ({stretch_percent:+.2f} % longer along x than along y), so its scale, which no image tells, may be "
        "off as well: lengths and baseline are known to {scale_percent:.2f} % at best; {remedy}.",
        "measure the printed board and give its true size, or use a better print",
    ),
    FindingKind(
        "scale-doubtful", _W, "The board's points are implausibly far apart, or near",
        "the board's points lie {pitch_m:g} m apart, as if millimetres had been given for metres or the other way round: no image tells "
        "a board's size, and all lengths of the result scale with it; {remedy}.",
        "give lengths in metres, or a SPEC with a unit (30mm)",
    ),
    FindingKind(
        "aprilgrid-gap-wrong", _W, "The gap between the tags of an AprilGrid is not as given",
        "the board's tags stand {found:.3f} of their size apart, not {given:.3f} as given; {remedy}.",
        "give the gap that was found as the last part of the board's SPEC",
    ),
    FindingKind(
        "corners-without-weight", _W, "More corners than usual were given no weight",
        "{n_outliers} of {n_corners} corners ({share_percent:.1f} %) do not fit and were given no weight; the worst is "
        "{camera} corner {corner} of view {view}, {distance_px:.1f} px off.", "",
    ),
    FindingKind(
        "corners-lock-to-pixels", _W, "Corners are drawn to places between the pixels",
        "{camera} corners lock to the pixels: an error of up to {amplitude_px:.2f} px repeats every {period_px:g} px "
        "({share_percent:.0f} % of the residuals' variance) and was taken out; {remedy}.",
        "calibrate with images of the camera's own resolution, not resized or enlarged",
    ),
    FindingKind(
        "halves-disagree", _W, "Two halves of the views give other depths than their standard deviations allow",
        "two halves of the views differ by {depth_percent:.2g} % in depth at {range:.2g} {unit}, where {stated_percent:.2g} % is stated "
        "({over_sigma:.1f} standard deviations, RMS), and by {projection_px:.2g} px in projection: something changed between the views, "
        "or bends them alike; {remedy}.",
        "take the board at rest, all over the images, and check the focus and the mounts",
    ),
    FindingKind(
        "zoom-off-curve", _W, "A zoom setting's calibration is not where the others' curves lead",
        "{at} ({sigmas:.1f} standard deviations); {remedy}.",
        "check its number, its unit and which images belong to it, or calibrate at more settings about it",
    ),
    FindingKind(
        "lens-of-another-kind", _W, "The lenses may be of another kind than the method's model",
        "the lenses may be of another kind than {model}: all corners lie where {other} fits as well or better ({other_px:.3g} px, {model} "
        "{own_px:.3g} px), and its rig is {sigmas:.1f} standard deviations away, which those stated hold now; {remedy}.",
        "calibrate with --calibrator lm, which picks the model",
    ),
    FindingKind(
        "lens-model-misfits", _W, "The lens bends light as its model cannot",
        "a free radial profile would lower the squared rows of views left out by {share_percent:.2g} % ({standard_errors:.1f} standard "
        "errors): corners lie up to {profile_px:.2g} px from where {model} has them; {remedy}.",
        "try --model auto, or a model with more coefficients",
    ),
    FindingKind(
        "residuals-correlated", _W, "Errors of neighbouring corners are alike, and the standard deviations do not count it",
        "residuals of neighbouring corners correlate by {correlation:.2f} ({common_px:.2g} px in common), which the standard deviations "
        "do not count: they are too small; {remedy}.",
        "take more views, so that what they have in common shows, or give the corners' cross-covariances",
    ),
    FindingKind(
        "corners-not-of-rig", _W, "The corners beside the rig's file are not those that it was made from",
        "{path} holds the rig's views by name, but was not used: {why}; {remedy}.",
        "if the rig's file was changed by hand, take it as it was written; else name its own corners with --evidence, or calibrate anew",
    ),
    FindingKind(
        "rig-file-changed", _W, "The rig's file was changed after the calibration",
        "the rig's R and T are not those of the calibration: the right poses of its views deviate from them on average by "
        "{standard_errors:.1f} standard errors, where a calibration leaves below 1: the file was changed after it was written; {remedy}.",
        "take the file as it was written, or calibrate anew from the corners",
    ),
    FindingKind(
        "rig-does-not-fit", _W, "The rig does not fit new images at all",
        "left and right corners miss each other under this rig by {pair_px:.2g} px (median), where each camera alone leaves {alone_px:.2g} "
        "px: {what}; {remedy}.",
        "calibrate anew; where that does not last, look for what is loose",
    ),
    FindingKind(
        "rows-off", _W, "Rows of new images are off, and nothing says how well the rig was known",
        "rectified rows are off by {common_px:.2g} px in all views alike (RMS; by {rest_px:.2g} px otherwise; p = {p_value:.1g}), and the "
        "rig states no standard deviations that would tell whether it was as bad before: a camera turned, or the calibration was poor; "
        "{remedy}.",
        "calibrate anew, or evaluate the rig.json of the calibration",
    ),
    FindingKind(
        "rig-disagrees", _W, "New images do not agree with the rig",
        "the images do not agree with the rig as its standard deviations allow ({difference_sigma:.1f} of them, RMS over {n_directions} "
        "directions; p = {p_value:.1g}): {what}; {remedy}.",
        "calibrate anew; where that does not last, look for what is loose",
    ),
    FindingKind(
        "model-choice-weak", _W, "Too few views to choose the camera model by held-out error",
        "camera model: {reason}.", "",
    ),
    FindingKind(
        "dataset-rigs-left-out", _W, "Pairs of other calibrations of a data set were left out",
        "{n_out} of {n_pairs} {n_pairs:pair|pairs} {n_out:is|are} of {n_rigs} other {n_rigs:calibration|calibrations} and "
        "{n_out:was|were} left out ({names}); used is the calibration of {used}, {why}; {remedy}.",
        "choose another one with --rig-of FRAME",
    ),
    FindingKind(
        "known-lengths-disagree", _W, "Known lengths of the scene contradict one another",
        "known lengths contradict each other: by {first} the cameras stand {first_m:.5g} m apart, by {second} {second_m:.5g} m "
        "({sigmas:.1f} standard deviations); {remedy}.",
        "measure them again, and look whether the ends are where they were pointed at",
    ),
    FindingKind(
        "dataset-frames-left-out", _W, "Some images of a data set have no partner and were left out",
        "{n_out} {n_out:image has|images have} no partner and {n_out:was|were} left out ({names}); {n_pairs} {n_pairs:pair is|pairs "
        "are} left; {remedy}.",
        "check that both cameras' images are complete",
    ),
    FindingKind(
        "board-not-as-drawn", _N, "The board is bent or badly printed, and was measured along with the rig",
        "the board is not as drawn: it bows by {bow:.2f} ± {bow_sigma:.2f} {unit}, and lengths along x are {stretch_percent:+.3f} ± "
        "{stretch_sigma_percent:.3f} % off those along y, which moves corners by up to {moves_px:.2f} px; it was measured along with the "
        "rig, and its scale is taken for the drawing's, which holds to {scale_percent:.2f} %; {remedy}.",
        "reuse the board with --board-file, or mount it on something flat and stiff",
    ),
    # --- views
    FindingKind(
        "principal-points-near-middle", _N, "Principal points that the views hardly tell were taken to lie near the middle",
        "through lenses this long the views hardly tell where the principal points lie: they were taken to lie near the middle of "
        "the images, within {share_percent:.0f} % of their size (one standard deviation); what follows from that is in the "
        "standard deviations.",
        "",
    ),
    FindingKind(
        "halves-agree", _N, "Two halves of the views agree within their standard deviations",
        "two halves of the views differ by {depth_percent:.2g} % in depth at {range:.2g} {unit} ({over_sigma:.1f} of the stated standard "
        "deviations, RMS) and by {projection_px:.2g} px in projection", "",
    ),
    FindingKind(
        "halves-undetermined", _N, "The views do not suffice for a test on two halves",
        "the {n_views} views were not tested in two halves: {why}", "",
    ),
    FindingKind(
        "lens-model-suffices", _N, "A freer lens would not predict views left out any better",
        "a free radial profile of the lens would lower the squared rows of views left out by {share_percent:.1f} %, and move corners by "
        "up to {profile_px:.2g} px", "",
    ),
    FindingKind(
        "rays-everywhere", _N, "Every pixel has a ray", "the distortion rises all over both images: every pixel has a ray", "",
    ),
    FindingKind(
        "residuals-checked", _N, "Errors of neighbouring corners are independent, or counted",
        "residuals of neighbouring corners correlate by {correlation:+.2f} ± {sigma:.2f} ({common_px:.2g} px in common); standard "
        "deviations count a factor of {sigma_factor:.1f} for what views have in common", "",
    ),
    FindingKind(
        "images-differ-in-noise", _N, "Corners of some images are much noisier than those of others",
        "corner noise is {least_px:.2g} px in the {least_camera} image of view {least_view} and {most_px:.2g} px in the "
        "{most_camera} one of view {most_view}: each image counts by its own.",
        "",
    ),
    FindingKind("view-without-corners", _N, "A view without corners", "no corners in either camera", ""),
    FindingKind(
        "view-off-grid", _N, "A view whose corners are no image of the board",
        "the {camera} corners do not lie on the board's grid (order or detection is wrong); {remedy}", "detect them again",
    ),
    FindingKind(
        "view-off-target", _N, "A view whose corners are no image of the target",
        "the {camera} corners are no image of the target's points, or too few of them; {remedy}", "detect this view again",
    ),
    FindingKind(
        "view-at-one-point", _N, "A view whose corners coincide",
        "the {camera} corners all lie at one point ({x_px:.0f}, {y_px:.0f}); {remedy}", "mark corners that were not found as NaN",
    ),
    FindingKind(
        "view-on-a-line", _N, "A view whose corners lie on one line",
        "the {camera} corners lie on one line and determine no pose; {remedy}", "show more of the board, less edge-on",
    ),
    FindingKind(
        "view-shifted", _N, "A view numbered off by a row or column",
        "the {camera} corners are shifted by {shift} against the other camera; {remedy}", "detect this view again",
    ),
    FindingKind(
        "view-mirrored", _N, "One image of a pair is mirrored",
        "the {camera} image is mirrored: left and right miss each other by {miss_px:.3g} px as given, by {typical_px:.2g} px in other views; "
        "{remedy}", "give it as the camera took it",
    ),
    FindingKind(
        "view-mismatched", _N, "A pair that does not show one board pose",
        "left and right do not show the same board pose (they miss each other by {miss_px:.3g} px, other views by "
        "{typical_px:.2g} px): the pair is mismatched or was not simultaneous", "",
    ),
    FindingKind(
        "view-contradicts", _N, "A view most of whose corners contradict the others",
        "{n_unused} of {n_seen} {camera} corners contradict the other views (typically {typical_px:.1f} px off); {remedy}",
        "check the corner order and that both images were taken together",
    ),
    FindingKind(
        "view-reordered", _N, "A view whose corner order was repaired",
        "the {camera} corner order was {symmetry} against the other camera; repaired", "",
    ),
)  # fmt: skip

KINDS: dict[str, FindingKind] = {kind.code: kind for kind in _KINDS}
"""Every code, in the order of the documentation."""


class _Sentences(string.Formatter):
    """Fills in figures, and for a count with two words (``one|many``) the word that is right for it."""

    def format_field(self, value: Any, format_spec: str) -> Any:
        one, bar, many = format_spec.partition("|")
        if not bar:
            return super().format_field(value, format_spec)
        return one if value == 1 else many


_SENTENCES = _Sentences()


def finding(code: str, *, remedy: str | None = None, **figures: Any) -> Finding:
    """The finding of that code with these figures; ``remedy`` in place of the table's where this case knows a better one."""
    kind = KINDS[code]
    what = _SENTENCES.format(kind.remedy if remedy is None else remedy, **figures)
    return Finding(code, kind.severity, _SENTENCES.format(kind.sentence, **figures, remedy=what), what, figures)


def refusal(found: Finding, rejected: Mapping[str, str] | None = None) -> BinocalError:
    """The exception of a refusal; ``rejected`` maps views to what each of them shows."""
    kind = KINDS[found.code].error
    assert kind is not None, f"{found.code} is no refusal"
    lists_views = issubclass(kind, CalibrationError | DetectionError)
    error = kind(found.text, dict(rejected or {})) if lists_views else kind(found.text)
    error.findings = (found,)
    return error


def findings_of(error: BaseException) -> tuple[Finding, ...]:
    """What an exception was raised for; empty where it is not about a calibration."""
    if isinstance(error, TooFewViewsError):
        plural = "" if error.found == 1 else "s"
        why = f": {error.why}" if error.why else ""
        figures = {"n_found": error.found, "plural": plural, "n_needed": error.needed, "why": why}
        return (finding("too-few-views", remedy=error.remedy, **figures),)
    return error.findings if isinstance(error, BinocalError) else ()
