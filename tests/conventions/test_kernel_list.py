"""A kernel that Python calls is in the list of those that are compiled in advance, however rarely
it is called: the others would be compiled while a robot drives.
"""

import ast
from collections.abc import Iterator

import pytest

from mazebot.common.files.root import ROOT
from mazebot.common.garbage import collections_held_off
from mazebot.embedded.kernel_list import listed

SERVICES = ROOT / "services"
COMPILED = {"kernel", "shared_kernel", "elementwise", "c_function"}
BENCH = "mazebot.bench"
Found = tuple[str, str]
"""Module and name of a kernel."""


def sources() -> dict[str, ast.Module]:
    """The modules of all services, without the benchmarks."""
    names = {
        ".".join(file.relative_to(SERVICES).with_suffix("").parts): file
        for file in SERVICES.rglob("*.py")
    }
    return {
        name: ast.parse(file.read_text())
        for name, file in names.items()
        if not name.startswith(BENCH)
    }


def is_kernel(node: ast.AST) -> bool:
    if not isinstance(node, ast.FunctionDef):
        return False
    names = {ast.unparse(one).split("(")[0] for one in node.decorator_list}
    return bool(names & COMPILED)


def kernels_of(modules: dict[str, ast.Module]) -> set[Found]:
    return {
        (module, node.name)
        for module, tree in modules.items()
        for node in tree.body
        if isinstance(node, ast.FunctionDef) and is_kernel(node)
    }


def calls_of(module: str, tree: ast.Module, kernels: set[Found]) -> Iterator[Found]:
    """The kernels that a module calls outside kernels."""
    homes = {where for where, _ in kernels}
    known = {name: (where, name) for where, name in kernels if where == module}
    modules: dict[str, str] = {}
    for node in tree.body:
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            for one in node.names:
                if (node.module, one.name) in kernels:
                    known[one.asname or one.name] = (node.module, one.name)
                if f"{node.module}.{one.name}" in homes:
                    modules[one.asname or one.name] = f"{node.module}.{one.name}"

    def called(node: ast.AST) -> Iterator[Found]:
        for inner in ast.iter_child_nodes(node):
            if is_kernel(inner):
                continue
            if isinstance(inner, ast.Call):
                match inner.func:
                    case ast.Name(name) if name in known:
                        yield known[name]
                    case ast.Attribute(ast.Name(of), name) if of in modules:
                        yield modules[of], name
            yield from called(inner)

    return (one for one in called(tree) if one in kernels) if known or modules else iter(())


def unlisted(modules: dict[str, ast.Module]) -> set[Found]:
    kernels = kernels_of(modules)
    known = {(one.module, one.name) for one in listed()}
    return {
        found for module, tree in modules.items() for found in calls_of(module, tree, kernels)
    } - known


def test_each_kernel_that_python_calls_is_listed() -> None:
    # Of the millions of nodes none is garbage, and to look for it takes longer than to parse.
    with collections_held_off():
        modules = sources()
    assert len(kernels_of(modules)) > 200
    assert unlisted(modules) == set(), "a warm-up has to call it; then make generate"


@pytest.mark.parametrize(
    "call",
    [
        "from mazebot.one import fast\n\ndef f():\n    return [fast(1)]",
        "from mazebot.one import fast as quick\n\ndef f(x=quick(1)): ...",
        "from mazebot import one\n\nclass A:\n    def f(self):\n        one.fast(1)",
    ],
)
def test_calls_are_found(call: str) -> None:
    kernel = "@kernel()\ndef fast(x): ...\n\n@shared_kernel(inline=True)\ndef g(x):\n    fast(x)"
    modules = {"mazebot.one": ast.parse(kernel), "mazebot.two": ast.parse(call)}
    assert unlisted(modules) == {("mazebot.one", "fast")}
    del modules["mazebot.two"]
    assert unlisted(modules) == set()
