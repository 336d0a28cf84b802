"""``T_right_left`` by consensus over views, board symmetries included; never the plain mean.

Each view's pair of board poses proposes a transform. A proposal predicts every other view's right image from its
left pose, and the quadratic forms of :class:`BoardPoses` say by how many pixels it misses, without touching corners.
The proposal with the most votes is then refined jointly with one board pose per view (Gauss-Newton on both cameras'
quadratic forms, views eliminated).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.geometry import SE3, so3
from binocal.geometry.homography import PlaneFrame
from binocal.initialization.poses import BoardPoses, pose_jacobian, pose_vector
from binocal.shapes import Bool, Float, Int

_MAX_PROPOSALS = 12
_MAX_VOTERS = 48  # views asked about every proposal; the winner is put to all
_FLOOR_PX = 2.0  # a start's own inaccuracy: below it no view is blamed
_RATIO = 6.0  # a view disagrees when it misses 6 times as far as the median agreeing view
_OWN_RATIO = 2.0  # nor is one that its own camera's start already misses by half as much: the lens is to blame there


@dataclass(frozen=True, slots=True, eq=False)
class Consensus:
    """``T_right_left``, and how each view stands to it.

    ``agrees`` marks the views that support it; ``symmetry`` is the index of the board symmetry each view needed (0 =
    none, -1 = the view lacks a camera); ``miss_px`` the RMS distance of both cameras' corners once the view's own
    board pose is refitted under T_right_left, ``limit_px`` the bound on it that the agreeing views set (or twice what
    the view misses by without any rig); ``T_left_board`` those poses (NaN rows where unusable).
    """

    T_right_left: SE3
    agrees: Bool[ndarray, "views"]
    symmetry: Int[ndarray, "views"]
    miss_px: Float[ndarray, "views"]
    limit_px: float
    R_left_board: Float[ndarray, "views 3 3"]
    t_left_board: Float[ndarray, "views 3"]


def estimate_relative_pose(
    left: BoardPoses,
    right: BoardPoses,
    symmetries: SE3 | None = None,
    *,
    max_proposals: int = _MAX_PROPOSALS,
    n_iterations: int = 3,
    start_rms_px: float = 0.0,
) -> Consensus:
    """Consensus over the views that both cameras see.

    ``symmetries``: transforms of the board onto itself, the identity first; a view may use any of them on its right
    pose (``T_right_board S``). Proposals come from at most ``max_proposals`` evenly chosen views.
    ``start_rms_px`` is what the cameras' own starts miss by: no view is blamed for less than six times that.

    Raises:
        ValueError: No view has both images.
    """
    both = np.flatnonzero(left.is_usable & right.is_usable)
    n_views = len(left.is_usable)
    if not len(both):
        raise ValueError("no view has both images: nothing ties the cameras to one another")
    S = SE3(np.eye(3)[None], np.zeros((1, 3))) if symmetries is None else symmetries
    L = SE3(left.R[both], left.t[both])
    R = SE3(right.R[both], right.t[both])
    proposers = np.linspace(0, len(both) - 1, min(max_proposals, len(both))).round().astype(int)
    inverse = L[proposers].inverse()
    turned = SE3(R.R[proposers, None] @ S.R, (R.R[proposers, None] @ S.t[..., None])[..., 0] + R.t[proposers, None])
    proposals = SE3(
        turned.R @ inverse.R[:, None], (turned.R @ inverse.t[:, None, :, None])[..., 0] + turned.t
    )  # (proposers, symmetries)
    voters = np.linspace(0, len(both) - 1, min(_MAX_VOTERS, len(both))).round().astype(int)

    forms = _camera_forms(right, both)

    def misses(T_R: ndarray, T_t: ndarray, views: ndarray) -> ndarray:
        seen = right.turn[both[views], 2], right.n_corners[both[views]], forms[views]
        return np.stack([_transfer_px(T_R, T_t, L[views], right.frame, *seen, S[k]) for k in range(len(S.R))], axis=-1)

    miss = misses(proposals.R, proposals.t, voters)
    unturned = np.argmin(miss, axis=-1) == 0
    least = np.min(miss, axis=-1)  # (proposers, symmetries, voters)
    scale = np.maximum(_FLOOR_PX, 3 * np.quantile(least, 0.3, axis=-1, keepdims=True))
    scale = np.minimum(scale, max(4 * float(scale.min()), 4 * _FLOOR_PX))
    votes = np.sum(1 / (1 + (least / scale) ** 2), axis=-1) + 1e-6 * np.sum(unturned, axis=-1)
    winner = np.unravel_index(int(np.argmax(votes)), votes.shape)
    miss = misses(proposals.R[winner], proposals.t[winner], np.arange(len(both)))
    symmetry, least = np.argmin(miss, axis=-1), np.min(miss, axis=-1)
    agrees = least < 3 * scale[winner]
    if not agrees.any():
        agrees = least <= least.min()
    T = SE3(proposals.R[winner], proposals.t[winner])

    own_px = np.sqrt((np.square(left.rms_px[both]) + np.square(right.rms_px[both])) / 2)
    right_form = _with_symmetry(right, both, S[symmetry])
    R_board, t_board, miss_px, limit_px = L.R, L.t, least, _FLOOR_PX
    for _ in range(2):
        T, R_board, t_board, miss_px = _refine(T, L, left, right_form, both, agrees, n_iterations)
        typical = float(np.median(miss_px[agrees]))
        limit_px = max(_FLOOR_PX, _RATIO * max(typical, start_rms_px))
        before, agrees = agrees, miss_px < np.maximum(limit_px, _OWN_RATIO * own_px)
        if not agrees.any():
            agrees = miss_px <= miss_px.min()
        if np.array_equal(agrees, before):
            break
    out_agrees, out_symmetry = np.zeros(n_views, dtype=bool), np.full(n_views, -1)
    out_miss, out_R, out_t = np.full(n_views, np.nan), np.full((n_views, 3, 3), np.nan), np.full((n_views, 3), np.nan)
    out_agrees[both], out_symmetry[both], out_miss[both] = agrees, symmetry, miss_px
    out_R[both], out_t[both] = R_board, t_board
    # A view that one camera saw takes its board pose from that camera
    only_left = left.is_usable & ~right.is_usable
    out_R[only_left], out_t[only_left] = left.R[only_left], left.t[only_left]
    only_right = right.is_usable & ~left.is_usable
    if only_right.any():
        back = T.inverse()
        out_R[only_right] = back.R @ right.R[only_right]
        out_t[only_right] = right.t[only_right] @ back.R.T + back.t
    return Consensus(T, out_agrees, out_symmetry, out_miss, limit_px, out_R, out_t)


def transfer_px(T: SE3, left: BoardPoses, right: BoardPoses, motion: SE3) -> Float[ndarray, "views"]:
    """RMS pixels of right views under proposals: predicted T_right_board = T T_left_board S⁻¹."""
    both = np.flatnonzero(left.is_usable & right.is_usable)
    out = np.full(len(left.is_usable), np.nan)
    moved = SE3(motion.R.reshape(3, 3), motion.t.reshape(3)).inverse()
    L = SE3(left.R[both], left.t[both])
    seen = right.turn[both, 2], right.n_corners[both], _camera_forms(right, both)
    out[both] = _transfer_px(T.R, T.t, L, right.frame, *seen, moved)
    return out


def _camera_forms(poses: BoardPoses, views: ndarray) -> Float[ndarray, "views 9 9"]:
    """Quadratic forms of poses in the camera's own frame instead of the turned one: [s r1, s r2, t] turns row by row."""
    turn = np.zeros((len(views), 3, 3, 3, 3))
    for column in range(3):
        turn[:, :, column, :, column] = poses.turn[views]
    turn = turn.reshape(-1, 9, 9)
    return turn.swapaxes(-1, -2) @ poses.fit[views] @ turn


def _transfer_px(
    T_R: Float[ndarray, "*k 3 3"],
    T_t: Float[ndarray, "*k 3"],
    L: SE3,
    frame: PlaneFrame,
    depth_axis: Float[ndarray, "views 3"],
    n_corners: ndarray,
    forms: Float[ndarray, "views 9 9"],
    symmetry: SE3,
) -> Float[ndarray, "*k views"]:
    """RMS pixels of right views under proposals: predicted T_right_board = T T_left_board S⁻¹.

    All proposals of a view go through one matrix product: the pose vector is linear in the proposal.
    """
    back = symmetry.inverse()
    R = L.R @ back.R
    t_centre = (L.R @ back.t) + L.t + R[..., :2] @ frame.centre
    board = np.concatenate([R[..., :2] * frame.scale, t_centre[..., None]], axis=-1)
    h = np.ascontiguousarray(T_R).reshape(-1, 3) @ board
    h[..., 2] += T_t.reshape(-1)
    h = h.reshape(len(board), -1, 9)
    squared = np.vecdot(h, h @ forms)
    depth = (h[..., 2::3] @ depth_axis[..., None])[..., 0]
    px = np.where(depth > 0, np.sqrt(np.maximum(squared, 0.0) / n_corners[:, None]), 1e6)
    return px.T.reshape(*T_t.shape[:-1], len(board))


def _with_symmetry(
    right: BoardPoses, both: ndarray, S: SE3
) -> tuple[Float[ndarray, "views 9 9"], Float[ndarray, "views 3 3"], PlaneFrame]:
    """Right quadratic forms rewritten for the pose ``T_right_board S``: h(pose S⁻¹) is linear in h(pose).

    A symmetry maps the plane onto itself, so on (x, y, 1) it is a 3x3 matrix A, and [s r1, s r2, t] changes by A from
    the right.
    """
    frame = right.frame
    inverse = S.inverse()
    A = np.zeros((len(both), 3, 3))
    A[:, :2, :2] = inverse.R[:, :2, :2]
    moved = (inverse.R[:, :2, :2] @ frame.centre) + inverse.t[:, :2] - frame.centre
    A[:, :2, 2] = moved / frame.scale
    A[:, 2, 2] = 1.0
    big = np.zeros((len(both), 9, 9))
    for row in range(3):  # each row of the 3x3 [s r1, s r2, t] becomes row @ A
        big[:, 3 * row : 3 * row + 3, 3 * row : 3 * row + 3] = A.swapaxes(-1, -2)
    return big.swapaxes(-1, -2) @ right.fit[both] @ big, right.turn[both], frame


def _refine(
    T: SE3,
    L: SE3,
    left: BoardPoses,
    right_form: tuple[ndarray, ndarray, PlaneFrame],
    both: ndarray,
    agrees: ndarray,
    n_iterations: int,
) -> tuple[SE3, ndarray, ndarray, ndarray]:
    """T_right_left (agreeing views) and board poses by Gauss-Newton; each view's RMS over both cameras."""
    fit_R, turn_R, frame = right_form
    fit_L, turn_L = left.fit[both], left.turn[both]
    n_corners = left.n_corners[both]
    centre = frame.centre
    R_b, t_b = L.R, L.t + L.R[..., :2] @ centre  # board's centre in the left frame

    def evaluate(T_R: ndarray, T_t: ndarray, R: ndarray, t: ndarray) -> tuple[ndarray, ndarray, ndarray]:
        h_L = pose_vector(turn_L @ R, (turn_L @ t[..., None])[..., 0], frame.scale)
        h_R = pose_vector(turn_R @ (T_R @ R), (turn_R @ (t @ T_R.T + T_t)[..., None])[..., 0], frame.scale)
        cost = np.sum(h_L * (fit_L @ h_L[..., None])[..., 0], axis=-1) + np.sum(
            h_R * (fit_R @ h_R[..., None])[..., 0], axis=-1
        )
        return h_L, h_R, np.maximum(cost, 0.0)

    T_R, T_t = T.R, T.t
    h_L, h_R, cost = evaluate(T_R, T_t, R_b, t_b)
    damping = 1e-6
    for _ in range(n_iterations):
        R_right = T_R @ R_b
        t_right = t_b @ T_R.T + T_t
        # Both are perturbed in the left frame: w, d of the board about its centre; then of T about the left origin
        J_L = _turned(pose_jacobian(turn_L @ R_b, frame.scale), turn_L)
        J_R = _turned(pose_jacobian(turn_R @ R_right, frame.scale), turn_R)
        J_Rb = np.concatenate([J_R[..., :3] @ T_R, J_R[..., 3:] @ T_R], axis=-1)
        J_T = np.concatenate([J_R[..., :3] - J_R[..., 3:] @ so3.hat(t_right - T_t), J_R[..., 3:]], axis=-1)
        F_L, F_R = fit_L @ J_L, fit_R @ J_Rb
        B = J_L.swapaxes(-1, -2) @ F_L + J_Rb.swapaxes(-1, -2) @ F_R
        B = B + (damping * np.einsum("...ii->...i", B))[..., None] * np.eye(6)
        E = F_R.swapaxes(-1, -2) @ J_T
        g_b = (F_L.swapaxes(-1, -2) @ h_L[..., None])[..., 0] + (F_R.swapaxes(-1, -2) @ h_R[..., None])[..., 0]
        F_T = fit_R @ J_T
        C = J_T.swapaxes(-1, -2) @ F_T
        g_T = (F_T.swapaxes(-1, -2) @ h_R[..., None])[..., 0]
        solved = np.linalg.solve(B, np.concatenate([E, g_b[..., None]], axis=-1))
        scale2 = max(1e-12, float(np.median(cost[agrees] / n_corners[agrees])))
        weight = np.where(agrees, 1 / (1 + cost / n_corners / (9 * scale2)), 0.0)[:, None, None]
        reduced = np.sum(weight * (C - E.swapaxes(-1, -2) @ solved[..., :6]), axis=0)
        gradient = np.sum(weight[..., 0] * (g_T - (E.swapaxes(-1, -2) @ solved[..., 6:])[..., 0]), axis=0)
        reduced += (1e-9 + damping) * np.diag(np.diag(reduced)) + 1e-300 * np.eye(6)
        step_T = -np.linalg.lstsq(reduced, gradient, rcond=None)[0]
        step_b = -(solved[..., 6] + solved[..., :6] @ step_T)
        step_b = step_b * np.minimum(1.0, 0.4 / np.maximum(np.linalg.norm(step_b[:, :3], axis=-1), 1e-300))[:, None]
        new_T = so3.exp(step_T[:3]) @ T_R
        candidate = (new_T, T_t + step_T[3:], so3.exp(step_b[:, :3]) @ R_b, t_b + step_b[:, 3:])
        h_L_new, h_R_new, cost_new = evaluate(*candidate)
        if np.sum(weight[:, 0, 0] * cost_new) > np.sum(weight[:, 0, 0] * cost) * (1 + 1e-9):
            damping = damping * 100 + 1e-4
            continue
        settled = np.sum(weight[:, 0, 0] * (cost - cost_new)) < 0.01 * np.sum(weight[:, 0, 0] * cost_new)
        keep = agrees | (cost_new < cost)
        T_R, T_t = candidate[0], candidate[1]
        R_b = np.where(keep[:, None, None], candidate[2], R_b)
        t_b = np.where(keep[:, None], candidate[3], t_b)
        if keep.all():
            h_L, h_R, cost = h_L_new, h_R_new, cost_new
        else:
            h_L, h_R, cost = evaluate(T_R, T_t, R_b, t_b)
        if settled:
            break
    return SE3(so3.project_to_rotation(T_R), T_t), R_b, t_b - R_b[..., :2] @ centre, np.sqrt(cost / n_corners / 2)


def _turned(J: Float[ndarray, "views 9 6"], turn: Float[ndarray, "views 3 3"]) -> Float[ndarray, "views 9 6"]:
    """Jacobian by motions expressed in the camera frame from one by motions in the turned frame."""
    return np.concatenate([J[..., :3] @ turn, J[..., 3:] @ turn], axis=-1)
