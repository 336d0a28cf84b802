"""Which board of the left image is which of the right one, where several look alike: by geometry, over all shots.

Each camera's boards give that camera's lens and the pose of every board before it (:mod:`.intrinsics`), without any pairing. One pair
of boards then proposes where the right camera stands, and a proposal is right if it puts the other boards of the left image where the
right image shows boards too, in all shots. Proposals are put to the vote, refined on the boards that they match, and one is taken only
where no other matches nearly as many.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.cameras import Camera, StereoRig
from binocal.errors import CalibrationError
from binocal.geometry import SE3, so3
from binocal.initialization.intrinsics import estimate_intrinsics
from binocal.initialization.poses import estimate_poses
from binocal.initialization.symmetries import BoardSymmetries, board_symmetries
from binocal.shapes import Bool, Float, Int

LENSES = ("brown4", "fisheye4")  # the one that fits better is taken
MOST_PROPOSALS = 600  # of boards of one SPEC that both cameras see in a shot, evenly chosen
VOTED_AT_ONCE = 64  # proposals; bounds the memory
MOST_REFINED = 8  # proposals with the most votes that match different boards
MAX_OFF_SIZE = 0.6  # of a board's image: from where a rough proposal puts its middle
MAX_OFF_SPACING = 0.75  # of the distance between neighbouring corners, RMS, once the proposal is refined
REFINEMENTS = 4
MIN_MATCHED = 3  # boards that agree on one pose of the cameras; any two boards agree by chance where they stand alike
MAX_RIVAL_SHARE = 0.6  # of the matched boards that any other proposal may match
DISTINCT = 0.5  # of the smaller of two sets of matches must differ, or else they are one proposal


@dataclass(frozen=True, slots=True, eq=False)
class SeenBoards:
    """The boards that one camera saw: ``shot[k]`` is the pair of images, ``kind[k]`` the SPEC and ``px[k]`` the corners of the k-th.

    ``px`` has a row for every point of all SPECs' boards, NaN where the board has none or it was not seen.
    """

    shot: Int[ndarray, "k"]
    kind: Int[ndarray, "k"]
    px: Float[ndarray, "k n 2"]
    size_wh: tuple[int, int]


@dataclass(frozen=True, slots=True, eq=False)
class BoardPairs:
    """``left[m]`` and ``right[m]`` are one board; its right corners stand in the left's order after ``px[order[m]]``.

    ``problem`` says why boards that look alike could not be paired; empty where they could.
    """

    left: Int[ndarray, "m"]
    right: Int[ndarray, "m"]
    order: Int[ndarray, "m n"]
    problem: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class _Posed:
    """What one camera saw, with the camera and ``T_camera_board``; not usable where there is no pose."""

    seen: SeenBoards
    camera: Camera
    R: Float[ndarray, "k 3 3"]
    t: Float[ndarray, "k 3"]
    is_usable: Bool[ndarray, "k"]
    spacing_px: Float[ndarray, "k"]
    middle_px: Float[ndarray, "k 2"]
    size_px: Float[ndarray, "k"]


@dataclass(frozen=True, slots=True, eq=False)
class _Matches:
    """Matched boards under a proposal: places in the left and right lists, the symmetry, and the miss in spacings."""

    left: Int[ndarray, "m"]
    right: Int[ndarray, "m"]
    symmetry: Int[ndarray, "m"]
    miss: Float[ndarray, "m"]

    @property
    def pairs(self) -> set[tuple[int, int]]:
        return set(zip(self.left.tolist(), self.right.tolist(), strict=True))


def pair_boards(
    points: Float[ndarray, "n 3"],
    places: Sequence[slice],
    left: SeenBoards,
    right: SeenBoards,
    *,
    rig: StereoRig | None = None,
) -> BoardPairs:
    """Pairs of one board each; ``places`` says which of the points belong to each SPEC's board.

    With the ``rig`` known, it alone says which boards are one. A board that is alone of its SPEC in both images of a shot is paired
    without proof where the boards determine no pose of the cameras.
    """
    posed = [
        _posed(points, seen, None if rig is None else camera)
        for seen, camera in zip((left, right), (None, None) if rig is None else (rig.left, rig.right), strict=True)
    ]
    alone = _alone(left, right, len(points))
    a, b = posed
    if a is None or b is None:
        if not _has_alike(left, right):
            return alone
        blind = "left" if a is None else "right"
        return BoardPairs(
            *_none(len(points)),
            f"too few boards, or boards too much alike in their tilts, tell the {blind} camera's lens",
        )
    symmetries = [_turns(points, place) for place in places]
    if rig is not None:
        matches = _match(rig.T_right_left, a, b, points, symmetries)
        return _as_pairs(matches, a, b, symmetries)
    ranked = _ranked(a, b, points, symmetries)
    n_best = len(ranked[0].left) if ranked else 0
    n_rival = max((len(other.left) for other in ranked[1:] if _differ(other, ranked[0])), default=0)
    if n_best >= MIN_MATCHED and n_rival <= MAX_RIVAL_SHARE * n_best:
        return _as_pairs(ranked[0], a, b, symmetries)
    if not _has_alike(left, right):
        return alone
    text = "no pose of the cameras puts three boards of the left images where the right ones show boards"
    if n_best >= MIN_MATCHED:
        text = f"two poses of the cameras match nearly as many boards ({n_best} and {n_rival})"
    return BoardPairs(*_none(len(points)), text)


def _none(n_points: int) -> tuple[Int[ndarray, "m"], Int[ndarray, "m"], Int[ndarray, "m n"]]:
    nobody = np.empty(0, dtype=int)
    return nobody, nobody, np.empty((0, n_points), dtype=int)


def _has_alike(left: SeenBoards, right: SeenBoards) -> bool:
    """Whether any image shows several boards of one SPEC."""
    return any(len(np.unique(np.stack([seen.shot, seen.kind]), axis=1).T) < len(seen.shot) for seen in (left, right))


def _alone(left: SeenBoards, right: SeenBoards, n_points: int) -> BoardPairs:
    """The boards that are alone of their SPEC in both images of a shot."""
    place = {key: k for k, key in enumerate(zip(right.shot.tolist(), right.kind.tolist(), strict=True))}
    pairs = [
        (k, place[key])
        for k, key in enumerate(zip(left.shot.tolist(), left.kind.tolist(), strict=True))
        if key in place
    ]
    i, j = np.array(pairs, dtype=int).reshape(-1, 2).T
    return BoardPairs(i, j, np.tile(np.arange(n_points), (len(i), 1)))


def _posed(points: Float[ndarray, "n 3"], seen: SeenBoards, camera: Camera | None) -> _Posed | None:
    """Lens and poses from one camera's boards alone; None where they do not tell it."""
    if camera is None:
        starts: list[tuple[float, Camera]] = []
        for model in LENSES:
            try:
                start = estimate_intrinsics(points, seen.px, seen.size_wh, model)
                if np.isfinite(start.rms_px) and start.is_usable.sum() >= MIN_MATCHED:
                    starts.append((start.rms_px, Camera(model, seen.size_wh, start.parameters)))
            except (CalibrationError, ValueError, np.linalg.LinAlgError):  # no camera follows from these boards
                continue
        if not starts:
            return None
        camera = min(starts, key=lambda start: start[0])[1]
    poses = estimate_poses(camera.model, camera.parameters, points, seen.px)
    is_usable = poses.is_usable & np.isfinite(poses.t).all(axis=1)
    R = np.where(is_usable[:, None, None], poses.R, np.eye(3))
    t = np.where(is_usable[:, None], poses.t, 0.0)
    middle = np.nanmean(seen.px, axis=1)
    size = np.sqrt(np.nanmean(np.square(seen.px - middle[:, None]).sum(axis=-1), axis=1))
    return _Posed(seen, camera, R, t, is_usable, _spacings_px(seen.px), middle, size)


def _spacings_px(px: Float[ndarray, "k n 2"]) -> Float[ndarray, "k"]:
    """Median distance from a corner to its nearest neighbour, by board."""
    out = np.full(len(px), np.nan)
    for k, corners in enumerate(px):
        seen = corners[np.isfinite(corners[:, 0])]
        distance2 = np.square(seen[:, None] - seen).sum(axis=-1)
        np.fill_diagonal(distance2, np.inf)
        out[k] = np.sqrt(np.median(distance2.min(axis=1)))
    return out


def _turns(points: Float[ndarray, "n 3"], place: slice) -> BoardSymmetries:
    """The turns of a SPEC's board in its plane that map it onto itself, as orders of all points."""
    found = board_symmetries(points[place])
    turns = np.flatnonzero(found.motions.R[:, 2, 2] > 0)
    order = np.tile(np.arange(len(points)), (len(turns), 1))
    order[:, place] = found.order[turns] + place.start
    return BoardSymmetries(
        tuple(found.names[k] for k in turns), SE3(found.motions.R[turns], found.motions.t[turns]), order
    )


def _ranked(
    a: _Posed, b: _Posed, points: Float[ndarray, "n 3"], symmetries: Sequence[BoardSymmetries]
) -> list[_Matches]:
    """The refined matches of the proposals with the most votes, those that match most first."""
    voted: dict[tuple[tuple[int, int], ...], tuple[int, float, SE3]] = {}
    proposals = _proposals(a, b, symmetries)
    for first in range(0, len(proposals.R), VOTED_AT_ONCE):
        some = proposals[first : first + VOTED_AT_ONCE]
        for k, off in enumerate(_offs(some, a, b, points)):
            pairs, mean_off = _one_to_one(off, MAX_OFF_SIZE)
            key = tuple(sorted(pairs))
            if key and (key not in voted or mean_off < voted[key][1]):
                voted[key] = (len(key), mean_off, some[k])
    best = sorted(voted.values(), key=lambda vote: (-vote[0], vote[1]))[:MOST_REFINED]
    refined = [_refined(T, a, b, points, symmetries) for _, _, T in best]
    return sorted((m for m in refined if len(m.left)), key=lambda m: (-len(m.left), float(np.median(m.miss))))


def _differ(a: _Matches, b: _Matches) -> bool:
    return len(a.pairs & b.pairs) < (1 - DISTINCT) * min(len(a.left), len(b.left))


def _proposals(a: _Posed, b: _Posed, symmetries: Sequence[BoardSymmetries]) -> SE3:
    """``T_right_left`` of every board that may be one with another of its SPEC and shot, in every turn."""
    is_one = (
        (a.seen.shot[:, None] == b.seen.shot)
        & (a.seen.kind[:, None] == b.seen.kind)
        & a.is_usable[:, None]
        & b.is_usable
    )
    pairs = np.argwhere(is_one)
    if len(pairs) > MOST_PROPOSALS:
        pairs = pairs[np.linspace(0, len(pairs) - 1, MOST_PROPOSALS).round().astype(int)]
    R, t = [np.empty((0, 3, 3))], [np.empty((0, 3))]
    for kind, symmetry in enumerate(symmetries):
        i, j = pairs[a.seen.kind[pairs[:, 0]] == kind].T
        for S_R, S_t in zip(symmetry.motions.R, symmetry.motions.t, strict=True):
            R_right = b.R[j] @ S_R
            t_right = b.R[j] @ S_t + b.t[j]
            R.append(R_right @ a.R[i].swapaxes(-1, -2))
            t.append(t_right - (R[-1] @ a.t[i][..., None])[..., 0])
    return SE3.unchecked(np.concatenate(R), np.concatenate(t))


def _offs(T: SE3, a: _Posed, b: _Posed, points: Float[ndarray, "n 3"]) -> Float[ndarray, "p k l"]:
    """How far each proposal puts the middle of each left board from that of each right one, in its size; infinite if another's."""
    middle = np.array([points[np.isfinite(px[:, 0])].mean(axis=0) for px in a.seen.px])
    in_left = np.vecdot(a.R, middle[:, None]) + a.t
    predicted = b.camera.project(in_left @ T.R.swapaxes(-1, -2) + T.t[:, None])
    off = np.linalg.norm(predicted[:, :, None] - b.middle_px, axis=-1) / b.size_px
    is_other = (a.seen.shot[:, None] != b.seen.shot) | (a.seen.kind[:, None] != b.seen.kind)
    return np.where(is_other | ~a.is_usable[:, None] | ~np.isfinite(off), np.inf, off)


def _one_to_one(off: Float[ndarray, "k l"], limit: float) -> tuple[set[tuple[int, int]], float]:
    """Pairs that are each other's nearest, within the limit; and their mean distance."""
    if not off.size:
        return set(), np.inf
    nearest, back = off.argmin(axis=1), off.argmin(axis=0)
    chosen = [(i, int(j)) for i, j in enumerate(nearest) if back[j] == i and off[i, j] < limit]
    return set(chosen), float(np.mean([off[pair] for pair in chosen])) if chosen else np.inf


def _refined(
    T: SE3, a: _Posed, b: _Posed, points: Float[ndarray, "n 3"], symmetries: Sequence[BoardSymmetries]
) -> _Matches:
    """The matches of a proposal after a few rounds of matching and fitting it to what matches, in 3-D."""
    limits = np.geomspace(4 * MAX_OFF_SPACING, MAX_OFF_SPACING, REFINEMENTS)
    for limit in limits:
        matches = _match(T, a, b, points, symmetries, float(limit))
        if len(matches.left) < 2:
            break
        T = _fitted(matches, a, b, points, symmetries)
    return _match(T, a, b, points, symmetries)


def _fitted(
    matches: _Matches, a: _Posed, b: _Posed, points: Float[ndarray, "n 3"], symmetries: Sequence[BoardSymmetries]
) -> SE3:
    """The rigid motion that takes the matched boards' corners, as the left camera has them, to the right's."""
    sources, targets, weights = [], [], []
    for i, j, k in zip(matches.left, matches.right, matches.symmetry, strict=True):
        some = points[np.isfinite(a.seen.px[i, :, 0])]
        turned = symmetries[int(a.seen.kind[i])].motions[int(k)].apply(some)
        sources.append(SE3.unchecked(a.R[i], a.t[i]).apply(some))
        targets.append(SE3.unchecked(b.R[j], b.t[j]).apply(turned))
        weights.append(np.full(len(some), 1 / (len(some) * float(a.t[i] @ a.t[i]))))  # far boards are known worse
    x, y, w = np.concatenate(sources), np.concatenate(targets), np.concatenate(weights)
    w = w / w.sum()
    x_mean, y_mean = w @ x, w @ y
    R = so3.project_to_rotation((y - y_mean).T @ ((x - x_mean) * w[:, None]))
    return SE3(R, y_mean - R @ x_mean)


def _match(
    T: SE3,
    a: _Posed,
    b: _Posed,
    points: Float[ndarray, "n 3"],
    symmetries: Sequence[BoardSymmetries],
    limit: float = MAX_OFF_SPACING,
) -> _Matches:
    """Boards that a pose of the cameras puts where the right image shows one, corner by corner."""
    rough, _ = _one_to_one(_offs(SE3.unchecked(T.R[None], T.t[None]), a, b, points)[0], MAX_OFF_SIZE)
    rows = []
    for i, j in sorted(rough):
        predicted = b.camera.project(T.apply(SE3.unchecked(a.R[i], a.t[i]).apply(points)))
        orders = symmetries[int(a.seen.kind[i])].order
        miss = [_rms(predicted - b.seen.px[j][order]) / float(b.spacing_px[j]) for order in orders]
        k = int(np.argmin(miss))
        if miss[k] < limit:
            rows.append((i, j, k, miss[k]))
    left, right, symmetry = (np.array([row[c] for row in rows], dtype=int) for c in range(3))
    return _Matches(left, right, symmetry, np.array([row[3] for row in rows], dtype=float))


def _rms(off: Float[ndarray, "n 2"]) -> float:
    seen = off[np.isfinite(off[:, 0])]
    return float(np.sqrt(np.mean(np.square(seen).sum(axis=-1)))) if len(seen) else np.inf


def _as_pairs(matches: _Matches, a: _Posed, b: _Posed, symmetries: Sequence[BoardSymmetries]) -> BoardPairs:
    """The matches, and the boards that no pose of theirs could be compared of left out."""
    n = a.seen.px.shape[1]
    orders = [symmetries[int(a.seen.kind[i])].order[k] for i, k in zip(matches.left, matches.symmetry, strict=True)]
    return BoardPairs(matches.left, matches.right, np.array(orders, dtype=int).reshape(-1, n))
