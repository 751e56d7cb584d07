"""Perception: camera images in, marker detections and a scan of what stands on the floor out."""

from __future__ import annotations

import logging
import math
from collections import Counter, deque
from collections.abc import Collection, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, NamedTuple

import cv2
import numpy as np

from mazebot.common.maths import portable
from mazebot.common.maths.frames import (
    BASE_FOOTPRINT_FRAME,
    CAMERA_FRAME,
    MAP_FRAME,
    ODOM_FRAME,
    Array,
    pose_matrix,
)
from mazebot.common.maths.pose_history import PoseHistory
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import Entities, MarkerEntity
from mazebot.common.messages.scan import Mount
from mazebot.common.messages.topics import (
    CAMERA_IMAGE,
    CAMERA_INFO,
    DEPTH_IMAGE,
    DEPTH_INFO,
    DEPTH_SCAN,
    DETECTIONS,
    ENTITIES,
    IMU,
    MAP_DETECTIONS,
    PHOTO,
    PHOTO_REQUEST,
    SIMULATION_STATS,
    TF,
    TF_STATIC,
    WORLD,
    Topic,
    read_by,
)
from mazebot.common.node.frame_tree import FrameTree
from mazebot.common.node.node import Inbox, Node, Outbox
from mazebot.common.world.marker_picture import marker_count, own_dictionaries
from mazebot.perception.config import PerceptionConfig
from mazebot.perception.depth_scan import (
    Depths,
    DepthScan,
    compile_kernels,
    depth_scan,
    unseen_ahead,
)
from mazebot.perception.detect import dictionary_exists, grey_from_rgb
from mazebot.perception.find import Findings, Found, MarkerFinder, Name
from mazebot.perception.picture import png_from_rgb
from mazebot.perception.pose import Camera
from mazebot.perception.sampling import brightness_at
from mazebot.perception.tilt import Tilt

_INFOS_KEPT = 10
_ODOMETRY_KEPT = 100
_CLOCK_LAG_NS = 100_000_000
"""Transforms may be newer than the clock by this much."""
_DISTORTION_LENGTHS = (4, 5, 8, 12, 14)

_DEPTH_TYPES: dict[str, np.dtype[Any]] = {
    "32FC1": np.dtype(np.float32),
    "16UC1": np.dtype(np.uint16),
}
"""Of depths: metres, and millimetres."""

UNKNOWN_KEY, MISPLACED_KEY = "unknown marker ", "misplaced marker "
"""Starts of keys in /diagnostics, before dictionary and id."""

_log = logging.getLogger("perception")


class PerceptionNode(Node):
    """Detects the markers of the world, each with every pose that its corners allow, and what
    stands on the floor before the camera.

    Detections are in the frame of their image, which is the camera's optical frame; they are also
    published in the map, by the pose that navigation estimates, for users. The scan of a depth
    image is in the camera's own frame.
    """

    name = "perception"
    _config: PerceptionConfig
    wakes = (CAMERA_IMAGE, CAMERA_INFO, DEPTH_IMAGE, DEPTH_INFO)
    period_ns = 100_000_000
    """As long as work on an image may take: what it gives is published one step later."""
    depth = 4

    def __init__(self, config: PerceptionConfig, has_camera: bool = True) -> None:
        """`has_camera`: whether the robot may have one. Else it makes no use of the IMU."""
        self._config = config
        self._worker = ThreadPoolExecutor(1, "markers")
        self._search: _Search | None = None
        self._depth: tuple[int, Mount, Future[DepthScan | None]] | None = None
        """Stamp of a depth image, its camera's mount, and the scan that is being made of it."""
        self._depth_info: msg.CameraInfo | None = None
        self._view_judged: tuple[tuple[int, int], bytes] | None = None
        """Size, lens and place of the camera that was looked at for whether it sees the floor."""
        self._tilt = Tilt(config.depth_scan.tilt_tolerance_rad)
        self._tilted_rad = 0.0
        """By how much the robot was tilted at the newest depth image, which was not used then."""
        self._entities: Entities | None = None
        self._finder = MarkerFinder(config)
        self._dictionaries: dict[str, cv2.aruco.Dictionary] = {}
        """The world's own"""
        self._slam = False
        """Whether the poses of the markers are unknown."""
        self._ignored: dict[str, int] = {}
        """How often, by key in /diagnostics"""
        self._infos: dict[int, msg.CameraInfo] = {}
        self._image: msg.Image | None = None
        self._photo_wanted_ns: int | None = None
        """A picture of this time or later is to be published."""
        self._published = False
        self._reads = [one for one in read_by(self.name) if has_camera or one is not IMU]
        self._has_camera = True
        """False: the simulator says that it renders no images."""
        self._static_frames = FrameTree()
        self._odom_from_base = PoseHistory(_ODOMETRY_KEPT)
        self._odometry: deque[tuple[int, msg.Transform]] = deque(maxlen=_ODOMETRY_KEPT)
        """What is not in the history yet: it is added when it is needed."""
        self._map_from_odom: msg.Transform | None = None
        self._now_ns = 0

    def nominal_rates_hz(self) -> dict[str, Topic[msg.Image]]:
        """See Node."""
        return {DETECTIONS.name: CAMERA_IMAGE}

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        """Begin to look for markers in each image whose intrinsics are received, and publish what
        the images before gave.
        """
        if now_ns < self._now_ns:
            self._forget_pictures()
        if now_ns > self._now_ns:
            if self._search is not None:
                self._publish_found(outbox)
            self._publish_depth_scan(outbox)
        self._now_ns = now_ns
        self._take_world(inbox)
        self._take_transforms(inbox)
        self._take_imu(inbox)
        stats = inbox.latest(SIMULATION_STATS)
        if stats is not None:
            self._has_camera = stats.renderer != "none"
        for info in inbox.new(CAMERA_INFO):
            self._take_info(info, inbox)
        for request in inbox.new(PHOTO_REQUEST):
            self._photo_wanted_ns = request.stamp_ns
        images = inbox.new(CAMERA_IMAGE)
        if self._image is not None:
            images.insert(0, self._image)
            self._image = None
        for index, image in enumerate(images):
            info_ = self._infos.get(msg.ns_from_time(image.header.stamp))
            if info_ is not None:
                self._perceive(image, info_, inbox, outbox)
            elif index == len(images) - 1:
                # Its intrinsics may still arrive.
                self._image = image
            else:
                inbox.reject(CAMERA_IMAGE, "no camera_info with its stamp")
        self._take_depth(inbox, outbox)

    def facts(self) -> dict[str, str]:
        """That there is no camera, and how often each marker was ignored that is not of the world
        or not in its place.
        """
        ignored = {key: str(count) for key, count in sorted(self._ignored.items())}
        return ignored if self._has_camera else {"camera": "none", **ignored}

    def waiting_for(self) -> str | None:
        """The first missing input for detections."""
        if not self.world_hash:
            return "the world"
        if self._entities is None or self._entities.world_hash != self.world_hash:
            return "the entities of the world"
        if self._published:
            return None
        if self._image is not None:
            return "the camera's intrinsics"
        return "an image" if self._has_camera else None

    def reads(self) -> Collection[Topic[Any]]:
        """See Node."""
        return self._reads

    def warning(self) -> str:
        """See Node: that the robot is tilted."""
        degrees = math.degrees(self._tilted_rad)
        return f"robot tilted by {degrees:.1f} degrees: depth images not used" if degrees else ""

    def prepare(self) -> None:
        """See Node."""
        nowhere = np.zeros((1, 1))
        brightness_at(np.zeros((1, 1), np.uint8), nowhere, nowhere)
        compile_kernels()

    def close(self) -> None:
        """End the thread that looks for markers."""
        self._worker.shutdown()

    def _take_world(self, inbox: Inbox) -> None:
        world = inbox.latest(WORLD)
        if world is not None and world.hash != self.world_hash:
            self.world_hash = world.hash
            self._dictionaries = own_dictionaries(world.dictionaries)
            self._slam = world.slam
            self._published = False
            self._forget_pictures()
        entities = inbox.latest(ENTITIES)
        if entities is not None:
            self._entities = entities
        elif world is None:
            return
        if self._search is not None:
            # It looks by the markers that were registered.
            self._search.found.exception()
        self._finder.clear()
        if self._entities is None or self._entities.world_hash != self.world_hash:
            return
        if self._slam:
            self._register_dictionaries(self._entities.markers)
        for entity in self._entities.markers:
            self._register(entity, inbox)

    def _forget_pictures(self) -> None:
        """Drop images and transforms, which are from the simulation before."""
        if self._search is not None:
            self._search.found.exception()
            self._search = None
        self._depth = None
        self._tilt.forget()
        self._tilted_rad = 0.0
        self._image = self._photo_wanted_ns = None
        self._infos.clear()
        self._odom_from_base.clear()
        self._odometry.clear()
        self._map_from_odom = None
        self._ignored.clear()
        self._finder.forget_picture()

    def _register_dictionaries(self, markers: Iterable[MarkerEntity]) -> None:
        """Look for every marker of each dictionary used, at the size that most of its markers have:
        which ones hang in the world is to be found out.
        """
        sizes: dict[str, Counter[float]] = {}
        for entity in markers:
            sizes.setdefault(entity.dictionary, Counter())[entity.marker_size_m] += 1
        for name, counts in sizes.items():
            book = self._dictionaries.get(name)
            if book is None and not dictionary_exists(name):
                continue
            (side_m, _), *_ = counts.most_common(1)
            for marker_id in range(marker_count(name, book)):
                self._finder.register(name, marker_id, side_m, None, book)

    def _register(self, entity: MarkerEntity, inbox: Inbox) -> None:
        name = entity.dictionary
        book = self._dictionaries.get(name)
        if book is None and not dictionary_exists(name):
            inbox.reject(ENTITIES, "unknown dictionary")
            _log.warning("MarkerEntity %s: dictionary: %r: unknown to OpenCV", entity.name, name)
            return
        map_from_marker = None if self._slam else pose_matrix(entity)
        self._finder.register(name, entity.marker_id, entity.marker_size_m, map_from_marker, book)

    def _take_transforms(self, inbox: Inbox) -> None:
        self._static_frames.receive(inbox, TF_STATIC)
        # The clock arrives after the measurements of its time.
        latest_ns = self._now_ns + _CLOCK_LAG_NS
        for transforms in inbox.new(TF):
            for entry in transforms.transforms:
                pair = entry.header.frame_id, entry.child_frame_id
                if pair == (ODOM_FRAME, BASE_FOOTPRINT_FRAME):
                    stamp_ns = msg.ns_from_time(entry.header.stamp)
                    if stamp_ns > latest_ns:
                        # From a simulation that has ended since.
                        inbox.reject(TF, "stamp in the future")
                        continue
                    self._odometry.append((stamp_ns, entry.transform))
                elif pair == (MAP_FRAME, ODOM_FRAME):
                    self._map_from_odom = entry.transform

    def _take_imu(self, inbox: Inbox) -> None:
        frames: dict[str, Array | None] = {}
        for imu in inbox.new(IMU):
            frame = imu.header.frame_id
            if frame not in frames:
                frames[frame] = self._static_frames.chain(BASE_FOOTPRINT_FRAME, frame)
            base_from_imu = frames[frame]
            # By ROS, -1 is of a sensor that does not measure this.
            covariances = imu.angular_velocity_covariance, imu.linear_acceleration_covariance
            if base_from_imu is not None and all(one[0] >= 0.0 for one in covariances):
                self._tilt.take(imu, base_from_imu)

    def _take_depth(self, inbox: Inbox, outbox: Outbox) -> None:
        """Begin to make a scan of the newest depth image."""
        infos, images = inbox.new(DEPTH_INFO), inbox.new(DEPTH_IMAGE)
        for info in infos:
            if info.k[0] > 0.0 and info.k[4] > 0.0 and info.k[8] == 1.0:
                self._depth_info = info
            else:
                inbox.reject(DEPTH_INFO, "intrinsics not of a pinhole camera")
        known, config = self._depth_info, self._config.depth_scan
        if not (images and config.enabled and known is not None):
            return
        image, frames = images[-1], self._static_frames
        base_from_camera = frames.chain(BASE_FOOTPRINT_FRAME, image.header.frame_id)
        base_from_link = frames.chain(BASE_FOOTPRINT_FRAME, CAMERA_FRAME)
        pixel_bytes = _DEPTH_TYPES.get(image.encoding, np.dtype(np.uint8)).itemsize
        if image.encoding not in _DEPTH_TYPES or image.is_bigendian:
            inbox.reject(DEPTH_IMAGE, "encoding is not 32FC1 or 16UC1, little endian")
        elif (image.width, image.height) != (known.width, known.height):
            inbox.reject(DEPTH_IMAGE, "size is not that of camera_info")
        elif image.step != pixel_bytes * image.width or image.width * image.height == 0:
            inbox.reject(DEPTH_IMAGE, "step is not that of the width")
        elif base_from_camera is not None and base_from_link is not None:
            self._publish_depth_scan(outbox)
            intrinsics = np.asarray(known.k, np.float64).reshape(3, 3)
            mount = Mount.of(base_from_link)
            yaw_rad = mount.base_from_scan.yaw_rad
            size_px = known.width, known.height
            places = (intrinsics, base_from_camera, base_from_link)
            view = size_px, b"".join(place.tobytes() for place in places)
            if view != self._view_judged:
                self._view_judged = view
                looks = unseen_ahead(size_px, intrinsics, base_from_camera, yaw_rad, config)
                if looks:
                    _log.warning(
                        "the camera does not see the floor ahead of the robot: low things are not "
                        "avoided; %s",
                        looks,
                    )
            stamp_ns = msg.ns_from_time(image.header.stamp)
            tilt_rad = self._tilt.at(stamp_ns)
            is_level = tilt_rad <= config.tilt_tolerance_rad
            self._tilted_rad = 0.0 if is_level else tilt_rad
            scan = self._worker.submit(
                lambda: depth_scan(
                    _depths(image) if is_level else _nothing(image),
                    intrinsics, base_from_camera, yaw_rad, config,
                )
            )  # fmt: skip
            self._depth = stamp_ns, mount, scan

    def _publish_depth_scan(self, outbox: Outbox) -> None:
        """Publish the scan of the depth image before."""
        if self._depth is None:
            return
        (stamp_ns, mount, made), self._depth = self._depth, None
        scan = made.result()
        if scan is not None:
            outbox.put(DEPTH_SCAN, _scan_message(stamp_ns, mount, scan))

    def _take_info(self, info: msg.CameraInfo, inbox: Inbox) -> None:
        if not (info.k[0] > 0.0 and info.k[4] > 0.0 and info.k[8] == 1.0):
            inbox.reject(CAMERA_INFO, "intrinsics not of a pinhole camera")
        elif len(info.d) and len(info.d) not in _DISTORTION_LENGTHS:
            inbox.reject(CAMERA_INFO, "unknown number of distortion coefficients")
        else:
            self._infos[msg.ns_from_time(info.header.stamp)] = info
            while len(self._infos) > _INFOS_KEPT:
                del self._infos[next(iter(self._infos))]

    def _perceive(
        self, image: msg.Image, info: msg.CameraInfo, inbox: Inbox, outbox: Outbox
    ) -> None:
        if image.encoding != "rgb8":
            inbox.reject(CAMERA_IMAGE, "encoding is not rgb8")
            return
        if (image.width, image.height) != (info.width, info.height):
            inbox.reject(CAMERA_IMAGE, "size is not that of camera_info")
            return
        if image.step < 3 * image.width or image.width * image.height == 0:
            inbox.reject(CAMERA_IMAGE, "step smaller than the width")
            return
        self._publish_photo(image, outbox)
        if self._search is not None:
            self._publish_found(outbox)
        base_from_camera = self._static_frames.chain(BASE_FOOTPRINT_FRAME, image.header.frame_id)
        found = self._worker.submit(self._find, image, info, base_from_camera)
        self._search = _Search(msg.ns_from_time(image.header.stamp), image.header.frame_id, found)
        self._published = True

    def _publish_found(self, outbox: Outbox) -> None:
        """Publish the markers of the newest image."""
        assert self._search is not None
        (stamp_ns, frame, searched), self._search = self._search, None
        findings = searched.result()
        for name in findings.unknown:
            self._ignore(UNKNOWN_KEY, name, "which is not registered")
        for name in findings.misplaced:
            self._ignore(MISPLACED_KEY, name, "which is not at its registered height and tilt")
        found = findings.found
        outbox.put(DETECTIONS, _detections(stamp_ns, frame, np.eye(4), found))
        if not outbox.is_read(MAP_DETECTIONS):
            return
        map_from_camera = self._map_from_camera(stamp_ns, frame)
        if map_from_camera is not None:
            outbox.put(MAP_DETECTIONS, _detections(stamp_ns, MAP_FRAME, map_from_camera, found))

    def _publish_photo(self, image: msg.Image, outbox: Outbox) -> None:
        """Publish the image where navigation wants a picture, and it is not of before that."""
        wanted_ns = self._photo_wanted_ns
        if wanted_ns is None or msg.ns_from_time(image.header.stamp) < wanted_ns:
            return
        self._photo_wanted_ns = None
        photo = msg.CompressedImage(
            header=image.header,
            format="rgb8; png compressed",
            data=png_from_rgb(image.data, image.height, image.width, image.step),
        )
        outbox.put(PHOTO, photo)

    def _find(
        self, image: msg.Image, info: msg.CameraInfo, base_from_camera: Array | None
    ) -> Findings:
        """Look for the registered markers; runs in the worker's thread."""
        if not self._finder.registered:
            return Findings([], [], [])
        camera = Camera(
            np.asarray(info.k, np.float64).reshape(3, 3),
            np.asarray(info.d if len(info.d) else np.zeros(5), np.float64),
        )
        grey = grey_from_rgb(image.data, image.height, image.width, image.step)
        return self._finder.find(grey, camera, base_from_camera)

    def _ignore(self, key: str, name: Name, reason: str) -> None:
        one = f"{name[0]}:{name[1]}"
        if f"{key}{one}" not in self._ignored:
            _log.warning("Ignoring marker %s, %s", one, reason)
        self._ignored[f"{key}{one}"] = self._ignored.get(f"{key}{one}", 0) + 1

    def _map_from_camera(self, stamp_ns: int, camera_frame: str) -> Array | None:
        tolerance_ns = round(self._config.transform_tolerance_s * 1e9)
        while self._odometry:
            taken_ns, transform = self._odometry.popleft()
            self._odom_from_base.add(taken_ns, msg.matrix_from_transform(transform))
        odom_from_base = self._odom_from_base.at(stamp_ns, tolerance_ns)
        base_from_camera = self._static_frames.chain(BASE_FOOTPRINT_FRAME, camera_frame)
        if self._map_from_odom is None or odom_from_base is None or base_from_camera is None:
            return None
        map_from_odom = msg.matrix_from_transform(self._map_from_odom)
        return portable.product(map_from_odom, odom_from_base, base_from_camera)


def _depths(image: msg.Image) -> Depths:
    """(h, w) metres."""
    pixels = image.data.view(_DEPTH_TYPES[image.encoding]).reshape(image.height, image.width)
    if image.encoding == "16UC1":
        return pixels.astype(np.float32) * np.float32(0.001)
    # The kernel is compiled for arrays that can be written to.
    depth_m: Depths = pixels if pixels.flags.writeable else pixels.copy()
    return depth_m


def _nothing(image: msg.Image) -> Depths:
    """(h, w), nothing measured: of a tilted robot, the floor looks like a thing that stands there,
    or things like the floor.
    """
    return np.zeros((image.height, image.width), np.float32)


def _scan_message(stamp_ns: int, mount: Mount, scan: DepthScan) -> msg.LaserScan:
    last_rad = scan.angle_min_rad + (len(scan.ranges_m) - 1) * scan.angle_increment_rad
    return msg.LaserScan(
        header=msg.header(stamp_ns, CAMERA_FRAME),
        angle_min=msg.float32(mount.angle_rad(scan.angle_min_rad)),
        angle_max=msg.float32(mount.angle_rad(last_rad)),
        angle_increment=msg.float32(mount.angle_rad(scan.angle_increment_rad)),
        time_increment=0.0,
        scan_time=0.0,
        range_min=msg.float32(scan.range_min_m),
        range_max=msg.float32(scan.range_max_m),
        ranges=scan.ranges_m,
        intensities=scan.reaches_m,
    )


class _Search(NamedTuple):
    """What is looked for in an image."""

    stamp_ns: int
    frame: str
    found: Future[Findings]


def _detections(
    stamp_ns: int, frame: str, frame_from_camera: Array, found: list[Found]
) -> msg.Detection3DArray:
    """The message of the markers found, transformed to a frame."""
    return msg.Detection3DArray(
        header=msg.header(stamp_ns, frame),
        detections=[_detection(stamp_ns, frame, frame_from_camera, one) for one in found],
    )


def _detection(
    stamp_ns: int, frame: str, frame_from_camera: Array, found: Found
) -> msg.Detection3D:
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = frame_from_camera[:3, :3]
    results = [
        msg.ObjectHypothesisWithPose(
            hypothesis=msg.ObjectHypothesis(class_id=str(found.marker_id), score=solution.score),
            pose=msg.PoseWithCovariance(
                pose=msg.pose_from_matrix(
                    portable.product(frame_from_camera, solution.camera_from_marker)
                ),
                covariance=np.ascontiguousarray(
                    portable.product(turn, solution.covariance, turn.T).reshape(36)
                ),
            ),
        )
        for solution in found.solutions
    ]
    return msg.Detection3D(
        header=msg.header(stamp_ns, frame),
        results=results,
        bbox=msg.BoundingBox3D(
            center=results[0].pose.pose, size=msg.Vector3(found.side_m, found.side_m, 0.0)
        ),
        id=f"{found.dictionary}:{found.marker_id}",
    )
