// The live page: brings the link, the plan, the tools and the lists together.

import { Camera } from "./camera.js";
import { Controls } from "./controls.js";
import { valueAt } from "./grids.js";
import { LAYERS } from "./layers.js";
import { Link } from "./link.js";
import { Panels } from "./panels.js";
import { Plan } from "./plan.js";
import { PlotsView } from "./plots_view.js";
import { RerunPane } from "./rerun_pane.js";
import { Scene } from "./scene.js";
import { StopLevel } from "./stop_level.js";
import { Teleop } from "./teleop.js";

const REMOVE_PX = 40;
/** A goal so near to the robot is where it stands. */
const SAME_PLACE_M = 0.2;
const STEPS_0_1_S = 24;
const HINTS = {
  move: "",
  goal: "Click where to drive; drag for the heading",
  initial_pose: "Click where the robot is; drag for its heading",
  waypoints: "Click several places, then go",
  drop_box: "Click where to drop a box",
  remove: "Click a box or marker to remove it",
  measure: "Click two places",
};
/** What a cell of a map or costmap means, beside its number. */
const CELLS = { "-1": "unknown", 99: "99 (inscribed)", 100: "100 (lethal)" };
const NARROW = "(max-width: 62rem)";
const $ = (id) => document.getElementById(id);

const scene = new Scene();
const panels = new Panels();
const controls = new Controls();
const camera = new Camera($("camera-panel"));
const plan = new Plan($("plan"), scene, pick);
const link = new Link(take, (isOpen) => {
  $("link").textContent = isOpen ? "connected" : "connection lost";
  $("link").className = `badge ${isOpen ? "good" : "bad"}`;
  controls.connected(isOpen);
  if (isOpen) {
    link.send({ do: "show", camera: $("camera-panel").open });
  } else {
    teleop.stop();
  }
});
const teleop = new Teleop(link, $("joystick"));
const rerun = new RerunPane($("rerun"), () => panels.run, () => scene.pose?.time_s ?? 0);
const plots = new PlotsView($("plots-view"), (timeS) => seek(timeS));
const stopLevel = new StopLevel();
const parts = [controls, camera, plots, stopLevel];
let tool = "move";

function take(kind, content, data) {
  if (kind === "stack") {
    showStack(content);
  } else if (kind === "error") {
    showMessage(content.error, true);
  }
  if (kind === "world" && scene.world && scene.world.hash !== content.hash) {
    forgetPlaces();
  }
  if (scene.take(kind, content, data)) {
    plan.redraw();
  }
  if (kind === "world" || kind === "map") {
    plan.worldChanged();
  } else if (kind === "action_result" || kind === "restarted") {
    plan.route = [];
    plan.redraw();
  }
  if (kind === "world") {
    fillPlaces(content.locations);
  } else if (kind === "entities") {
    fillDocks(content.docks);
  }
  panels.take(kind, content);
  for (const part of parts) {
    part.take(kind, content, data);
  }
}

function showStack({ services, how_to_start: hint }) {
  const runs = services.length > 0;
  $("no-stack").hidden = runs;
  $("live").hidden = !runs;
  $("how-to-start").textContent = hint;
  $("link").textContent = runs ? "connected" : "no stack";
  $("link").className = `badge ${runs ? "good" : "warn"}`;
}

function showMessage(text, isBad = false) {
  $("message").textContent = $("message").title = text;
  $("message").className = `message ${isBad ? "bad" : ""}`;
}

/** Ask for something, and show what the services answer. */
async function ask(action) {
  showMessage("…");
  const { said: message, error } = await link.ask(action);
  showMessage(error || message, Boolean(error));
  return !error;
}

function asPose([x, y, yaw]) {
  return { x_m: x, y_m: y, yaw_rad: yaw };
}

/** Without a drag the heading is left to the services: as the robot arrives on its way there. Where
 * it is already, it keeps its own.
 */
function withHeading([x, y, yaw], dragged, from) {
  const isThere = from && Math.hypot(x - from[0], y - from[1]) < SAME_PLACE_M;
  return [x, y, dragged ? yaw : isThere ? from[2] : null];
}

function pick(pose, dragged) {
  switch (tool) {
    case "goal":
      ask({ do: "goal", pose: asPose(withHeading(pose, dragged, scene.robot())) });
      choose("move");
      break;
    case "initial_pose":
      ask({ do: "initial_pose", pose: asPose(dragged || !scene.robot() ? pose : [pose[0], pose[1], scene.robot()[2]]) });
      choose("move");
      break;
    case "waypoints":
      plan.waypoints.push(withHeading(pose, dragged, plan.waypoints.at(-1) ?? scene.robot()));
      showWaypoints();
      break;
    case "drop_box":
      if (takeBox()) {
        ask({ do: "drop_box", pose: asPose(pose), size_m: box.size, mass_kg: box.mass });
        choose("move");
      }
      break;
    case "remove":
      removeAt(pose);
      break;
    case "measure":
      plan.measured = [...(plan.measured.length === 1 ? plan.measured : []), [pose[0], pose[1]]];
      showMeasured();
      break;
    default:
  }
}

function removeAt([x, y]) {
  const things = [
    ...scene.entities.bodies.map((body) => {
      const at = scene.pose?.moved?.[body.name] ?? body.pose;
      return { name: body.name, at };
    }),
    ...scene.entities.markers.map((marker) => ({ name: marker.name, at: [marker.x_m, marker.y_m] })),
  ];
  const far = ({ at }) => Math.hypot(at[0] - x, at[1] - y);
  things.sort((one, other) => far(one) - far(other));
  if (things.length === 0 || far(things[0]) * plan.scale > REMOVE_PX) {
    showMessage("no box or marker to remove there", true);
    return;
  }
  ask({ do: "remove", name: things[0].name });
}

const box = { size: [0.3, 0.3, 0.3], mass: 0 };

/** The size as the fields say it; false where one of them cannot be. */
function takeBox() {
  const fields = ["box-length", "box-width", "box-height", "box-mass"].map($);
  const wrong = fields.find((field) => !field.checkValidity());
  if (wrong) {
    showMessage(`${wrong.labels[0].textContent.trim()}: ${wrong.validationMessage}`, true);
    return false;
  }
  const [length, width, height, mass] = fields.map((field) => Number(field.value));
  Object.assign(box, { size: [length, width, height], mass });
  return true;
}

function showBox() {
  $("box-bar").hidden = tool !== "drop_box";
  plan.outline = tool === "drop_box" && takeBox() ? box.size.slice(0, 2) : null;
  plan.redraw();
}

function showMeasured() {
  const [from, to] = plan.measured;
  if (to) {
    const [dx, dy] = [to[0] - from[0], to[1] - from[1]];
    showMessage(`${Math.hypot(dx, dy).toFixed(3)} m (x ${dx.toFixed(3)}, y ${dy.toFixed(3)}, ${degreesOf(Math.atan2(dy, dx))})`);
  }
  plan.redraw();
}

function degreesOf(angle) {
  return `${Math.round((angle * 180) / Math.PI)}°`;
}

/** The place under the pointer, and what map and costmaps say of it. */
function showPlace(place) {
  $("readout").hidden = !place;
  if (!place) {
    return;
  }
  const [x, y] = place;
  const { map, global_costmap: global, local_costmap: local } = scene.grids;
  const inMap = map ? valueAt(map, x, y) : null;
  const texts = [`${x.toFixed(2)}, ${y.toFixed(2)} m`];
  if (inMap !== null) {
    texts.push(inMap < 0 ? "unknown" : inMap >= 65 ? "occupied" : "free");
  }
  for (const [name, grid] of [["cost", global], ["local cost", local]]) {
    const value = grid ? valueAt(grid, x, y) : null;
    if (value !== null) {
      texts.push(`${name} ${CELLS[value] ?? value}`);
    }
  }
  $("readout").textContent = texts.join(" · ");
}

function choose(name) {
  if (document.querySelector(`[data-tool=${name}]`).disabled) {
    return;
  }
  if (name !== "move") {
    showView("plan");
  }
  tool = name;
  for (const button of document.querySelectorAll("[data-tool]")) {
    button.setAttribute("aria-pressed", String(button.dataset.tool === name));
  }
  plan.isAiming = name !== "move";
  plan.hasHeading = name !== "remove" && name !== "measure";
  plan.canvas.classList.toggle("aims", plan.isAiming);
  $("hint").textContent = HINTS[name];
  $("hint").hidden = HINTS[name] === "";
  if (name !== "waypoints") {
    plan.waypoints = [];
  }
  plan.measured = [];
  showWaypoints();
  showBox();
  plan.giveUp();
  if (plan.isAiming) {
    plan.canvas.focus({ preventScroll: true });
  }
}

/** Where the keys have moved the aim. */
function showAim([x, y, yaw], hasHeading) {
  const degrees = hasHeading ? `, ${degreesOf(yaw)}` : "";
  showPlace([x, y]);
  $("hint").textContent = `(${x.toFixed(2)}, ${y.toFixed(2)}) m${degrees}: Enter sets it`;
}

/** What was clicked in one world means nothing in another. */
function forgetPlaces() {
  const dropped = plan.waypoints.length;
  plan.waypoints = [];
  plan.measured = [];
  plan.route = [];
  showWaypoints();
  if (dropped) {
    showMessage(`another world: ${dropped} waypoint${dropped === 1 ? "" : "s"} dropped`);
  }
}

function showWaypoints() {
  const count = plan.waypoints.length;
  $("waypoint-bar").hidden = tool !== "waypoints";
  $("waypoint-count").textContent = `${count} waypoint${count === 1 ? "" : "s"}`;
  $("waypoints-go").disabled = $("waypoints-through").disabled = count === 0;
  plan.redraw();
}

async function goThrough(stops) {
  const { waypoints } = plan;
  if (await ask({ do: "waypoints", poses: waypoints.map(asPose), stops })) {
    plan.route = waypoints;
    choose("move");
  }
}

function fillPlaces(locations) {
  const select = $("place");
  select.replaceChildren(new Option("by numbers", ""));
  for (const place of locations) {
    select.append(new Option(place.name, JSON.stringify([place.x_m, place.y_m, place.yaw_rad])));
  }
}

function fillDocks(names) {
  const select = $("dock-id");
  const chosen = select.value;
  select.replaceChildren(...names.map((name) => new Option(name, name)));
  if (names.includes(chosen)) {
    select.value = chosen;
  }
}

function fillLayers() {
  for (const [key, name, color, shown] of LAYERS) {
    const label = document.createElement("label");
    const box = document.createElement("input");
    box.type = "checkbox";
    box.checked = shown;
    box.dataset.layer = key;
    box.addEventListener("change", () => {
      plan.layers[key] = box.checked;
      plan.redraw();
    });
    const swatch = document.createElement("span");
    swatch.className = "swatch";
    swatch.style.background = color;
    label.append(box, swatch, name);
    const opacity = document.createElement("input");
    opacity.type = "range";
    opacity.min = 5;
    opacity.max = 100;
    opacity.value = 100;
    opacity.title = "opacity";
    opacity.setAttribute("aria-label", `Opacity of ${name}`);
    opacity.addEventListener("input", () => {
      plan.opacity[key] = Number(opacity.value) / 100;
      plan.redraw();
    });
    $("layers").append(label, opacity);
  }
}

function follow(wanted) {
  plan.follows = wanted;
  $("follow").setAttribute("aria-pressed", String(wanted));
  plan.redraw();
}

const CLICKS = {
  pause: () => ask({ do: "simulation", pause: $("pause").getAttribute("aria-pressed") !== "true" }),
  step: () => ask({ do: "simulation", step: STEPS_0_1_S }),
  reset: () => {
    if (confirm("Reset the simulation to time 0 and its initial state?")) {
      ask({ do: "simulation", reset: "all" });
    }
  },
  "emergency-stop": () => ask({ do: "emergency_stop", stop: !stopLevel.isHeld }),
  cancel: () => ask({ do: "cancel" }),
  "pause-task": () => ask({ do: "pause_task", pause: true }),
  "resume-task": () => ask({ do: "pause_task", pause: false }),
  dock: () => ask({ do: "dock", dock_id: $("dock-id").value }),
  undock: () => ask({ do: "undock" }),
  spin: () => ask({ do: "spin" }),
  "back-up": () => ask({ do: "back_up" }),
  "clear-costmaps": () => ask({ do: "clear_costmaps" }),
  "find-robot": () => ask({ do: "global_localization" }),
  "explore-stop": () => ask({ do: "explore", resume: false }),
  "explore-resume": () => ask({ do: "explore", resume: true }),
  "waypoints-go": () => goThrough(true),
  "waypoints-through": () => goThrough(false),
  "waypoints-clear": () => {
    plan.waypoints = [];
    showWaypoints();
  },
  "zoom-in": () => plan.zoom(1.3),
  "zoom-out": () => plan.zoom(1 / 1.3),
  fit: () => {
    follow(false);
    plan.fit();
  },
  follow: () => follow(!plan.follows),
};
for (const [id, act] of Object.entries(CLICKS)) {
  $(id).addEventListener("click", act);
}
for (const button of document.querySelectorAll("[data-tool]")) {
  button.addEventListener("click", () => choose(button.dataset.tool === tool ? "move" : button.dataset.tool));
}
/** Show the plan, the 3D view or the plots. */
function showView(name) {
  for (const part of document.querySelectorAll("[data-view]")) {
    part.hidden = part.dataset.view !== name;
  }
  for (const view of ["plan", "3d", "plots"]) {
    $(`view-${view}`)?.setAttribute("aria-pressed", String(view === name));
  }
  if (name === "3d") {
    rerun.shown();
  }
  plots.draw();
}

/** Show a moment in the 3D view. */
function seek(timeS) {
  if ($("view-3d")) {
    showView("3d");
    rerun.seek(timeS);
  }
}

for (const view of ["plan", "3d", "plots"]) {
  const button = $(`view-${view}`);
  button?.addEventListener("click", () => {
    showView(button.getAttribute("aria-pressed") === "true" ? "plan" : view);
  });
}
for (const list of ["results", "log"]) {
  $(list).addEventListener("click", (event) => {
    const time = event.target.closest("[data-time]");
    if (time) {
      seek(Number(time.dataset.time));
    }
  });
}
for (const field of $("box-bar").querySelectorAll("input")) {
  field.addEventListener("input", showBox);
}
plan.onAim = showAim;
plan.onHover = showPlace;
plan.onFollow = () => follow(plan.follows);
$("speed").addEventListener("change", () => ask({ do: "simulation", speed: Number($("speed").value) }));
$("camera-panel").addEventListener("toggle", () => link.send({ do: "show", camera: $("camera-panel").open }));
$("place").addEventListener("change", () => {
  if ($("place").value) {
    const [x, y, yaw] = JSON.parse($("place").value);
    $("pose-x").value = x;
    $("pose-y").value = y;
    $("pose-yaw").value = Math.round((yaw * 1800) / Math.PI) / 10;
  }
});
$("pose-form").addEventListener("submit", (event) => {
  event.preventDefault();
  const [x, y, degrees] = ["pose-x", "pose-y", "pose-yaw"].map((id) => Number($(id).value));
  ask({ do: "goal", pose: { x_m: x, y_m: y, yaw_rad: (degrees * Math.PI) / 180 } });
});
const SHORTCUTS = { g: () => choose("goal"), p: () => choose("initial_pose"), m: () => choose("measure"), f: CLICKS.follow, 0: CLICKS.fit,
  "+": CLICKS["zoom-in"], "-": CLICKS["zoom-out"], escape: () => choose("move") };
addEventListener("keydown", (event) => {
  const isField = event.target instanceof Element && event.target.closest("input, select, textarea, [id=rerun]");
  const act = SHORTCUTS[event.key.toLowerCase()];
  if (act && !isField && !event.ctrlKey && !event.metaKey && !event.altKey && !event.repeat) {
    act();
  }
});
fillLayers();
// A phone has no room for it at first.
$("camera-panel").open = !matchMedia(NARROW).matches;
