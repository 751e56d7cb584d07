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
from xml.dom import expatbuilder
from xml.parsers.expat import ExpatError

import xacro
from xacro import substitution_args

from mazebot.worldgen.sdf.files.locate import Locator
from mazebot.worldgen.sdf.files.xml_text import (
    MAX_FILE_BYTES,
    UnreadableError,
    bytes_of,
    without_doctype,
)
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
    text, error, line = "", "", 0
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
        error = " ".join(_words(problem).split())[:300] or type(problem).__name__
        if error.startswith("Undefined substitution argument "):
            error += ": give it with `--arg NAME:=VALUE`"
        file, line = _origin(problem, work["file"])
        if file != work["file"]:
            error = f"{Path(file).name}:{line}: {error}" if line else f"{Path(file).name}: {error}"
            line = 0
    answer.write(json.dumps({"text": text, "error": error, "line": line}))


def _words(problem: BaseException) -> str:
    """The message of an error once: xacro repeats those that it wraps."""
    if not isinstance(problem, xacro.XacroException):
        return str(problem)
    own = str(problem.args[0] or "") if problem.args else ""
    inner = "" if problem.exc is None else _words(problem.exc)
    if isinstance(problem.exc, OSError) and own:
        inner = ""
    if own.startswith("<class "):
        own = ""
    return " ".join(part for part in (own, inner, str(problem.suffix or "")) if part)


def _origin(problem: BaseException, first: str) -> tuple[str, int]:
    """File and line of what xacro was reading; line 0: it is not known."""
    file, line = first, 0
    if isinstance(problem, ExpatError):
        return str((xacro.filestack or [first])[-1]), problem.lineno
    at = problem.__traceback__
    while at is not None:
        for name in ("node", "elt"):
            place = getattr(at.tb_frame.f_locals.get(name), "mazebot_place", None)
            if place is not None:
                file, line = place
        at = at.tb_next
    if isinstance(problem, UnreadableError):
        line = problem.line
    return file, line


class _Builder(expatbuilder.ExpatBuilderNS):
    """Builds a document whose elements know their file and line."""

    file = ""

    def start_element_handler(self, name: str, attributes: list[str]) -> None:
        super().start_element_handler(name, attributes)
        node: Any = self.curNode
        node.mazebot_place = self.file, self.getParser().CurrentLineNumber


def _parse(text: io.BytesIO | None, name: str | None = None) -> Any:
    """In place of xacro's own: files are opened by what it is given to open them."""
    assert text is None
    assert name is not None
    try:
        opened = xacro.open(name)
    except OSError as error:
        # As there, a file that cannot be opened is not the one that is being read.
        xacro.filestack.pop()
        raise xacro.XacroException(f"{error.strerror}: {error.filename}", exc=error) from error
    builder = _Builder()
    builder.file = name
    return builder.parseString(opened.read())


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
            try:
                data = without_doctype(data)
            except UnreadableError as error:
                raise UnreadableError(f"{path.name} {error}", error.line) from None
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
    xacro.parse = _parse
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
