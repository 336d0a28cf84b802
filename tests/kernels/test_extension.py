"""The extension's interface: its stub for type checkers, its errors, and what happens in its threads."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

from binocal import kernels
from binocal.kernels import _kernel


def test_the_stub_names_what_the_extension_has():
    stub = ast.parse(Path(kernels.__file__).with_name("_kernel.pyi").read_text(encoding="utf-8"))
    named = {node.name for node in stub.body if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    named |= {
        node.target.id for node in stub.body if isinstance(node, ast.AnnAssign) and "TypeAlias" not in ast.dump(node)
    }
    assert named == {name for name in dir(_kernel) if not name.startswith("_")}


OUT_OF_MEMORY = """
import resource
import numpy as np
import binocal
from binocal.kernels import accumulate

binocal.set_threads(2)
views, n = 2, 400_000  # a thread's columns take 134 MB
parameters = np.array([800.0, 800, 320, 240, 0, 0, 0, 0, 0])
R, t = np.broadcast_to(np.eye(3), (views, 3, 3)), np.tile([0.0, 0, 1], (views, 1))
arrays = R, t, np.zeros((3, n)), np.zeros((views, 2, n)), np.ones((views, n), bool)
with open("/proc/self/statm") as file:
    now = int(file.read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (now + 100_000_000, resource.RLIM_INFINITY))
try:
    accumulate("brown4", parameters, *arrays, np.asarray(1.0), "hampel")
except MemoryError:
    print("raised")
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits the memory of a process as Linux does")
@pytest.mark.skipif("asan" in os.environ.get("LD_PRELOAD", ""), reason="AddressSanitizer reserves all memory")
def test_an_exception_in_a_worker_thread_is_an_exception_in_python():
    # without in_parallel's care it ends the process by std::terminate
    done = subprocess.run([sys.executable, "-c", OUT_OF_MEMORY], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "raised\n"), done.stderr
