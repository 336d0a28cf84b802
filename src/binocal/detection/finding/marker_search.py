"""The search for boards with markers: X-corners first, their faces next, and only then what is printed in these.

The faces of linked corners are read where they lie; readings vote for the way in which they fit one board; from the corners
that these name the lattice grows, corner by corner, through any lens, for each is expected by its neighbours alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy import ndarray

from binocal.detection.finding.crossings import (
    better_lens,
    count_visible,
    from_level,
    grow_known,
    median_of,
    points_at,
    steps_at,
)
from binocal.detection.finding.groups import MAX_TURN_RAD
from binocal.detection.finding.marker_codes import (
    BLURS_CELLS,
    CodeKind,
    CodeTemplates,
    cell_places,
    code_templates,
    face_cells,
)
from binocal.detection.finding.marker_consistency import find_inconsistent
from binocal.detection.finding.marker_grid import MarkerGrid
from binocal.detection.finding.missing_corners import grow_missing
from binocal.detection.finding.search import LevelSetting, scaled_saddles
from binocal.detection.finding.xcorners import SaddleImage, XCorners, find_saddles
from binocal.kernels import images
from binocal.kernels.marker_grids import (
    FieldLens,
    find_faces,
    predict_places,
    read_cells,
    vote_on_tags,
)
from binocal.shapes import Bool, Float, Float32, Int, UInt8

SURE, SURE_AHEAD = 0.72, 0.12  # correlation of a marker that is read, and by how much no other id or turn comes near
LIKELY = 0.45  # of one that has a say where others agree
LEAST_SURE, LEAST_LIKELY = (
    2,
    4,
)  # markers that agree, for a board: of likely ones chance would bring one in many thousand images
READ, FOREIGN = 0.55, 0.3  # a face with the code that its place demands; with another one or none
LEAST_MEDIAN = 0.4  # of a board's faces
FIELDS_RAD = tuple(np.radians([0, 100, 140, 180]))
LEAST_BETTER = 1.02  # by which a lens reads better, for it to be preferred to none
MOST_COMPARED = 64  # faces by which lens and blur are chosen
ENOUGH_SHARE = 0.9  # of the corners that should be seen
MOST_LESS_READ = 4  # faces, than of the likeliest way of printing, for a way to be looked into further
LEAST_GAIN = 0.02  # of a level, for the next one to be searched
LEAST_CELL_PX = 0.85  # of a marker's code: below it chance reads as well
LEAST_KEPT = 0.85  # of the corners that markers predict; with fewer a note says so
MOST_OFF, MOST_OFF_PER_PITCH = 0.35, 0.25  # sides, of a marker that is found behind a gap


@dataclass(frozen=True, slots=True)
class ReadingWay:
    """How an image's faces are read best."""

    kind: CodeKind
    lens: FieldLens
    blur_cells: float
    is_inverted: bool


@dataclass(slots=True, eq=False)
class _Faces:
    """Faces of one level, in the image's pixels."""

    quads_px: Float[ndarray, "n 4 2"]
    is_bright: Bool[ndarray, "n"]

    def of(self, is_bright: bool) -> Float[ndarray, "m 4 2"]:
        return self.quads_px[self.is_bright == is_bright]


@dataclass(frozen=True, slots=True, eq=False)
class _Readings:
    """Best id and turn of faces; ``quads_px`` are in the markers' own order."""

    quads_px: Float[ndarray, "n 4 2"]
    index: Int[ndarray, "n"]
    """Of the marker among those of the board."""
    likeness: Float32[ndarray, "n"]
    is_sure: Bool[ndarray, "n"]

    def __getitem__(self, which: ndarray) -> _Readings:
        return _Readings(self.quads_px[which], self.index[which], self.likeness[which], self.is_sure[which])


@dataclass(slots=True, eq=False)
class MarkerSighting:
    """A board in an image, printed in one of its ways."""

    way: int
    """The index of the grid."""
    grid: MarkerGrid
    reading: ReadingWay
    known_px: Float[ndarray, "rows columns 2"]
    is_seed: Bool[ndarray, "rows columns"]
    """Corners of markers that voted."""
    likeness: Float[ndarray, "m"] = field(default_factory=lambda: np.zeros(0))
    """Of each marker's face to its code; NaN where the face is not in the image, or hidden in part."""
    of_faces: Float[ndarray, "m"] = field(default_factory=lambda: np.zeros(0))
    """The same, of faces hidden in part too; NaN where nothing says where the face is."""
    n_predicted: int = 0
    """Corners at which the markers that are read say that there is one."""

    @property
    def n_read(self) -> int:
        """Faces that bear the codes that their places demand."""
        return int(np.count_nonzero(self.likeness >= READ))

    def points_px(self, n_points: int) -> Float[ndarray, "n 2"]:
        """The corners in the board's order, NaN where not seen."""
        return points_at(self.grid, self.known_px, n_points)

    def steps_px(self, n_points: int) -> tuple[Float[ndarray, "n"], Float[ndarray, "n"]]:
        """A marker's face at each corner seen, in the board's order, pixels: its shorter side, and its least height."""
        return steps_at(self.grid, self.known_px, self.reading.lens, n_points)

    def find_inconsistent(
        self, points_px: Float[ndarray, "n 2"], covariance_px2: Float[ndarray, "n 2 2"], step_px: Float[ndarray, "n"]
    ) -> Bool[ndarray, "n"]:
        """Which of the board's points, in its own order, lie elsewhere than their neighbours put them."""
        is_blurred = self.reading.blur_cells >= BLURS_CELLS[-1]
        return find_inconsistent(
            self.grid, self.reading.lens, points_px, covariance_px2, step_px, is_blurred=is_blurred
        )


@dataclass(frozen=True, slots=True, eq=False)
class MarkerSearch:
    """What was seen: sightings by falling number of faces read (none: no board), and whether a mirror image was."""

    sightings: list[MarkerSighting]
    is_mirrored: bool = False
    n_markers: int = 0
    """Faces that were read for sure."""


def choose_way(sightings: Sequence[MarkerSighting], least_more: int) -> tuple[MarkerSighting, bool]:
    """The sighting that bears ``least_more`` markers more than any other, and True; else the first of the likely ways, and False."""
    most = max(each.n_read for each in sightings)
    likely = sorted((each for each in sightings if each.n_read > most - least_more), key=lambda each: each.way)
    return likely[0], len(likely) == 1


def few_kept_note(n_kept: int, n_predicted: int) -> str:
    """What a careful reader should know where few of the corners that the markers predict were kept; "" otherwise."""
    if n_kept >= LEAST_KEPT * n_predicted:
        return ""
    return f"only {n_kept} of the {n_predicted} corners beside its markers could be measured"


def marker_level_settings(halvings: int) -> list[LevelSetting]:
    """The searches of an image that can be halved so often, in order: half of a large picture shows nine boards in ten."""
    full = [LevelSetting(0, 1.0, 3.2), LevelSetting(0, 0.8, 2.2)]
    if halvings <= 1:
        return [*full, LevelSetting(0, 1.5, 5.0)] if halvings == 0 else [*full, LevelSetting(1, 1.2, 4.0)]
    return [LevelSetting(1, 1.2, 4.0), *full, LevelSetting(2, 0.8, 2.6)]


def search_markers(
    image: UInt8[ndarray, "h w"],
    grids: Sequence[MarkerGrid],
    kinds: Sequence[CodeKind],
    first_id: int,
    *,
    least_sure: int = LEAST_SURE,
) -> MarkerSearch:
    """The board in an image (8 bits), printed in any of these ways with markers of any of these kinds."""
    n_ids = max(len(grid.faces) for grid in grids)
    most = max(1200, 5 * max(grid.points.size for grid in grids))
    least_side_px = min(LEAST_CELL_PX * face_cells(kind) for kind in kinds)
    sightings: list[MarkerSighting] = []
    n_markers, is_mirrored, n_before = 0, False, 0
    for saddles, scale in scaled_saddles(image, marker_level_settings):
        corners, peaks = find_saddles(saddles, most=most)
        faces = _find_faces(saddles, corners, scale, least_side_px)
        readings = None
        for is_oblique in () if sightings else (False, True):
            # Where all faces lie between codes' corners, the nearest, those of the board may be farther away.
            if is_oblique:
                faces = _find_faces(saddles, corners, scale, least_side_px, is_oblique=True)
            readings, reading, mirrored = _read_first(image, faces, grids, kinds, first_id, n_ids)
            is_mirrored |= mirrored
            if reading is not None:
                n_markers = max(n_markers, int(readings.is_sure.sum()))
                sightings = _vote(readings, reading, grids, least_sure)
            if sightings or mirrored:
                break
        for sighting in sightings:
            if readings is None:  # all sightings are read in one way
                quads = faces.of(sighting.grid.is_dark == sighting.reading.is_inverted)
                readings = _read_all(image, quads, sighting.reading, first_id, n_ids)
            _join(sighting, readings)
            _follow_lens(sighting, (image.shape[1], image.shape[0]))
            _grow(sighting, saddles, scale, peaks)
            if _follow_lens(sighting, (image.shape[1], image.shape[0])):
                # Through a wrong lens other saddles than the board's may have been taken.
                sighting.known_px[~sighting.is_seed] = np.nan
                _grow(sighting, saddles, scale, peaks)
            _verify(image, sighting, first_id)
        sightings = _best(sightings)
        if sightings:
            n_known = int(np.count_nonzero(np.isfinite(sightings[0].known_px[..., 0])))
            if (
                n_known >= ENOUGH_SHARE * grids[0].points.size  # all that there are: the visible need not be counted
                or n_known >= ENOUGH_SHARE * _n_visible(sightings[0], image.shape)
                or n_known < (1 + LEAST_GAIN) * n_before
            ):
                break
            n_before = n_known
    _complete(image, sightings, first_id)
    return MarkerSearch(sightings, is_mirrored and not sightings, n_markers)


def _complete(image: UInt8[ndarray, "h w"], sightings: list[MarkerSighting], first_id: int) -> None:
    """Looks for corners that the likely ways of printing still miss."""
    for sighting in sightings:
        if sighting.n_read <= sightings[0].n_read - MOST_LESS_READ:
            continue
        way = sighting.reading
        known = grow_missing(image, sighting.grid, sighting.known_px, way.lens, is_inverted=way.is_inverted)
        if (
            known is not sighting.known_px
            and np.isfinite(known[..., 0]).sum() > np.isfinite(sighting.known_px[..., 0]).sum()
        ):
            sighting.known_px = known
            _verify(image, sighting, first_id)
    sightings.sort(key=lambda each: -each.n_read)


def _find_faces(
    saddles: SaddleImage, corners: XCorners, scale: float, least_side_px: float, *, is_oblique: bool = False
) -> _Faces:
    """The faces between a level's linked X-corners, in the image's pixels; ``is_oblique`` looks farther for neighbours."""
    links = images.link_corners(
        saddles.smooth,
        corners.points_px,
        corners.rays_rad,
        corners.contrast_dn,
        MAX_TURN_RAD,
        has_markers=True,
        is_oblique=is_oblique,
    )
    members, is_bright = find_faces(*links)
    quads = from_level(corners.points_px, scale)[members]
    is_large = _areas(quads) >= least_side_px**2
    return _Faces(quads[is_large], is_bright[is_large])


def _read_first(
    image: UInt8[ndarray, "h w"],
    faces: _Faces,
    grids: Sequence[MarkerGrid],
    kinds: Sequence[CodeKind],
    first_id: int,
    n_ids: int,
) -> tuple[_Readings, ReadingWay | None, bool]:
    """The faces read in the way that reads most of them best; whether they are rather those of a mirror image."""
    best, best_score, mirrored_score = None, 0.0, 0.0
    best_readings = _Readings(np.zeros((0, 4, 2)), np.zeros(0, int), np.zeros(0, np.float32), np.zeros(0, bool))
    is_enough = False
    for is_inverted in (False, True):
        quads = faces.of(grids[0].is_dark == is_inverted)
        if len(quads) == 0:
            continue
        area = _areas(quads)
        largest = np.argsort(-area, kind="stable")[:MOST_COMPARED]
        some = quads[largest]
        for kind, lens in _lenses(kinds, (image.shape[1], image.shape[0])):
            values = read_cells(image, some, cell_places(kind), lens) * (-1 if is_inverted else 1)
            is_enough = False
            for blur in BLURS_CELLS:
                templates = code_templates(kind, first_id, n_ids, blur)
                readings = _read(values, some, templates)
                score = float(readings.likeness @ (readings.is_sure + 0.1 * (readings.likeness > LIKELY)))
                if score > best_score * (
                    LEAST_BETTER if best is not None and best.lens.f_px == 0 and lens.f_px else 1.0
                ):
                    best, best_score, best_readings = ReadingWay(kind, lens, blur, is_inverted), score, readings
                    is_enough = _are_enough(readings.is_sure, area[largest])
                elif is_enough:  # more blur than fits best reads worse and worse
                    break
                if lens.f_px == 0 and blur == BLURS_CELLS[1] and not is_enough:
                    mirrored_score = max(mirrored_score, _mirrored_score(values, templates))
            if is_enough:
                break
        if is_enough:
            break
    if best is None:
        return best_readings, None, False
    quads = faces.of(grids[0].is_dark == best.is_inverted)
    if len(quads) > MOST_COMPARED:
        best_readings = _read_all(image, quads, best, first_id, n_ids)
    is_mirrored = not is_enough and mirrored_score > 2 * best_score and mirrored_score >= 2 * SURE
    return best_readings, best, is_mirrored


def _lenses(kinds: Sequence[CodeKind], size_wh: tuple[int, int]) -> Iterator[tuple[CodeKind, FieldLens]]:
    for field_rad in FIELDS_RAD:
        for kind in kinds:
            yield kind, FieldLens.of_field(size_wh, field_rad)


def _are_enough(is_sure: Bool[ndarray, "n"], area: Float[ndarray, "n"]) -> bool:
    """Whether nearly all faces that are about as large as those read are read: no other way will read more."""
    if is_sure.sum() < LEAST_LIKELY:
        return False
    return bool(is_sure.sum() >= ENOUGH_SHARE * (area >= 0.3 * median_of(area[is_sure])).sum())


def _mirrored_score(values: Float32[ndarray, "n cells"], templates: CodeTemplates) -> float:
    rest = templates.residual(values)
    likeness = (rest @ templates.mirrored.reshape(-1, rest.shape[1]).T).max(axis=1, initial=0)
    return float(likeness[likeness >= SURE].sum())


def _areas(quads: Float[ndarray, "n 4 2"]) -> Float[ndarray, "n"]:
    a, b = quads[:, 2] - quads[:, 0], quads[:, 3] - quads[:, 1]
    return 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _read_all(
    image: UInt8[ndarray, "h w"], quads: Float[ndarray, "n 4 2"], way: ReadingWay, first_id: int, n_ids: int
) -> _Readings:
    values = read_cells(image, quads, cell_places(way.kind), way.lens) * (-1 if way.is_inverted else 1)
    return _read(values, quads, code_templates(way.kind, first_id, n_ids, way.blur_cells))


def _read(values: Float32[ndarray, "n cells"], quads: Float[ndarray, "n 4 2"], templates: CodeTemplates) -> _Readings:
    rest = templates.residual(values)
    likeness = rest @ templates.turned.reshape(-1, rest.shape[1]).T
    rows = np.arange(len(rest))
    best = likeness.argmax(axis=1)
    top = likeness[rows, best]
    likeness[rows, best] = -1
    is_sure = (top >= SURE) & (top - likeness.max(axis=1) >= SURE_AHEAD)
    index, turn = np.divmod(best, 4)
    own = quads[rows[:, None], (np.arange(4) + turn[:, None]) % 4]
    return _Readings(own, index, top, is_sure)


def _vote(readings: _Readings, way: ReadingWay, grids: Sequence[MarkerGrid], least_sure: int) -> list[MarkerSighting]:
    """The board in the ways of printing that the most readings fit, in the order given."""
    likely = readings[readings.likeness >= LIKELY]
    ballots = []
    for number, grid in enumerate(grids):
        of_grid = likely[
            (grid.is_inner[np.minimum(likely.index, len(grid.faces) - 1)]) & (likely.index < len(grid.faces))
        ]
        if len(of_grid.index) == 0:
            continue
        corners = grid.corners[of_grid.index]
        group, agreeing, disagreeing = vote_on_tags(of_grid.quads_px, corners, way.lens, grid.lines.pitch)
        is_voter = (agreeing > disagreeing) | ((agreeing >= disagreeing) & of_grid.is_sure)
        best, members = 0.0, np.zeros(len(group), bool)
        for g in np.unique(group):
            of_group = (group == g) & is_voter
            n_sure, n = int((of_group & of_grid.is_sure).sum()), int(of_group.sum())
            if n_sure < least_sure and n < LEAST_LIKELY:
                continue
            if (score := n_sure + 0.25 * n) > best:
                best, members = score, of_group
        if best:
            ballots.append((best, number, of_grid[members]))
    most = max((score for score, *_ in ballots), default=0.0)
    return [_start(number, grids[number], way, voters) for score, number, voters in ballots if score >= 0.9 * most]


def _start(number: int, grid: MarkerGrid, way: ReadingWay, voters: _Readings) -> MarkerSighting:
    known = np.full((*grid.points.shape, 2), np.nan)
    crossings = grid.crossings
    for k in np.argsort(voters.likeness, kind="stable"):
        column, row = crossings[voters.index[k]].T
        known[row, column] = voters.quads_px[k]
    return MarkerSighting(number, grid, way, known, np.isfinite(known[..., 0]))


def _join(sighting: MarkerSighting, readings: _Readings) -> None:
    """Adds markers that are read, and lie about where those already known put them: behind a gap, or seen at this level only."""
    grid, way = sighting.grid, sighting.reading
    readings = readings[readings.index < len(grid.faces)]
    inner = grid.is_inner[readings.index] & (readings.likeness >= LIKELY)
    crossings = grid.crossings
    corners = grid.corners
    for _ in range(3):
        column, row = crossings[readings.index[inner]].reshape(-1, 2).T
        open_ = ~np.isfinite(sighting.known_px[row, column, 0]).reshape(-1, 4).all(axis=1)
        index = np.nonzero(inner)[0][open_]
        if len(index) == 0:
            return
        expected = predict_places(grid.lines, sighting.known_px, way.lens, corners[readings.index[index]])
        quads = readings.quads_px[index]
        side = np.sqrt(_areas(quads))
        off = np.linalg.norm(expected - quads, axis=-1).max(axis=1) / np.maximum(side, 1e-9)
        known = np.argwhere(np.isfinite(sighting.known_px[..., 0]))
        known_xy = np.stack([grid.lines.x[known[:, 1]], grid.lines.y[known[:, 0]]], axis=-1)
        middle = corners[readings.index[index]].mean(axis=1)
        away = np.linalg.norm(middle[:, None] - known_xy, axis=-1).min(axis=1) / grid.lines.pitch
        # A likely one only where its neighbours put it well; a sure one behind a gap, too.
        fits = off < np.where(readings.is_sure[index], MOST_OFF + MOST_OFF_PER_PITCH * np.minimum(away, 6), 0.35)
        fits &= readings.is_sure[index] | (away < 1.6)
        # Two readings of one marker: the likelier.
        chosen = index[fits]
        chosen = chosen[np.argsort(readings.likeness[chosen], kind="stable")]
        if len(chosen) == 0:
            return
        for k in chosen:
            column, row = crossings[readings.index[k]].T
            is_open = ~np.isfinite(sighting.known_px[row, column, 0])
            sighting.known_px[row[is_open], column[is_open]] = readings.quads_px[k][is_open]
            sighting.is_seed[row[is_open], column[is_open]] = True


def _grow(sighting: MarkerSighting, saddles: SaddleImage, scale: float, peaks: Float[ndarray, "k 2"]) -> None:
    way = sighting.reading
    level = saddles.smooth, scale, peaks
    sighting.known_px = grow_known(sighting.grid, sighting.known_px, way.lens, way.is_inverted, level)


def _follow_lens(sighting: MarkerSighting, size_wh: tuple[int, int]) -> bool:
    """Takes the lens through which corners expect each other best, where without one they do not well; whether another one."""
    best = better_lens(sighting.grid, sighting.known_px, sighting.reading.lens, size_wh)
    if best is None:
        return False
    sighting.reading = replace(sighting.reading, lens=best)
    return True


def _verify(image: UInt8[ndarray, "h w"], sighting: MarkerSighting, first_id: int) -> None:
    """Reads every face where it should be; takes grown corners back whose faces all bear something else."""
    grid, way = sighting.grid, sighting.reading
    crossings, corners = grid.crossings, grid.corners
    rows, columns = sighting.known_px.shape[:2]
    padded = np.full((rows + 2, columns + 2, 2), np.nan)
    padded[1:-1, 1:-1] = sighting.known_px
    quads = padded[crossings[..., 1] + 1, crossings[..., 0] + 1]
    is_known = np.isfinite(quads[..., 0])
    # Faces of the board's rim have two crossings, or one: the others are where the lattice leads. Where crossings are hidden
    # the marker may be, too: it cannot deny the board.
    n_known = is_known.sum(axis=1)
    is_judged = (n_known == 4) | (~grid.is_inner & (n_known >= 2))
    wanted = ~is_known & (n_known >= 1)[:, None]
    quads[wanted] = predict_places(grid.lines, sighting.known_px, way.lens, corners[wanted])
    size_wh = np.array(image.shape[::-1])
    inside = np.isfinite(quads[..., 0]).all(axis=1) & ((quads > -0.5) & (quads < size_wh - 0.5)).all(axis=(1, 2))
    likeness = np.full(len(quads), np.nan)
    if inside.any():
        values = read_cells(image, quads[inside], cell_places(way.kind), way.lens) * (-1 if way.is_inverted else 1)
        templates = code_templates(way.kind, first_id, len(grid.faces), way.blur_cells)
        rest = templates.residual(values)
        likeness[inside] = (rest * templates.turned[np.nonzero(inside)[0], 0]).sum(axis=1)
    sighting.n_predicted = _count_crossings(crossings[likeness >= READ], rows, columns)
    sighting.of_faces = likeness.copy()
    likeness[~is_judged] = np.nan
    sighting.likeness = likeness
    known = likeness[np.isfinite(likeness) & is_known.all(axis=1)]
    # On a board of other columns some rows fit, and those about them deny it.
    n_denied = int(np.count_nonzero(likeness < FOREIGN))
    if len(known) == 0 or not median_of(known) > LEAST_MEDIAN or n_denied >= sighting.n_read:
        sighting.known_px[:] = np.nan
        return
    borne, denied = np.zeros((rows + 2, columns + 2), bool), np.zeros((rows + 2, columns + 2), bool)
    for is_good, mark in ((True, borne), (False, denied)):
        which = np.isfinite(likeness) & ((likeness >= FOREIGN) == is_good)
        mark[crossings[which][..., 1] + 1, crossings[which][..., 0] + 1] = True
    is_wrong = denied[1:-1, 1:-1] & ~borne[1:-1, 1:-1] & ~sighting.is_seed
    sighting.known_px[is_wrong] = np.nan


def _count_crossings(crossings: Int[ndarray, "m 4 2"], rows: int, columns: int) -> int:
    is_met = np.zeros((rows + 2, columns + 2), bool)
    is_met[crossings[..., 1] + 1, crossings[..., 0] + 1] = True
    return int(np.count_nonzero(is_met[1:-1, 1:-1]))


def _best(sightings: list[MarkerSighting]) -> list[MarkerSighting]:
    """Those that hold, by falling number of faces read; in the order given where they are equal."""
    held = [s for s in sightings if np.isfinite(s.known_px[..., 0]).any()]
    return sorted(held, key=lambda s: -s.n_read)


def _n_visible(sighting: MarkerSighting, shape: tuple[int, ...]) -> int:
    """How many crossings should lie inside the image."""
    return count_visible(sighting.grid, sighting.known_px, sighting.reading.lens, (shape[1], shape[0]))
