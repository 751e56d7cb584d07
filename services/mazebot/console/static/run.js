// The page of one run: its plots, the viewer, and the way to another run without a reload.

import { plan, timePlots } from "/static/plots.js";
import { Viewer } from "/static/viewer.js";

const PERIOD_MS = 3000;
const LIVE_MS = 5000;
const REMEMBERED = "viewer";

document.documentElement.classList.add("scripted");

const section = document.getElementById("viewer");
const box = section.querySelector(".viewer-box");
const start = section.querySelector(".viewer-start");
const status = document.getElementById("viewer-status");
let viewer = null;
let etag = "";
let plots = [];

const head = () => document.querySelector("[data-part=head]");
const part = (name) => document.querySelector(`[data-part=${name}]`);
const urls = () => [...document.querySelectorAll("#parts li")].map((item) => item.dataset.url);

async function openViewer() {
  if (!viewer) {
    const button = document.getElementById("open-viewer");
    if (!button || button.disabled) return;
    button.disabled = true;
    status.textContent = "loading the viewer ...";
    box.hidden = false;
    section.classList.add("open");
    try {
      viewer = await Viewer.start(box, section.dataset.version);
    } catch (error) {
      status.textContent = `failed to load the viewer: ${error.message}`;
      button.disabled = false;
      box.hidden = true;
      section.classList.remove("open");
      return;
    }
    sessionStorage.setItem(REMEMBERED, "open");
    viewer.onOpen = (recording) => {
      if (recording !== head().dataset.run && viewer.isOpen(head().dataset.live)) return;
      section.dataset.recording = recording;
      start.hidden = true;
      const time_s = Number(new URLSearchParams(location.search).get("t"));
      if (time_s > 0) viewer.seek(time_s);
    };
    viewer.onTime = showTime;
  }
  await openRecording();
}

/** The files of the run; or, while it is recorded, what its recorder shows live. */
async function openRecording() {
  const { run, live } = head().dataset;
  if (!live) {
    await viewer.open(urls());
    return;
  }
  if (viewer.isOpen(live) || viewer.isOpen(urls()[0])) return;
  await viewer.open([live]);
  setTimeout(() => {
    // The recorder is no live one, or it shows another run.
    const { dataset } = head();
    if (dataset.run === run && dataset.live && section.dataset.recording !== run) {
      viewer.open(urls());
    }
  }, LIVE_MS);
}

/** Mark the moment that the viewer shows in the plots and the table of events. */
function showTime(time_s) {
  for (const plot of plots) plot.mark(time_s);
  let newest = null;
  for (const row of document.querySelectorAll("#events tbody tr")) {
    if (Number(row.dataset.time) <= time_s + 1e-6) newest = row;
    row.removeAttribute("aria-current");
  }
  newest?.setAttribute("aria-current", "time");
}

async function seek(time_s) {
  const query = new URLSearchParams(location.search);
  query.set("t", String(Math.round(time_s * 1000) / 1000));
  history.replaceState(null, "", `?${query}`);
  showTime(time_s);
  await openViewer();
  await viewer?.seek(time_s);
}

async function draw() {
  plots = [];
  const name = head().dataset.run;
  const drawn = document.querySelector("[data-plot=plan]");
  if (!drawn) return;
  const answer = await fetch(`/runs/${encodeURIComponent(name)}/files/series.json`);
  if (!answer.ok || head().dataset.run !== name) return;
  const runs = [{ name, series: await answer.json() }];
  plots = [plan(drawn, runs), ...timePlots(document.querySelector("[data-plot=time]"), runs, seek)];
  const time_s = Number(new URLSearchParams(location.search).get("t"));
  if (time_s > 0) showTime(time_s);
}

/** Take over the page of a run, all but the viewer. */
function takeOver(text) {
  const fresh = new DOMParser().parseFromString(text, "text/html");
  document.title = fresh.title;
  for (const name of ["head", "events", "body"]) {
    const [from, to] = [fresh.querySelector(`[data-part=${name}]`), part(name)];
    if (!from) throw new Error("no page of a run");
    to.replaceWith(document.adoptNode(from));
  }
}

async function show(address, push) {
  const answer = await fetch(address, { headers: { accept: "text/html" } });
  if (!answer.ok) {
    location.assign(address);
    return;
  }
  takeOver(await answer.text());
  etag = answer.headers.get("etag") ?? "";
  if (push) history.pushState(null, "", address);
  delete section.dataset.recording;
  await draw();
  if (viewer) await openRecording();
}

/** A run that is recorded changes: its page does, too. */
async function refresh() {
  if (document.hidden || head().dataset.state !== "running") return;
  if (document.activeElement?.closest("[data-part]")) return;
  try {
    const headers = etag ? { "if-none-match": etag } : {};
    const name = head().dataset.run;
    const answer = await fetch(location.pathname, { headers, cache: "no-store" });
    if (answer.status !== 200 || head().dataset.run !== name) return;
    etag = answer.headers.get("etag") ?? "";
    takeOver(await answer.text());
    await draw();
    if (viewer) await openRecording();
  } catch {
    // The next time.
  }
}

document.addEventListener("click", (event) => {
  const seeking = event.target.closest(".seek");
  if (seeking) {
    seek(Number(seeking.dataset.time));
    return;
  }
  const link = event.target.closest("a[data-go]");
  if (!link || event.ctrlKey || event.metaKey || event.shiftKey) return;
  event.preventDefault();
  show(link.href, true);
});

document.addEventListener("submit", async (event) => {
  if (event.target.id !== "labels") return;
  event.preventDefault();
  const status = document.getElementById("labels-status");
  const body = new URLSearchParams(new FormData(event.target));
  const headers = { accept: "application/json" };
  try {
    const answer = await fetch(event.target.action, { method: "POST", body, headers });
    const content = await answer.json();
    status.className = answer.ok ? "good" : "bad";
    status.textContent = answer.ok ? "saved" : content.error;
    if (answer.ok) event.target.elements.tags.value = content.tags.join(" ");
  } catch (error) {
    status.className = "bad";
    status.textContent = `not saved: ${error.message}`;
  }
});

document.addEventListener("toggle", (event) => {
  if (event.target.id !== "report") return;
  const frame = event.target.querySelector("iframe");
  if (event.target.open && !frame.src) frame.src = frame.dataset.src;
}, true);

document.addEventListener("keydown", (event) => {
  const isTyping = event.target.matches("input, select, textarea, canvas");
  if (isTyping || event.ctrlKey || event.metaKey || event.altKey) return;
  const which = { j: "[rel=next]", k: "[rel=prev]" }[event.key];
  if (which) head().querySelector(which)?.click();
  if (event.key === "v") openViewer();
});

window.addEventListener("popstate", () => show(location.href, false));
document.getElementById("open-viewer")?.addEventListener("click", openViewer);
setInterval(refresh, PERIOD_MS);

draw();
const wantsViewer = new URLSearchParams(location.search).has("t");
if (wantsViewer || sessionStorage.getItem(REMEMBERED)) openViewer();
