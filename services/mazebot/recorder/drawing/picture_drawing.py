"""How camera and depth images are drawn, each in the image plane of its pinhole."""

from __future__ import annotations

from concurrent.futures import Future

import cv2
import numpy as np
import rerun as rr

from mazebot.common.messages import messages as msg
from mazebot.recorder.drawing import palette
from mazebot.recorder.drawing.canvas import Canvas
from mazebot.recorder.stream.pictures import is_drawable

CAMERA_ENTITY = "camera/color/image_raw"
"""Entity path of the camera's pictures."""
IMAGE_FRAME = "camera_image"
"""Image plane of the camera, in pixels."""
DEPTH_FRAME = "camera_depth"
"""Image plane of the depth camera, in pixels."""

_DEPTH_NS = 480_000_000
_DEPTH_RANGE_M = (0.0, 10.0)
"""Range of the depth image's colours."""
_PNG = (cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_NONE)
"""Without filters, of which libpng would try all five on every row: a third of the time."""


def draw_camera_image(canvas: Canvas, image: msg.Image) -> None:
    """The camera image, as JPEG; not drawn if it is also published as JPEG."""
    canvas.at(image.header.stamp)
    if canvas.comes_compressed:
        return
    if not is_drawable(image):
        if canvas.changed(f"{CAMERA_ENTITY}/encoding", image.encoding):
            text = f"cannot draw images with encoding {image.encoding}"
            canvas.log_text(CAMERA_ENTITY, text, "WARN")
        return
    canvas.frame(CAMERA_ENTITY, IMAGE_FRAME)
    jpeg = canvas.pictures.jpeg(image)
    canvas.recording.log_later(CAMERA_ENTITY, lambda: _encoded(jpeg))


def draw_camera_compressed(canvas: Canvas, image: msg.CompressedImage) -> None:
    """The camera image, as received."""
    canvas.at(image.header.stamp)
    canvas.comes_compressed = True
    kind = "image/png" if "png" in image.format else "image/jpeg"
    canvas.frame(CAMERA_ENTITY, IMAGE_FRAME)
    picture = rr.EncodedImage(contents=image.data.tobytes(), media_type=kind)
    canvas.recording.log(CAMERA_ENTITY, picture)


def draw_photo(canvas: Canvas, photo: msg.CompressedImage) -> None:
    """A picture taken at a waypoint."""
    canvas.at(photo.header.stamp)
    picture = rr.EncodedImage(contents=photo.data.tobytes(), media_type="image/png")
    canvas.recording.log("waypoint_photo", picture)


def draw_camera_info(canvas: Canvas, info: msg.CameraInfo) -> None:
    """The camera's view frustum, in its frame."""
    canvas.camera = info
    _draw_pinhole(canvas, "camera/color/camera_info", info, IMAGE_FRAME)


def draw_depth_image(canvas: Canvas, image: msg.Image) -> None:
    """Depths twice per second, as PNG in millimetres: an image, and points in the camera frame."""
    stamp_ns = canvas.at(image.header.stamp)
    path = "camera/depth/image_rect_raw"
    if image.encoding != "32FC1" or image.is_bigendian or not 0 < 4 * image.width <= image.step:
        if canvas.changed(f"{path}/encoding", image.encoding):
            canvas.log_text(
                path, f"cannot draw depth images with encoding {image.encoding}", "WARN"
            )
    elif canvas.due(path, stamp_ns, _DEPTH_NS):
        canvas.frame(path, DEPTH_FRAME)
        canvas.recording.log_later(path, lambda: _depth_png(image))


def draw_depth_info(canvas: Canvas, info: msg.CameraInfo) -> None:
    """The depth camera's view frustum, in its frame."""
    _draw_pinhole(canvas, "camera/depth/camera_info", info, DEPTH_FRAME)


def _encoded(jpeg: Future[bytes]) -> rr.EncodedImage:
    return rr.EncodedImage(contents=jpeg.result(), media_type="image/jpeg")


def _depth_png(image: msg.Image) -> rr.EncodedDepthImage:
    """Millimetres in 16 bits; depths beyond 65 m are clipped to that."""
    rows = image.data.reshape(image.height, image.step)[:, : 4 * image.width]
    depth_m = np.ascontiguousarray(rows).view(np.float32)
    scaled = 1000.0 * depth_m
    # No number: nothing in range.
    np.fmax(scaled, 0.0, out=scaled)
    if not np.isfinite(scaled.sum()):
        scaled = np.nan_to_num(scaled, nan=0.0, posinf=0.0, neginf=0.0)
    np.rint(scaled, out=scaled)
    millimetres = np.clip(scaled, 0, 65_535, out=scaled).astype(np.uint16)
    _, png = cv2.imencode(".png", millimetres, _PNG)
    return rr.EncodedDepthImage(
        blob=png.tobytes(),
        media_type=rr.components.MediaType.PNG,
        meter=1000.0,
        depth_range=[1000.0 * edge_m for edge_m in _DEPTH_RANGE_M],
    )


def _draw_pinhole(canvas: Canvas, path: str, info: msg.CameraInfo, image_frame: str) -> None:
    value = (info.k.tobytes(), info.width, info.height, info.header.frame_id)
    if canvas.changed(path, value):
        canvas.recording.log(
            path,
            rr.Pinhole(
                image_from_camera=info.k.reshape(3, 3),
                resolution=(info.width, info.height),
                camera_xyz=rr.ViewCoordinates.RDF,
                image_plane_distance=0.5,
                parent_frame=info.header.frame_id,
                child_frame=image_frame,
                color=palette.ESTIMATE,
                line_width=0.004,
            ),
            static=True,
        )
