"""Records every run.

Rerun and Arrow use mimalloc, which reads these when it is loaded: without them it holds what was
freed, and maps more than is used, together 30 MB in a tour of a minute.
"""

import os

os.environ.setdefault("MIMALLOC_PURGE_DELAY", "0")
os.environ.setdefault("MIMALLOC_ARENA_EAGER_COMMIT", "0")
