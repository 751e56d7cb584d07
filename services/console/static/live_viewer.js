// The Rerun view in the live page: what the recorder shows, or else the newest run's files so far.

import { Viewer } from "/static/viewer.js";

const LOOK_MS = 3000;

const panel = document.getElementById("live-viewer");
const says = document.getElementById("live-viewer-says");
const box = panel?.querySelector(".viewer-box");
const live = panel?.dataset.live;
let viewer = null;
let isStarting = false;

/** Whether a recorder listens for viewers. */
async function isServed() {
  if (!live) return false;
  try {
    await fetch(`http://${live}/`, { mode: "no-cors" });
    return true;
  } catch {
    return false;
  }
}

/** The files of the run that is being recorded; empty: none is. */
async function runningFiles() {
  const headers = { accept: "application/json" };
  const answer = await fetch("/runs.json?state=running", { headers, cache: "no-store" });
  const run = answer.ok && (await answer.json()).cards[0];
  return run ? [`/runs/${encodeURIComponent(run.name)}/files/run.rrd`] : [];
}

/** Show what there is; a run that begins later, too. */
async function look() {
  if (!panel.open || document.hidden || isStarting) return;
  try {
    const urls = (await isServed()) ? [`rerun+http://${live}/proxy`] : await runningFiles();
    if (!urls.length) {
      if (!viewer) says.textContent = "no run is being recorded";
      return;
    }
    if (!viewer) {
      isStarting = true;
      says.textContent = "loading the viewer ...";
      box.hidden = false;
      viewer = await Viewer.start(box, panel.dataset.version);
    }
    await viewer.open(urls);
    says.textContent = urls[0].startsWith("/") ? "from the files of the run, as they were when opened" : "";
  } catch (error) {
    says.textContent = `the viewer cannot be shown: ${error.message}`;
  } finally {
    isStarting = false;
  }
}

panel?.addEventListener("toggle", look);
if (panel) setInterval(look, LOOK_MS);
