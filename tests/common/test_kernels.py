"""Kernels are compiled functions, made without what they do not need."""

from __future__ import annotations

import subprocess
import sys


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
