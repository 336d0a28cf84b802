"""Damaged copies of files, the same for the same seed: bytes flipped, cut out, doubled; numbers and structure of texts made absurd."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator

import numpy as np

Mutator = Callable[[bytes, np.random.Generator], bytes]

_NUMBER = re.compile(rb"-?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
_LINE = re.compile(rb"[^\n]*\n?")
ABSURD = (
    *(
        b"0",
        b"-1",
        b"1e300",
        b"1e-300",
        b"1e400",
        b"-.inf",
        b".inf",
        b".nan",
        b"NaN",
        b"Infinity",
        b"6.9",
        b"4294967297",
    ),
    *(
        b"1" + b"0" * 400,
        b"9" * 5000,
        b"null",
        b"true",
        b'""',
        b'"x"',
        b"[]",
        b"{}",
        b"[" * 2000,
        b"[[[1]]]",
        b"{'a': 1}",
    ),
    *(b"*a", b"&a [1, 2]", b"!!int ''", b"!!python/name:os.system", b"\xff\xfe", b"\0", b"2001-99-99", b"0x", b"1:1:1"),
)
SPECIAL_BYTES = (0x00, 0x01, 0x7F, 0x80, 0xD9, 0xFE, 0xFF)


def mutations(content: bytes, n: int, seed: int, *, is_text: bool) -> Iterator[bytes]:
    """``n`` damaged copies, each by one to three mutations."""
    rng = np.random.default_rng(seed)
    mutators = [*BINARY, *(TEXT * 2 if is_text else ())]
    for _ in range(n):
        changed = content
        for _ in range(rng.integers(1, 4)):
            changed = mutators[rng.integers(len(mutators))](changed, rng)
        yield changed


def _span(content: bytes, rng: np.random.Generator, most: int = 1 << 30) -> tuple[int, int]:
    """The begin and end of a piece."""
    begin = int(rng.integers(len(content) + 1))
    return begin, min(len(content), begin + int(rng.integers(1, 1 + min(most, max(1, len(content))))))


def flip_bits(content: bytes, rng: np.random.Generator) -> bytes:
    changed = bytearray(content)
    for at in rng.integers(max(1, len(changed)), size=rng.integers(1, 9)) if changed else ():
        changed[at] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def damage_header(content: bytes, rng: np.random.Generator) -> bytes:
    """Special bytes near the beginning, where sizes and counts stand."""
    changed = bytearray(content)
    for at in rng.integers(max(1, min(len(changed), 160)), size=rng.integers(1, 5)) if changed else ():
        changed[at] = SPECIAL_BYTES[rng.integers(len(SPECIAL_BYTES))]
    return bytes(changed)


def truncate(content: bytes, rng: np.random.Generator) -> bytes:
    return content[: int(rng.integers(len(content) + 1))]


def cut_out(content: bytes, rng: np.random.Generator) -> bytes:
    begin, end = _span(content, rng, 4096)
    return content[:begin] + content[end:]


def double(content: bytes, rng: np.random.Generator) -> bytes:
    begin, end = _span(content, rng, 4096)
    return content[:end] + content[begin:end] * int(rng.integers(1, 20)) + content[end:]


def insert_run(content: bytes, rng: np.random.Generator) -> bytes:
    at, byte = int(rng.integers(len(content) + 1)), SPECIAL_BYTES[rng.integers(len(SPECIAL_BYTES))]
    return content[:at] + bytes([byte]) * int(10 ** rng.uniform(0, 5)) + content[at:]


def overwrite(content: bytes, rng: np.random.Generator) -> bytes:
    begin, end = _span(content, rng, 64)
    return content[:begin] + rng.bytes(end - begin) + content[end:]


def absurd_number(content: bytes, rng: np.random.Generator) -> bytes:
    found = list(_NUMBER.finditer(content))
    if not found:
        return content
    match = found[rng.integers(len(found))]
    return content[: match.start()] + ABSURD[rng.integers(len(ABSURD))] + content[match.end() :]


def absurd_line(content: bytes, rng: np.random.Generator) -> bytes:
    """A line left out, doubled, indented, or put elsewhere."""
    lines = _LINE.findall(content)[:-1] or [content]
    at, other = rng.integers(len(lines), size=2)
    match rng.integers(4):
        case 0:
            del lines[at]
        case 1:
            lines.insert(at, lines[at])
        case 2:
            lines[at] = b"   " + lines[at]
        case _:
            lines[at], lines[other] = lines[other], lines[at]
    return b"".join(lines)


def insert_absurd(content: bytes, rng: np.random.Generator) -> bytes:
    at = int(rng.integers(len(content) + 1))
    return content[:at] + ABSURD[rng.integers(len(ABSURD))] + content[at:]


BINARY: tuple[Mutator, ...] = (flip_bits, damage_header, truncate, cut_out, double, insert_run, overwrite)
TEXT: tuple[Mutator, ...] = (absurd_number, absurd_number, absurd_line, insert_absurd)
