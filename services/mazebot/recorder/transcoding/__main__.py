"""Makes the pictures of a run videos: `python -m mazebot.recorder.transcoding FOLDER`."""

from __future__ import annotations

import sys
from pathlib import Path

from mazebot.recorder.transcoding.background import yield_to_others
from mazebot.recorder.transcoding.job import compress_run
from mazebot.recorder.transcoding.vp9 import VideoError


def main() -> int:
    """Exit code 1 with one line if it cannot be done."""
    yield_to_others()
    try:
        compress_run(Path(sys.argv[1]))
    except (VideoError, OSError) as error:
        sys.stderr.write(f"{error}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
