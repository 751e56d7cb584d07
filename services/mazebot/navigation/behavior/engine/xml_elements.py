"""XML text as elements with line numbers; entities and document types are refused."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from xml.parsers import expat

from mazebot.common.config import ConfigError
from mazebot.common.files.limits import MAX_TREE_ELEMENTS
from mazebot.common.files.xml_declaration import with_sound_declaration


@dataclass
class Element:
    """One element; text between elements is dropped."""

    tag: str
    attributes: dict[str, str]
    source: str
    line: int
    children: list[Element] = field(default_factory=list)

    @property
    def at(self) -> str:
        """Where it stands: the source and the line."""
        return f"{self.source}:{self.line}"

    def walk(self) -> Iterator[Element]:
        """This element and all below it."""
        yield self
        for child in self.children:
            yield from child.walk()


DEEPEST = 200


def parse(text: str | bytes, source: str) -> Element:
    """The root element. Raises ConfigError, in one line, for text that is not well-formed XML."""
    stack: list[Element] = []
    roots: list[Element] = []
    parser = expat.ParserCreate()
    elements = 0

    def begin(tag: str, attributes: dict[str, str]) -> None:
        nonlocal elements
        elements += 1
        if elements > MAX_TREE_ELEMENTS:
            raise ConfigError(
                f"{source}:{parser.CurrentLineNumber}: must have at most {MAX_TREE_ELEMENTS} "
                "elements"
            )
        if len(stack) >= DEEPEST:
            raise ConfigError(
                f"{source}:{parser.CurrentLineNumber}: elements are nested more than {DEEPEST} deep"
            )
        element = Element(tag, attributes, source, parser.CurrentLineNumber)
        (stack[-1].children if stack else roots).append(element)
        stack.append(element)

    def end(_: str) -> None:
        stack.pop()

    def refuse(*_: object) -> None:
        raise ConfigError(
            f"{source}:{parser.CurrentLineNumber}: a DOCTYPE is not allowed in a behaviour tree"
        )

    parser.StartElementHandler = begin
    parser.EndElementHandler = end
    parser.StartDoctypeDeclHandler = refuse
    parser.EntityDeclHandler = refuse
    try:
        # With a byte order mark or an encoding of its own, bytes are read by the parser.
        data = text.encode() if isinstance(text, str) else text
        parser.Parse(with_sound_declaration(data), True)
    except expat.ExpatError as error:
        what = expat.ErrorString(error.code)
        raise ConfigError(f"{source}:{error.lineno}: not well-formed XML: {what}") from None
    return roots[0]
