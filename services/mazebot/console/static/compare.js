// The page that compares runs: the same plots of all of them over each other.

import { plan, timePlots } from "/static/plots.js";

document.documentElement.classList.add("scripted");

async function load(item, index) {
  const name = item.dataset.run;
  if (!("series" in item.dataset)) return null;
  const answer = await fetch(`/runs/${encodeURIComponent(name)}/files/series.json`);
  return answer.ok ? { name, index, series: await answer.json() } : null;
}

const items = [...document.querySelectorAll("#legend li")];
const runs = (await Promise.all(items.map(load))).filter(Boolean);
const box = document.querySelector("[data-plot=plan]");
if (box && runs.length) {
  plan(box, runs);
  timePlots(document.querySelector("[data-plot=time]"), runs);
}
