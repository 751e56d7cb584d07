// The run so far over time: speed, turning, and how far the estimate is off.

import { timePlots } from "/static/plots.js";

const PERIOD_MS = 500;
const MOST_ROWS = 1500;
const STEP_S = 0.1;

/** The plots, drawn while they are shown. `onTime(timeS)` is called with the time of a click. */
export class PlotsView {
  #box;
  #onTime;
  #rows = [];
  #stepS = STEP_S;
  #isDrawn = false;

  constructor(box, onTime) {
    this.#box = box;
    this.#onTime = onTime;
    setInterval(() => this.draw(), PERIOD_MS);
  }

  /** Take one frame in. */
  take(kind, content) {
    if (kind === "restarted") {
      this.#begin([]);
    } else if (kind === "plots") {
      this.#begin(content.rows);
    } else if (kind === "pose" && content.truth) {
      this.#add(content);
    }
  }

  #begin(rows) {
    this.#rows = rows;
    this.#stepS = rows.length > 1 ? Math.max(STEP_S, (rows.at(-1)[0] - rows[0][0]) / rows.length) : STEP_S;
    this.#isDrawn = false;
  }

  #add({ time_s: timeS, truth, estimate, velocity }) {
    const last = this.#rows.at(-1);
    if (last && timeS - last[0] < this.#stepS) {
      return;
    }
    const errorM = estimate ? Math.hypot(truth[0] - estimate[0], truth[1] - estimate[1]) : null;
    const turn = estimate ? truth[2] - estimate[2] : null;
    const errorRad = turn === null ? null : Math.abs(Math.atan2(Math.sin(turn), Math.cos(turn)));
    this.#rows.push([timeS, velocity[0], velocity[1], errorM, errorRad]);
    if (this.#rows.length >= MOST_ROWS) {
      this.#rows = this.#rows.filter((_, index) => index % 2 === 0);
      this.#stepS *= 2;
    }
    this.#isDrawn = false;
  }

  /** Draw what is new, if it is seen. */
  draw() {
    if (this.#isDrawn || this.#box.hidden || document.hidden || this.#rows.length < 2) {
      return;
    }
    this.#isDrawn = true;
    const [times, speeds, turning, errors, headings] = [0, 1, 2, 3, 4].map((column) =>
      this.#rows.map((row) => row[column]),
    );
    const series = {
      sim_time_s: times.at(-1),
      truth: { time_s: times, speed_m_s: speeds, yaw_rate_rad_s: turning },
      estimate: { time_s: times, error_m: errors, error_rad: headings },
      pace: { time_s: [], real_time_factor: [] },
      costs: {},
    };
    timePlots(this.#box.querySelector(".plots"), [{ index: 0, series }], this.#onTime);
    this.#box.classList.add("has-plots");
  }
}
