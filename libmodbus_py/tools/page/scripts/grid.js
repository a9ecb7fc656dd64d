// A table. Only its visible rows exist in the page and are requested.

import { $, clock, glow, made } from "./elements.js";
import { fillSpark, sparkline } from "./spark.js";

const EXTRA = 6;  // rows above and below the window
const MOST_KEPT = 2000;

export const grid = { table: null, count: 0, rows: new Map(), chosen: "", behind: 0 };

let first = 0;
let drawnRows = [];
let above = null;
let below = null;
let changed = () => {};
let isDue = false;

const tall = () => parseFloat(getComputedStyle(document.documentElement).getPropertyValue("--tall"));
let height = tall();

export function onView(call) { changed = call; }

export function range() { return [first, first + drawnRows.length]; }

export function setTable(table) {
  grid.table = table;
  $("caption").textContent = table.title;
  $("grid").className = table.name;
  const kind = ([, kind, wide]) => `${kind}${wide ? " wide" : ""}`;
  $("cols").replaceChildren(...table.columns.map((each) => made("col", undefined, `col col-${kind(each)}`)));
  $("heads").replaceChildren(...table.columns.map((each) => {
    const head = made("th", each[0], kind(each));
    head.scope = "col";
    return head;
  }));
  clear();
}

export function clear() {
  grid.rows.clear();
  grid.count = 0;
  first = 0;
  $("scroll").scrollTop = 0;
  drawnRows = [];
  above = spacer();
  below = spacer();
  $("rows").replaceChildren(above, below);
  place();
}

function spacer() {
  const row = made("tr");
  row.setAttribute("aria-hidden", "true");
  const cell = made("td", undefined, "space");
  cell.colSpan = grid.table?.columns.length || 1;
  row.append(cell);
  return row;
}

export function take(count, rows) {
  if (count !== grid.count) {
    grid.count = count;
    for (const at of grid.rows.keys()) if (at >= count) grid.rows.delete(at);
    $("grid").setAttribute("aria-rowcount", count + 1);
    $("empty").hidden = count > 0;
    place();
  }
  for (const [key, cells] of Object.entries(rows)) {
    const at = Number(key);
    const isNew = !grid.rows.has(at);
    grid.rows.set(at, cells);
    if (at >= first && at < first + drawnRows.length) fill(drawnRows[at - first], at, !isNew);
  }
  if (grid.rows.size > MOST_KEPT) {
    for (const at of grid.rows.keys()) if (at < first - 500 || at > first + 500) grid.rows.delete(at);
  }
}

// --- rows ------------------------------------------------------------------------

function place() {
  const box = $("scroll");
  const most = Math.ceil(box.clientHeight / height) + 2 * EXTRA;
  const number = Math.min(most, grid.count);
  const wanted = Math.max(0, Math.min(Math.floor(box.scrollTop / height) - EXTRA, grid.count - number));
  while (drawnRows.length > number) drawnRows.pop().remove();
  const before = drawnRows.length;
  while (drawnRows.length < number) {
    const row = emptyRow();
    drawnRows.push(row);
    below.before(row);
  }
  const by = wanted - first;
  first = wanted;
  if (Math.abs(by) >= number) drawnRows.forEach((row, at) => fill(row, first + at, false));
  else {
    for (let at = before; at < number; at += 1) fill(drawnRows[at], first + at, false);
    if (before < number && by) drawnRows.forEach((row, at) => fill(row, first + at, false));
    else if (by > 0) rotate(by, number, false);
    else if (by < 0) rotate(-by, number, true);
  }
  above.firstChild.style.height = `${first * height}px`;
  below.firstChild.style.height = `${Math.max(0, grid.count - first - number) * height}px`;
  changed();
}

// Rows that leave the window on one side are used again on the other side.
function rotate(by, number, isUp) {
  for (let at = 0; at < by; at += 1) {
    const row = isUp ? drawnRows.pop() : drawnRows.shift();
    if (isUp) { drawnRows.unshift(row); above.after(row); } else { drawnRows.push(row); below.before(row); }
  }
  for (let at = 0; at < by; at += 1) {
    const index = isUp ? at : number - by + at;
    fill(drawnRows[index], first + index, false);
  }
}

function emptyRow() {
  const row = made("tr");
  for (const [, kind, wide] of grid.table.columns) {
    const cell = made(kind === "row" ? "th" : "td", undefined, `${kind}${wide ? " wide" : ""}`);
    if (kind === "row") {
      cell.scope = "row";
      const button = made("button");
      button.type = "button";
      button.append(made("span", "", "group"), made("span", "", "own"), made("span", "", "place"));
      cell.append(button);
    } else if (kind === "spark") cell.append(sparkline());
    else if (kind === "state") cell.append(made("b"), made("span"));
    row.append(cell);
  }
  return row;
}

// --- cells -------------------------------------------------------------------------

const GOOD = { good: "good", up: "good", open: "good", answers: "good", down: "down", silent: "down", offline: "down" };

function fill(row, at, glows) {
  const cells = grid.rows.get(at);
  row.setAttribute("aria-rowindex", at + 2);
  row.dataset.at = at;
  const columns = grid.table.columns;
  row.classList.toggle("chosen", grid.chosen !== "" && !!cells && JSON.stringify(cells[0]) === grid.chosen);
  columns.forEach(([, kind], index) => {
    const cell = row.children[index];
    FILL[kind](cell, cells ? cells[index] : undefined, glows, row);
    // On telephones the column of units is left out.
    if (kind === "value" && columns[index + 1]?.[0] === "unit") setUnits(cell, cells?.[index + 1]);
  });
}

function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

function setUnits(cell, units) {
  if (units) cell.dataset.units = units; else delete cell.dataset.units;
}

function plain(cell, value) {
  const text = value === undefined || value === null ? "" : String(value);
  setText(cell, text);
  cell.title = text;
}

const FILL = {
  row(cell, names) {
    const [group, own, place] = cell.firstChild.children;
    const given = names || ["", "…"];
    setText(group, given[0]);
    group.hidden = !given[0];
    setText(own, given[1]);
    setText(place, given[2] || "");
    cell.title = given.filter(Boolean).join("  ");
  },
  text: plain,
  note: plain,
  number: plain,
  value(cell, value, glows) {
    const text = value === undefined || value === null ? "…" : String(value);
    if (cell.textContent === text) return;
    cell.textContent = text;
    cell.title = text;
    // Cells that change all the time do not glow.
    const before = cell.changedAt || 0;
    cell.changedAt = glows ? performance.now() : 0;
    if (glows && (!before || cell.changedAt - before > 4000)) glow(cell);
  },
  spark(cell, levels) { fillSpark(cell.firstChild, levels || []); },
  state(cell, state, glows, row) {
    const [word, why, all] = state || ["", ""];
    setText(cell.firstChild, word);
    setText(cell.lastChild, why);
    cell.title = `${word}${why ? `: ${all || why}` : ""}`;
    const kind = GOOD[word] || (word && word !== "new" ? "bad" : "new");
    cell.classList.remove("good", "bad", "down", "new");
    cell.classList.add(kind);
    row.classList.toggle("trouble", kind === "bad" || kind === "down");
  },
  age(cell, time) { cell.dataset.time = time || ""; fillAge(cell); },
  since(cell, time) { setText(cell, time ? moment(time) : ""); cell.title = time ? new Date(time * 1000).toString() : ""; },
};

function moment(time) {
  const isToday = new Date(time * 1000).toDateString() === new Date().toDateString();
  return isToday ? clock(time) : new Date(time * 1000).toLocaleDateString();
}

export function lasted(seconds) {
  if (seconds < 100) return `${Math.max(0, Math.floor(seconds))} s`;
  if (seconds < 6000) return `${Math.floor(seconds / 60)} min`;
  return seconds < 360000 ? `${Math.floor(seconds / 3600)} h` : `${Math.floor(seconds / 86400)} d`;
}

function fillAge(cell) {
  const time = Number(cell.dataset.time);
  setText(cell, time ? lasted(Date.now() / 1000 - grid.behind - time) : "");
}

setInterval(() => { for (const cell of document.querySelectorAll("td.age")) fillAge(cell); }, 1000);

export function choose(key) {
  grid.chosen = key;
  drawnRows.forEach((row, at) => fill(row, first + at, false));
}

$("scroll").addEventListener("scroll", () => {
  if (isDue) return;
  isDue = true;
  requestAnimationFrame(() => { isDue = false; place(); });
}, { passive: true });

$("scroll").addEventListener("keydown", (event) => {
  const at = event.target.closest("tr")?.dataset.at;
  const step = { ArrowUp: -1, ArrowDown: 1 }[event.key];
  if (!step || at === undefined) return;
  event.preventDefault();
  const wanted = Number(at) + step;
  if (wanted < 0 || wanted >= grid.count) return;
  const box = $("scroll");
  const top = wanted * height;
  if (top < box.scrollTop) box.scrollTop = top;
  else if (top + 2 * height > box.scrollTop + box.clientHeight) box.scrollTop = top + 2 * height - box.clientHeight;
  place();
  drawnRows[wanted - first]?.querySelector("button")?.focus({ preventScroll: true });
});

new ResizeObserver(() => {
  if (!grid.table) return;
  if (tall() !== height) { height = tall(); first = -1e9; }
  place();
}).observe($("scroll"));
