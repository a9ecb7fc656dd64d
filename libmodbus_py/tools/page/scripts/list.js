// The list of points or cells; only the visible rows exist in the page and are requested.

import { $, asCell, made } from "./elements.js";
import { HEIGHT, addressOf, indexOf, layOut, layout } from "./layout.js";
import { lookAt } from "./requests.js";
import { cellRow, fillCell, fillPoint, pointRow, template } from "./rows.js";
import { has, known, unit, view } from "./state.js";

const rows = new Map();

function visible() {
  const list = $("list");
  const first = Math.max(0, Math.floor(list.scrollTop / HEIGHT) - 4);
  const stop = Math.min(layout.count, Math.ceil((list.scrollTop + list.clientHeight) / HEIGHT) + 4);
  return [first, stop];
}

export function look() {
  if (!known.stream || !unit() || !layout.count) return;
  let [first, stop] = visible();
  if (stop <= first) return;
  // More rows than are visible, so that scrolling a little needs no request.
  first = Math.max(0, Math.floor((first - 16) / 32) * 32);
  stop = Math.min(layout.count, Math.ceil((stop + 16) / 32) * 32);
  if (view.what !== "points") {
    first = addressOf(first);
    stop = Math.min(addressOf(stop - 1) + layout.each, 65536);
  }
  lookAt({ stream: known.stream, unit: view.unit, what: view.what, first, stop });
}

export function clearRows() {
  for (const row of rows.values()) row.remove();
  rows.clear();
}

export function rebuild() {
  clearRows();
  layOut();
  $("space").style.height = `${layout.count * HEIGHT}px`;
  $("empty").hidden = layout.count > 0;
  $("list").hidden = !layout.count;
  $("table").setAttribute("aria-rowcount", layout.count + 1);
  $("going").hidden = view.what === "points" || layout.count < 40;
  showColumns();
  show();
}

function heading(text, name) { return asCell(made("span", text, name), "columnheader"); }

function showColumns() {
  const columns = $("columns");
  columns.replaceChildren();
  if (view.what === "points") {
    columns.className = "row columns point";
    for (const [text, name] of [["Name", ""], ["Value", "value"], ["", ""], ["Last values", "wide"], ["Address", "wide"],
      ["Type", "wide"], ["Last written", "wide"]]) columns.append(heading(text, name));
  } else {
    columns.className = "row columns cells";
    columns.style.gridTemplateColumns = template();
    columns.append(heading("", "at"));
    for (let at = 0; at < layout.each; at += 1) columns.append(heading(`+${at}`, "value"));
  }
  columns.hidden = !layout.count;
}

function show() {
  const [first, stop] = visible();
  for (const [index, row] of rows) {
    if ((index < first || index >= stop) && !row.contains(document.activeElement)) {
      row.remove();
      rows.delete(index);
    }
  }
  const space = $("space");
  for (let index = first; index < stop; index += 1) {
    if (!rows.has(index)) {
      const row = view.what === "points" ? pointRow(index) : cellRow(index);
      row.style.transform = `translateY(${index * HEIGHT}px)`;
      // In order, for people who move from one to the next with the keyboard.
      const next = [...space.children].find((each) => Number(each.dataset.index) > index);
      row.dataset.index = index;
      row.setAttribute("role", "row");
      row.setAttribute("aria-rowindex", index + 2);
      space.insertBefore(row, next || null);
      rows.set(index, row);
    }
  }
  look();
}

export function refill(glows) {
  for (const [index, row] of rows) {
    if (view.what === "points") {
      fillPoint(row, index, glows);
    } else {
      for (const cell of row.querySelectorAll("[data-cell]")) fillCell(cell, Number(cell.dataset.cell), glows);
    }
  }
}

export function chooseCell(address) {
  view.chosen = address;
  for (const cell of document.querySelectorAll("[data-cell]")) {
    cell.tabIndex = Number(cell.dataset.cell) === address ? 0 : -1;
  }
}

// Arrow keys move from cell to cell, across gaps.
$("list").addEventListener("keydown", (event) => {
  const cell = event.target.closest("[data-cell]");
  if (!cell) return;
  const step = { ArrowLeft: -1, ArrowRight: 1, ArrowUp: -layout.each, ArrowDown: layout.each }[event.key];
  if (!step) return;
  event.preventDefault();
  let address = Number(cell.dataset.cell) + step;
  while (address >= 0 && address < 65536 && !has(address)) address += step;
  if (address >= 0 && address < 65536) goTo(address);
});

function goTo(address) {
  const index = indexOf(address);
  if (index < 0 || !has(address)) return false;
  const list = $("list");
  const top = index * HEIGHT;
  if (top < list.scrollTop) list.scrollTop = top;
  else if (top + HEIGHT > list.scrollTop + list.clientHeight) list.scrollTop = top + HEIGHT - list.clientHeight;
  show();
  chooseCell(address);
  document.querySelector(`[data-cell="${address}"]`)?.focus({ preventScroll: true });
  return true;
}

$("going").addEventListener("submit", (event) => {
  event.preventDefault();
  const input = $("address");
  const address = Number(input.value);
  const isThere = input.value.trim() !== "" && Number.isInteger(address) && goTo(address);
  input.setAttribute("aria-invalid", String(!isThere));
});

$("list").addEventListener("scroll", show, { passive: true });
new ResizeObserver(() => {
  const before = layout.each;
  layOut();
  if (before !== layout.each) rebuild(); else show();
}).observe($("list"));
