// Rerun's view beside the plan: the run as its recorder shows it live, else its file as it grows.

import { Viewer } from "/static/viewer.js";

const LOOK_MS = 3000;
const FOLLOW_MS = 500;
/** Of a time sent to the viewer, within which the viewer reports it. */
const SAME_S = 0.002;
const MOST_SENT = 20;
/** After a touch of the viewer, within which another time is the user's choice. */
const TOUCH_MS = 3000;

/** The pane; it loads the viewer when it is first shown, and opens the next run by itself. */
export class RerunPane {
  #box;
  #viewer = null;
  #status;
  #button;
  #run;
  #nowS;
  #isStarting = false;
  #shownRun = null;
  #file = "";
  #isFollowing = true;
  #wantedS = null;
  #sent = [];
  #touchedMs = -Infinity;

  /** `run()` gives the name of the newest run, or ""; `nowS()` the simulation time, in s. */
  constructor(box, run, nowS) {
    this.#box = box;
    this.#status = box.querySelector("p");
    this.#button = box.querySelector("button");
    this.#run = run;
    this.#nowS = nowS;
    this.#button.addEventListener("click", () => this.#follow(true));
    for (const kind of ["pointerdown", "pointerup", "wheel", "keydown"]) {
      box.querySelector(".rerun-box").addEventListener(kind, () => {
        this.#touchedMs = performance.now();
      }, { capture: true, passive: true });
    }
    setInterval(() => this.#look(), LOOK_MS);
    setInterval(() => this.#showNow(), FOLLOW_MS);
  }

  get isShown() {
    return !this.#box.hidden;
  }

  /** The pane is shown now. */
  shown() {
    return this.#look();
  }

  /** Open what there is, if it is another run than before. */
  async #look() {
    const run = this.#run();
    if (!this.isShown || document.hidden || this.#isStarting || run === this.#shownRun) {
      return;
    }
    this.#isStarting = true;
    try {
      const live = await this.#liveAddress();
      const url = live || (await fileOf(run));
      if (!url) {
        // It may come: not all files of a run exist at its start.
        this.#status.textContent = run
          ? `${run}: no recording with this name in the folder of runs of this console`
          : "no recorded run yet";
        return;
      }
      if (!this.#viewer) {
        this.#status.textContent = "loading the viewer ...";
        this.#viewer = await Viewer.start(
          this.#box.querySelector(".rerun-box"),
          this.#box.dataset.version,
        );
        this.#viewer.onOpen = (recording) => this.#opened(recording);
        this.#viewer.onTime = (timeS) => this.#sees(timeS);
      }
      delete this.#box.dataset.recording;
      this.#sent = [];
      this.#file = live ? "" : url;
      // Before it opens: then the moment that is wanted is shown, and no longer wanted.
      this.#follow(this.#wantedS === null);
      await this.#viewer.open([url]);
      this.#shownRun = run;
      this.#status.textContent = "";
    } catch (error) {
      this.#status.textContent = `failed to show the viewer: ${error.message}`;
    } finally {
      this.#isStarting = false;
    }
  }

  /** Where the recorder shows its run, if it does. */
  async #liveAddress() {
    const { live } = this.#box.dataset;
    if (!live) {
      return "";
    }
    try {
      await fetch(`http://${live}/`, { mode: "no-cors" });
      return `rerun+http://${live}/proxy`;
    } catch {
      return "";
    }
  }

  #opened(recording) {
    this.#box.dataset.recording = recording;
    if (this.#wantedS !== null) {
      this.#sendTime(this.#wantedS);
      this.#wantedS = null;
    }
  }

  /** Show a moment, in s of simulation time. */
  async seek(timeS) {
    this.#wantedS = timeS;
    this.#follow(false);
    await this.#look();
    if (this.#box.dataset.recording) {
      this.#sendTime(timeS);
      this.#wantedS = null;
    }
  }

  /** Follow the newest moment, or stay where the viewer is. A recorder's view follows by itself. */
  #follow(wanted) {
    this.#isFollowing = wanted;
    this.#button.hidden = wanted || !this.#file;
    this.#showNow();
  }

  #showNow() {
    if (this.#isFollowing && this.#file && this.isShown && this.#box.dataset.recording && !document.hidden) {
      this.#sendTime(this.#nowS());
    }
  }

  #sendTime(timeS) {
    if (timeS !== this.#sent[this.#sent.length - 1]) {
      this.#sent = [...this.#sent.slice(-MOST_SENT), timeS];
      this.#viewer.seek(timeS);
    }
  }

  /** The user has gone to another time in the viewer itself: it stays there. */
  #sees(timeS) {
    this.#box.dataset.time = timeS;
    const isOurs = this.#sent.some((sent) => Math.abs(sent - timeS) < SAME_S);
    if (this.#isFollowing && !isOurs && performance.now() - this.#touchedMs < TOUCH_MS) {
      this.#follow(false);
    }
  }
}

/** The recording in a run's folder, as it grows; empty: there is none. */
async function fileOf(run) {
  const url = `/runs/${encodeURIComponent(run)}/growing/run.rrd`;
  const found = run ? await fetch(url, { method: "HEAD" }) : null;
  return found?.status === 200 ? url : "";
}
