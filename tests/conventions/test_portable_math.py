"""What feeds the state of a simulation uses nothing whose last bits the processor chooses."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from mazebot.common.files.root import ROOT

SERVICES = ROOT / "services" / "mazebot"
PACKAGES = (
    "common",
    "worldgen",
    "physics",
    "spawner",
    "perception",
    "localization",
    "mapping",
    "navigation",
    "explorer",
    "bringup",
)
EXEMPT = {
    "common/maths/portable.py": "it is what the others use",
    "common/recordings": "reads and draws what has been recorded",
    "physics/camera/gl_camera.py": "draws on a GPU, whose pixels are its own",
    "physics/camera/tiny_camera.py": "draws with PyBullet's own renderer, for comparison",
    "worldgen/map/disagreement.py": "says how well a map fits, and changes nothing",
    "worldgen/preview.py": "draws worlds for people",
    "worldgen/plan_bodies.py": "draws worlds for people",
    "worldgen/world_model.py": "draws worlds for people",
    "worldgen/assets/textures.py": "made the textures that are shipped as pictures",
    "worldgen/sdf": "writes a recipe, which is the world from then on",
}
MATH = {
    *("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "asinh"),
    *("acosh", "atanh", "exp", "exp2", "expm1", "log", "log1p", "log2", "log10", "pow", "cbrt"),
    *("erf", "erfc", "gamma", "lgamma"),
}
NUMPY = MATH | {
    *("arcsin", "arccos", "arctan", "arctan2", "arcsinh", "arccosh", "arctanh", "hypot", "power"),
    *("float_power", "logaddexp", "dot", "vdot", "inner", "matmul", "tensordot", "convolve"),
    *("correlate", "cov", "corrcoef", "polyfit", "linalg", "fft", "argpartition"),
}
DRAWN = {"standard_normal", "normal", "exponential", "standard_exponential", "gamma", "poisson"}
STABLE = {"stable", "mergesort"}
COMPILED = {"kernel", "shared_kernel", "elementwise", "c_function"}
POSES = {
    "common/world/footprint.py": 1,
    "common/world/marker_file.py": 1,
    "common/world/placement.py": 1,
    "common/messages/messages.py": 1,
    "common/robot/frozen_scans.py": 3,
    "common/robot/wheel_slip.py": 13,
    "localization/beam_model.py": 2,
    "localization/global_search/global_search.py": 4,
    "localization/global_search/hypotheses.py": 3,
    "localization/likelihood_field.py": 1,
    "localization/messages.py": 1,
    "localization/monte_carlo.py": 22,
    "localization/node.py": 3,
    "mapping/kernels.py": 1,
    "mapping/graph/landmarks.py": 4,
    "mapping/loops/carried_off.py": 4,
    "mapping/loops/loop_closer.py": 3,
    "mapping/loops/loop_closing.py": 2,
    "mapping/matching/scan_points.py": 1,
    "mapping/node.py": 1,
    "mapping/matching/occupancy.py": 6,
    "mapping/graph/optimizer.py": 2,
    "mapping/slam.py": 17,
    "navigation/control/mppi/mppi.py": 1,
    "navigation/control/yielding/giving_way.py": 2,
    "navigation/control/yielding/newcomers.py": 1,
    "navigation/robot/narrow_gaps.py": 1,
    "navigation/control/mppi/mppi_kernels.py": 2,
    "localization/particle_set.py": 1,
    "localization/pose_monitor.py": 3,
    "navigation/control/regulated_pure_pursuit.py": 1,
    "navigation/behavior/context.py": 2,
    "navigation/behavior/docking/docking.py": 11,
    "navigation/behavior/docking/docks.py": 2,
    "navigation/behavior/nodes/nodes_behaviors.py": 4,
    "navigation/costmap/layered_costmap.py": 1,
    "navigation/drive.py": 7,
    "navigation/robot/hidden.py": 1,
    "navigation/robot/measurements.py": 5,
    "navigation/robot/planner_server.py": 1,
    "physics/bodies/bodies.py": 2,
    "physics/sensors/odometry.py": 1,
    "worldgen/difficulty.py": 1,
    "worldgen/map/occupancy.py": 1,
    "worldgen/markers/visibility.py": 2,
}
"""Where `@` joins poses (SE2, SE3), and how often: of arrays it is BLAS."""
SPARSE = {"worldgen/markers/marker_cover.py": 3}
"""Where it multiplies whole numbers, in sparse matrices."""


def sources() -> Iterator[tuple[str, Path]]:
    """Package and name of each file, whatever folder between the two holds it."""
    for package in PACKAGES:
        for path in sorted((SERVICES / package).rglob("*.py")):
            folder = path.relative_to(SERVICES / package).parts[0]
            name = str(path.relative_to(SERVICES))
            if name not in EXEMPT and f"{package}/{folder}" not in EXEMPT:
                yield name, path


def dotted(node: ast.AST) -> str:
    """`a.b.c` of what is written so; empty of all else."""
    if isinstance(node, ast.Attribute):
        of = dotted(node.value)
        return f"{of}.{node.attr}" if of else ""
    return node.id if isinstance(node, ast.Name) else ""


def mistakes(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Line and what is wrong there."""
    hypots = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
        and any(dotted(getattr(one, "func", one)) in COMPILED for one in node.decorator_list)
        for inner in ast.walk(node)
        if dotted(inner) in ("math.hypot", "math.dist")
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute):
            name, of = node.attr, dotted(node.value)
            if of == "math" and name in MATH:
                yield node.lineno, f"math.{name} is the C library's: portable.{name}"
            elif of == "np" and name in NUMPY:
                yield node.lineno, f"np.{name}: see services/mazebot/common/maths/portable.py"
            elif name == "Rodrigues" or (name == "dot" and of != "np"):
                yield node.lineno, f"{name}: see services/mazebot/common/maths/portable.py"
            elif id(node) in hypots:
                yield node.lineno, "in a kernel it is the C library's: math.sqrt of the squares"
        elif isinstance(node, ast.ImportFrom) and node.module in (
            "math",
            "numpy.linalg",
            "scipy.linalg",
        ):
            yield node.lineno, f"import {node.module} itself, so that this test sees what is used"
        elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow):
            if not (isinstance(node.left, ast.Constant) and isinstance(node.right, ast.Constant)):
                yield node.lineno, "** of numbers is the C library's power: portable.square"
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            name, of = node.func.attr, dotted(node.func.value)
            if name in DRAWN and of not in ("math", "portable_kernels"):
                yield node.lineno, f"{name}: portable_kernels.standard_normal"
            if name == "argsort" and not any(
                word.arg == "kind" and getattr(word.value, "value", None) in STABLE
                for word in node.keywords
            ):
                yield node.lineno, 'argsort: kind="stable", or equals come in an order by processor'


def test_nothing_on_the_states_path_is_the_processors() -> None:
    found = []
    for name, path in sources():
        tree = ast.parse(path.read_text().replace("np.linalg.LinAlgError", "LinAlgError"))
        found += [f"{path}:{line}: {what}" for line, what in mistakes(tree)]
        joined = sum(
            isinstance(node, ast.BinOp | ast.AugAssign) and isinstance(node.op, ast.MatMult)
            for node in ast.walk(tree)
        )
        expected = POSES.get(name, 0) + SPARSE.get(name, 0)
        if joined != expected:
            found.append(
                f"{path}: {joined} times `@`, not {expected}: of arrays it is BLAS, and should be "
                "portable.product; of poses, count it in POSES of this test"
            )
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    "mistake",
    [
        *("y = math.sin(x)", "y = np.exp(x)", "y = np.linalg.norm(x)", "y = a.dot(b)", "y = x**2"),
        *("y = rng.standard_normal(3)", "y = np.argsort(x)", "y = x.argsort()"),
        *("from math import sin", "y = cv2.Rodrigues(x)"),
        "@kernel()\ndef f(x):\n    return math.hypot(x, x)",
    ],
)
def test_what_the_processor_chooses_is_found(mistake: str) -> None:
    assert len(list(mistakes(ast.parse(mistake)))) == 1


@pytest.mark.parametrize(
    "right",
    ["y = math.sqrt(x)", "y = portable.sin(x)", "y = 2**10", 'y = np.argsort(x, kind="stable")',
     "y = math.hypot(x, x)", "y = portable_kernels.standard_normal(rng, 3)"],
)  # fmt: skip
def test_what_every_processor_rounds_alike_is_let_through(right: str) -> None:
    assert not list(mistakes(ast.parse(right)))
