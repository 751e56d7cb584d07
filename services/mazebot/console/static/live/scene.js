// What is known of the robot and its world, as the feed tells it.

import { gridPicture } from "./grids.js";

const MOST_TRAIL = 6000;
const TRAIL_STEP_M = 0.02;
const SMOOTH_MS = 90;
const SLOW_KINDS = ["trails", "entities", "plan", "particles", "frontiers", "trajectories", "graph", "navigation"];
/** So much of a trail is drawn with the robot, in points, before it is drawn below it. */
const TRAIL_END = 50;

/** Everything that the plan draws; `take` gives it each frame of the feed. */
export class Scene {
  #map = null;
  #moved = undefined;

  constructor() {
    /** Counts the changes of what changes seldom: world, map and costmaps; */
    this.version = 0;
    /** and of what else is drawn below the robot. */
    this.slowVersion = 0;
    this.world = null;
    this.entities = { bodies: [], markers: [], refused: [] };
    this.grids = {};
    this.beginAnew();
  }

  /** The simulation restarted: only the world stays, and the costmap made of its map. */
  beginAnew() {
    this.pose = null;
    this.shown = { truth: null, estimate: null };
    this.trails = { truth: [], estimate: [] };
    /** How many points of the trails are drawn below the robot already. */
    this.drawn = { truth: 0, estimate: 0 };
    this.scan = null;
    this.plan = [];
    this.particles = null;
    this.shapes = { frontiers: [], trajectories: [] };
    this.graph = null;
    this.goal = null;
    this.seen = new Set();
    this.visible = new Map();
    delete this.grids.local_costmap;
    this.poseTime = performance.now();
    this.version += 1;
    this.slowVersion += 1;
  }

  /** The map without the walls that the plan draws by itself: all but those that the robot maps. */
  #drawMap() {
    this.version += 1;
    if (this.#map) {
      const walls = this.world && !this.world.slam ? this.world.walls : [];
      this.grids.map = gridPicture("map", this.#map.head, this.#map.data, walls);
    }
  }

  /** Take one frame in; returns whether the plan has to be drawn again. */
  take(kind, content, data) {
    if (SLOW_KINDS.includes(kind)) {
      this.slowVersion += 1;
    }
    switch (kind) {
      case "world":
        if (this.world && this.world.hash !== content.hash) {
          this.beginAnew();
          delete this.grids.global_costmap;
        }
        this.world = content;
        this.#drawMap();
        return true;
      case "restarted":
        this.beginAnew();
        return true;
      case "map":
        this.#map = { head: content, data };
        this.#drawMap();
        return true;
      case "global_costmap":
      case "local_costmap":
        this.grids[kind] = gridPicture(kind, content, data);
        this.version += 1;
        return true;
      case "trails":
        this.trails = content;
        return true;
      case "entities":
        this.entities = content;
        return true;
      case "pose":
        this.#takePose(content);
        return true;
      case "scan":
        this.scan = scanPoints(content, new Uint16Array(data));
        return true;
      case "plan":
        this.plan = content.points_m;
        return true;
      case "particles":
        this.particles = new Float32Array(data);
        return true;
      case "frontiers":
      case "trajectories":
        this.shapes[kind] = content.shapes;
        return true;
      case "graph":
        this.graph = content;
        return true;
      case "evaluation":
        for (const [id, count] of Object.entries(content.markers_seen)) {
          if (count > 0) {
            this.seen.add(id);
          }
        }
        return true;
      case "detections":
        for (const id of content.ids) {
          const number = id.split(":").pop();
          this.seen.add(number);
          this.visible.set(number, performance.now());
        }
        return true;
      case "navigation":
        this.goal = content.goal;
        if (!content.goal && content.state === "idle") {
          this.plan = [];
          this.shapes.trajectories = [];
        }
        return true;
      default:
        return false;
    }
  }

  #takePose(content) {
    const places = JSON.stringify(content.moved);
    if (places !== this.#moved) {
      this.#moved = places;
      this.slowVersion += 1;
    }
    this.pose = content;
    this.poseTime = performance.now();
    for (const name of ["truth", "estimate"]) {
      const at = content[name];
      if (!at) {
        continue;
      }
      const trail = this.trails[name];
      const last = trail[trail.length - 1];
      if (!last || Math.hypot(at[0] - last[0], at[1] - last[1]) > TRAIL_STEP_M) {
        trail.push([at[0], at[1]]);
        if (trail.length > MOST_TRAIL) {
          trail.splice(0, MOST_TRAIL / 10);
          this.drawn[name] = 0;
        }
        if (trail.length > this.drawn[name] + TRAIL_END) {
          this.drawn[name] = trail.length;
          this.slowVersion += 1;
        }
      }
    }
  }

  /** Move what is shown towards the newest poses; returns whether it has not arrived yet. */
  smooth(elapsedMs) {
    if (!this.pose) {
      return false;
    }
    const share = 1 - Math.exp(-elapsedMs / SMOOTH_MS);
    let moves = false;
    for (const name of ["truth", "estimate"]) {
      const to = this.pose[name];
      const from = this.shown[name];
      if (!to || !from || Math.hypot(to[0] - from[0], to[1] - from[1]) > 1) {
        this.shown[name] = to ? [...to] : null;
        continue;
      }
      const turn = Math.atan2(Math.sin(to[2] - from[2]), Math.cos(to[2] - from[2]));
      moves ||= Math.hypot(to[0] - from[0], to[1] - from[1]) > 1e-4 || Math.abs(turn) > 1e-4;
      from[0] += share * (to[0] - from[0]);
      from[1] += share * (to[1] - from[1]);
      from[2] += share * turn;
    }
    return moves;
  }

  /** Where the robot is, as far as it is known: `[x, y, yaw]` or null. */
  robot() {
    return this.pose?.truth || this.pose?.estimate || null;
  }

  /** Where it is drawn: a moment behind. */
  drawnRobot() {
    return this.shown.truth || this.shown.estimate;
  }

  /** The place in the map of a body that may have moved: `[polygon, ...]`. */
  polygonsOf(body) {
    const now = this.pose?.moved?.[body.name];
    if (!now) {
      return body.polygons_m;
    }
    const [x, y, yaw] = body.pose;
    const cos = Math.cos(now[2] - yaw);
    const sin = Math.sin(now[2] - yaw);
    return body.polygons_m.map((polygon) =>
      polygon.map(([px, py]) => [
        now[0] + cos * (px - x) - sin * (py - y),
        now[1] + sin * (px - x) + cos * (py - y),
      ]),
    );
  }

  /** The smallest rectangle around the world, in m: `[left, bottom, right, top]`. */
  bounds() {
    const points = [];
    for (const wall of this.world?.walls ?? []) {
      points.push(...wall);
    }
    if (points.length === 0 && this.grids.map) {
      const { origin, width_m, height_m } = this.grids.map;
      points.push([origin[0], origin[1]], [origin[0] + width_m, origin[1] + height_m]);
    }
    if (points.length === 0) {
      points.push([-3, -3], [3, 3]);
    }
    const xs = points.map((point) => point[0]);
    const ys = points.map((point) => point[1]);
    return [Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)];
  }
}

/** The ends of a scan's beams in the map: Float32Array of x, y pairs in m. */
function scanPoints(head, ranges) {
  const [x, y, yaw] = head.pose;
  const step = (head.angle_end_rad - head.angle_min_rad) / ranges.length;
  const points = new Float32Array(2 * ranges.length);
  let count = 0;
  for (let index = 0; index < ranges.length; index += 1) {
    if (ranges[index] !== 65535) {
      const angle = yaw + head.angle_min_rad + index * step;
      points[count] = x + ranges[index] * 0.001 * Math.cos(angle);
      points[count + 1] = y + ranges[index] * 0.001 * Math.sin(angle);
      count += 2;
    }
  }
  return points.subarray(0, count);
}
