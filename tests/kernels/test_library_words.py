"""What C code prints to stderr is caught for the thread that asks, and for no other."""

from __future__ import annotations

import ctypes
import platform
import sys
import threading

import pytest

from binocal.kernels.library_words import caught_words

pytestmark = pytest.mark.skipif(
    platform.libc_ver()[0] != "glibc", reason="the C library is not GNU's: nothing is caught"
)


def print_in_c(text):
    """As a C library does: to the stream that the variable ``stderr`` names at that moment."""
    libc = ctypes.CDLL(None)
    libc.fputs(text.encode(), ctypes.c_void_p.in_dll(libc, "stderr"))


def test_the_words_of_this_thread_are_caught_and_then_printed_again(capfd):
    with caught_words() as words:
        print_in_c("Corrupt JPEG data: bad\nand more\n")
        print("python's own", file=sys.stderr)
    assert words == ["Corrupt JPEG data: bad", "and more"]
    print_in_c("after\n")
    assert capfd.readouterr() == ("", "python's own\nafter\n")


def test_other_threads_keep_their_words_and_lose_none(capfd):
    n_threads, n_times = 8, 200
    caught, barrier = [[] for _ in range(n_threads)], threading.Barrier(2 * n_threads)

    def catch(i):
        barrier.wait()
        for _ in range(n_times):
            with caught_words() as words:
                print_in_c(f"caught {i}\n")
            caught[i] += words

    def speak(i):
        barrier.wait()
        for _ in range(n_times):
            print_in_c(f"spoken {i}\n")

    threads = [threading.Thread(target=f, args=(i,)) for i in range(n_threads) for f in (catch, speak)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert caught == [[f"caught {i}"] * n_times for i in range(n_threads)]
    spoken = capfd.readouterr().err.splitlines()
    assert sorted(spoken) == sorted(f"spoken {i}" for i in range(n_threads) for _ in range(n_times))


def test_an_error_inside_gives_the_stream_back(capfd):
    with pytest.raises(ZeroDivisionError), caught_words():
        raise ZeroDivisionError
    print_in_c("heard\n")
    assert capfd.readouterr().err == "heard\n"
