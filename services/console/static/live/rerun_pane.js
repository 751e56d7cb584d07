// Rerun's view below the plan: the run as its recorder shows it live, else its files so far.

import { Viewer } from "/static/viewer.js";

const LOOK_MS = 3000;

/** The pane; it loads the viewer when it is first shown, and opens the next run by itself. */
export class RerunPane {
  #box;
  #viewer = null;
  #says;
  #isStarting = false;
  #shownRun = null;

  /** `run()` gives the name of the newest run, or "". */
  constructor(box, run) {
    this.#box = box;
    this.#says = box.querySelector("p");
    this.run = run;
    setInterval(() => this.#look(), LOOK_MS);
  }

  get isShown() {
    return !this.#box.hidden;
  }

  /** Show or hide the pane. */
  toggle() {
    this.#box.hidden = !this.#box.hidden;
    this.#look();
  }

  /** Open what there is, if it is another run than before. */
  async #look() {
    const run = this.run();
    if (!this.isShown || document.hidden || this.#isStarting || run === this.#shownRun) {
      return;
    }
    this.#isStarting = true;
    try {
      const url = (await this.#liveAddress()) || (await fileOf(run));
      this.#shownRun = run;
      if (!url) {
        this.#says.textContent = run ? `${run} has no recording to show` : "no run is recorded yet";
        return;
      }
      if (!this.#viewer) {
        this.#says.textContent = "loading the viewer ...";
        this.#viewer = await Viewer.start(
          this.#box.querySelector(".rerun-box"),
          this.#box.dataset.version,
        );
      }
      await this.#viewer.open([url]);
      this.#says.textContent = "";
      this.#box.title = url.startsWith("/") ? "from the run's files, as they were when opened" : "";
    } catch (error) {
      this.#says.textContent = `the viewer cannot be shown: ${error.message}`;
    } finally {
      this.#isStarting = false;
    }
  }

  /** Where the recorder shows its run, if it does. */
  async #liveAddress() {
    const { live } = this.#box.dataset;
    try {
      await fetch(`http://${live}/`, { mode: "no-cors" });
      return live ? `rerun+http://${live}/proxy` : "";
    } catch {
      return "";
    }
  }

  /** Show a moment, in s of simulation time. */
  seek(timeS) {
    if (this.isShown && this.#viewer) {
      this.#viewer.seek(timeS);
    }
  }
}

/** The recording in a run's folder; empty: there is none. */
async function fileOf(run) {
  const url = `/runs/${encodeURIComponent(run)}/files/run.rrd`;
  const found = run ? await fetch(url, { method: "HEAD" }) : null;
  return found?.ok ? url : "";
}
