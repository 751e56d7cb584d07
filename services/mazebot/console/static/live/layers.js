// How each layer of the plan is drawn. `pen` has the context and the transform of the moment.

export const COLORS = {
  truth: "#2ecc71",
  estimate: "#ff8c00",
  plan: "#3498ff",
  scan: "#ff3c3c",
  marker: "#ff00c8",
  unseen: "#8a8f98",
  particle: "#e6a700",
  goal: "#0958c4",
  wall: "#5b4636",
  body: "#9b6b43",
  room: "#4b5563",
  measure: "#b3005e",
  halo: "#ffffffd8",
  keepout: "#cf222e",
  speed: "#bf8700",
};

/** The outline of a TurtleBot3 waffle, in m in base_footprint. */
const FOOTPRINT = [
  [0.0685, 0.1325], [0.03, 0.153], [-0.03, 0.153], [-0.1965, 0.1325],
  [-0.1965, -0.1325], [-0.03, -0.153], [0.03, -0.153], [0.0685, -0.1325],
];
/** Standard deviations within which 95 % of a planar Gaussian lie. */
const ELLIPSE_95 = Math.sqrt(5.991);
const VISIBLE_MS = 1500;

/** A trail has a gap where its points are further apart: something was put elsewhere. */
const TRAIL_GAP_M = 2.5;
/** Points of a line that are nearer to each other add nothing to see. */
const LEAST_PX = 3;
/** Where a name may stand instead, if another one stands there: below or above, in px. */
const ASIDE_PX = [0, 14, -14, 28, -28];

/**
 * Layers from the lowest to the highest: key, name, colour, whether shown at first, drawing. Names and
 * scan lie above all that could hide them. The `FIXED` lowest change seldom, those up to `SLOW` with
 * messages that come a few times a second.
 */
export const FIXED = 5;
export const SLOW = 12;
export const LAYERS = [
  ["map", "Map", "#ffffff", true, drawMap],
  ["global_costmap", "Global costmap", "#7f007f", false, (pen, scene) => drawGrid(pen, scene.grids.global_costmap)],
  ["local_costmap", "Local costmap", "#ff00ff", false, (pen, scene) => drawGrid(pen, scene.grids.local_costmap)],
  ["zones", "Zones", COLORS.speed, true, drawZones],
  ["walls", "Walls", COLORS.wall, true, drawWalls],
  ["bodies", "Bodies", COLORS.body, true, drawBodies],
  ["frontiers", "Frontiers", "#2ecc71", true, (pen, scene) => drawShapes(pen, scene.shapes.frontiers)],
  ["graph", "Pose graph", COLORS.plan, true, drawGraph],
  ["trails", "Driven trails", COLORS.truth, true, drawTrails],
  ["trajectories", "Trajectories", "#9acd32", false, (pen, scene) => drawShapes(pen, scene.shapes.trajectories)],
  ["plan", "Path", COLORS.plan, true, (pen, scene) => drawLine(pen, scene.plan, COLORS.plan, 3)],
  ["particles", "Particles", COLORS.particle, false, drawParticles],
  ["markers", "Markers", COLORS.marker, true, drawMarkers],
  ["locations", "Locations", COLORS.goal, true, drawLocations],
  ["robot", "Robot", COLORS.truth, true, drawRobot],
  ["scan", "Scan", COLORS.scan, true, drawScan],
  ["names", "Names", COLORS.room, true, drawNames],
];

function drawMap(pen, scene) {
  drawGrid(pen, scene.grids.map);
}

function drawGrid(pen, grid) {
  if (!grid) {
    return;
  }
  const { context } = pen;
  const [x, y] = pen.at(grid.origin[0], grid.origin[1]);
  context.save();
  context.translate(x, y);
  context.rotate(-grid.origin[2]);
  context.imageSmoothingEnabled = false;
  const height = grid.height_m * pen.scale;
  context.drawImage(grid.canvas, 0, -height, grid.width_m * pen.scale, height);
  context.restore();
}

function polygon(pen, points) {
  const { context } = pen;
  context.beginPath();
  points.forEach(([x, y], index) => {
    const [px, py] = pen.at(x, y);
    if (index) {
      context.lineTo(px, py);
    } else {
      context.moveTo(px, py);
    }
  });
  context.closePath();
}

function drawZones(pen, scene) {
  const { context } = pen;
  const world = scene.world;
  if (!world) {
    return;
  }
  for (const [zones, color] of [[world.keepout_zones, COLORS.keepout], [world.speed_limits, COLORS.speed]]) {
    context.fillStyle = `${color}40`;
    context.strokeStyle = color;
    for (const zone of zones) {
      polygon(pen, zone);
      context.fill();
      context.stroke();
    }
  }
}

/** Where the robot makes the map, only the outlines of the true walls: the others are on the map. */
function drawWalls(pen, scene) {
  const { context } = pen;
  context.fillStyle = context.strokeStyle = COLORS.wall;
  context.lineWidth = 1;
  for (const wall of scene.world?.walls ?? []) {
    polygon(pen, wall);
    if (scene.world.slam) {
      context.stroke();
    } else {
      context.fill();
    }
  }
}

function drawBodies(pen, scene) {
  const { context } = pen;
  context.strokeStyle = "#00000080";
  context.lineWidth = 1;
  for (const body of [...(scene.world?.bodies ?? []), ...scene.entities.bodies]) {
    context.fillStyle = COLORS.body;
    for (const points of scene.polygonsOf(body)) {
      polygon(pen, points);
      context.fill();
      context.stroke();
    }
  }
}

function drawShapes(pen, shapes) {
  const { context } = pen;
  for (const shape of shapes) {
    const color = `rgb(${shape.rgb.join(",")})`;
    if (shape.is_line) {
      drawLine(pen, shape.points_m, color, Math.max(1, shape.width_m * pen.scale));
      continue;
    }
    context.fillStyle = color;
    const side = Math.max(2, shape.width_m * pen.scale);
    for (const [x, y] of shape.points_m) {
      const [px, py] = pen.at(x, y);
      context.fillRect(px - side / 2, py - side / 2, side, side);
    }
  }
}

function drawGraph(pen, scene) {
  const { context } = pen;
  if (!scene.graph) {
    return;
  }
  for (const isLoop of [false, true]) {
    context.strokeStyle = isLoop ? COLORS.marker : COLORS.plan;
    context.lineWidth = 1;
    context.beginPath();
    for (const [from, to, closes] of scene.graph.edges) {
      if (closes === isLoop) {
        context.moveTo(...pen.at(...scene.graph.nodes[from]));
        context.lineTo(...pen.at(...scene.graph.nodes[to]));
      }
    }
    context.stroke();
  }
  context.fillStyle = COLORS.plan;
  for (const node of scene.graph.nodes) {
    dot(pen, node[0], node[1], 2);
  }
  context.fillStyle = COLORS.marker;
  for (const [, x, y] of scene.graph.markers) {
    dot(pen, x, y, 4);
  }
}

/** All but the ends, which are drawn with the robot: a long line takes long. */
function drawTrails(pen, scene) {
  for (const name of ["estimate", "truth"]) {
    scene.drawn[name] = scene.trails[name].length;
    drawTrail(pen, name, scene.trails[name]);
  }
}

/** The ends of the trails, from where they are drawn already to the robot. */
export function drawTrailEnds(pen, scene) {
  for (const name of ["estimate", "truth"]) {
    const end = scene.trails[name].slice(Math.max(scene.drawn[name] - 1, 0));
    drawTrail(pen, name, scene.shown[name] ? [...end, scene.shown[name]] : end);
  }
}

function drawTrail(pen, name, points) {
  const [color, width] = { estimate: [`${COLORS.estimate}90`, 1.5], truth: [`${COLORS.truth}b0`, 2] }[name];
  drawLine(pen, points, color, width, TRAIL_GAP_M);
}

function drawLine(pen, points, color, width, gapM = Infinity) {
  if (points.length < 2) {
    return;
  }
  const { context } = pen;
  context.strokeStyle = color;
  context.lineWidth = width;
  context.lineJoin = "round";
  context.beginPath();
  context.moveTo(...pen.at(points[0][0], points[0][1]));
  let [fromX, fromY] = points[0];
  const leastM = LEAST_PX / pen.scale;
  for (let index = 1; index < points.length; index += 1) {
    const [x, y] = points[index];
    const farM = Math.abs(x - fromX) + Math.abs(y - fromY);
    if (farM < leastM && index < points.length - 1) {
      continue;
    }
    if (farM > gapM) {
      context.moveTo(...pen.at(x, y));
    } else {
      context.lineTo(...pen.at(x, y));
    }
    [fromX, fromY] = [x, y];
  }
  context.stroke();
}

function drawParticles(pen, scene) {
  const { context } = pen;
  const particles = scene.particles;
  if (!particles) {
    return;
  }
  context.strokeStyle = COLORS.particle;
  context.lineWidth = 1;
  context.beginPath();
  for (let index = 0; index + 2 < particles.length; index += 3) {
    const [x, y] = pen.at(particles[index], particles[index + 1]);
    const yaw = particles[index + 2];
    context.moveTo(x, y);
    context.lineTo(x + 7 * Math.cos(yaw), y - 7 * Math.sin(yaw));
  }
  context.stroke();
}

function drawScan(pen, scene) {
  if (!scene.scan) {
    return;
  }
  const { context } = pen;
  context.fillStyle = COLORS.scan;
  const side = Math.min(4, Math.max(2, 0.03 * pen.scale));
  for (let index = 0; index < scene.scan.length; index += 2) {
    const [x, y] = pen.at(scene.scan[index], scene.scan[index + 1]);
    context.fillRect(x - side / 2, y - side / 2, side, side);
  }
}

function drawMarkers(pen, scene) {
  const { context } = pen;
  const now = performance.now();
  for (const marker of scene.entities.markers) {
    const id = String(marker.id);
    const seen = scene.seen.has(id);
    const isVisible = now - (scene.visible.get(id) ?? -VISIBLE_MS) < VISIBLE_MS;
    const [x, y] = pen.at(marker.x_m, marker.y_m);
    const half = Math.max(5, (marker.size_m * pen.scale) / 2);
    const [cos, sin] = [Math.cos(marker.heading_rad), Math.sin(marker.heading_rad)];
    context.strokeStyle = seen ? COLORS.marker : COLORS.unseen;
    context.lineWidth = isVisible ? 7 : 4;
    context.beginPath();
    context.moveTo(x - sin * half, y - cos * half);
    context.lineTo(x + sin * half, y + cos * half);
    context.stroke();
  }
}

function drawLocations(pen, scene) {
  pen.context.fillStyle = COLORS.goal;
  for (const place of scene.world?.locations ?? []) {
    dot(pen, place.x_m, place.y_m, 3);
  }
}

/** The names of what is shown: of markers, locations and rooms. */
function drawNames(pen, scene) {
  const taken = [];
  for (const marker of pen.shows("markers") ? scene.entities.markers : []) {
    const seen = scene.seen.has(String(marker.id));
    const [x, y] = pen.at(marker.x_m, marker.y_m);
    const at = [x + 13 * Math.cos(marker.heading_rad), y - 13 * Math.sin(marker.heading_rad) + 4];
    const text = seen ? String(marker.id) : `${marker.id}?`;
    writeName(pen, text, at, "center", seen ? COLORS.marker : COLORS.room, pen.font(12, seen), taken);
  }
  for (const place of pen.shows("locations") ? (scene.world?.locations ?? []) : []) {
    const [x, y] = pen.at(place.x_m, place.y_m);
    writeName(pen, place.name, [x + 6, y - 4], "left", COLORS.goal, pen.font(11), taken);
  }
  for (const room of scene.world?.rooms ?? []) {
    const middle = room.polygon_m.reduce((sum, point) => [sum[0] + point[0], sum[1] + point[1]], [0, 0]);
    const at = pen.at(middle[0] / room.polygon_m.length, middle[1] / room.polygon_m.length);
    writeName(pen, room.name, at, "center", COLORS.room, pen.font(12), taken);
  }
}

/** Text with a light rim; it moves aside where there is one already. */
function writeName(pen, text, [x, y], align, color, font, taken) {
  const { context } = pen;
  context.font = font;
  context.textAlign = align;
  const width = pen.widthOf(text, font);
  const left = align === "center" ? x - width / 2 : x;
  const isFree = (aside) =>
    !taken.some(
      (one) => left < one.right && left + width > one.left && Math.abs(y + aside - one.y) < ASIDE_PX[1],
    );
  const shift = ASIDE_PX.find(isFree) ?? 0;
  taken.push({ left, right: left + width, y: y + shift });
  context.lineJoin = "round";
  context.lineWidth = 3;
  context.strokeStyle = COLORS.halo;
  context.strokeText(text, x, y + shift);
  context.fillStyle = color;
  context.fillText(text, x, y + shift);
}

/** The outline of a box that is to be placed. */
export function boxOutline(pen, [x, y, yaw], [length, width], color) {
  const [cos, sin] = [Math.cos(yaw), Math.sin(yaw)];
  const corners = [[1, 1], [-1, 1], [-1, -1], [1, -1]].map(([a, b]) => [(a * length) / 2, (b * width) / 2]);
  polygon(pen, corners.map(([a, b]) => [x + cos * a - sin * b, y + sin * a + cos * b]));
  const { context } = pen;
  context.setLineDash([5, 3]);
  context.strokeStyle = color;
  context.lineWidth = 2;
  context.stroke();
  context.setLineDash([]);
}

/** A line between two places with its length. */
export function measured(pen, from, to) {
  const { context } = pen;
  context.strokeStyle = context.fillStyle = COLORS.measure;
  context.lineWidth = 2;
  dot(pen, ...from, 4);
  if (!to) {
    return;
  }
  dot(pen, ...to, 4);
  drawLine(pen, [from, to], COLORS.measure, 2);
  const [ax, ay] = pen.at(...from);
  const [bx, by] = pen.at(...to);
  const text = `${Math.hypot(to[0] - from[0], to[1] - from[1]).toFixed(2)} m`;
  writeName(pen, text, [(ax + bx) / 2, (ay + by) / 2 - 8], "center", COLORS.measure, pen.font(13, true), []);
}

function drawRobot(pen, scene) {
  const { context } = pen;
  if (scene.goal) {
    arrow(pen, [scene.goal.x_m, scene.goal.y_m, scene.goal.yaw_rad], COLORS.goal);
  }
  const { truth, estimate } = scene.shown;
  if (truth) {
    outline(pen, truth);
    context.fillStyle = `${COLORS.truth}c0`;
    context.fill();
    context.strokeStyle = "#145a32";
    context.lineWidth = 1.5;
    context.stroke();
    nose(pen, truth, "#145a32");
  }
  if (estimate) {
    outline(pen, estimate);
    context.strokeStyle = COLORS.estimate;
    context.lineWidth = 2;
    context.stroke();
    nose(pen, estimate, COLORS.estimate);
    drawEllipse(pen, estimate, scene.pose.covariance);
  }
}

function outline(pen, [x, y, yaw]) {
  const [cos, sin] = [Math.cos(yaw), Math.sin(yaw)];
  // Never too small to see.
  const grow = Math.max(1, 14 / (0.3 * pen.scale));
  polygon(
    pen,
    FOOTPRINT.map(([a, b]) => [x + grow * (cos * a - sin * b), y + grow * (sin * a + cos * b)]),
  );
}

function nose(pen, [x, y, yaw], color) {
  const { context } = pen;
  const [px, py] = pen.at(x, y);
  const length = Math.max(14, 0.22 * pen.scale);
  context.strokeStyle = color;
  context.lineWidth = 2;
  context.beginPath();
  context.moveTo(px, py);
  context.lineTo(px + length * Math.cos(yaw), py - length * Math.sin(yaw));
  context.stroke();
}

/** The ellipse that holds the position with 95 %, and the heading's sector of two deviations. */
function drawEllipse(pen, [x, y, yaw], covariance) {
  if (!covariance) {
    return;
  }
  const { context } = pen;
  const [xx, xy, yy, aa] = covariance;
  const middle = (xx + yy) / 2;
  const spread = Math.hypot((xx - yy) / 2, xy);
  const long = ELLIPSE_95 * Math.sqrt(Math.max(middle + spread, 0)) * pen.scale;
  const short = ELLIPSE_95 * Math.sqrt(Math.max(middle - spread, 0)) * pen.scale;
  const [px, py] = pen.at(x, y);
  context.fillStyle = `${COLORS.estimate}38`;
  context.strokeStyle = COLORS.estimate;
  context.lineWidth = 1;
  context.beginPath();
  context.ellipse(px, py, Math.max(long, 1), Math.max(short, 1), -Math.atan2(2 * xy, xx - yy) / 2, 0, 2 * Math.PI);
  context.fill();
  context.stroke();
  const half = Math.min(2 * Math.sqrt(Math.max(aa, 0)), Math.PI);
  context.beginPath();
  context.moveTo(px, py);
  context.arc(px, py, 26, -yaw - half, -yaw + half);
  context.closePath();
  context.fill();
}

/** An arrow of a pose, such as RViz draws for a goal. */
export function arrow(pen, [x, y, yaw], color, label = "") {
  const { context } = pen;
  const [px, py] = pen.at(x, y);
  const length = Math.max(26, 0.35 * pen.scale);
  context.save();
  context.translate(px, py);
  context.rotate(-(yaw ?? 0));
  context.strokeStyle = color;
  context.fillStyle = color;
  context.lineWidth = 3;
  context.beginPath();
  context.arc(0, 0, 6, 0, 2 * Math.PI);
  context.stroke();
  if (yaw !== null) {
    context.beginPath();
    context.moveTo(6, 0);
    context.lineTo(length - 9, 0);
    context.stroke();
    context.beginPath();
    context.moveTo(length, 0);
    context.lineTo(length - 11, 6);
    context.lineTo(length - 11, -6);
    context.fill();
  }
  context.restore();
  if (label) {
    context.fillStyle = color;
    context.font = pen.font(12, true);
    context.textAlign = "center";
    context.fillText(label, px, py - 11);
  }
}

function dot(pen, x, y, radius) {
  const { context } = pen;
  const [px, py] = pen.at(x, y);
  context.beginPath();
  context.arc(px, py, radius, 0, 2 * Math.PI);
  context.fill();
}
