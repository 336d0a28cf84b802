"""The directories of a TIFF file: what they say of its images, without decoding a pixel. Source: TIFF 6.0, section 2."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4, 16: 8, 17: 8, 18: 8}
_FORMATS = {1: "B", 3: "H", 4: "I", 13: "I", 16: "Q", 18: "Q"}
SUBFILE, WIDTH, HEIGHT, BITS, COMPRESSION, ORIENTATION, SAMPLES = 254, 256, 257, 258, 259, 274, 277
STRIPS, STRIP_BYTES, TILES, TILE_BYTES = 273, 279, 324, 325
_WANTED = frozenset(
    (SUBFILE, WIDTH, HEIGHT, BITS, COMPRESSION, ORIENTATION, STRIPS, SAMPLES, STRIP_BYTES, TILES, TILE_BYTES)
)
_UNCOMPRESSED = 1
_REDUCED_OR_MASK = 0b101  # of SUBFILE: a smaller copy, or a mask, of another page
MOST_PAGES = 100_000  # a chain of directories that is longer leads in circles


@dataclass(frozen=True, slots=True)
class Tag:
    """The numbers of an entry, and where in the file the first of them stands."""

    numbers: tuple[int, ...]
    at: int
    format: str


@dataclass(frozen=True, slots=True)
class TiffFile:
    """A TIFF file's byte order (``<`` or ``>``) and kind, by its first bytes."""

    content: bytes
    order: str
    is_big: bool

    @staticmethod
    def of(content: bytes) -> TiffFile:
        """The file of these bytes, which :func:`binocal.images.containers.identify_container` calls TIFF."""
        return TiffFile(content, "<" if content[:1] == b"I" else ">", b"+" in content[2:4])

    def _read(self, code: str, at: int) -> int:
        return struct.unpack_from(self.order + code, self.content, at)[0]

    @property
    def _word(self) -> tuple[str, int]:
        return ("Q", 8) if self.is_big else ("I", 4)

    def first_directory(self) -> dict[int, Tag]:
        """The tags that matter here of the first page.

        Raises:
            struct.error: The directory, or what it points to, lies beyond the end of the file.
        """
        return self._directory(self._read(self._word[0], 8 if self.is_big else 4))[0]

    def _directory(self, at: int) -> tuple[dict[int, Tag], int]:
        """The wanted tags of the directory at an offset, and the offset of the next one, 0 after the last."""
        word, word_size = self._word
        n_entries = self._read("Q" if self.is_big else "H", at)
        at += 8 if self.is_big else 2
        entry_size = 20 if self.is_big else 12
        following = self._read(word, at + n_entries * entry_size) if n_entries * entry_size < len(self.content) else -1
        if following < 0:
            raise struct.error("a directory is longer than the file")
        tags: dict[int, Tag] = {}
        for entry in range(at, at + n_entries * entry_size, entry_size):
            tag, kind = struct.unpack_from(self.order + "HH", self.content, entry)
            if tag not in _WANTED or tag in tags or kind not in _FORMATS:
                continue
            count, value_at = self._read(word, entry + 4), entry + 4 + word_size
            if _SIZES[kind] * count > word_size:
                value_at = self._read(word, value_at)
            if value_at + _SIZES[kind] * count > len(self.content):
                raise struct.error("a tag points beyond the end of the file")
            code = _FORMATS[kind]
            tags[tag] = Tag(struct.unpack_from(f"{self.order}{count}{code}", self.content, value_at), value_at, code)
        return tags, following

    def pages(self) -> Iterator[dict[int, Tag]]:
        """The directories in their order, as far as the chain of them is sound."""
        at, seen = self._read(self._word[0], 8 if self.is_big else 4), set[int]()
        while at and at not in seen and len(seen) < MOST_PAGES:
            seen.add(at)
            try:
                tags, at = self._directory(at)
            except struct.error:
                return
            yield tags


def count_pages(content: bytes) -> int:
    """Images of a TIFF file; reduced copies and masks of one are none of their own."""
    pages = list(TiffFile.of(content).pages())
    return sum(1 for index, tags in enumerate(pages) if index == 0 or not _first(tags, SUBFILE, 0) & _REDUCED_OR_MASK)


def without_orientation(content: bytes) -> bytes:
    """The file with its first image's Orientation tag at 1, "as stored": OpenCV's decoder obeys the tag whatever it is told."""
    file = TiffFile.of(content)
    tag = file.first_directory().get(ORIENTATION)
    if tag is None or tag.numbers[:1] in ((), (1,)):
        return content
    changed = bytearray(content)
    struct.pack_into(file.order + tag.format, changed, tag.at, 1)
    return bytes(changed)


def tiff_problem(content: bytes, size_problem: Any) -> str:
    """What is wrong with the file's structure, as the end of a sentence about it; ``size_problem`` judges its size.

    Raises:
        struct.error: It is truncated.
    """
    tags = TiffFile.of(content).first_directory()
    width, height = _first(tags, WIDTH, 0), _first(tags, HEIGHT, 0)
    for offsets, counts in ((STRIPS, STRIP_BYTES), (TILES, TILE_BYTES)):
        if offsets in tags and counts in tags:
            ends = [at + length for at, length in zip(tags[offsets].numbers, tags[counts].numbers, strict=False)]
            if not ends or max(ends) > len(content):
                return "is a truncated TIFF file"
            bits_per_row = width * _first(tags, BITS, 1) * _first(tags, SAMPLES, 1)
            if _first(tags, COMPRESSION, 1) == _UNCOMPRESSED and sum(tags[counts].numbers) < bits_per_row * height // 8:
                return f"is a damaged TIFF file (it has not enough content for {width} x {height} pixels)"
            break
    # without byte counts (old writers) the decoder decides
    return size_problem(width, height)


def _first(tags: dict[int, Tag], tag: int, default: int) -> int:
    return tags[tag].numbers[0] if tag in tags and tags[tag].numbers else default
