"""Classes chosen by name: those of Mazebot, and those that a user has in a file of their own."""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import sys
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

from mazebot.common.config import ConfigError

_PAGES = {"planner": "planning", "behavior tree node": "behavior-trees"}
_NO_BUILTINS: Mapping[str, type[Any]] = {}

_FROM_FILES: dict[tuple[Path, int, int], ModuleType] = {}
"""A file that has not changed is run once, however many of its classes are named."""


def load_plugin(
    spec: str, protocol: type[Any], kind: str, known: Mapping[str, type[Any]] = _NO_BUILTINS
) -> type[Any]:
    """The class that a configuration names.

    Args:
        spec: a name among `known`, "my_package.my_module:MyClass", or "FILE.py:MyClass", relative
            to the working directory.
        protocol: what its instances must have; members that begin with "_" are not asked for.
        kind: of plugin, for errors: "controller", "planner", "behavior".
        known: Mazebot's own classes by name.

    Raises ConfigError with one line where the file, the module or the class does not exist, where
    importing it raises, or where the class has not all that the protocol has.
    """
    if spec in known:
        return known[spec]
    place, _, name = spec.rpartition(":")
    if not place or not name.isidentifier():
        names = ", ".join([*known, "my_package.my_module:MyClass", "FILE.py:MyClass"])
        raise ConfigError(f"{kind}: {spec!r:.80}: must be one of {names}")
    source = f"{kind}: {spec:.120}"
    module = _from_file(place, source) if place.endswith(".py") else _from_module(place, source)
    found = getattr(module, name, None)
    if not isinstance(found, type):
        classes = sorted(
            key for key, value in vars(module).items()
            if isinstance(value, type) and value.__module__ == module.__name__
        )  # fmt: skip
        known_as = f"; it has {', '.join(classes)}" if classes else ""
        raise ConfigError(f"{source}: {place} has no class {name}{known_as}")
    missing = [each for each in _members(protocol) if not hasattr(found, each)]
    missing += sorted(getattr(found, "__abstractmethods__", ()))
    if missing:
        page = _PAGES.get(kind, "controllers")
        raise ConfigError(f"{source}: a {kind} must have {', '.join(missing)}, see docs/{page}.md")
    for name in _members(protocol):
        _check_arguments(getattr(protocol, name, None), getattr(found, name), f"{source}: {name}")
    return found


def _check_arguments(wanted: object, found: object, source: str) -> None:
    """Raises ConfigError where a method cannot be called as that of the protocol is."""
    if not inspect.isfunction(wanted) or not callable(found):
        return
    names = list(inspect.signature(wanted).parameters)
    try:
        taken = inspect.signature(found)
        taken.bind(*names)
    except TypeError:
        line = getattr(getattr(found, "__code__", None), "co_firstlineno", 0)
        place = f" of line {line}" if line else ""
        raise ConfigError(f"{source}{place}: {taken}: must take ({', '.join(names)})") from None
    except ValueError:
        # The signature of a function that is not written in Python may not be known.
        return


def _from_file(place: str, source: str) -> ModuleType:
    path = Path(place)
    if not path.is_file():
        raise ConfigError(f"{source}: {place}: no such file")
    version = (path.resolve(), path.stat().st_mtime_ns, path.stat().st_size)
    if version in _FROM_FILES:
        return _FROM_FILES[version]
    # A name of its own, so that a file named like a module hides none.
    name = f"mazebot_plugin_{path.stem}"
    made = importlib.util.spec_from_file_location(name, path)
    if made is None or made.loader is None:
        raise ConfigError(f"{source}: {place}: must be a Python file")
    module = importlib.util.module_from_spec(made)
    sys.modules[name] = module
    try:
        made.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        raise ConfigError(f"{source}: {_import_error(error)}") from error
    _FROM_FILES[version] = module
    return module


def _from_module(place: str, source: str) -> ModuleType:
    try:
        return importlib.import_module(place)
    except ModuleNotFoundError as error:
        if error.name is not None and f"{place}.".startswith(f"{error.name}."):
            raise ConfigError(f"{source}: no module {error.name} can be imported") from error
        raise ConfigError(f"{source}: {_import_error(error)}") from error
    except (Exception, SystemExit) as error:
        raise ConfigError(f"{source}: {_import_error(error)}") from error


def _import_error(error: BaseException) -> str:
    """What an import raised, in one line, with the line of the file where it did."""
    line = ""
    if isinstance(error, SyntaxError):
        line = f"line {error.lineno}: "
    elif error.__traceback__ is not None:
        last = error.__traceback__
        while last.tb_next is not None:
            last = last.tb_next
        line = f"{Path(last.tb_frame.f_code.co_filename).name} line {last.tb_lineno}: "
    text = error.msg if isinstance(error, SyntaxError) else str(error)
    return f"raises on import: {line}{type(error).__name__}: {' '.join(text.split()):.200}"


def _members(protocol: type[Any]) -> list[str]:
    """The public members that a protocol and its bases define."""
    found = {
        name
        for base in protocol.__mro__
        if base is not object and base.__name__ not in ("Protocol", "Generic")
        for name in (*vars(base), *getattr(base, "__annotations__", ()))
    }
    return sorted(name for name in found if not name.startswith("_"))
