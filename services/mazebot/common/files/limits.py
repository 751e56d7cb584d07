"""Limits of files that come from other people.

A reader's time and memory are bounded by them, and honest files stay far below. docs/security.md
lists them. Limits of a single format are with its reader.
"""

from __future__ import annotations

from typing import Final

MIB: Final = 1024 * 1024

MAX_TEXT_BYTES: Final = 4 * MIB
"""Of a recipe, settings, parameters, a behaviour tree, waypoints, metadata.yaml or labels; Nav2's
largest parameter files have 0.03 MB."""
MAX_DOCUMENT_BYTES: Final = 64 * MIB
"""Of an SDF, URDF, mesh, summary, series or relations file, and of a texture."""
MAX_YAML_VALUES: Final = 300_000
"""Of a YAML file, an alias counted as all that it stands for."""
MAX_YAML_DEPTH: Final = 40
MAX_NUMBER_CHARACTERS: Final = 6000
"""Of a value without quotes: YAML's base-60 numbers take time that grows with the square of it."""
MAX_STRING_CHARACTERS: Final = 256 * 1024
"""Of a value in quotes: metadata.yaml has all the QoS profiles of a topic in one."""
MAX_TREE_ELEMENTS: Final = 20_000
"""Of a behaviour tree; Nav2's largest have 40."""
MAX_IMAGE_PIXELS: Final = 8192 * 8192
"""Of a texture or picture: at most 270 MB while it is decoded."""
MAX_CHUNK_BYTES: Final = 128 * MIB
"""Of an unpacked chunk of MCAP, and of a message; writers' own limit is about 1 MB, and one message
where that is larger."""
MAX_LINE_BYTES: Final = 2 * MIB
"""Of a line of a log: the largest scan has 20,000 beams."""
MIN_UNPACKED_BYTES: Final = 256 * MIB
MAX_UNPACKED_RATIO: Final = 100
"""A packed log or bag may grow to so many times its size, or to `MIN_UNPACKED_BYTES`. Logs of text
grow 10 times, and a bomb 1000 times and more."""
