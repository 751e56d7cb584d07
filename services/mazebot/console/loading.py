"""The script within each page that loads it again where a part of it did not come.

It is in the page because a file of its own could fail to come for the same reason.
"""

from __future__ import annotations

import base64
import hashlib
from pathlib import Path

LOADING_SCRIPT = Path(__file__).with_name("templates").joinpath("loading.js").read_text("utf-8")
LOADING_SOURCE = (
    f"'sha256-{base64.b64encode(hashlib.sha256(LOADING_SCRIPT.encode()).digest()).decode()}'"
)
"""Its source in a content security policy (CSP3, 2.3.1)."""
