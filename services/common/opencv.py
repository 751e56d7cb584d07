"""OpenCV with the same bits on every processor."""

from __future__ import annotations

import cv2


def without_ipp() -> None:
    """Keep OpenCV from asking Intel's library, which rounds by the processor, in this thread.

    Each thread has a switch of its own: whoever needs the same bits says so where it calls OpenCV.
    """
    cv2.ipp.setUseIPP(False)
