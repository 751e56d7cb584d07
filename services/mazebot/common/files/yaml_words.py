"""Explanations of YAML syntax errors for the author of the file."""

from __future__ import annotations

import yaml

_WORDS = {
    "mapping values are not allowed": "a second `: ` in one line, or more indentation than above",
    "cannot start any token": "a tab as indentation, or text that begins with @, ` or % unquoted",
    "could not find expected ':'": "a field without a colon after its name",
    "did not find expected ',' or ']'": "a list that is not closed: `,` or `]` is missing",
    "did not find expected ',' or '}'": "a mapping that is not closed: `,` or `}` is missing",
    "unexpected end of stream": "a quote that is not closed",
    "expected node content": "a value that is missing, or a bracket that is not closed",
    "did not find expected key": "different indentation from the lines above, or an extra bracket",
    "did not find expected '-' indicator": "a field among the items of a list",
    "block sequence entries are not allowed": "a list item (`- `) where none is allowed",
    "undefined alias": "an alias (*name): must be written out",
    "duplicate anchor": "a duplicate anchor (&name)",
    "constructor for the tag": "a tag (!name): must be left out",
    "unknown escape character": "a backslash within double quotes: use single ones",
    "unhashable key": "a field name that is not a string",
    "found another document": "a second document: must be one, without `---` between",
    "expected <document start>": "an extra bracket, or text after the end",
    "expected comment or line break": "text directly after `|` or `>`: must begin on the next line",
    "directive": "text that begins with % unquoted",
    "for merging": "`<<` without a mapping after it",
    "too deep": "too many nested levels",
}
"""By a part of the message of libyaml and PyYAML."""


def line_and_words(error: Exception) -> tuple[int, str]:
    """The line of a YAML syntax error, from 1 (0: unknown), and its explanation."""
    if isinstance(error, yaml.reader.ReaderError):
        return 0, f"a control character (code {error.character}) at position {error.position}"
    if not isinstance(error, yaml.MarkedYAMLError):
        return 0, f"an invalid value: {' '.join(str(error).split()):.200}"
    mark = error.problem_mark
    reason = error.problem or ""
    plain = next((words for part, words in _WORDS.items() if part in reason), reason)
    where = f"column {mark.column + 1}: " if mark else ""
    return (mark.line + 1 if mark else 0), where + plain
