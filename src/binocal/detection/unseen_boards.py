"""What to say of a set of images in most of which the board was not found: the likeliest cause first."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from binocal.boards import Board
from binocal.detection.found import FoundBoard
from binocal.detection.hints import count_signs, hint_from_images
from binocal.findings import finding, refusal

SEVERAL_SHARE = 0.5  # of the images: with fewer, those that show several boards are left out, as one may stand about
OTHER_SHARE = 0.1  # of those with the board, that show its markers beyond it: chance shows them in none
FEW_FOUND = 0.2  # of the images: so few may be chance where the others that are looked at again agree on another board


@dataclass(frozen=True, slots=True, eq=False)
class LookedAt:
    """One image that was looked at: what was found, or why it could not be read."""

    side: str
    path: Path
    found: FoundBoard | None
    problem: str = ""

    @property
    def reason(self) -> str:
        """Why the board was not found; empty where it was."""
        return self.problem if self.found is None else self.found.reason


def require_board(images: Sequence[LookedAt], board: Board, least_pairs: int) -> None:
    """Refuse images that show no board, another one, several, none in one camera, or too few in both; they come pair by pair.

    Raises:
        DetectionError: So it is; ``reasons`` says why for each image.
    """
    looked = [(image.path, image.found) for image in images if image.found is not None]
    left, right = images[0::2], images[1::2]
    n_seen = {"left": _count(left), "right": _count(right)}
    n_found, n_pairs = n_seen["left"] + n_seen["right"], len(left)
    n_both = sum(not (a.reason or b.reason) for a, b in zip(left, right, strict=True))
    spec = f"{board.kind}:{board.columns}x{board.rows}"
    common: dict[str, Any] = {"board": spec, "n_images": len(images), "n_pairs": n_pairs}
    n_several = sum(found.is_among_several for _, found in looked)
    if n_several and n_several >= SEVERAL_SHARE * len(looked):
        raise refusal(finding("several-boards", n_several=n_several, **common), _reasons(images))
    _require_no_other(looked, n_found, common, images)
    is_few = 0 in n_seen.values() or n_found < FEW_FOUND * len(looked)
    is_doubtful = is_few or 2 * n_found < len(looked) or count_signs(looked) > n_found
    hint = hint_from_images(looked, board) if is_doubtful else None
    if hint is not None and (not n_found or hint.n_other > n_found or (is_few and hint.n_other == hint.n_tried)):
        counts = {"n_found": n_found, "n_other": hint.n_other, "n_tried": hint.n_tried}
        raise refusal(finding(hint.code, remedy=hint.remedy, **hint.figures, **counts, **common), _reasons(images))
    if not n_found:
        _refuse("board-not-found", images, **common)
    for blind, other, unseen in (("left", "right", left), ("right", "left", right)):
        if not n_seen[blind] and any(image.found for image in unseen):
            _refuse("board-in-one-camera-only", unseen, camera=blind, other=other, n_found=n_seen[other], **common)
    if n_both < least_pairs <= n_pairs:
        counts = {"n_left": n_seen["left"], "n_right": n_seen["right"], "n_both": n_both, "n_needed": least_pairs}
        _refuse("board-in-too-few-pairs", images, **counts, **common)


def _require_no_other(
    looked: Sequence[tuple[Path, FoundBoard]], n_found: int, common: Mapping[str, Any], images: Sequence[LookedAt]
) -> None:
    """Refuse a marker board that goes on beyond the SPEC's in some images: where it is cut off it seems to be the SPEC's."""
    others = [(path, found) for path, found in looked if found.spec_seen]
    if not others or len(others) < OTHER_SHARE * (n_found + len(others)):
        return
    specs = Counter(found.spec_seen for _, found in others if found.spec_seen != "?")
    spec = specs.most_common(1)[0][0] if specs else ""
    path, first = next(each for each in others if not spec or each[1].spec_seen == spec)
    remedy = f"did you mean {spec}?" if spec else "check the SPEC's size and first id"
    figures = {"what": f"that {first.reason.partition(';')[0]} ({path.name})", "n_found": n_found}
    figures |= {"n_other": len(others), "n_tried": len(looked)}
    raise refusal(finding("board-is-another", remedy=remedy, **figures, **common), _reasons(images))


def _refuse(code: str, images: Sequence[LookedAt], **figures: Any) -> None:
    """Raises DetectionError of that code: the commonest reason, in how many images, and what to do."""
    why = Counter(image.reason for image in images if image.reason)
    reason, n_reason = why.most_common(1)[0]
    first = next(image for image in images if image.reason == reason)
    text, _, advice = reason.partition("; ")
    found = finding(
        code,
        remedy=advice or None,
        reason=text,
        n_reason=n_reason,
        first=first.path.name if first.side in first.path.name else f"{first.side} {first.path.name}",
        **figures,
    )
    raise refusal(found, _reasons(images))


def _count(images: Sequence[LookedAt]) -> int:
    return sum(not image.reason for image in images)


def _reasons(images: Sequence[LookedAt]) -> Mapping[str, str]:
    """Why, by the image's name; with its side where both cameras' files have the same names."""
    names = Counter(image.path.name for image in images)
    return {
        image.path.name if names[image.path.name] == 1 else f"{image.side} {image.path.name}": image.reason
        for image in images
        if image.reason
    }
