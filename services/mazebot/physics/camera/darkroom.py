"""Develops the camera's pictures in a thread, while physics goes on."""

from __future__ import annotations

import threading
from collections import deque
from concurrent.futures import ThreadPoolExecutor

from mazebot.common.maths.frames import Array
from mazebot.physics.camera.camera import Picture, Renderer
from mazebot.physics.camera.camera_noise import CameraNoise
from mazebot.physics.camera.image_hash import ImageHash


class Exposure:
    """One picture: its poses, and what becomes of them."""

    def __init__(
        self,
        darkroom: Darkroom,
        map_from_optical: Array,
        map_from_movers: Array,
        noise: CameraNoise,
        image_hash: ImageHash,
    ) -> None:
        self._darkroom = darkroom
        self._poses = map_from_optical, map_from_movers
        self._noise = noise
        self._hash = image_hash
        self._done = threading.Event()
        self._picture: Picture | None = None
        self._error: BaseException | None = None

    def picture(self) -> Picture:
        """The picture, as soon as it is developed. Raises what its renderer raised."""
        if not self._done.is_set():
            self._darkroom.develop_until(self)
            self._done.wait()
        if self._picture is None:
            assert self._error is not None
            raise self._error
        return self._picture

    def develop(self, renderer: Renderer, spare: int) -> None:
        """Render, add the noise and the hash. Called once."""
        try:
            picture = renderer.render(*self._poses, spare=spare)
            self._noise.add_to(picture.rgb)
            self._hash.add(picture.rgb)
            self._picture = picture
        except BaseException as error:
            self._error = error
        finally:
            self._done.set()


class Darkroom:
    """Develops pictures in the order in which they were taken, each once: in a thread of its own,
    with a processor left to physics, or in that of somebody who waits for one. A renderer that
    belongs to a thread develops at once.
    """

    def __init__(self, renderer: Renderer) -> None:
        self._renderer = renderer
        self._waiting: deque[Exposure] = deque()
        self._lock = threading.Lock()
        """Held while a picture is developed."""
        self._worker = ThreadPoolExecutor(1, "darkroom") if renderer.any_thread else None

    def take(
        self,
        map_from_optical: Array,
        map_from_movers: Array,
        noise: CameraNoise,
        image_hash: ImageHash,
    ) -> Exposure:
        """Take a picture of the renderer's scene: its noise and hash follow those before it."""
        taken = Exposure(self, map_from_optical, map_from_movers, noise, image_hash)
        self._waiting.append(taken)
        if self._worker is None:
            self.finish()
        else:
            self._worker.submit(self._develop_next, 1)
        return taken

    def develop_until(self, wanted: Exposure) -> None:
        """Develop what was taken up to a picture, if nobody does it already."""
        while not wanted._done.is_set() and self._develop_next(0):
            pass

    def finish(self) -> None:
        """Return when all pictures are developed."""
        while self._develop_next(0):
            pass

    def close(self) -> None:
        """Finish, and end the thread."""
        self.finish()
        if self._worker is not None:
            self._worker.shutdown()

    def _develop_next(self, spare: int) -> bool:
        """Develop the oldest picture; False: there is none."""
        with self._lock:
            try:
                oldest = self._waiting.popleft()
            except IndexError:
                return False
            oldest.develop(self._renderer, spare)
            return True
