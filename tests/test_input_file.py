"""What is read: ordinary files of a bounded size, and errors that name the others."""

from __future__ import annotations

import socket
import tracemalloc

import pytest

from binocal.errors import FormatError
from binocal.input_file import exists, read_file, read_text


def test_a_file_takes_the_memory_that_it_has_bytes(tmp_path):
    (tmp_path / "a").write_bytes(bytes(1 << 20))
    tracemalloc.start()
    assert len(read_file(tmp_path / "a")) == 1 << 20
    _, most_bytes = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most_bytes < 4 << 20


def test_a_file_beyond_the_bound_is_refused(tmp_path):
    for size in (1024, 1025):
        (tmp_path / "a").write_bytes(bytes(size))
        if size == 1024:
            assert len(read_file(tmp_path / "a", most_bytes=1024)) == 1024
        else:
            with pytest.raises(FormatError, match="larger than the 1 kB"):
                read_file(tmp_path / "a", most_bytes=1024)


def test_text_is_utf8_with_or_without_a_mark(tmp_path):
    (tmp_path / "a").write_bytes("\ufeffµ".encode())
    assert read_text(tmp_path / "a") == "µ"
    (tmp_path / "a").write_bytes(b"abc\xff")
    with pytest.raises(FormatError, match=r"not a text file in UTF-8 \(byte 3"):
        read_text(tmp_path / "a")


def test_what_is_no_ordinary_file_is_named(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with socket.socket(socket.AF_UNIX) as unix:
        unix.bind("s")
        for name, words in (("s", "a socket"), (".", "a folder"), ("/dev/null", "a device"), ("no", "no such file")):
            with pytest.raises(FormatError, match=words):
                read_file(name)
    with pytest.raises(FormatError, match="null"):
        read_file("a\0b")
    assert not exists("a\0b") and not exists("x" * 5000) and exists(".")
