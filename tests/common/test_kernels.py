"""Kernels are compiled functions, made without what they do not need."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numba

from mazebot.common.maths import kernel_loading


def test_a_kernel_computes_and_scipy_s_linear_algebra_is_neither_loaded_nor_lost() -> None:
    code = (
        "import sys\n"
        "from mazebot.localization.particle_filter import _systematic\n"
        "import numpy as np\n"
        "assert _systematic(np.array([0.0, 1.0, 0.0]), 0.5, 2).tolist() == [1, 1]\n"
        "assert 'scipy.linalg' not in sys.modules, 'loaded'\n"
        "import scipy.linalg.cython_blas\n"
        "assert scipy.linalg.norm([3.0, 4.0]) == 5.0\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=100)


_CALLEE = """
from mazebot.common.maths.kernels import kernel


@kernel("float64(float64)")
def twice(x: float) -> float:
    return 2.0 * x
"""
_CALLER = """
import sys
from pathlib import Path
from callee import twice
from mazebot.common.maths.kernels import kernel

assert twice(3.0) == 6.0
library = twice.compiled().overloads[twice.signatures[0]].library
assert library.is_parsed is bool(sys.argv[1:]), "is parsed"


@kernel("float64(float64)")
def thrice(x: float) -> float:
    return twice(x) + x


assert thrice(3.0) == 9.0
assert library.is_parsed, "is not parsed"
"""


def test_bitcode_of_a_loaded_kernel_is_parsed_when_a_kernel_that_calls_it_is_compiled(
    tmp_path: Path,
) -> None:
    (tmp_path / "callee.py").write_text(_CALLEE)
    environment = {
        **os.environ,
        "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
        "PYTHONPATH": os.pathsep.join((str(tmp_path), os.environ.get("PYTHONPATH", ""))),
    }
    for number, is_compiled_here in enumerate((["compiled"], [])):
        # Of another file each time: its own machine code is not in the cache.
        caller = tmp_path / f"caller_{number}.py"
        caller.write_text(_CALLER)
        run = [sys.executable, str(caller), *is_compiled_here]
        subprocess.run(run, check=True, timeout=100, env=environment, cwd=tmp_path)


def test_the_version_of_numba_that_is_locked_was_tried() -> None:
    assert numba.__version__.startswith(kernel_loading.TRIED_WITH)


def test_what_no_kernel_needs_is_neither_loaded_nor_lost() -> None:
    code = (
        "import sys\n"
        "from mazebot.common.maths.portable_kernels import cos_sin\n"
        "assert cos_sin(0.0) == (1.0, 0.0)\n"
        "assert 'cffi' not in sys.modules, 'loaded'\n"
        "import cffi\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=100)
