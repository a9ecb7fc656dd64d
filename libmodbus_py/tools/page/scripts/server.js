// The page of a server: the tabs of its units and their tables, whose points and cells are shown as rows.

import { closeChart, openChart } from "./chart.js";
import { closeEditor, edit, edited, isBits, showHold } from "./editor.js";
import { $, clock, figure, fillSpark, madeButton, madeOption, replaceButtons, made } from "./elements.js";
import { showFaults, showKinds } from "./faults.js";
import { KINDS, fill, grid, onView, range, reveal, setColumns, setCount, setText, setValue } from "./grid.js";
import { addUnits } from "./log.js";
import { lookAt, onRows, rowsOf } from "./rows.js";

const TABLES = {
  points: "Points",
  coils: "Coils",
  discrete_inputs: "Discrete inputs",
  holding_registers: "Holding registers",
  input_registers: "Input registers",
};
const SHORT = { coils: "coil", discrete_inputs: "discrete", holding_registers: "holding", input_registers: "input" };
const POINTS = [["Name", "row"], ["Value", "point"], ["", "text"], ["Last values", "spark", true],
  ["Address", "text", true], ["Type", "text", true], ["Last written", "text", true],
].map(([title, kind, isWide]) => ({ title, kind, is_wide: isWide }));
const CHUNK = 64;  // cells of a row of the server

// The unit by its name, the table or "points", the cells of each row, and the cell that has the focus.
const view = { unit: "", what: "", each: 10, chosen: null };
let spans = [];  // the rows of cells, without those in gaps: index, and the number of the first and last row
let written = new Map();  // unit and table -> the last writes

const unit = () => rowsOf("units").get(view.unit);
const values = () => rowsOf(`${view.unit}/${view.what}`);
const nameOf = (number) => (number === null ? "every" : String(number));

// --- the view ----------------------------------------------------------------------------------------------

function look() {
  if (!unit() || !grid.count) return;
  let [first, stop] = range();
  if (stop <= first) return;
  // More rows than are visible, so that scrolling a little needs no request.
  first = Math.max(0, Math.floor((first - 16) / 32) * 32);
  stop = Math.min(grid.count, Math.ceil((stop + 16) / 32) * 32);
  if (view.what !== "points") {
    first = addressOf(first);
    stop = Math.min(addressOf(stop - 1) + view.each, 65536);
  }
  lookAt({ unit: unit().number, what: view.what, first, stop });
}

onView(look);

function choose(name, what) {
  if (name !== view.unit || what !== view.what) {
    Object.assign(view, { unit: name, what, chosen: null });
    closeChart();
    closeEditor(false);
  }
  location.hash = `${name}/${what}`;
  showTabs();
  rebuild();
}

function showTabs() {
  const here = unit();
  const titleOf = (each, name) => each.name || `Unit ${name}`;
  const units = [...rowsOf("units")].sort(([, a], [, b]) => a.number - b.number);
  replaceButtons($("units"), units.map(([name, each]) => {
    const small = each.name ? `unit ${name}` : "";
    return tab(titleOf(each, name), small, name === view.unit, () => choose(name, firstOf(each)));
  }));
  replaceButtons($("tables"), tablesOf(here).map(([what, count]) =>
    tab(TABLES[what], String(count), what === view.what, () => choose(view.unit, what))));
  document.title = `${titleOf(here, view.unit)} - libmodbus-py`;
  $("caption").textContent = titleOf(here, view.unit);
  $("description").textContent = here.description;
  $("description").hidden = !here.description;
}

function tab(text, small, isCurrent, press) {
  const button = madeButton(text, press);
  if (small) button.append(made("small", small));
  button.setAttribute("aria-current", String(isCurrent));
  return button;
}

function tablesOf(each) {
  const found = each.points.length ? [["points", each.points.length]] : [];
  for (const [table, ranges] of Object.entries(each.tables)) {
    found.push([table, ranges.reduce((sum, [start, stop]) => sum + stop - start, 0)]);
  }
  return found;
}

const firstOf = (each) => tablesOf(each)[0]?.[0] || "points";

function showUnits() {
  const [name, what] = decodeURIComponent(location.hash.slice(1)).split("/");
  const units = rowsOf("units");
  if (!units.size) { setCount(0); return; }
  const here = [view.unit, name].find((each) => units.has(each)) || [...units.keys()][0];
  const wanted = view.what || what;
  choose(here, tablesOf(units.get(here)).some(([each]) => each === wanted) ? wanted : firstOf(units.get(here)));
  const numbers = [...units.values()].map((each) => each.number);
  addUnits(numbers);
  const choices = [null, ...numbers.filter((each) => each !== null)];
  $("fault-unit").replaceChildren(...choices.map((each) => madeOption(nameOf(each), JSON.stringify(each))));
}

// --- rows --------------------------------------------------------------------------------------------------

function rebuild() {
  const ranges = unit().tables[view.what] || [];
  if (view.what === "points") {
    grid.cells = pointCells;
    setColumns(POINTS, "points");
    setCount(unit().points.length);
  } else {
    view.each = perRow();
    spans = [];
    let count = 0;
    for (const [start, stop] of ranges) {
      const first = Math.max(Math.floor(start / view.each), spans.length ? spans.at(-1).last + 1 : 0);
      const last = Math.floor((stop - 1) / view.each);
      if (last >= first) spans.push({ at: count, first, last });
      count += Math.max(0, last - first + 1);
    }
    const numbers = Array.from({ length: view.each }, (_, at) => at);
    grid.cells = (index) => Object.fromEntries([["", addressOf(index)], ...numbers.map((at) => [`+${at}`, addressOf(index) + at])]);
    setColumns([{ title: "", kind: "at" }, ...numbers.map((at) => ({ title: `+${at}`, kind: "cell" }))], `cells${isBits(view.what) ? " bits" : ""}`);
    setCount(count);
  }
  $("going").hidden = view.what === "points" || grid.count < 40;
}

function perRow() {
  const width = $("scroll").clientWidth - 70;
  return [16, 10, 8, 5, 4].find((count) => count * (isBits(view.what) ? 34 : 58) <= width) || 4;
}

function addressOf(index) {
  const span = spans.findLast((each) => each.at <= index);
  return (span.first + index - span.at) * view.each;
}

function has(address) {
  return (unit().tables[view.what] || []).some(([start, stop]) => start <= address && address < stop);
}

function lastWrite(table, address) {
  return (written.get(`${view.unit}/${table}`) || [])
    .findLast(({ start, stop }) => start <= address && address < stop);
}

function takeWritten() {
  written = new Map();
  for (const each of rowsOf("written").values()) {
    const key = `${nameOf(each.unit)}/${each.table}`;
    written.set(key, [...(written.get(key) || []), each]);
  }
}

function pointCells(index) {
  const { name, table, address, type, units, description } = unit().points[index];
  const { text, moves, spark } = values().get(String(index)) || { text: "…", moves: null, spark: [] };
  const last = lastWrite(table, address);
  return {
    Name: { own: name, description },
    Value: { index, text, type, moves, name },
    "": units,
    "Last values": spark,
    Address: `${SHORT[table]} ${address}`,
    Type: type,
    "Last written": last ? `${clock(last.time)} ${last.who.replace(/:[0-9]+$/, "")}` : "",
  };
}

KINDS.point = {
  make(cell) { cell.append(madeButton("", undefined, "value")); },
  fill(cell, { index, text, type, moves, name }, glows, row) {
    const button = cell.firstChild;
    button.dataset.point = index;
    setValue(button, text, glows);
    button.title = text;
    button.classList.toggle("wrong", text.startsWith("? ") || text === "no such cells");
    button.setAttribute("aria-label", `${name}: ${text}${type === "bit" ? "" : ", change"}`);
    if (type === "bit") {
      button.setAttribute("role", "switch");
      button.setAttribute("aria-checked", String(text === "on"));
    }
    row.classList.toggle("held", moves === false);
    row.classList.toggle("selected", edited()?.point === index);
  },
};

KINDS.at = { fill(cell, address) { setText(cell, String(address)); } };

KINDS.cell = {
  make(cell) { cell.append(madeButton("", undefined, "value")); },
  fill(cell, address, glows) {
    const button = cell.firstChild;
    button.hidden = !has(address);
    if (button.hidden) return;
    const value = values().get(String(address - address % CHUNK))?.[address % CHUNK];
    const last = lastWrite(view.what, address);
    const who = last ? `, written at ${clock(last.time)} by ${last.who}` : "";
    button.dataset.cell = address;
    setValue(button, String(value ?? "…"), glows);
    button.className = `value${value === 0 ? " zero" : ""}${isBits(view.what) && value ? " on" : ""}`;
    button.classList.toggle("chosen", edited()?.address === address);
    button.tabIndex = address === (view.chosen ?? unit().tables[view.what][0][0]) ? 0 : -1;
    button.title = `${SHORT[view.what]} ${address}${who}`;
    button.setAttribute("aria-label", `${SHORT[view.what]} ${address}: ${value}${who}`);
  },
};

// --- what a person does ------------------------------------------------------------------------------------

$("rows").addEventListener("click", (event) => {
  const { point, cell } = event.target.closest("button")?.dataset || {};
  const row = event.target.closest("tr[data-at]");
  if (cell !== undefined) {
    view.chosen = Number(cell);
    const last = lastWrite(view.what, view.chosen);
    edit({ unit: unit().number, table: view.what, address: view.chosen, text: event.target.textContent,
      title: `${SHORT[view.what]} ${cell}`, note: last ? `written at ${clock(last.time)} by ${last.who}` : "" });
  } else if (row && view.what === "points") {
    const index = Number(row.dataset.at);
    const { name, table, address, type, units, access, description } = unit().points[index];
    if (point === undefined) {
      if (event.target.closest("th, .spark")) openChart({ row: [unit().number, name] }, name, pointCells(index).Name);
      return;
    }
    const note = [`${SHORT[table]} ${address}`, type, units, access === "read" ? "read-only for clients" : "",
      description].filter(Boolean).join(" · ");
    edit({ unit: unit().number, point: index, name, type, text: values().get(point)?.text ?? "", title: name, note });
  }
});

// Arrow keys move from cell to cell, across gaps.
$("rows").addEventListener("keydown", (event) => {
  const cell = event.target.closest("[data-cell]");
  const step = { ArrowLeft: -1, ArrowRight: 1, ArrowUp: -view.each, ArrowDown: view.each }[event.key];
  if (!cell || !step) return;
  event.preventDefault();
  let address = Number(cell.dataset.cell) + step;
  while (address >= 0 && address < 65536 && !has(address)) address += step;
  if (address >= 0 && address < 65536) goTo(address);
}, { capture: true });

function goTo(address) {
  if (!has(address)) return false;
  const number = Math.floor(address / view.each);
  const span = spans.find((each) => each.first <= number && number <= each.last);
  view.chosen = address;
  reveal(span.at + number - span.first);
  fill(false);
  document.querySelector(`[data-cell="${address}"]`)?.focus({ preventScroll: true });
  return true;
}

$("going").addEventListener("submit", (event) => {
  event.preventDefault();
  const address = Number($("address").value);
  const isThere = $("address").value.trim() !== "" && Number.isInteger(address) && goTo(address);
  $("address").setAttribute("aria-invalid", String(!isThere));
});

new ResizeObserver(() => {
  if (unit() && view.what !== "points" && perRow() !== view.each) rebuild();
}).observe($("scroll"));

// --- what the server says ----------------------------------------------------------------------------------

const GLANCE = ["connections", "requests", "refused"];
let before = null;
let perSecond = 0;

function showCounters() {
  const counters = rowsOf("counters");
  const now = { at: performance.now(), requests: counters.get("requests") || 0 };
  if (before && now.at - before.at >= 1000) {
    perSecond = Math.max(0, (now.requests - before.requests) * 1000 / (now.at - before.at));
  }
  if (!before || now.at - before.at >= 1000) before = now;
  const glance = [...GLANCE.map((name) => [name, counters.get(name) ?? 0]),
    ["requests/s", perSecond < 10 ? perSecond.toFixed(1) : Math.round(perSecond)]];
  const shown = ([name, value]) => figure(name, value, value ? "" : "zero");
  $("figures").replaceChildren(...glance.map(shown));
  $("counters").replaceChildren(...[...counters].filter(([name, value]) => value || GLANCE.includes(name)).map(shown));
}

setInterval(showCounters, 1000);

export function show() {
  for (const each of document.querySelectorAll(".of-server")) each.hidden = false;
  $("logging").hidden = false;
  showKinds();
  takeWritten();
  showUnits();
  showFaults();
  showCounters();
}

onRows((message) => {
  if (message.page) { show(); return; }
  if (message.units) showUnits();
  if (message.faults) showFaults();
  if (message.written) takeWritten();
  const here = message[`${view.unit}/${view.what}`];
  if (here || message.written) fill();
  if (here && view.what === "points") showHold();
});
