// The lists beside the plan: task, figures, services, tree, results, log.

const MOST_LINES = 200;
const RECENT_S = 2;
const FAULTS = ["rejected", "lost"];
const LEVELS = { 30: "warn", 40: "bad", 50: "bad" };
const $ = (id) => document.getElementById(id);

function element(tag, text = "", className = "") {
  const made = document.createElement(tag);
  made.textContent = text;
  made.className = className;
  return made;
}

function line(list, timeS, text, className) {
  const item = element("li", "", className);
  if (timeS !== null) {
    const time = element("button", timeS.toFixed(1), "seek");
    time.type = "button";
    time.title = "show this time in the 3D view";
    time.dataset.time = timeS;
    item.append(time);
  }
  item.append(text);
  const atEnd = list.scrollHeight - list.scrollTop - list.clientHeight < 30;
  list.append(item);
  while (list.childElementCount > MOST_LINES) {
    list.firstElementChild.remove();
  }
  if (atEnd) {
    list.scrollTop = list.scrollHeight;
  }
}

/** Shows what is not on the plan. */
export class Panels {
  #services = new Map();
  #running = new Set();
  #figures = new Map();
  #timeS = 0;
  /** Name of the newest run's folder; empty: nothing is recorded. */
  run = "";

  /** Take one frame in. */
  take(kind, content) {
    if (kind.startsWith("service ")) {
      this.#services.set(content.name, content);
      this.#showServices();
      return;
    }
    switch (kind) {
      case "stack":
        this.#running = new Set(content.services);
        this.#showServices();
        break;
      case "restarted":
        $("tree").replaceChildren();
        this.#forgetTimes();
        $("task").textContent = "simulation restarted";
        break;
      case "stats":
        this.#showTime(content);
        break;
      case "pose":
        this.#showPose(content);
        break;
      case "localization":
        this.#figure("localisation", `${content.state}, quality ${content.quality.toFixed(2)}`, content.reason);
        break;
      case "monitor":
        this.#figure(
          "collision monitor",
          content.action === "do_nothing" ? "free" : `${content.action} ${content.polygon_name}`,
          content.reason,
        );
        break;
      case "navigation":
        this.#showNavigation(content);
        break;
      case "feedback":
        $("task").textContent = progress(content);
        break;
      case "exploration":
        this.#showExploration(content);
        break;
      case "evaluation":
        this.#showEvaluation(content);
        break;
      case "tree":
        showTree(content);
        break;
      case "log":
        line($("log"), content.time_s, `[${content.name}] ${content.text}`, LEVELS[content.level] ?? "");
        break;
      case "action_result":
        this.#result(content.end_time_s, content.action.replaceAll("_", " "), content);
        break;
      case "navigation_result":
        this.#result(content.end_time_s, `goal (${content.goal.x_m.toFixed(2)}, ${content.goal.y_m.toFixed(2)})`, content);
        break;
      case "contact":
        line($("results"), content.time_s, `contact with ${content.body}`, "bad");
        break;
      case "world_status":
        if (content.error) {
          line($("results"), null, content.error, "bad");
        }
        break;
      default:
    }
  }

  /** Times of before are none of the run that is shown now. */
  #forgetTimes() {
    for (const time of document.querySelectorAll("#results [data-time], #log [data-time]")) {
      time.disabled = true;
      time.title = "before the simulation restarted";
    }
  }

  #result(timeS, what, content) {
    const done = content.error_code === 0 && (content.status ?? "succeeded") === "succeeded";
    const missed = (content.waypoints ?? []).filter((one) => one.status === "failed");
    const short = missed.length ? `, ${missed.length} missed` : "";
    const how = done ? `done${short}` : `${content.status ?? "failed"}: ${content.error_msg} (${content.error_code})`;
    const took = (timeS - content.start_time_s).toFixed(1);
    line($("results"), timeS, `${what}: ${how} after ${took} s`, done && !short ? "good" : "bad");
    for (const one of missed) {
      line($("results"), null, `waypoint ${one.index + 1} missed: ${one.error_msg} (${one.error_code})`, "bad");
    }
    // Else it is one of those that this page has missed.
    if (timeS > this.#timeS - RECENT_S) {
      $("task").textContent = `${what}: ${how}`;
    }
  }

  #figure(name, value, title = "") {
    let shown = this.#figures.get(name);
    if (!shown) {
      shown = element("dd");
      this.#figures.set(name, shown);
      $("figures").append(element("dt", name), shown);
    }
    if (shown.textContent !== value) {
      shown.textContent = value;
    }
    shown.title = title;
  }

  #showTime(stats) {
    $("pause").textContent = stats.paused ? "Resume" : "Pause";
    $("pause").setAttribute("aria-pressed", String(stats.paused));
    const speed = $("speed");
    const value = String(stats.speed);
    if (![...speed.options].some((option) => option.value === value)) {
      speed.append(new Option(`${value}×`, value));
    }
    if (document.activeElement !== speed) {
      speed.value = value;
    }
    if (stats.paused) {
      $("time").textContent = `${stats.sim_time_s.toFixed(2)} s`;
    }
  }

  #showPose(pose) {
    if (pose.time_s !== undefined) {
      this.#timeS = pose.time_s;
      $("time").textContent = `${pose.time_s.toFixed(2)} s`;
    }
    for (const [name, at] of [["true pose", pose.truth], ["estimate", pose.estimate]]) {
      if (at) {
        const degrees = ((at[2] * 180) / Math.PI).toFixed(0);
        this.#figure(name, `${at[0].toFixed(2)}, ${at[1].toFixed(2)} m, ${degrees}°`);
      }
    }
    if (pose.truth && pose.estimate) {
      const apart = Math.hypot(pose.truth[0] - pose.estimate[0], pose.truth[1] - pose.estimate[1]);
      this.#figure("pose error", `${(100 * apart).toFixed(1)} cm`);
    }
    if (pose.velocity) {
      this.#figure("speed", `${pose.velocity[0].toFixed(2)} m/s, ${pose.velocity[1].toFixed(2)} rad/s`);
    }
  }

  #showNavigation(status) {
    const active = status.localization_active && status.navigation_active;
    const state = status.stop_level === "hold" ? "held" : status.state;
    $("task-state").textContent = active ? state : "not active";
    $("task-state").className = `badge ${active && !["held", "recovering"].includes(state) ? "good" : "warn"}`;
    if (active && status.state === "idle" && !status.goal && $("task").textContent.includes(" left")) {
      $("task").textContent = "no task";
    }
  }

  #showExploration(status) {
    $("explore-stop").hidden = $("explore-resume").hidden = false;
    this.#figure("exploration", `${status.state}, ${Math.round(100 * status.seen_share)} % seen`, status.reason);
    this.#figure("frontiers", `${status.reachable} of ${status.frontiers}`);
  }

  #showEvaluation(evaluation) {
    this.#showRun(evaluation.recording.split("/").pop());
    const goals = evaluation.goals.filter((goal) => !goal.given_up);
    this.#figure("goals reached", `${goals.filter((goal) => goal.reached).length} of ${goals.length}`);
    const error = evaluation.localisation_error_m;
    if (error.mean !== null) {
      this.#figure("localisation error", `${(100 * error.mean).toFixed(1)} cm mean, ${(100 * error.max).toFixed(1)} max`);
    }
    this.#figure("contacts", String(evaluation.contacts.length));
    const seen = Object.values(evaluation.markers_seen);
    this.#figure("markers seen", `${seen.filter((count) => count > 0).length} of ${seen.length}`);
    if (evaluation.mapping?.coverage_share != null) {
      this.#figure("mapped", `${Math.round(100 * evaluation.mapping.coverage_share)} %`);
    }
  }

  /** The way to the page of the run, with its events and plots. */
  #showRun(name) {
    if (name === this.run) {
      return;
    }
    this.run = name;
    this.#figure("run", name || "not recorded");
    if (name) {
      const link = element("a", name);
      link.href = `/runs/${encodeURIComponent(name)}`;
      this.#figures.get("run").replaceChildren(link);
    }
  }

  #showServices() {
    const names = [...new Set([...this.#services.keys(), ...this.#running])].sort();
    const items = names.map((name) => {
      const known = this.#services.get(name);
      const runs = this.#running.has(name);
      const message = runs ? (known?.message ?? "running") : "not running";
      const waits = runs && (known?.level ?? 0) > 0;
      const item = element("li", "", runs ? (waits ? "waits" : "") : "gone");
      const text = runs ? [message, ...faultsOf(known)].join("; ") : message;
      item.append(element("span", "", "dot"), element("strong", name), element("span", text, "muted"));
      const values = Object.entries(known?.values ?? {}).filter(([, value]) => value !== "");
      item.title = values.map(([key, value]) => `${key}: ${value}`).join("\n");
      return item;
    });
    $("services").replaceChildren(...items);
  }
}

/** What a service has rejected or lost, which its message does not contain. */
function faultsOf(status) {
  return Object.entries(status?.values ?? {})
    .filter(([key]) => FAULTS.some((kind) => key.startsWith(kind)))
    .map(([key, count]) => `${key} (${count})`);
}

function showTree(log) {
  if (log.nodes.length === 0) {
    $("tree").replaceChildren(element("li", "no task running", "IDLE"));
    return;
  }
  const items = log.nodes.map((node) => {
    const item = element("li", "", node.status);
    item.style.paddingInlineStart = `${0.8 * node.depth}rem`;
    item.append(element("span", MARKS[node.status]), element("span", node.name));
    item.title = `${node.kind}: ${node.status.toLowerCase()}`;
    item.setAttribute("aria-label", `${node.name}: ${node.status.toLowerCase()}`);
    return item;
  });
  $("tree").replaceChildren(...items);
}

const MARKS = { RUNNING: "▶", SUCCESS: "✓", FAILURE: "✗", IDLE: "·", SKIPPED: "–" };

/** Feedback in one line: time, what is left, recoveries. */
function progress(feedback) {
  const parts = [`${feedback.action.replaceAll("_", " ")}: ${feedback.navigation_time_s.toFixed(1)} s`];
  const add = (value, text) => {
    if (value !== null && value !== undefined) {
      parts.push(text(value));
    }
  };
  add(feedback.current_waypoint, (value) => `waypoint ${value + 1}`);
  add(feedback.number_of_poses_remaining, (value) => `${value} to go`);
  add(feedback.distance_remaining_m, (value) => `${value.toFixed(2)} m left`);
  add(feedback.estimated_time_remaining_s, (value) => `about ${value.toFixed(0)} s left`);
  add(feedback.angular_distance_traveled_rad, (value) => `turned ${value.toFixed(2)} rad`);
  add(feedback.distance_traveled_m, (value) => `driven ${value.toFixed(2)} m`);
  add(feedback.docking_state, (value) => value.replaceAll("_", " "));
  add(feedback.number_of_recoveries || null, (value) => `${value} recoveries`);
  if (feedback.paused) {
    parts.push("paused");
  }
  return parts.join(", ");
}
