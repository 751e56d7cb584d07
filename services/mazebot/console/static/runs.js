// The page of all runs: filters without a reload, and changes itself when a run does.

const PERIOD_MS = 2000;
const TYPING_MS = 150;
const MOST_COMPARED = 10;

const filter = document.getElementById("filter");
const cards = document.getElementById("cards");
const status = document.getElementById("status");
const pages = document.getElementById("pages");
const compare = document.getElementById("compare");
const shown = new Map();
let etag = "";
let asked = 0;

document.documentElement.classList.add("scripted");

/** The query of an address for the content of the form, without empty fields. */
function queryOfForm() {
  const query = new URLSearchParams();
  for (const [name, value] of new FormData(filter)) {
    if (value && !(name === "sort" && value === "newest")) query.set(name, value);
  }
  return query;
}

function show(answer) {
  status.innerHTML = answer.status;
  pages.innerHTML = answer.pages;
  const names = new Set(answer.cards.map((card) => card.name));
  const chosen = new Set(chosenRuns());
  const focused = document.activeElement?.closest?.(".card")?.dataset.run;
  for (const element of [...cards.children]) {
    if (!names.has(element.dataset.run)) element.remove();
  }
  const present = new Map([...cards.children].map((element) => [element.dataset.run, element]));
  let before = cards.firstElementChild;
  for (const { name, html } of answer.cards) {
    let element = present.get(name);
    if (!element || shown.get(name) !== html) {
      const fresh = document.createRange().createContextualFragment(html).firstElementChild;
      if (chosen.has(name)) fresh.querySelector("input[name=run]").checked = true;
      if (element && focused !== name) {
        if (before === element) before = fresh;
        element.replaceWith(fresh);
        element = fresh;
      } else if (!element) {
        element = fresh;
      }
      shown.set(name, html);
    }
    if (element === before) before = before.nextElementSibling;
    else cards.insertBefore(element, before);
  }
  updateChoice();
}

async function load() {
  const mine = ++asked;
  try {
    const headers = { accept: "application/json", ...(etag && { "if-none-match": etag }) };
    const answer = await fetch(`/runs.json${location.search}`, { headers, cache: "no-store" });
    if (mine !== asked || answer.status === 304) return;
    if (!answer.ok) throw new Error(answer.statusText);
    const content = await answer.json();
    if (mine !== asked) return;
    etag = answer.headers.get("etag") ?? "";
    show(content);
  } catch {
    if (mine === asked) {
      etag = "";
      status.textContent = "no response from the console; this page shows its last state";
    }
  }
}

function go(query, push) {
  const address = `/runs${query.size ? `?${query}` : ""}`;
  if (address === location.pathname + location.search) return;
  history[push ? "pushState" : "replaceState"](null, "", address);
  etag = "";
  load();
}

let typing = 0;
filter.addEventListener("input", (event) => {
  clearTimeout(typing);
  const isText = event.target.name === "q";
  typing = setTimeout(() => go(queryOfForm(), !isText), isText ? TYPING_MS : 0);
});
filter.addEventListener("submit", (event) => {
  event.preventDefault();
  clearTimeout(typing);
  go(queryOfForm(), true);
});
pages.addEventListener("click", (event) => {
  const link = event.target.closest("a");
  if (!link || event.ctrlKey || event.metaKey || event.shiftKey) return;
  event.preventDefault();
  go(new URL(link.href).searchParams, true);
  window.scrollTo(0, 0);
});
window.addEventListener("popstate", () => {
  const query = new URLSearchParams(location.search);
  for (const field of filter.elements) {
    if (field.name) field.value = query.get(field.name) ?? (field.name === "sort" ? "newest" : "");
  }
  etag = "";
  load();
});

// The choice outlives a page of cards, and a visit to a run.
const CHOICE = "chosen-runs";
const chosenElsewhere = new Set(JSON.parse(sessionStorage.getItem(CHOICE) ?? "[]"));

function chosenRuns() {
  const here = [...cards.querySelectorAll("input[name=run]")];
  for (const box of here) chosenElsewhere[box.checked ? "add" : "delete"](box.value);
  return [...chosenElsewhere];
}

function updateChoice() {
  const chosen = chosenRuns();
  sessionStorage.setItem(CHOICE, JSON.stringify(chosen));
  const button = compare.querySelector("button");
  button.disabled = chosen.length < 2 || chosen.length > MOST_COMPARED;
  button.textContent = compareText(chosen.length);
}

function compareText(count) {
  if (count === 0) return "Choose runs to compare";
  if (count === 1) return "Choose one more run to compare";
  if (count > MOST_COMPARED) return `${count} runs chosen: at most ${MOST_COMPARED} can be compared`;
  return `Compare ${count} runs`;
}

for (const box of cards.querySelectorAll("input[name=run]")) {
  if (chosenElsewhere.has(box.value)) box.checked = true;
}
cards.addEventListener("change", updateChoice);
compare.addEventListener("submit", (event) => {
  event.preventDefault();
  const query = new URLSearchParams(chosenRuns().map((name) => ["run", name]));
  sessionStorage.removeItem(CHOICE);
  location.assign(`/compare?${query}`);
});

document.addEventListener("keydown", (event) => {
  const isTyping = event.target.matches("input:not([type=checkbox]), select, textarea");
  if (event.key === "/" && !isTyping) {
    event.preventDefault();
    filter.elements.q.focus();
    return;
  }
  const move = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
  const card = event.target.closest?.(".card");
  if (move && card && !isTyping) {
    const next = move > 0 ? card.nextElementSibling : card.previousElementSibling;
    next?.querySelector("h2 a").focus();
  }
});

updateChoice();
setInterval(() => document.hidden || load(), PERIOD_MS);
document.addEventListener("visibilitychange", () => document.hidden || load());
