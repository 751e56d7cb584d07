"""A map as the document of `/map_server/load_map`, and back."""

from __future__ import annotations

import base64
import binascii
import zlib

import numpy as np

from mazebot.common.messages.action_documents import LoadMap
from mazebot.common.messages.documents import Planar
from mazebot.common.world.costmap import MAX_CELLS, OCCUPIED, UNKNOWN
from mazebot.common.world.map_files import MapFile


class MapDataError(ValueError):
    """Cells that are none; the text is one line."""


def document_of_map(chart: MapFile) -> LoadMap:
    """A map as a request."""
    rows, columns = chart.cells.shape
    packed = zlib.compress(np.ascontiguousarray(chart.cells, np.int8).tobytes())
    return LoadMap(
        resolution_m=chart.resolution_m,
        origin=Planar(x_m=chart.origin.x_m, y_m=chart.origin.y_m, yaw_rad=chart.origin.yaw_rad),
        rows=rows,
        columns=columns,
        cells_base64=base64.b64encode(packed).decode(),
    )


def map_of_document(document: LoadMap) -> MapFile:
    """The map of a request. Raises MapDataError."""
    count = document.rows * document.columns
    if count > MAX_CELLS:
        raise MapDataError(f"{count} cells: must be at most {MAX_CELLS}")
    unpacker = zlib.decompressobj()
    try:
        data = unpacker.decompress(base64.b64decode(document.cells_base64, validate=True), count)
    except (binascii.Error, zlib.error) as error:
        raise MapDataError(f"cells_base64: must be zlib in base64: {error}") from error
    if len(data) != count or not unpacker.eof:
        raise MapDataError(f"cells_base64: must be {document.rows} x {document.columns} bytes")
    cells = np.frombuffer(data, np.int8).reshape(document.rows, document.columns)
    if cells.min() < UNKNOWN or cells.max() > OCCUPIED:
        raise MapDataError(f"cells: must be {UNKNOWN} to {OCCUPIED}")
    return MapFile(cells, document.resolution_m, document.origin.se2())
