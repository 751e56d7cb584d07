"""Parses untrusted XML to a tree: nothing is fetched or expanded, all sizes are limited."""

from __future__ import annotations

import re
from pathlib import Path

from lxml import etree

from mazebot.common.files.limits import MAX_DOCUMENT_BYTES
from mazebot.common.files.reading import NotReadableError, read_limited, reason
from mazebot.common.files.xml_declaration import with_sound_declaration
from mazebot.worldgen.xml_comments import without_comments

MAX_FILE_BYTES = MAX_DOCUMENT_BYTES

_FORBIDDEN = (b"<!DOCTYPE", b"<!ENTITY")


_BARE_DOCTYPE = re.compile(rb"<!DOCTYPE\s[^\[<>]*>")


class UnreadableError(Exception):
    """An invalid file: a short phrase, and the line if it is known."""

    def __init__(self, phrase: str, line: int = 0) -> None:
        super().__init__(phrase)
        self.line = line


def without_doctype(data: bytes) -> bytes:
    """The text without a document type that declares nothing itself; lines are kept.

    Raises UnreadableError where it declares something, which may be an entity that grows.
    """
    bare = _BARE_DOCTYPE.sub(lambda found: b"\n" * found[0].count(b"\n"), data, count=1)
    for mark in _FORBIDDEN:
        at = bare.replace(b"\0", b"").find(mark)
        if at >= 0:
            line = bare.replace(b"\0", b"").count(b"\n", 0, at) + 1
            raise UnreadableError(
                f"has a {mark[2:].decode()} with declarations, which are not allowed: delete it",
                line,
            )
    return bare


def bytes_of(file: Path, max_bytes: int = MAX_FILE_BYTES) -> bytes:
    """The bytes of a regular file of limited size. Raises UnreadableError."""
    try:
        return read_limited(file, max_bytes)
    except (OSError, NotReadableError) as error:
        phrase = reason(error)
        raise UnreadableError(phrase[0].lower() + phrase[1:]) from None


def tree_of(data: bytes) -> etree._Element:
    """The root element, without comments and processing instructions.

    As in SDFormat's own parser an undeclared prefix stays a part of the name, a namespace without a
    prefix is ignored, a comment may contain `--`, and there may be space before the declaration,
    which may have any version.
    Raises UnreadableError.
    """
    data = without_comments(data)
    if not data.strip():
        raise UnreadableError("is empty, must be XML")
    data = without_doctype(data)
    data = with_sound_declaration(data)
    root, problem = _parsed(data, recover=False)
    if root is None and _only_prefixes(data):
        root, problem = _parsed(data, recover=True)
    if root is None:
        raise UnreadableError(f"is not well-formed XML: {problem}")
    default = root.nsmap.get(None)
    if default is not None:
        for element in root.iter(f"{{{default}}}*"):
            if element.prefix is None:
                element.tag = etree.QName(element).localname
    return root


def _parser(recover: bool) -> etree.XMLParser:
    return etree.XMLParser(
        resolve_entities=False,
        no_network=True,
        load_dtd=False,
        huge_tree=False,
        remove_comments=True,
        remove_pis=True,
        recover=recover,
    )


def _parsed(data: bytes, recover: bool) -> tuple[etree._Element | None, str]:
    try:
        return etree.fromstring(data, _parser(recover)), ""
    except (etree.XMLSyntaxError, ValueError, LookupError) as error:
        # lxml adds a made-up file name.
        words = " ".join(str(error).partition(" (<string>")[0].split())
        return None, words[:200]


def _only_prefixes(data: bytes) -> bool:
    """Whether undeclared prefixes are the only errors."""
    parser = _parser(recover=True)
    try:
        if etree.fromstring(data, parser) is None:
            return False
    except (etree.XMLSyntaxError, ValueError, LookupError):
        return False
    log = parser.error_log
    return bool(log) and all(
        entry.type == etree.ErrorTypes.NS_ERR_UNDEFINED_NAMESPACE for entry in log
    )
