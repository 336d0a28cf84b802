from __future__ import annotations

import errno
import os
import resource
import stat

import pytest

from binocal import output
from binocal.errors import DataError, OutputError, OutputExistsError


def test_writes_and_leaves_no_second_file(tmp_path):
    target = tmp_path / "new" / "rig.json"
    output.write_aside(target, "{}")
    assert target.read_text() == "{}" and os.listdir(target.parent) == ["rig.json"]
    (tmp_path / "plain").touch()
    assert stat.S_IMODE(target.stat().st_mode) == stat.S_IMODE((tmp_path / "plain").stat().st_mode)


def test_refuses_to_overwrite_without_force(tmp_path):
    target = tmp_path / "rig.json"
    target.write_text("old")
    with pytest.raises(OutputExistsError, match="--force") as caught:
        output.write_aside(target, "new")
    assert isinstance(caught.value, FileExistsError) and target.read_text() == "old"
    output.write_aside(target, "new", force=True)
    assert target.read_text() == "new"


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    target = tmp_path / "rig.json"
    target.write_text("old")

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(DataError, match="No space left"):
        output.write_aside(target, "new", force=True)
    assert target.read_text() == "old" and os.listdir(tmp_path) == ["rig.json"]


def test_a_folder_or_a_file_in_the_way_is_named(tmp_path):
    with pytest.raises(DataError, match="is a folder"):
        output.check_output(tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="folder cannot be made"):
        output.check_output(tmp_path / "file" / "rig.json")


def test_several_files_are_written_together_or_not_at_all(tmp_path, monkeypatch):
    (tmp_path / "a").write_text("old")
    output.write_together({tmp_path / "a": "new", tmp_path / "b": b"new"}, force=True)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"a": "new", "b": "new"}
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limit[1]))
    try:
        with pytest.raises(OutputError, match=r"b: cannot be written: File too large") as caught:
            output.write_together({tmp_path / "a": "newer", tmp_path / "b": bytes(2000)}, force=True)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    assert isinstance(caught.value, DataError)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"a": "new", "b": "new"}


def test_what_a_killed_process_left_is_removed_and_what_a_living_one_writes_is_not(tmp_path):
    for name in (".rig.json.0123abcd.part", ".rig.json.mine", ".other.json.0123abcd.part"):
        (tmp_path / name).write_text("half")
    (tmp_path / ".set.0123abcd.part").mkdir()
    (tmp_path / ".set.0123abcd.part" / "left_00.png").write_text("half")
    with output.staged_folder(tmp_path / "set") as living:
        output.write_aside(tmp_path / "rig.json", "whole")
        with output.staged_folder(tmp_path / "set", force=True):
            assert living.is_dir()
    assert sorted(os.listdir(tmp_path)) == [".other.json.0123abcd.part", ".rig.json.mine", "rig.json", "set"]


def fill(folder, names, text):
    for name in names:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text)


def content(folder):
    return {path.relative_to(folder).as_posix(): path.read_text() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("can_exchange", [True, False])
@pytest.mark.parametrize("others", [(), ("notes.txt", "more/notes.txt")])
def test_a_new_folder_takes_the_place_of_the_old_and_leaves_other_files(tmp_path, monkeypatch, can_exchange, others):
    if not can_exchange:
        monkeypatch.setattr(output, "_exchange", lambda *_: False)
    place = tmp_path / "set"
    place.mkdir()
    fill(place, ["0.png", "9.png", "a/truth.json", *others], "old")
    with output.staged_folder(place, force=True, former=lambda _: {"0.png", "9.png"}, last=["truth.json"]) as aside:
        fill(aside, ["0.png", "1.png", "a/truth.json"], "new")
    assert content(place) == dict.fromkeys(["0.png", "1.png", "a/truth.json"], "new") | dict.fromkeys(others, "old")
    assert os.listdir(tmp_path) == ["set"]


def test_where_files_are_moved_one_by_one_the_mark_is_never_beside_others_of_another_run(tmp_path, monkeypatch):
    monkeypatch.setattr(output, "_exchange", lambda *_: False)
    place, names = tmp_path / "set", ["0.png", "1.png", "truth.json"]
    seen, replace = [], os.replace

    def watched(source, target):
        seen.append(content(place))
        replace(source, target)

    place.mkdir()
    fill(place, names, "old")
    monkeypatch.setattr(os, "replace", watched)
    with output.staged_folder(place, force=True, last=["truth.json"]) as aside:
        fill(aside, names, "new")
    assert len(seen) == 3 and all("truth.json" not in now for now in seen)
    assert content(place) == dict.fromkeys(names, "new")


def test_the_working_folder_does_not_vanish_under_its_shell(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "0.png").write_text("old")
    inode = os.stat(".").st_ino
    with output.staged_folder(".", force=True) as aside:
        (aside / "0.png").write_text("new")
    assert os.stat(tmp_path).st_ino == inode and (tmp_path / "0.png").read_text() == "new"


def test_a_block_that_fails_leaves_the_folder_as_it_was(tmp_path):
    place = tmp_path / "set"
    place.mkdir()
    fill(place, ["0.png"], "old")
    with pytest.raises(KeyboardInterrupt), output.staged_folder(place, force=True) as aside:
        fill(aside, ["0.png"], "new")
        raise KeyboardInterrupt
    assert content(place) == {"0.png": "old"} and os.listdir(tmp_path) == ["set"]


def test_a_file_of_the_folder_that_cannot_be_written_is_named_by_its_place(tmp_path):
    with pytest.raises(OutputError) as caught, output.staged_folder(tmp_path / "set") as aside:
        output.write_part(aside / "none" / "0.png", b"")
    assert str(tmp_path / "set" / "none" / "0.png") in str(caught.value) and os.listdir(tmp_path) == []


@pytest.mark.parametrize("check", [output.check_output, output.check_output_folder])
def test_a_name_that_no_file_can_have_is_one_line(tmp_path, check):
    with pytest.raises(DataError, match="name too long") as caught:
        check(tmp_path / ("x" * 300))
    assert len(str(caught.value)) < 300
    with pytest.raises(DataError, match="null"):
        check("a\0b")


def test_a_pipe_is_no_output(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(DataError, match="pipe or a device"):
        output.check_output(tmp_path / "pipe", force=True)


@pytest.mark.skipif(not os.path.exists("/dev/stdin"), reason="the system has no /dev")
def test_links_of_the_system_are_never_replaced():
    """With stdout on a file ``--output /dev/stdout --force`` put the result in the link's place."""
    with pytest.raises(DataError, match="is a pipe or a device"):
        output.check_output("/dev/stdin", force=True)
    with pytest.raises(DataError, match="is a pipe or a device"):
        output.check_output("/proc/self/status", force=True)


def test_a_link_is_followed_and_stays(tmp_path):
    (tmp_path / "store").mkdir()
    link, target = tmp_path / "rig.json", tmp_path / "store" / "today.json"
    link.symlink_to(target)
    output.write_aside(link, "first")  # what it names is not there yet
    with pytest.raises(OutputExistsError):
        output.write_aside(link, "second")
    output.write_aside(link, "second", force=True)
    assert link.is_symlink() and target.read_text() == "second" and not target.is_symlink()
    assert sorted(path.name for path in (tmp_path / "store").iterdir()) == ["today.json"]


def test_a_link_that_leads_nowhere_is_named(tmp_path):
    (tmp_path / "broken").symlink_to(tmp_path / "gone" / "rig.json")
    (tmp_path / "round").symlink_to("round")
    with pytest.raises(DataError, match=r"is a link to .*whose folder is missing"):
        output.write_aside(tmp_path / "broken", "text")
    with pytest.raises(DataError, match="round: cannot be a file"):
        output.write_aside(tmp_path / "round", "text", force=True)
    assert not (tmp_path / "gone").exists()


def test_a_failure_leaves_no_folder(tmp_path, monkeypatch):
    output.check_output(tmp_path / "a" / "rig.json")
    output.check_output_folder(tmp_path / "b" / "out")
    assert not list(tmp_path.iterdir())  # to ask makes nothing

    def refuse(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(OutputError, match="No space left"):
        output.write_together({tmp_path / "new" / "deep" / "rig.json": "text", tmp_path / "other.json": "text"})
    assert not list(tmp_path.iterdir())
