// The table. Only its visible rows exist in the page and are requested.

import { $, clock, fillSpark, glow, made, madeButton, sparkline } from "./elements.js";
import { rowsOf } from "./rows.js";

const EXTRA = 6;  // rows above and below the window

// `columns` have a title, a kind, and `is_wide`; `cells` returns the cells of a row by its index, by their titles.
export const grid = { columns: [], count: 0, cells: () => undefined };

const rows = new Map();
const above = spacer();
const below = spacer();
let look = () => {};
let chosen = "";  // the name of the row whose chart is shown, as JSON

export function onView(call) { look = call; }

const tall = () => parseFloat(getComputedStyle(document.body).getPropertyValue("--tall"));

function spacer() {
  const row = made("tr");
  row.setAttribute("aria-hidden", "true");
  row.append(made("td", undefined, "space"));
  return row;
}

const classOf = (column) => `${column.kind}${column.is_wide ? " wide" : ""}`;

export function setColumns(columns, name) {
  grid.columns = columns;
  $("grid").className = name;
  $("cols").replaceChildren(...columns.map((each) => made("col", undefined, `col col-${classOf(each)}`)));
  $("heads").replaceChildren(...columns.map((each) => {
    const head = made("th", each.title, classOf(each));
    head.scope = "col";
    return head;
  }));
  for (const each of [above, below]) each.firstChild.colSpan = columns.length || 1;
  rows.clear();
  $("rows").replaceChildren(above, below);
  $("scroll").scrollTop = 0;
}

export function setCount(count) {
  grid.count = count;
  $("grid").setAttribute("aria-rowcount", count + 1);
  $("empty").hidden = count > 0;
  place();
}

export function range() {
  const height = tall();
  const box = $("scroll");
  const first = Math.max(0, Math.min(Math.floor(box.scrollTop / height) - EXTRA, grid.count));
  return [first, Math.min(grid.count, Math.ceil((box.scrollTop + box.clientHeight) / height) + EXTRA)];
}

function place() {
  const height = tall();
  const [first, stop] = range();
  for (const [index, row] of rows) {
    if (index >= first && index < stop) continue;
    if (row.contains(document.activeElement)) $("scroll").focus({ preventScroll: true });
    row.remove();
    rows.delete(index);
  }
  let next = below;
  for (let index = stop - 1; index >= first; index -= 1) {
    const row = rows.get(index) || newRow(index);
    if (!rows.has(index)) { next.before(row); rows.set(index, row); }
    next = row;
  }
  above.firstChild.style.height = `${first * height}px`;
  below.firstChild.style.height = `${(grid.count - stop) * height}px`;
  look();
}

function newRow(index) {
  const row = made("tr");
  row.dataset.at = index;
  row.setAttribute("aria-rowindex", index + 2);
  for (const column of grid.columns) {
    const cell = made(HEADS.has(column.kind) ? "th" : "td", undefined, classOf(column));
    if (HEADS.has(column.kind)) cell.scope = "row";
    KINDS[column.kind].make?.(cell);
    row.append(cell);
  }
  fillRow(row, index, false);
  return row;
}

// Fill the rows again; values that have changed glow.
export function fill(glows = true) { for (const [index, row] of rows) fillRow(row, index, glows); }

export function choose(key) {
  chosen = key;
  fill(false);
}

function fillRow(row, index, glows) {
  const cells = grid.cells(index);
  row.classList.toggle("chosen", chosen !== "" && !!cells && JSON.stringify(cells[grid.columns[0].title]) === chosen);
  grid.columns.forEach(({ kind, title }, at) => KINDS[kind].fill(row.children[at], cells?.[title], glows, row));
}

export function reveal(index) {
  const box = $("scroll");
  const top = index * tall();
  if (top < box.scrollTop) box.scrollTop = top;
  else if (top + 2 * tall() > box.scrollTop + box.clientHeight) box.scrollTop = top + 2 * tall() - box.clientHeight;
  place();
  return rows.get(index);
}

$("scroll").addEventListener("scroll", () => requestAnimationFrame(place), { passive: true });
new ResizeObserver(place).observe($("scroll"));

// The arrow keys move from a button to the one above or below it.
$("rows").addEventListener("keydown", (event) => {
  const step = { ArrowUp: -1, ArrowDown: 1 }[event.key];
  const row = event.target.closest("tr");
  const wanted = Number(row?.dataset.at) + step;
  if (!step || event.defaultPrevented || !(wanted >= 0 && wanted < grid.count)) return;
  event.preventDefault();
  const at = [...row.children].indexOf(event.target.closest("td, th"));
  reveal(wanted)?.children[at].querySelector("button")?.focus({ preventScroll: true });
});

// --- cells -------------------------------------------------------------------------

export function setText(element, text) { if (element.textContent !== text) element.textContent = text; }

function plain(cell, value) {
  const text = String(value ?? "");
  setText(cell, text);
  cell.title = text;
}

export function setValue(element, text, glows) {
  const before = element.textContent;
  if (before === text) return;
  element.textContent = text;
  if (before === "" || before === "…") return;
  // Values that change all the time do not glow.
  const now = performance.now();
  if (glows && !(now - element.changedAt < 4000)) glow(element);
  if (glows) element.changedAt = now;
}

const GOOD = { good: "good", up: "good", open: "good", answers: "good", works: "good", new: "new", client: "new",
  down: "down", silent: "down", offline: "down", fails: "down" };

const HEADS = new Set(["row", "at"]);
const NAME = ["group", "own", "place"];

// How the cells of each kind of column are made and filled.
export const KINDS = {
  text: { fill: plain },
  note: { fill: plain },
  number: { fill: plain },
  row: {
    make(cell) {
      const button = madeButton();
      button.append(...NAME.map((part) => made("span", "", part)));
      cell.append(button);
    },
    fill(cell, name = { own: "…" }) {
      for (const part of cell.firstChild.children) {
        setText(part, name[part.className] || "");
        part.hidden = !name[part.className];
      }
      cell.title = [...NAME, "description"].map((part) => name[part]).filter(Boolean).join("  ");
    },
  },
  value: {
    make(cell) { cell.append(made("span"), made("span", "", "units")); },
    fill(cell, { text, units } = { text: "…", units: "" }, glows) {
      setValue(cell.firstChild, text, glows);
      setText(cell.lastChild, units);
      cell.title = `${text} ${units}`;
    },
  },
  spark: {
    make(cell) { cell.append(sparkline()); },
    fill(cell, levels) { fillSpark(cell.firstChild, levels || []); },
  },
  // A word, the reason, and since when.
  state: {
    make(cell) { cell.append(made("b"), " ", made("span")); },
    fill(cell, { word = "", reason = "", since = 0 } = {}, glows, row) {
      const kind = GOOD[word] || (word ? "bad" : "");
      const isProblem = kind === "bad" || kind === "down";
      setText(cell.firstChild, word);
      setText(cell.lastChild, [isProblem && since ? `since ${moment(since)}` : "", reason].filter(Boolean).join(": "));
      cell.title = [since ? `since ${new Date(since * 1000)}` : "", reason].filter(Boolean).join(": ");
      cell.className = `state ${kind}`;
      row.classList.toggle("trouble", isProblem || reason !== "");
    },
  },
  age: { fill(cell, time) { cell.dataset.time = time || ""; fillAge(cell); } },
};

function moment(time) {
  const isToday = new Date(time * 1000).toDateString() === new Date().toDateString();
  return isToday ? clock(time) : new Date(time * 1000).toLocaleDateString();
}

function lasted(seconds) {
  if (seconds < 100) return `${Math.max(0, Math.floor(seconds))} s`;
  if (seconds < 6000) return `${Math.floor(seconds / 60)} min`;
  return seconds < 360000 ? `${Math.floor(seconds / 3600)} h` : `${Math.floor(seconds / 86400)} d`;
}

let behind = null;  // seconds by which the clock of the server is behind that of the browser

export function setClock() { behind = Date.now() / 1000 - rowsOf("page").get("now"); }

function fillAge(cell) {
  const time = Number(cell.dataset.time);
  setText(cell, time ? lasted(Date.now() / 1000 - behind - time) : "");
}

setInterval(() => { for (const cell of document.querySelectorAll("td.age")) fillAge(cell); }, 1000);
