// The plan of runs and their plots over time, drawn as SVG from series.json.

const SVG = "http://www.w3.org/2000/svg";
const WIDTH = 640;
const HEIGHT = 150;
const MARGIN = { left: 52, right: 8, top: 8, bottom: 22 };

function element(name, attributes = {}, text = "") {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text) made.textContent = text;
  return made;
}

const colorClass = (run) => `s${run.index ?? 0}`;

/** A line through points; it has a gap where a value is not a number. */
function path(points) {
  let text = "";
  let pen = "M";
  for (const [x, y] of points) {
    if (!Number.isFinite(x) || !Number.isFinite(y)) {
      pen = "M";
      continue;
    }
    text += `${pen}${x.toFixed(2)} ${y.toFixed(2)}`;
    pen = "L";
  }
  return text;
}

const zip = (first, second) => first.map((value, index) => [value, second[index]]);

/** Index of the last value that is not above `wanted`; -1: none. */
function lastUpTo(values, wanted) {
  let [low, high] = [0, values.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (values[middle] <= wanted) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}

/** Round numbers between two values, about `count` of them. */
function ticks(low, high, count) {
  const rough = (high - low) / count || 1;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((one) => one >= rough);
  const found = [];
  for (let value = Math.ceil(low / step) * step; value <= high + step * 1e-9; value += step) {
    found.push(Math.abs(value) < step * 1e-9 ? 0 : value);
  }
  return found;
}

/** The world with the driven paths; `mark(time_s)` moves the robots to a moment. */
export function plan(box, runs) {
  const first = runs[0].series;
  const xs = [], ys = [];
  for (const ring of first.solid) for (const [x, y] of ring) { xs.push(x); ys.push(y); }
  for (const { series } of runs) { xs.push(...series.truth.x_m); ys.push(...series.truth.y_m); }
  if (!xs.length) { xs.push(-1, 1); ys.push(-1, 1); }
  const low = [Math.min(...xs) - 0.3, Math.min(...ys) - 0.3];
  const high = [Math.max(...xs) + 0.3, Math.max(...ys) + 0.3];
  const size = Math.max(high[0] - low[0], high[1] - low[1]);
  const svg = element("svg", {
    viewBox: `${low[0]} ${-high[1]} ${high[0] - low[0]} ${high[1] - low[1]}`,
    role: "img",
    "aria-label": `plan of ${first.world} with the driven path`,
  });
  // SVG's y points down.
  const flipped = (points) => points.map(([x, y]) => [x, -y]);
  const solid = first.solid.map((ring) => `${path(flipped(ring))}Z`).join("");
  svg.append(element("path", { d: solid, class: "solid", "fill-rule": "evenodd" }));
  for (const marker of first.markers) {
    const dot = element("circle", {
      cx: marker.x_m, cy: -marker.y_m, r: size / 90, class: marker.images ? "marker seen" : "marker",
    });
    dot.append(element("title", {}, `marker ${marker.marker_id}: in ${marker.images} images`));
    svg.append(dot);
  }
  const robots = [];
  for (const run of runs) {
    const { series } = run;
    const isAlone = runs.length === 1;
    if (isAlone) {
      const estimated = flipped(zip(series.estimate.x_m, series.estimate.y_m));
      svg.append(element("path", { d: path(estimated), class: "way estimated" }));
    }
    const way = flipped(zip(series.truth.x_m, series.truth.y_m));
    svg.append(element("path", { d: path(way), class: `way ${colorClass(run)}` }));
    for (const goal of isAlone ? series.goals : []) {
      if (!goal.pose) continue;
      const { x_m, y_m, yaw_rad } = goal.pose;
      const group = element("g", {
        class: goal.reached ? "goal reached" : "goal missed",
        transform: `translate(${x_m} ${-y_m}) rotate(${(-yaw_rad * 180) / Math.PI}) scale(${size / 45})`,
      });
      group.append(element("path", { d: "M-.7-.6L1 0L-.7.6Z" }));
      group.append(element("title", {}, `${goal.name}: ${goal.reached ? "reached" : "missed"}`));
      svg.append(group);
    }
    for (const event of isAlone ? series.events : []) {
      if (event.kind !== "contact" || event.x_m === null) continue;
      const cross = element("path", {
        d: "M-1-1L1 1M-1 1L1-1", class: "contact",
        transform: `translate(${event.x_m} ${-event.y_m}) scale(${size / 90})`,
      });
      cross.append(element("title", {}, `${event.time_s.toFixed(2)} s: ${event.text}`));
      svg.append(cross);
    }
    const robot = element("path", { d: "M-1-.8L1.2 0L-1 .8Z", class: `robot ${colorClass(run)}` });
    svg.append(robot);
    robots.push([series.truth, robot]);
  }
  const mark = (time_s) => {
    for (const [truth, robot] of robots) {
      const row = Math.max(lastUpTo(truth.time_s, time_s), 0);
      if (!truth.time_s.length) continue;
      const degrees = (-truth.yaw_rad[row] * 180) / Math.PI;
      robot.setAttribute("transform", `translate(${truth.x_m[row]} ${-truth.y_m[row]}) ` +
        `rotate(${degrees}) scale(${size / 60})`);
    }
  };
  mark(Infinity);
  box.replaceChildren(svg);
  return { mark };
}

/** What is plotted over time: title, unit, factor, and the columns of a run. */
function quantities(runs) {
  const list = [
    ["localisation error", "mm", (series) => [series.estimate.time_s, series.estimate.error_m, 1e3]],
    ["heading error", "mrad", (series) => [series.estimate.time_s, series.estimate.error_rad, 1e3]],
    ["speed", "m/s", (series) => [series.truth.time_s, series.truth.speed_m_s, 1]],
    ["turning", "rad/s", (series) => [series.truth.time_s, series.truth.yaw_rate_rad_s, 1]],
    ["real-time factor", "x", (series) => [series.pace.time_s, series.pace.real_time_factor, 1]],
  ];
  const services = new Set(runs.flatMap((run) => Object.keys(run.series.costs)));
  for (const service of [...services].sort()) {
    list.push([`step of ${service}, p99`, "ms", (series) => {
      const cost = series.costs[service];
      return cost ? [cost.time_s, cost.step_time_p99_ms, 1] : [[], [], 1];
    }]);
  }
  return list;
}

/**
 * One plot under the other on a common time axis. The pointer shows the values of a moment in all of
 * them, and a click calls `onTime` with its time in s. `mark(time_s)` marks one from outside.
 */
export function timePlots(box, runs, onTime = null) {
  const end_s = Math.max(1e-3, ...runs.map((run) => run.series.sim_time_s));
  const plots = [];
  const point = (time_s) => {
    box.dataset.pointed = time_s ?? "";
    for (const one of plots) one.point(time_s);
  };
  for (const [title, unit, columns] of quantities(runs)) {
    const lines = runs.map((run) => {
      const [times, values, factor] = columns(run.series);
      return { run, times, values: values.map((value) => (value === null ? NaN : factor * value)) };
    });
    if (lines.some((line) => line.values.length > 1)) {
      plots.push(timePlot(title, unit, lines, end_s, point, onTime));
    }
  }
  box.replaceChildren(...plots.map((plot) => plot.figure));
  // Plots of a run that goes on are drawn again under the pointer.
  if (box.dataset.pointed) point(Number(box.dataset.pointed));
  return plots;
}

function timePlot(title, unit, lines, end_s, point, onTime) {
  const finite = lines.flatMap((line) => line.values.filter(Number.isFinite));
  const low = finite.reduce((least, value) => Math.min(least, value), 0);
  const high = finite.reduce((most, value) => Math.max(most, value), low + 1e-9);
  const x = (time_s) => MARGIN.left + (time_s / end_s) * (WIDTH - MARGIN.left - MARGIN.right);
  const y = (value) =>
    HEIGHT - MARGIN.bottom - ((value - low) / (high - low)) * (HEIGHT - MARGIN.top - MARGIN.bottom);

  const figure = document.createElement("figure");
  figure.className = "plot";
  const caption = document.createElement("figcaption");
  const name = document.createElement("span");
  name.textContent = `${title}, ${unit}`;
  const values = document.createElement("span");
  values.className = "values";
  caption.append(name, values);
  const svg = element("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img" });
  const most = finite.length ? `, at most ${high.toPrecision(3)}` : "";
  svg.setAttribute("aria-label", `${title} in ${unit} over ${end_s.toFixed(0)} s${most}`);
  for (const value of ticks(low, high, 4)) {
    const attributes = { x1: MARGIN.left, x2: WIDTH - MARGIN.right, y1: y(value), y2: y(value) };
    svg.append(element("line", { ...attributes, class: "grid" }));
    const text = { x: MARGIN.left - 6, y: y(value) + 4, "text-anchor": "end" };
    svg.append(element("text", text, String(Number(value.toPrecision(6)))));
  }
  for (const time_s of ticks(0, end_s, 8)) {
    const text = { x: x(time_s), y: HEIGHT - 6, "text-anchor": "middle" };
    svg.append(element("text", text, `${Number(time_s.toPrecision(6))}`));
  }
  for (const line of lines) {
    const points = line.times.map((time_s, index) => [x(time_s), y(line.values[index])]);
    svg.append(element("path", { d: path(points), class: `line ${colorClass(line.run)}` }));
  }
  const marked = element("line", { y1: MARGIN.top, y2: HEIGHT - MARGIN.bottom, class: "marked" });
  const cursor = element("line", { y1: MARGIN.top, y2: HEIGHT - MARGIN.bottom, class: "cursor" });
  marked.style.display = cursor.style.display = "none";
  svg.append(marked, cursor);

  const place = (line, time_s) => {
    line.style.display = time_s === null ? "none" : "";
    if (time_s === null) return;
    line.setAttribute("x1", x(time_s));
    line.setAttribute("x2", x(time_s));
  };
  const showValues = (time_s) => {
    const shown = lines.map((line) => {
      const row = lastUpTo(line.times, time_s);
      const value = row < 0 ? NaN : line.values[row];
      return Number.isFinite(value) ? value.toPrecision(3) : "-";
    });
    values.textContent = `${time_s.toFixed(2)} s: ${shown.join("  |  ")}`;
  };
  const timeAt = (event) => {
    const box = svg.getBoundingClientRect();
    const inside = ((event.clientX - box.left) / box.width) * WIDTH - MARGIN.left;
    const share = inside / (WIDTH - MARGIN.left - MARGIN.right);
    return Math.min(Math.max(share, 0), 1) * end_s;
  };
  svg.addEventListener("pointermove", (event) => point(timeAt(event)));
  svg.addEventListener("pointerleave", () => point(null));
  if (onTime) {
    svg.classList.add("clickable");
    svg.addEventListener("click", (event) => onTime(timeAt(event)));
  }
  figure.append(caption, svg);
  return {
    figure,
    point(time_s) {
      place(cursor, time_s);
      if (time_s === null) values.textContent = "";
      else showValues(time_s);
    },
    mark(time_s) {
      place(marked, Math.min(time_s, end_s));
    },
  };
}
