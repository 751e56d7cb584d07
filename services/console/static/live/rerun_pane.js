// Rerun's view below the plan: the run as its recorder shows it live, else its files so far.

import { Viewer } from "/static/viewer.js";

const LIVE_MS = 8000;

/** The pane; it loads the viewer when it is first shown. */
export class RerunPane {
  #box;
  #viewer = null;
  #says;
  #opened = "";

  /** `run()` gives the name of the newest run, or "". */
  constructor(box, run) {
    this.#box = box;
    this.#says = box.querySelector("p");
    this.run = run;
  }

  get isShown() {
    return !this.#box.hidden;
  }

  /** Show or hide the pane. */
  async toggle() {
    this.#box.hidden = !this.#box.hidden;
    if (this.isShown && !this.#viewer) {
      await this.#start();
    }
  }

  async #start() {
    this.#says.textContent = "loading the viewer ...";
    try {
      this.#viewer = await Viewer.start(this.#box.querySelector(".rerun-box"), this.#box.dataset.version);
    } catch (error) {
      this.#says.textContent = `the viewer cannot be loaded: ${error.message}`;
      return;
    }
    this.#viewer.onOpen = (recording) => {
      this.#opened = recording;
      this.#says.textContent = "";
    };
    const { live } = this.#box.dataset;
    if (live && (await isThere(live))) {
      await this.#viewer.open([live]);
      setTimeout(() => {
        if (!this.#opened) {
          this.#openFiles();
        }
      }, LIVE_MS);
    } else {
      await this.#openFiles();
    }
  }

  async #openFiles() {
    const run = this.run();
    if (!run) {
      this.#says.textContent = "no run is recorded yet";
      return;
    }
    const url = `/runs/${encodeURIComponent(run)}/files/run.rrd`;
    const found = await fetch(url, { method: "HEAD" }).catch(() => null);
    if (!found?.ok) {
      this.#says.textContent = `${run} has no recording to show`;
      return;
    }
    await this.#viewer.open([url]);
  }

  /** Show a moment, in s of simulation time. */
  seek(timeS) {
    if (this.isShown && this.#viewer) {
      this.#viewer.seek(timeS);
    }
  }
}

/** Whether anybody listens at the address of a live recording. */
async function isThere(live) {
  const address = live.replace(/^rerun[+]/, "").replace(/proxy$/, "");
  try {
    await fetch(address, { mode: "no-cors" });
    return true;
  } catch {
    return false;
  }
}
