"""The process that runs xacro: with limited time, memory and file access."""

from __future__ import annotations

import ast
import codecs
import io
import json
import resource
import sys
from pathlib import Path
from typing import Any

import xacro
from xacro import substitution_args

from mazebot.worldgen.sdf.files.locate import Locator
from mazebot.worldgen.sdf.files.xml_text import MAX_FILE_BYTES, UnreadableError, bytes_of
from mazebot.worldgen.xml_comments import without_comments

MAX_CPU_SECONDS = 2
MAX_MEMORY_BYTES = 1024 * 1024 * 1024
MAX_FILES = 1000

_INSIDES = ("_", "gi_", "cr_", "ag_", "f_", "tb_", "co_", "func_", "mro")
"""Prefixes of attributes that give access to the interpreter."""


def main() -> None:
    """Expand the file named on stdin, and reply on stdout."""
    work = json.loads(sys.stdin.buffer.read())
    answer = sys.stdout
    sys.stdout = sys.stderr = io.StringIO()
    resource.setrlimit(resource.RLIMIT_CPU, (MAX_CPU_SECONDS, MAX_CPU_SECONDS))
    resource.setrlimit(resource.RLIMIT_AS, (MAX_MEMORY_BYTES, MAX_MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
    locator = Locator(Path(work["first"]), [Path(root) for root in work["roots"]])
    _restrict(locator)
    text, error = "", ""
    try:
        xacro.init_stacks(work["file"])
        document = xacro.parse(None, work["file"])
        xacro.process_doc(document, mappings=dict(work["arguments"]))
        text = document.toprettyxml(indent=" ")
        if len(text) > MAX_FILE_BYTES:
            text, error = "", f"makes {len(text)} characters, must be at most {MAX_FILE_BYTES}"
    except MemoryError:
        error = "xacro exceeded its memory limit"
    except RecursionError:
        error = "macros or includes are nested too deep"
    except Exception as problem:
        error = " ".join(str(problem).split())[:300] or type(problem).__name__
        if error.startswith("Undefined substitution argument "):
            error += ": give it with `--arg NAME:=VALUE`"
    answer.write(json.dumps({"text": text, "error": error}))


def _restrict(locator: Locator) -> None:
    """Replace xacro's access to files, environment and interpreter by checked versions."""
    read = 0

    def checked_open(name: str) -> io.BytesIO:
        nonlocal read
        read += 1
        path = Path(name)
        if not locator.may_read(path):
            raise xacro.XacroException(
                f"{path.name} lies outside the file's folder and the path: put its folder on the "
                "path (`--path DIR` or GZ_SIM_RESOURCE_PATH)"
            )
        if read > MAX_FILES:
            raise xacro.XacroException(f"more than {MAX_FILES} files")
        if not path.exists():
            raise FileNotFoundError(2, "No such file", path.name)
        try:
            data = bytes_of(path)
        except UnreadableError as error:
            raise xacro.XacroException(f"{path.name} {error}") from None
        if data.removeprefix(codecs.BOM_UTF8).lstrip().startswith(b"<"):
            # Otherwise it is YAML.
            data = without_comments(data)
        if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
            raise xacro.XacroException(f"{path.name} has a DOCTYPE, which is not allowed")
        return io.BytesIO(data)

    def find(package: str) -> str:
        folder = locator.package(package)
        if folder is None:
            raise substitution_args.SubstitutionException(
                f"$(find {package}): no such package: put the folder that holds it on the path "
                "(`--path DIR` or GZ_SIM_RESOURCE_PATH)"
            )
        return str(folder)

    def environment(name: str) -> str:
        raise substitution_args.SubstitutionException(
            f"$(env {name}): the environment is not read; use an argument"
        )

    def evaluate(text: str, context: dict[str, Any]) -> str:
        names = dict(substitution_args._eval_dict)
        names.update(arg=lambda name: substitution_args.convert_value(context["arg"][name], "auto"))
        names.update(find=find, env=environment, optenv=lambda name, default="": default)
        names["__builtins__"] = {}
        for name, value in context.get("arg", {}).items():
            names.setdefault(name, substitution_args.convert_value(value, "auto"))
        for function in (list, dict, map, str, float, int):
            names[function.__name__] = function
        return str(eval(compiled(text), names))

    def safe_eval(
        expression: str, names: dict[str, Any], local: dict[str, Any] | None = None
    ) -> Any:
        names.update(__builtins__={})
        return eval(compiled(expression), names, local)

    xacro.open = checked_open
    xacro.safe_eval = safe_eval
    for name in ("vars", "type"):
        dict.pop(xacro._global_symbols["python"], name, None)
    substitution_args._eval = evaluate
    substitution_args._eval_find = find
    substitution_args._eval_env = environment
    substitution_args._eval_optenv = lambda name, default="": default


def compiled(expression: str) -> Any:
    """The compiled expression. Raises XacroException if it accesses the interpreter."""
    tree = ast.parse(expression.strip(), "<expression>", "eval")
    for node in ast.walk(tree):
        name = ""
        if isinstance(node, ast.Attribute):
            name = node.attr
        elif isinstance(node, ast.Name) and node.id.startswith("__"):
            name = node.id
        if name.startswith(_INSIDES) or name in ("format", "format_map"):
            raise xacro.XacroException(f"`{name}` must not be used in an expression")
    return compile(tree, "<expression>", "eval")
