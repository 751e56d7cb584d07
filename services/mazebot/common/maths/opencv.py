"""OpenCV with the same bits on every processor."""

from __future__ import annotations

import cv2


def without_ipp() -> None:
    """Stop OpenCV from using Intel's IPP, whose rounding depends on the processor, in this thread.

    The switch is per thread: call this wherever OpenCV must give the same bits.
    """
    cv2.ipp.setUseIPP(False)
