// What all pages share: copying, tables that sort and filter, choosing things to compare, and pages that follow a run.
"use strict";

const labbook = {
  // Whoever wants to set up what is new on the page: at the start, and after a part of it was replaced.
  ready(setUp) {
    const run = () => setUp(document);
    if (document.readyState === "loading") document.addEventListener("DOMContentLoaded", run);
    else run();
    document.addEventListener("htmx:afterSettle", run);
  },
  // The state of the page stands in its address, so that a link shows what one sees.
  get(name) { return new URLSearchParams(location.search).get(name); },
  set(values) {
    const query = new URLSearchParams(location.search);
    for (const [name, value] of Object.entries(values)) {
      if (value === null || value === "") query.delete(name); else query.set(name, value);
    }
    const text = query.toString();
    history.replaceState(history.state, "", location.pathname + (text ? "?" + text : "") + location.hash);
  },
  data() {
    const holder = document.getElementById("data");
    return holder ? JSON.parse(holder.textContent) : null;
  },
  // Points that ranges leave, or null: all.
  chosen: null,
  // While a range is dragged the table keeps its rows: else what stands below it would move under the pointer.
  dragging: false,
  choose(points) {
    labbook.chosen = points;
    document.dispatchEvent(new CustomEvent("labbook:chosen"));
  },
  save(content, file) {
    const link = document.createElement("a"), address = URL.createObjectURL(content);
    link.href = address;
    link.download = file;
    link.click();
    URL.revokeObjectURL(address);
  },
  once(element, name) {
    if (!element || element.dataset[name]) return false;
    element.dataset[name] = "1";
    return true;
  },
};

function number(text) {
  const plain = text.replace(/−/g, "-").trim();
  if (plain === "" || plain === "–") return NaN;
  const value = parseFloat(plain.replace(/^[^\d.-]+/, ""));
  return value;
}

function sortable(table) {
  const heads = [...table.tHead.rows[0].cells];
  heads.forEach((head, column) => {
    const button = head.querySelector("button");
    if (!button) return;
    button.addEventListener("click", () => sort(table, column, head.getAttribute("aria-sort") === "ascending" ? "descending" : "ascending", true));
  });
  const order = table.id === "points" && labbook.get("sort");
  if (order) {
    const column = Number(order.replace("-", ""));
    if (heads[column]) sort(table, column, order.startsWith("-") ? "descending" : "ascending", false);
  }
}

function sort(table, column, order, keep) {
  const body = table.tBodies[0], sign = order === "ascending" ? 1 : -1;
  const rows = [...body.rows].map((row, place) => ({ row, place, text: row.cells[column].textContent.trim(), value: number(row.cells[column].textContent) }));
  const numeric = rows.some((entry) => !Number.isNaN(entry.value));
  rows.sort((a, b) => {
    if (numeric) {
      if (Number.isNaN(a.value) || Number.isNaN(b.value)) return Number.isNaN(a.value) - Number.isNaN(b.value) || a.place - b.place;
      return sign * (a.value - b.value) || a.place - b.place;
    }
    return sign * a.text.localeCompare(b.text) || a.place - b.place;
  });
  body.append(...rows.map((entry) => entry.row));
  for (const head of table.tHead.rows[0].cells) if (head.hasAttribute("aria-sort")) head.setAttribute("aria-sort", "none");
  table.tHead.rows[0].cells[column].setAttribute("aria-sort", order);
  if (keep && table.id === "points") labbook.set({ sort: (sign < 0 ? "-" : "") + column });
}

function filterPoints() {
  const table = document.getElementById("points"), field = document.getElementById("points-find");
  if (!table || labbook.dragging) return;
  const text = field.value.trim().toLowerCase(), rows = [...table.tBodies[0].rows];
  let visible = 0;
  for (const row of rows) {
    const fits = row.textContent.toLowerCase().includes(text) && (!labbook.chosen || labbook.chosen.has(Number(row.dataset.point)));
    row.hidden = !fits;
    visible += fits;
  }
  document.getElementById("points-count").textContent = visible === rows.length ? `${rows.length} points` : `${visible} of ${rows.length} points`;
}

function comparing() {
  const button = document.querySelector("button.compare");
  if (!button) return;
  const items = [...document.querySelectorAll("input.choose:checked")].map((box) => box.value);
  button.disabled = items.length < 2 || items.length > 6;
  button.title = items.length > 6 ? "six at most" : "";
}

document.addEventListener("change", (event) => { if (event.target.matches("input.choose")) comparing(); });
document.addEventListener("click", (event) => {
  // A permalink names what the chart shows, too.
  const permalink = event.target.closest("a.permalink");
  if (permalink) {
    const query = new URLSearchParams(location.search), target = new URL(permalink.href);
    for (const [name, value] of query) if (name !== "as" && name !== "since") target.searchParams.set(name, value);
    permalink.href = target.pathname + target.search;
  }
  const compare = event.target.closest("button.compare");
  if (compare) {
    const items = [...document.querySelectorAll("input.choose:checked")].map((box) => "item=" + encodeURIComponent(box.value));
    location.assign(compare.dataset.address + "?" + items.join("&"));
  }
  const save = event.target.closest("button.save");
  if (save) labbook.save(new Blob([save.dataset.save], { type: "text/yaml" }), save.dataset.file);
  const copy = event.target.closest("button.copy");
  if (copy) {
    const notice = copy.parentElement.querySelector(".copied");
    const done = (text) => { if (notice) notice.textContent = text; };
    if (navigator.clipboard) {
      navigator.clipboard.writeText(copy.dataset.copy).then(() => done(copy.textContent + ": done"), () => done("The browser did not allow it."));
    } else done("Copying needs a secure address (https or localhost).");
  }
});

// An address names a part of the page: if it is folded, it opens.
function unfold() {
  const part = location.hash.length > 1 && document.getElementById(decodeURIComponent(location.hash.slice(1)));
  if (part && part.tagName === "DETAILS") part.open = true;
}
window.addEventListener("hashchange", unfold);

// What was opened stays open when the page is shown anew.
let openParts = [];
document.addEventListener("htmx:beforeSwap", (event) => {
  if (event.detail.target && event.detail.target.id === "main") openParts = [...document.querySelectorAll("main details[id]")].map((part) => [part.id, part.open]);
});
document.addEventListener("htmx:afterSettle", (event) => {
  if (event.detail.target && event.detail.target.id === "main") for (const [id, open] of openParts) { const part = document.getElementById(id); if (part) part.open = open; }
});

// A page that shows a study which runs now is shown anew when more runs are there.
let lastDone = null, lastShown = performance.now();
document.addEventListener("htmx:afterSettle", () => {
  const bar = document.querySelector("#chart") && document.querySelector(".progress[data-done]");
  const empty = document.querySelector(".panel.empty") && document.querySelector(".progress[data-done]");
  const progress = bar || empty;
  if (!progress) return;
  const done = Number(progress.dataset.done);
  const later = performance.now() - lastShown > 5000 || !("running" in progress.dataset); // the last time, at once
  if (lastDone !== null && done > lastDone && later && !document.querySelector("form :focus")) {
    lastShown = performance.now();
    lastDone = done;
    htmx.ajax("GET", location.pathname + location.search, { target: "#main", select: "#main", swap: "outerHTML" });
  } else if (lastDone === null) lastDone = done;
});

// A study that is new in the lab has no card yet: the first page is shown anew, once.
let studies = null;
document.addEventListener("htmx:afterSettle", () => {
  const summary = document.querySelector("#summary[data-studies]");
  if (!summary) return;
  const before = studies;
  studies = summary.dataset.studies;
  if (before !== null && before !== studies && !document.querySelector("form :focus")) {
    htmx.ajax("GET", location.pathname + location.search, { target: "#main", select: "#main", swap: "outerHTML" });
  }
});

// The viewer is as light or dark as the page, and plays from the middle of the window on.
function viewers() {
  for (const frame of document.querySelectorAll("iframe[data-theme]")) {
    frame.removeAttribute("data-theme");
    const dark = matchMedia("(prefers-color-scheme: dark)").matches;
    frame.src = frame.getAttribute("src") + "&theme=" + (dark ? "dark" : "light");
    if (frame.dataset.opens) openAt(frame, Uint8Array.from(atob(frame.dataset.opens), (character) => character.charCodeAt(0)));
  }
}

// Sends a request to the viewer as soon as it has the recording: until then it refuses, and without it it plays from 0.
function openAt(frame, request, attempts = 300) {
  if (!attempts || !frame.isConnected) return;
  const later = () => setTimeout(() => openAt(frame, request, attempts - 1), 200);
  const handle = frame.contentWindow && frame.contentWindow._handle;
  if (!handle || !handle.viewer_control) later();
  else handle.viewer_control(request).then(() => frame.setAttribute("data-opened", ""), later);
}

// A film of the run beside its tile, while the pointer stays on it or it has the focus; Escape takes it away.
function films(root) {
  if (matchMedia("(prefers-reduced-motion: reduce)").matches) return;
  let film = null, waits = 0;
  const away = () => { clearTimeout(waits); if (film) film.remove(); film = null; };
  const escape = (event) => { if (event.key === "Escape") away(); };
  const show = (tile) => {
    away();
    film = Object.assign(document.createElement("img"), { src: tile.dataset.film, alt: "", className: "playing" });
    film.addEventListener("error", away);
    const { left, right, top } = tile.getBoundingClientRect(), wide = Math.min(480, innerWidth - 32);
    const beside = right + 8 + wide < innerWidth ? right + 8 : Math.max(8, left - wide - 8);
    const high = Math.min(440, innerHeight - 16);
    Object.assign(film.style, { left: `${beside}px`, top: `${Math.max(8, Math.min(top, innerHeight - high - 8))}px`, maxWidth: `${wide}px`, maxHeight: `${high}px` });
    document.body.append(film);
  };
  for (const tile of root.querySelectorAll("a[data-film]")) {
    if (!labbook.once(tile, "plays")) continue;
    const soon = () => { away(); waits = setTimeout(() => show(tile), 300); };
    tile.addEventListener("pointerenter", soon);
    tile.addEventListener("focus", soon);
    tile.addEventListener("pointerleave", away);
    tile.addEventListener("blur", away);
  }
  document.addEventListener("keydown", escape);
}

// Beds of a card move together: once for five seconds when the card comes into view, and as long as the pointer or the
// focus is on it. Loops are loaded one after the other, as a server may have to draw them.
const moved = new Set();
let loading = Promise.resolve();
function motion(root) {
  if (matchMedia("(prefers-reduced-motion: reduce)").matches) return;
  for (const card of root.querySelectorAll(".card")) {
    const beds = [...card.querySelectorAll("img[data-loop]")];
    if (!beds.length || !labbook.once(card, "moves")) continue;
    let ready = null, within = false, waits = 0;
    const load = () => ready || (ready = Promise.all(beds.map((bed) => (loading = loading.then(() => {
      const loop = new Image();
      loop.src = bed.dataset.loop;
      return loop.decode().catch(() => bed.removeAttribute("data-loop"));
    })))));
    const show = (name) => { for (const bed of beds) if (bed.dataset.loop) { bed.dataset.still ||= bed.getAttribute("src"); bed.src = bed.dataset[name]; } card.toggleAttribute("data-moving", name === "loop"); };
    const rest = () => { clearTimeout(waits); if (!within && card.hasAttribute("data-moving")) show("still"); };
    const enter = () => { within = true; load().then(() => { if (within && !card.hasAttribute("data-moving")) show("loop"); }); };
    const leave = () => { within = card.matches(":hover, :focus-within"); rest(); };
    card.addEventListener("pointerenter", enter);
    card.addEventListener("focusin", enter);
    card.addEventListener("pointerleave", leave);
    card.addEventListener("focusout", () => setTimeout(leave));
    if (moved.has(card.id)) continue; // shown anew while its study runs
    const seen = new IntersectionObserver((entries) => {
      if (!entries.some((entry) => entry.isIntersecting)) return;
      seen.disconnect();
      moved.add(card.id);
      load().then(() => { if (card.isConnected && !card.hasAttribute("data-moving")) { show("loop"); waits = setTimeout(rest, 5000); } });
    }, { threshold: 0.6 });
    seen.observe(card);
  }
}

labbook.ready((root) => {
  films(root);
  motion(root);
  for (const table of root.querySelectorAll("table[data-sortable]")) if (labbook.once(table, "sorting")) sortable(table);
  const field = document.getElementById("points-find");
  if (labbook.once(field, "filtering")) {
    field.value = labbook.get("find") || "";
    field.addEventListener("input", () => { labbook.set({ find: field.value }); filterPoints(); });
    filterPoints();
  }
  comparing();
  viewers();
  unfold();
});
document.addEventListener("labbook:chosen", filterPoints);
