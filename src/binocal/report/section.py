"""What a section of a report consists of."""

from __future__ import annotations

from dataclasses import dataclass

from binocal.report.scene import RigScene
from binocal.report.svg import FigureSvg


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure with what stands below it."""

    figure: FigureSvg
    caption: str


@dataclass(frozen=True, slots=True)
class Table:
    """A table; the first column names the rows. Numbers are right-aligned from the column ``numbers_from`` on."""

    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""
    numbers_from: int = 1


@dataclass(frozen=True, slots=True)
class Notice:
    """Something found: its level (``good``, ``care``, ``bad``, or nothing), that in a word, what it is, and what to do."""

    level: str
    word: str
    title: str
    text: str
    remedy: str = ""
    code: str = ""


@dataclass(frozen=True, slots=True)
class Photo:
    """An image (a data address), what it shows in words, and what stands below it."""

    source: str
    alt: str
    caption: str


@dataclass(frozen=True, slots=True)
class ViewCard:
    """A view's pair of images: for each side its image (a data address), its size, corners as an SVG path, and outliers."""

    name: str
    text: str
    is_used: bool
    sides: tuple[tuple[str, str, tuple[int, int], str, tuple[tuple[int, int], ...]], ...]


@dataclass(frozen=True, slots=True)
class Section:
    """One section; ``anchor`` is its id in the page."""

    anchor: str
    title: str
    lead: str = ""
    pictures: tuple[Picture, ...] = ()
    tables: tuple[Table, ...] = ()
    notices: tuple[Notice, ...] = ()
    texts: tuple[str, ...] = ()
    steps: tuple[str, ...] = ()
    photos: tuple[Photo, ...] = ()
    cards: tuple[ViewCard, ...] = ()
    scene: RigScene | None = None
