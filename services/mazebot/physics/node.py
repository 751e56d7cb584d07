"""The simulation service: advances time, moves the robot and publishes its sensors' data."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from mazebot.common.config import ConfigError
from mazebot.common.maths import portable
from mazebot.common.maths.frames import (
    BASE_FOOTPRINT_FRAME,
    CAMERA_OPTICAL_FRAME,
    SCAN_FRAME,
)
from mazebot.common.messages import messages as msg
from mazebot.common.messages.action_documents import Reply
from mazebot.common.messages.documents import (
    BodyEntity,
    EmergencyStop,
    Entities,
    Planar,
    SimulationCheckpoint,
    SimulationControl,
    SimulationControlReply,
    SimulationStats,
    Thing,
    World,
)
from mazebot.common.messages.messages import ns_from_time
from mazebot.common.messages.topics import (
    ASSETS,
    BATTERY_STATE,
    CAMERA_COMPRESSED,
    CAMERA_IMAGE,
    CAMERA_INFO,
    CLOCK,
    CMD_VEL,
    CONTACTS,
    DEPTH_IMAGE,
    DEPTH_INFO,
    DESIRED_ENTITIES,
    EMERGENCY_STOP,
    ENTITIES,
    ENTITY_MARKERS,
    GROUND_TRUTH_ODOM,
    IMU,
    JOINT_STATES,
    ODOM,
    ROBOT_DESCRIPTION,
    SCAN,
    SIMULATION_CHECKPOINT,
    SIMULATION_CONTROL,
    SIMULATION_STATS,
    TF,
    TF_STATIC,
    WORLD,
    Topic,
)
from mazebot.common.node.node import ClockNode, Inbox, Outbox
from mazebot.common.world.assets import asset_message, assets_of
from mazebot.common.world.convex.convex_parts import rough_text
from mazebot.common.world.geometry import TriangleMesh
from mazebot.common.world.placement import Placement
from mazebot.common.world.surfaces import Surface, surfaces
from mazebot.physics.assets import Assets, meshes_of
from mazebot.physics.battery import Battery
from mazebot.physics.bodies.entities import change_text, establish
from mazebot.physics.bodies.first_poses import since_reset
from mazebot.physics.bodies.robot_model import ModelError, robot_model_from_urdf
from mazebot.physics.bodies.world_limits import MAX_LENGTH_M
from mazebot.physics.camera.camera import Intrinsics
from mazebot.physics.camera.camera_messages import (
    camera_info,
    compressed_message,
    depth_message,
    image_message,
)
from mazebot.physics.camera.darkroom import Darkroom
from mazebot.physics.camera.renderers import make_renderer
from mazebot.physics.camera.scene import build_scene
from mazebot.physics.config import PhysicsConfig, steps_per_period, time_of_step_ns
from mazebot.physics.run_control import ControlRequest, RunControl
from mazebot.physics.rviz_messages import EntityMarkers, WheelFrames
from mazebot.physics.sensors import raycast
from mazebot.physics.sensors.ground_truth import ground_truth, joint_states, mover_frames
from mazebot.physics.sensors.lidar_height import seen_otherwise
from mazebot.physics.simulation import STEP_S, Simulation

_Report = Callable[[Simulation, int, Outbox], None]
_MAX_DESIRED_SETS = 4
_IMU_STEPS, _ODOM_STEPS = (steps_per_period(topic.rate_hz or 1.0) for topic in (IMU, ODOM))
"""Steps between messages"""
_CHECKPOINT_STEPS = steps_per_period(SIMULATION_CHECKPOINT.rate_hz or 1.0)
_WHEEL_STEPS = steps_per_period(10.0)
"""Steps between the frames of the wheels, which nothing but a drawing needs."""
_TILT_HZ = 10.0
_LEAST_UPRIGHT = 0.866
"""Cosine of 30 degrees: a robot that is tilted by more does not stand on its wheels."""

_OF_THE_WORLD: tuple[Topic[Any], ...] = (ASSETS, WORLD, DESIRED_ENTITIES)
_log = logging.getLogger("physics")


class PhysicsNode(ClockNode):
    """Time is stopped until a world, its assets and its set of entities are received and built.

    A process that is started again goes on where the one before was, by the checkpoint that others
    keep: the same world, run and seed, the robot at rest. Time goes on, later than anything that
    the one before has sent; the epoch is another one.

    Another world is prepared while the old one runs on, and replaces it once all its parts are
    received; time goes on. A world that cannot be built changes nothing.
    """

    name = "physics"
    _config: PhysicsConfig
    wakes = (WORLD, ASSETS, DESIRED_ENTITIES)
    depth = 32
    """Queue size for velocity commands: those of one source do not displace another's."""

    def __init__(self, config: PhysicsConfig) -> None:
        """Raises ConfigError if the robot's model or the requested renderer is not available."""
        self._config = config
        self._urdf = config.robot_urdf()
        self._battery = Battery(
            config.battery_capacity_ah, config.battery_current_a, config.battery_charge_at_start
        )
        try:
            self._model = robot_model_from_urdf(self._urdf)
            self._wheels = WheelFrames.of(self._model)
            self._footprint_from_optical = self._model.transform(
                BASE_FOOTPRINT_FRAME, CAMERA_OPTICAL_FRAME
            )
        except ModelError as error:
            raise ConfigError(f"physics: robot_model: {config.robot_model}: {error}") from error
        self._intrinsics = Intrinsics.from_horizontal_fov(
            config.camera_width_px, config.camera_height_px, config.camera_horizontal_fov_rad
        )
        kind = config.renderer if config.camera_enabled else "none"
        depth_range_m = (
            (config.camera_depth_min_m, config.camera_depth_max_m)
            if config.camera_depth_enabled
            else None
        )
        self._renderer = make_renderer(kind, self._intrinsics, depth_range_m)
        self._darkroom = None if self._renderer is None else Darkroom(self._renderer)
        self._lidar_m = float(self._model.transform(BASE_FOOTPRINT_FRAME, SCAN_FRAME)[2, 3])
        if depth_range_m is None or self._renderer is None:
            _log.info(
                "No depth camera: the robot sees only what its lidar's plane meets, %.3f m above "
                "the floor, and does not see low things, sills, table tops and glass",
                self._lidar_m,
            )
        self._timeout_ns = round(config.cmd_vel_timeout_s * 1e9)
        self._steps = 0
        self._epoch = 0
        self._resumed_from: int | None = None
        """Epoch in which the run began that a process before had; None: it began with this one."""
        self._kept: SimulationCheckpoint | None = None
        """Of the process before, until its world is loaded again."""
        self._seed = config.seed
        self._control = RunControl()
        self._assets = Assets()
        self._desired: dict[str, Entities] = {}
        self._next_world: World | None = None
        self._entities: Entities | None = None
        self._is_asked_again = False
        """Whether a spawner that comes from another world waits to hear which entities exist."""
        self._at_reset: Entities | None = None
        """The desired set at the newest reset in this world; None: there was no reset."""
        self._kept_at_reset: frozenset[str] | None = None
        """Names of the entities that it has not removed; None: all."""
        self._reset_epoch = 0
        """Epoch that began with it."""
        self._entity_markers = EntityMarkers()
        self._commander: str | None = None
        """The source of the last velocity command, while it is alive."""
        self._emergency_stop = ""
        """Why the robot is held at rest; empty: it is not."""
        self._simulation: Simulation | None = None
        self._placement: Placement | None = None
        self._surfaces: tuple[Surface, ...] = ()
        self._schedule = self._make_schedule()

    def next_step_ns(self) -> int | None:
        """The time of the next step; None before a world is loaded, and while paused."""
        if self._simulation is None or self._control.stands(self._steps):
            return None
        return time_of_step_ns(self._steps + 1)

    @property
    def now_ns(self) -> int:  # type: ignore[override]
        """See ClockNode."""
        return time_of_step_ns(self._steps)

    @property
    def speed(self) -> float:
        """See ClockNode."""
        return self._control.speed

    @speed.setter
    def speed(self, speed: float) -> None:
        self._control.speed = speed

    @property
    def paused(self) -> bool:  # type: ignore[override]
        """See ClockNode."""
        return self._control.stands(self._steps)

    def nominal_rates_hz(self) -> dict[str, float]:
        """See Node."""
        config, fixed = self._config, (
            CLOCK, TF, ODOM, JOINT_STATES, IMU, GROUND_TRUTH_ODOM, BATTERY_STATE,
        )  # fmt: skip
        rates = {topic.name: topic.rate_hz or 1.0 for topic in fixed}
        rates[SCAN.name] = config.scan_rate_hz
        if self._renderer is not None:
            sent: list[Topic[Any]] = [CAMERA_IMAGE, CAMERA_INFO]
            sent += [DEPTH_IMAGE, DEPTH_INFO] if config.camera_depth_enabled else []
            sent += [CAMERA_COMPRESSED] if config.camera_compressed_enabled else []
            rates |= {topic.name: config.camera_rate_hz for topic in sent}
        return rates

    @property
    def interventions(self) -> int:  # type: ignore[override]
        """See ClockNode."""
        return self._control.interventions

    @property
    def resting(self) -> bool:
        """See ClockNode."""
        simulation = self._simulation
        return (
            simulation is not None
            and simulation.drive.is_at_rest
            and not simulation.bodies.follows_paths
        )

    def waiting_for(self) -> str | None:
        """The missing part that keeps time from starting."""
        if self._simulation is not None:
            return None
        if self._next_world is None:
            return f"a world on {WORLD.name}"
        return self._missing(self._next_world)

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        """Process new messages and, if `now_ns` is the next step's time, advance to it."""
        has_news, inbox.has_news = inbox.has_news, False
        for request in inbox.requests(SIMULATION_CONTROL) if has_news else ():
            self._take_in_control(request, inbox, outbox)
        for stop in inbox.requests(EMERGENCY_STOP) if has_news else ():
            self._take_in_emergency_stop(stop.message, outbox)
            stop.respond(Reply())
        due = self.next_step_ns() == now_ns
        if not due:
            # A request may have paused or reset the simulation.
            now_ns = outbox.now_ns = self.now_ns
        if has_news:
            self._take_in_messages(now_ns, inbox, outbox)
        if self._commander is not None and inbox.is_gone(self._commander):
            self._commander = None
            if self._simulation is not None:
                self._simulation.drive.expire()
        if due and self._simulation is not None:
            self._advance(self._simulation, now_ns, outbox)
        ended = self._control.ended(self._steps)
        if ended is not None:
            self._answer(ended, "")
            self._publish_stats(outbox)

    def _take_in_emergency_stop(self, asked: EmergencyStop, outbox: Outbox) -> None:
        """Hold the robot at rest, or let it move again. The first reason stands until then."""
        if bool(self._emergency_stop) == asked.stop:
            return
        if asked.stop:
            self._stop_for(" ".join(asked.reason.split()) or "requested", outbox)
            return
        _log.warning("emergency stop cleared (%s): the robot may move", self._emergency_stop)
        self._emergency_stop = ""
        if self._simulation is not None:
            self._simulation.release()
        self._publish_stats(outbox)

    def _stop_for(self, reason: str, outbox: Outbox) -> None:
        self._emergency_stop = reason
        _log.error("emergency stop: %s: the robot is held until this is cleared", reason)
        if self._simulation is not None:
            self._simulation.hold()
        self._publish_stats(outbox)

    def _take_in_messages(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        if inbox.pending(SIMULATION_STATS):
            self._take_in_past(inbox, outbox)
        if self._simulation is None or any(inbox.pending(one) for one in _OF_THE_WORLD):
            self._take_in_world(now_ns, inbox, outbox)
        if inbox.pending(CMD_VEL):
            self._take_in_command(now_ns, inbox)

    def _take_in_past(self, inbox: Inbox, outbox: Outbox) -> None:
        """Continue the epoch count of the previous process."""
        past = max((stats.epoch for stats in inbox.new(SIMULATION_STATS)), default=0)
        if self._simulation is None:
            self._epoch = max(self._epoch, past)
        elif past >= self._epoch:
            self._epoch = past + 1
            self._publish_stats(outbox)

    def prepare(self) -> None:
        """See Node."""
        raycast.compile_kernels()
        if self._renderer is not None:
            self._renderer.prepare()

    def close(self) -> None:
        """Close PyBullet and the renderer."""
        if self._simulation is not None:
            self._simulation.close()
        if self._darkroom is not None:
            self._darkroom.close()
        if self._renderer is not None:
            self._renderer.close()

    def _advance(self, simulation: Simulation, now_ns: int, outbox: Outbox) -> None:
        self._steps += 1
        drive = simulation.drive
        stops = drive.watchdog_stops
        contacts = simulation.step(now_ns)
        if contacts is None:
            self._respawn_entities(simulation, outbox)
        else:
            for contact in contacts:
                _log.info("%s touches %s", contact.robot_link, contact.body)
                outbox.put(CONTACTS, contact)
        if drive.watchdog_stops > stops:
            timeout_s = self._config.cmd_vel_timeout_s
            if self._commander is None:
                _log.warning("publisher of velocity commands is gone: stopping the robot")
            else:
                _log.warning("no velocity command for %g s: stopping the robot", timeout_s)
        for report in self._schedule[self._steps % len(self._schedule)]:
            report(simulation, now_ns, outbox)

    def _respawn_entities(self, simulation: Simulation, outbox: Outbox) -> None:
        """Report that PyBullet's state was not physical, and respawn the entities."""
        _log.error("invalid state of a body: rebuilt world '%s'", self._name())
        self._epoch += 1
        self._resumed_from = None
        self._place_entities(simulation.world, outbox)
        self._publish_stats(outbox)

    def _take_in_control(self, request: ControlRequest, inbox: Inbox, outbox: Outbox) -> None:
        asked = request.message
        asked_s = self.now_ns * 1e-9
        error = self._control.problem(asked, self._steps)
        if not error and asked.reset is not None:
            error = self._reset(asked, inbox, outbox)
        if not error and asked.robot_pose is not None:
            error = self._move_robot(asked.robot_pose)
        if error:
            self._answer(request, error)
            return
        cut = self._control.apply(request, self._steps)
        if cut is not None:
            self._answer(cut, f"interrupted at {asked_s:.6g} s by a newer request")
        if not self._control.running(request):
            self._answer(request, "")
        if asked.model_dump(exclude_none=True):
            self._publish_stats(outbox)
        if asked.reset is not None:
            # The schedule publishes none while time is stopped.
            outbox.put(CLOCK, msg.Clock(clock=msg.time_from_ns(0)))

    def _reset(self, asked: SimulationControl, inbox: Inbox, outbox: Outbox) -> str:
        """Reset all, or only the clock, to time 0; returns an error in one line, or empty."""
        old = self._simulation
        if old is None:
            return f"reset: {asked.reset}: no world loaded yet"
        seed = self._seed if asked.seed is None else asked.seed
        if asked.reset == "time":
            self._read_out(old)
            old.restart_clock(self.now_ns)
        else:
            try:
                self._simulation = self._simulation_of(old.world, old.meshes, seed)
            except ValueError as error:
                return f"reset: {asked.reset}: {error}"
            old.close()
        # Drop the commands that were sent before the reset.
        inbox.new(CMD_VEL)
        self._resumed_from = None
        self._seed = seed
        self._steps = 0
        self._epoch += 1
        outbox.now_ns = 0
        _log.info("world '%s' reset: %s, seed %d", old.world.name, asked.reset, seed)
        if self._simulation is not None and self._simulation is not old:
            own = frozenset(marker.name for marker in old.world.markers)
            self._put_back_entities(old.world, own if asked.reset == "fresh" else None, outbox)
            # Nothing else publishes the moving bodies' poses while time is stopped.
            frames = mover_frames(self._simulation.bodies, 0)
            if frames:
                outbox.put(TF, msg.TFMessage(transforms=frames))
        return ""

    def _move_robot(self, pose: Planar) -> str:
        """Put the robot down at another pose; returns an error in one line, or empty."""
        prefix = f"robot_pose: ({pose.x_m:g}, {pose.y_m:g}, {pose.yaw_rad:g}): "
        if self._simulation is None:
            return prefix + "no world loaded yet"
        if max(abs(pose.x_m), abs(pose.y_m)) > MAX_LENGTH_M:
            return prefix + f"must be within {MAX_LENGTH_M:g} m"
        reason = self._simulation.bodies.move_robot(pose.se2())
        if not reason:
            _log.info("robot moved to (%g, %g, %g)", pose.x_m, pose.y_m, pose.yaw_rad)
        return prefix + reason if reason else ""

    def _read_out(self, simulation: Simulation) -> None:
        """Update the sensors that measure changes with the change since their last message."""
        since_imu = self._steps % _IMU_STEPS
        if since_imu:
            simulation.imu.read(self.now_ns, since_imu * STEP_S)
        since_odom = self._steps % _ODOM_STEPS
        if since_odom:
            simulation.odometry.update(simulation.wheel_angles_rad, since_odom * STEP_S)

    def _simulation_of(
        self, world: World, meshes: Mapping[str, TriangleMesh], seed: int
    ) -> Simulation:
        """Raises ValueError, in one line, where the world cannot be built."""
        config = self._config.model_copy(update={"seed": seed})
        simulation = Simulation(world, self._model, config, meshes)
        if self._emergency_stop:
            # It holds whatever is reset or loaded.
            simulation.hold()
        return simulation

    def _answer(self, request: ControlRequest, error: str) -> None:
        stats = None if self._simulation is None else self._stats(self._simulation)
        request.respond(SimulationControlReply(error=error, stats=stats))

    def _publish_stats(self, outbox: Outbox) -> None:
        simulation = self._simulation
        if simulation is not None:
            outbox.put(SIMULATION_STATS, self._stats(simulation))
            outbox.offer(SIMULATION_CHECKPOINT, lambda: self._checkpoint(simulation))

    def _take_in_command(self, now_ns: int, inbox: Inbox) -> None:
        """Accept the commands of one source until it stops the robot or times out; those of others
        are rejected.
        """
        arrivals = inbox.arrivals(CMD_VEL)
        if self._simulation is None:
            return
        drive = self._simulation.drive
        for command, envelope in arrivals:
            stamp_ns = ns_from_time(command.header.stamp)
            # A zero stamp comes from a sender without a clock and counts as now.
            if stamp_ns and abs(now_ns - stamp_ns) > self._timeout_ns:
                inbox.reject(CMD_VEL, "stale" if stamp_ns < now_ns else "stamp in the future")
            elif self._is_held_against(envelope.source, inbox):
                inbox.reject(CMD_VEL, "another publisher is in control")
            elif self._emergency_stop:
                inbox.reject(CMD_VEL, "emergency stop")
            else:
                self._commander = envelope.source
                drive.command(command.twist.linear.x, command.twist.angular.z, now_ns)

    def _is_held_against(self, source: str, inbox: Inbox) -> bool:
        """Whether another source drives the robot: it is alive and has not timed out."""
        holder = self._commander
        if holder is None or holder == source or self._simulation is None:
            return False
        return self._simulation.drive.is_driven and not inbox.is_gone(holder)

    def _take_in_world(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        for asset in inbox.new(ASSETS):
            reason = self._assets.add(asset, self._assets_in_use)
            if reason:
                inbox.reject(ASSETS, reason)
        world = inbox.latest(WORLD)
        if world is not None:
            self._take_in_newest_world(world, inbox)
        for desired in inbox.new(DESIRED_ENTITIES):
            self._take_in_desired(desired, outbox)
        epoch, is_first = self._epoch, self._simulation is None
        if is_first:
            self._kept = inbox.latest(SIMULATION_CHECKPOINT) or self._kept
            if not inbox.is_handed_over:
                return
        if self._next_world is not None and self._missing(self._next_world) is None:
            self._load(self._next_world, now_ns, inbox, outbox)
            self._next_world = None
        if self._simulation is not None:
            self._place_entities(self._simulation.world, outbox)
            if self._kept is not None:
                self._resume(self._kept, self._simulation, outbox)
                self._kept = None
        if self._epoch != epoch:
            self._publish_stats(outbox)

    def _take_in_desired(self, desired: Entities, outbox: Outbox) -> None:
        """Keep the newest set of each of the last few worlds."""
        newest = next(reversed(self._desired), None)
        starts = desired.revision == 0 and newest == desired.world_hash == self.world_hash
        if starts and self._entities:
            # A spawner that has just started does not know what was spawned, moved and deleted;
            # one that comes from another world begins this one anew.
            standing = self._entities.entities
            refused = {refusal.name for refusal in self._entities.refused}
            refused -= {entity.name for entity in standing}
            again = [entity for entity in desired.entities if entity.name in refused]
            desired = self._entities.model_copy(
                update={"revision": 0, "entities": (*standing, *again), "refused": desired.refused}
            )
            self._hand_over(self._entities, outbox)
        if newest != desired.world_hash == self.world_hash:
            # The other world was refused: nothing need change here for the spawner to be answered.
            self._is_asked_again = True
        self._desired.pop(desired.world_hash, None)
        self._desired[desired.world_hash] = desired
        while len(self._desired) > _MAX_DESIRED_SETS:
            del self._desired[next(iter(self._desired))]

    def _forget_worlds_before(self, world: World) -> None:
        """Drop the sets that came before this world's: one that is loaded again begins anew."""
        while next(iter(self._desired)) != world.hash:
            del self._desired[next(iter(self._desired))]

    def _hand_over(self, entities: Entities, outbox: Outbox) -> None:
        """Publish the existing entities' assets: those of a spawner are gone when it ends."""
        for sha256 in assets_of(*entities.entities, *entities.deleted):
            outbox.put(ASSETS, asset_message(sha256, self._assets.files[sha256]))

    def _take_in_newest_world(self, world: World, inbox: Inbox) -> None:
        if world.hash == self.world_hash:
            self._next_world = None
        elif world.content_hash() != world.hash:
            inbox.reject(WORLD, "hash mismatch")
            _log.error(
                "world '%s' rejected: hash: %s does not match its content", world.name, world.hash
            )
        else:
            self._next_world = world

    def _missing(self, world: World) -> str | None:
        """A phrase for the first missing part of a world; None if it is complete."""
        missing = self._assets.missing(assets_of(world))
        if missing:
            return f"assets of the world on {ASSETS.name}: {_digests(missing)}"
        desired = self._desired.get(world.hash)
        if desired is None:
            return f"the entities on {DESIRED_ENTITIES.name}"
        missing = self._assets.missing(assets_of(*desired.entities, *desired.deleted))
        if missing:
            return f"assets of the entities on {ASSETS.name}: {_digests(missing)}"
        return None

    def _assets_in_use(self) -> set[str]:
        worlds = [self._next_world, self._simulation.world if self._simulation else None]
        sets = (*self._desired.values(), *filter(None, [self._entities]))
        entities = (entity for one in sets for entity in (*one.entities, *one.deleted))
        return set(assets_of(*filter(None, worlds), *entities))

    def _resume(self, kept: SimulationCheckpoint, simulation: Simulation, outbox: Outbox) -> None:
        """Go on where the process before was."""
        simulation.restore(kept)
        self._control.restore(kept.paused, kept.speed)
        # Nothing that the process before has sent must be later.
        self._steps = kept.iterations + 2 * _CHECKPOINT_STEPS
        self._resumed_from = kept.run_epoch
        outbox.now_ns = self.now_ns
        pose = simulation.bodies.footprint_pose()
        _log.warning(
            "simulation resumed after step %d, at %.3f s: robot at (%.2f, %.2f, %.2f)",
            kept.iterations, self.now_ns * 1e-9, *pose,
        )  # fmt: skip

    def _load(self, world: World, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        kept, self._kept = self._kept, None
        if kept is not None and not self._emergency_stop:
            self._emergency_stop = kept.emergency_stop
        if kept is not None and kept.world_hash != world.hash:
            kept = None
        if kept is not None:
            self._seed = kept.seed
            self._epoch = max(self._epoch, kept.epoch)
        try:
            meshes = meshes_of(world.bodies, self._assets.files)
            simulation = self._simulation_of(world, meshes, self._seed)
            try:
                seen = surfaces(world, meshes) if self._renderer is not None else ()
                placement = Placement(world, meshes)
            except ValueError:
                simulation.close()
                raise
        except ValueError as error:
            inbox.reject(WORLD, "cannot be built")
            _log.error("world '%s' rejected: %s", world.name, error)
            return
        if self._simulation is not None:
            self._simulation.close()
        if kept is not None:
            simulation.bodies.set_robot_aside()
        self._kept, self._resumed_from = kept, None
        self._forget_worlds_before(world)
        self._simulation = simulation
        self._placement = placement
        self._surfaces = seen
        self._entities = self._at_reset = None
        self._epoch += 1
        self.world_hash = world.hash
        walls, things, start = len(world.walls), len(world.bodies), world.start
        _log.info(
            "world '%s' (%s) loaded: %d walls,%s robot at (%g, %g, %g)",
            *(world.name, world.hash, walls, f" {things} bodies," if things else ""),
            *(start.x_m, start.y_m, start.yaw_rad),
        )
        _warn_of_rough(world.bodies, meshes)
        otherwise = seen_otherwise(world, meshes, self._lidar_m)
        if otherwise:
            _log.warning("%s", otherwise)
        transforms = [
            msg.transform_stamped(now_ns, joint.parent, joint.child, joint.parent_from_child)
            for joint in self._model.fixed_joints()
        ]
        outbox.put(TF_STATIC, msg.TFMessage(transforms=transforms))
        outbox.put(ROBOT_DESCRIPTION, msg.String(data=self._urdf))

    def _wanted(self, world: World) -> Entities | None:
        """The desired set, put back by the newest reset if the spawner does not know of it yet."""
        desired, at_reset = self._desired.get(world.hash), self._at_reset
        if desired is None or at_reset is None or desired.reset_epoch >= self._reset_epoch:
            return desired
        put_back = since_reset(desired, at_reset, self._kept_at_reset)
        return put_back.model_copy(update={"reset_epoch": self._reset_epoch})

    def _put_back_entities(self, world: World, kept: frozenset[str] | None, outbox: Outbox) -> None:
        """Place the entities, or only those `kept`, where they were first, in a simulation that has
        none yet. Where one of them would be in another's way so, they stay where they were moved
        to.
        """
        desired = self._desired.get(world.hash)
        if desired is None or self._placement is None or self._simulation is None:
            return
        self._at_reset, self._kept_at_reset = desired, kept
        self._reset_epoch = self._epoch
        to = self._assets.files, self._placement, self._simulation.bodies
        first = self._wanted(world) or desired
        standing = establish(first, None, *to)
        if standing.refused and kept is None:
            as_moved = establish(desired, standing, *to)
            if len(as_moved.entities) > len(standing.entities):
                refusal = standing.refused[0]
                _log.warning(
                    "entities stay where they were moved to: entity '%s' at its first place: %s",
                    refusal.name, refusal.reason,
                )  # fmt: skip
                self._at_reset = None
                standing = as_moved
            else:
                standing = establish(first, as_moved, *to)
        self._place_entities(world, outbox, standing)

    def _place_entities(
        self, world: World, outbox: Outbox, standing: Entities | None = None
    ) -> None:
        """Bring the entities, those that stand or those published last, to the desired set as far
        as possible; publish only a change, or what is asked for again.
        """
        desired = self._wanted(world)
        if desired is None or self._placement is None or self._simulation is None:
            return
        before, files = self._entities, self._assets.files
        entities = establish(
            desired, standing or before, files, self._placement, self._simulation.bodies
        )
        if entities == before and not self._is_asked_again:
            return
        self._entities, self._is_asked_again = entities, False
        if before is None or entities.entities != before.entities:
            if self._renderer is not None and self._darkroom is not None:
                self._darkroom.finish()
                scene = build_scene(world, files, entities.entities, self._surfaces)
                for problem in scene.problems:
                    _log.warning("%s", problem)
                self._renderer.set_scene(scene)
            fresh = _with_other_shapes(before, entities)
            _warn_of_rough(fresh, meshes_of(fresh, files))
            changes = change_text(before, entities)
            if changes:
                _log.info("world '%s': %s", world.name, changes)
        for refusal in entities.refused:
            if before is None or refusal not in before.refused:
                _log.warning("entity '%s' rejected: %s", refusal.name, refusal.reason)
        outbox.put(ENTITIES, entities)
        if before is None or entities.entities != before.entities:
            self._put_entity_markers(entities, self._simulation, outbox)

    def _put_entity_markers(
        self, entities: Entities, simulation: Simulation, outbox: Outbox
    ) -> None:
        bodies = [one for one in entities.entities if isinstance(one, BodyEntity)]
        markers = self._entity_markers.array(
            entities, simulation.world, meshes_of(bodies, self._assets.files),
            simulation.bodies.mover_names, self.now_ns,
        )  # fmt: skip
        outbox.put(ENTITY_MARKERS, markers)

    def _name(self) -> str:
        return self._simulation.world.name if self._simulation is not None else ""

    def _make_schedule(self) -> list[list[_Report]]:
        """What to publish after each step of a cycle. The clock comes last, after all else."""
        rates: list[tuple[float | None, _Report]] = [
            (IMU.rate_hz, self._put_imu),
            (ODOM.rate_hz, self._put_odometry),
            (self._config.scan_rate_hz, self._put_scan),
            (BATTERY_STATE.rate_hz, self._put_battery),
            (SIMULATION_STATS.rate_hz, self._put_stats),
            (_TILT_HZ, self._look_at_tilt),
            (SIMULATION_CHECKPOINT.rate_hz, self._put_checkpoint),
            (CLOCK.rate_hz, self._put_clock),
        ]
        if self._renderer is not None:
            # After the statistics, which wait for the hash of all pictures before.
            rates.insert(-1, (self._config.camera_rate_hz, self._put_picture))
        periods = [(steps_per_period(rate or 1.0), report) for rate, report in rates]
        cycle = math.lcm(*(period for period, _ in periods))
        return [
            [report for period, report in periods if step % period == 0] for step in range(cycle)
        ]

    def _put_imu(self, simulation: Simulation, now_ns: int, outbox: Outbox) -> None:
        outbox.offer(IMU, lambda: simulation.imu.read(now_ns, _IMU_STEPS * STEP_S))

    def _put_odometry(self, simulation: Simulation, now_ns: int, outbox: Outbox) -> None:
        bodies, odometry = simulation.bodies, simulation.odometry
        angles_rad = simulation.wheel_angles_rad
        odometry.update(angles_rad, _ODOM_STEPS * STEP_S)
        transforms = [*odometry.transform(now_ns).transforms, *mover_frames(bodies, now_ns)]
        if self._steps % _WHEEL_STEPS == 0:
            transforms += self._wheels.transforms(angles_rad, now_ns)
        outbox.put(TF, msg.TFMessage(transforms=transforms))
        outbox.put(ODOM, odometry.message(now_ns))
        speeds_rad_s = simulation.wheel_speeds_rad_s
        outbox.offer(JOINT_STATES, lambda: joint_states(angles_rad, speeds_rad_s, now_ns))
        outbox.offer(GROUND_TRUTH_ODOM, lambda: ground_truth(bodies, now_ns))

    def _put_battery(self, _: Simulation, now_ns: int, outbox: Outbox) -> None:
        outbox.offer(BATTERY_STATE, lambda: self._battery.message(now_ns))

    def _put_scan(self, simulation: Simulation, now_ns: int, outbox: Outbox) -> None:
        outbox.put(SCAN, simulation.lidar.read(now_ns))

    def _put_picture(self, simulation: Simulation, now_ns: int, outbox: Outbox) -> None:
        if self._darkroom is None:
            return
        map_from_optical = portable.product(
            simulation.bodies.map_from_footprint(), self._footprint_from_optical
        )
        taken = self._darkroom.take(
            map_from_optical,
            simulation.bodies.map_from_movers(),
            simulation.camera_noise,
            simulation.image_hash,
        )
        info = camera_info(now_ns, self._intrinsics)
        outbox.put(CAMERA_INFO, info)
        outbox.put(CAMERA_IMAGE, image_message(now_ns, self._intrinsics, taken))
        if self._config.camera_compressed_enabled:
            quality = self._config.camera_jpeg_quality
            rgb = taken.picture().rgb
            outbox.put(CAMERA_COMPRESSED, compressed_message(now_ns, rgb, quality))
        if self._config.camera_depth_enabled:
            outbox.put(DEPTH_INFO, info)
            outbox.put(DEPTH_IMAGE, depth_message(now_ns, self._intrinsics, taken))

    def _put_stats(self, simulation: Simulation, now_ns: int, outbox: Outbox) -> None:
        outbox.put(SIMULATION_STATS, self._stats(simulation))

    def _stats(self, simulation: Simulation) -> SimulationStats:
        if self._darkroom is not None:
            self._darkroom.finish()
        return SimulationStats(
            world_hash=simulation.world.hash,
            sim_time_s=time_of_step_ns(self._steps) * 1e-9,
            iterations=self._steps,
            step_size_s=STEP_S,
            paused=self.paused,
            speed=self.speed,
            seed=self._seed,
            epoch=self._epoch,
            resumed_from=self._resumed_from,
            entities=len(self._entities.entities) if self._entities is not None else 0,
            renderer="none" if self._renderer is None else self._renderer.name,
            state_hash=simulation.state_hash.hex(),
            image_hash="" if self._renderer is None else simulation.image_hash.hex(),
            watchdog_stops=simulation.watchdog_stops,
            emergency_stop=self._emergency_stop,
        )

    def _look_at_tilt(self, simulation: Simulation, now_ns: int, outbox: Outbox) -> None:
        """Stop a robot that has fallen: its wheels say nothing of where it is."""
        upright = float(simulation.bodies.map_from_footprint()[2, 2])
        if self._emergency_stop or upright >= _LEAST_UPRIGHT:
            return
        self._stop_for("the robot is tilted by more than 30 degrees", outbox)

    def _put_checkpoint(self, simulation: Simulation, now_ns: int, outbox: Outbox) -> None:
        outbox.offer(SIMULATION_CHECKPOINT, lambda: self._checkpoint(simulation))

    def _checkpoint(self, simulation: Simulation) -> SimulationCheckpoint:
        robot, movers = simulation.bodies.checkpoints()
        return SimulationCheckpoint(
            world_hash=simulation.world.hash,
            epoch=self._epoch,
            run_epoch=self._epoch if self._resumed_from is None else self._resumed_from,
            seed=self._seed,
            iterations=self._steps,
            paused=self.paused,
            speed=self.speed,
            robot=robot,
            wheel_angles_rad=simulation.bodies.state.wheel_angles_rad,
            odom_from_base=Planar.of(simulation.odometry.odom_from_footprint),
            odom_covariance=tuple(simulation.odometry.planar_covariance),
            movers=tuple(movers),
            watchdog_stops=simulation.watchdog_stops,
            emergency_stop=self._emergency_stop,
        )

    def _put_clock(self, _: Simulation, now_ns: int, outbox: Outbox) -> None:
        outbox.offer(CLOCK, lambda: msg.Clock(clock=msg.time_from_ns(now_ns)))


def _digests(sha256s: list[str]) -> str:
    """The first few, short enough for a line."""
    more = f" and {len(sha256s) - 3} more" if len(sha256s) > 3 else ""
    return ", ".join(sha256[:16] for sha256 in sha256s[:3]) + more


def _warn_of_rough(bodies: Sequence[Thing], meshes: Mapping[str, TriangleMesh]) -> None:
    rough = rough_text(bodies, meshes)
    if rough:
        _log.warning("%s", rough)


def _with_other_shapes(before: Entities | None, after: Entities) -> list[BodyEntity]:
    """The bodies that are new, or have other shapes than before."""
    old = {one.name: one for one in (before.entities if before is not None else ())}
    return [
        one
        for one in after.entities
        if isinstance(one, BodyEntity) and getattr(old.get(one.name), "shapes", ()) != one.shapes
    ]
