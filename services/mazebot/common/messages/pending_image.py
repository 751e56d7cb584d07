"""An image whose pixels are still being made."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mazebot.common.messages import messages as msg

Pixels = NDArray[np.uint8]


class PendingImage(msg.Image):
    """Everything but its pixels is known: whoever reads `data` waits until they are made."""

    def __init__(
        self,
        header: msg.Header,
        height: int,
        width: int,
        encoding: str,
        is_bigendian: int,
        step: int,
        data: Callable[[], Pixels],
    ) -> None:
        self._make = data
        known = msg.Image(header, height, width, encoding, is_bigendian, step, _NONE)
        self.__dict__.update({**known.__dict__, "data": None})

    @property
    def data(self) -> Pixels:  # type: ignore[override]
        """(height * step,) bytes."""
        pixels: Pixels | None = self.__dict__["data"]
        if pixels is None:
            pixels = self.__dict__["data"] = self._make()
        return pixels

    def __repr__(self) -> str:
        return repr(
            msg.Image(
                *(self.header, self.height, self.width, self.encoding, self.is_bigendian),
                *(self.step, self.data),
            )
        )


_NONE = np.zeros(0, np.uint8)
