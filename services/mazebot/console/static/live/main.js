// The live page: brings the link, the plan, the tools and the lists together.

import { LAYERS } from "./layers.js";
import { Link } from "./link.js";
import { Panels } from "./panels.js";
import { Plan } from "./plan.js";
import { RerunPane } from "./rerun_pane.js";
import { Scene } from "./scene.js";
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
};
const $ = (id) => document.getElementById(id);

const scene = new Scene();
const panels = new Panels();
const plan = new Plan($("plan"), scene, pick);
const link = new Link(take, (isOpen) => {
  $("link").textContent = isOpen ? "connected" : "connection lost";
  $("link").className = `badge ${isOpen ? "good" : "bad"}`;
  if (isOpen) {
    link.send({ do: "show", camera: $("camera-panel").open });
  } else {
    teleop.stop();
  }
});
const teleop = new Teleop(link, $("joystick"));
const rerun = new RerunPane($("rerun"), () => panels.run, () => scene.pose?.time_s ?? 0);
let tool = "move";

function take(kind, content, data) {
  if (kind === "stack") {
    showStack(content);
  } else if (kind === "error") {
    showMessage(content.error, true);
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
    fillDocks(content.markers);
  }
  panels.take(kind, content, data);
}

function showStack({ services, how_to_start: hint }) {
  const runs = services.length > 0;
  $("no-stack").hidden = runs;
  $("live").hidden = !runs;
  $("how-to-start").textContent = hint;
  $("link").textContent = runs ? "connected" : "no stack";
  $("link").className = `badge ${runs ? "good" : "warn"}`;
  for (const control of document.querySelectorAll(".clock :is(button, select)")) {
    control.disabled = !runs;
  }
}

function showMessage(text, isBad = false) {
  $("message").textContent = text;
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

/** Without a drag the robot arrives as it comes from one place or, where it is there, stands. */
function headingFrom(from, pose, dragged) {
  if (dragged || !from) {
    return pose;
  }
  const [dx, dy] = [pose[0] - from[0], pose[1] - from[1]];
  return [pose[0], pose[1], Math.hypot(dx, dy) < SAME_PLACE_M ? from[2] : Math.atan2(dy, dx)];
}

function pick(pose, dragged) {
  switch (tool) {
    case "goal":
      ask({ do: "goal", pose: asPose(headingFrom(scene.robot(), pose, dragged)) });
      choose("move");
      break;
    case "initial_pose":
      ask({ do: "initial_pose", pose: asPose(dragged || !scene.robot() ? pose : [pose[0], pose[1], scene.robot()[2]]) });
      choose("move");
      break;
    case "waypoints":
      plan.waypoints.push(headingFrom(plan.waypoints.at(-1) ?? scene.robot(), pose, dragged));
      showWaypoints();
      break;
    case "drop_box":
      ask({ do: "drop_box", pose: asPose(pose) });
      choose("move");
      break;
    case "remove":
      removeAt(pose);
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

function choose(name) {
  tool = name;
  for (const button of document.querySelectorAll("[data-tool]")) {
    button.setAttribute("aria-pressed", String(button.dataset.tool === name));
  }
  plan.isAiming = name !== "move";
  plan.hasHeading = name !== "remove";
  plan.canvas.classList.toggle("aims", plan.isAiming);
  $("hint").textContent = HINTS[name];
  $("hint").hidden = HINTS[name] === "";
  if (name !== "waypoints") {
    plan.waypoints = [];
  }
  showWaypoints();
  plan.giveUp();
  if (plan.isAiming) {
    plan.canvas.focus({ preventScroll: true });
  }
}

/** Where the keys have moved the aim. */
function showAim([x, y, yaw], hasHeading) {
  const degrees = hasHeading ? `, ${Math.round((yaw * 180) / Math.PI)}°` : "";
  $("hint").textContent = `(${x.toFixed(2)}, ${y.toFixed(2)}) m${degrees}: Enter sets it`;
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

function fillDocks(markers) {
  const select = $("dock-id");
  const chosen = select.value;
  select.replaceChildren(...markers.map((marker) => new Option(marker.name, marker.name)));
  if (markers.some((marker) => marker.name === chosen)) {
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
    $("layers").append(label);
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
function showsRerun() {
  $("view-3d").setAttribute("aria-pressed", String(rerun.isShown));
}
$("view-3d")?.addEventListener("click", () => {
  rerun.toggle();
  showsRerun();
});
for (const list of ["results", "log"]) {
  $(list).addEventListener("click", (event) => {
    const time = event.target.closest("[data-time]");
    if (time && $("view-3d")) {
      rerun.seek(Number(time.dataset.time));
      showsRerun();
    }
  });
}
plan.onAim = showAim;
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
const SHORTCUTS = { g: () => choose("goal"), p: () => choose("initial_pose"), f: CLICKS.follow, 0: CLICKS.fit,
  "+": CLICKS["zoom-in"], "-": CLICKS["zoom-out"], escape: () => choose("move") };
addEventListener("keydown", (event) => {
  const isField = event.target instanceof Element && event.target.closest("input, select, textarea, [id=rerun]");
  const act = SHORTCUTS[event.key.toLowerCase()];
  if (act && !isField && !event.ctrlKey && !event.metaKey && !event.altKey && !event.repeat) {
    act();
  }
});
fillLayers();
