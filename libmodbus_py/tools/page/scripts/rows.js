// One row of the list: a point, or some cells.

import { asCell, clock, glow, made } from "./elements.js";
import { addressOf, layout } from "./layout.js";
import { fillSpark, sparkline } from "./spark.js";
import { SHORT, has, isBits, lastWrite, unit, view } from "./state.js";

export function template() {
  return `60px repeat(${layout.each}, minmax(0, ${isBits(view.what) ? "44px" : "1fr"}))`;
}

export function pointRow(index) {
  const [name, table, address, kind, measure, , description] = unit().points[index];
  const row = made("div", undefined, "row point");
  const label = made("span", name);
  label.title = description || name;
  const value = made("button", "", "value");
  value.type = "button";
  value.dataset.point = index;
  const drawing = made("button", undefined, "drawing wide");
  drawing.type = "button";
  drawing.dataset.chart = index;
  drawing.setAttribute("aria-label", `${name}: chart`);
  drawing.append(sparkline());
  const others = [value, made("span", measure, "faint"), drawing, made("span", `${SHORT[table]} ${address}`, "faint wide"),
    made("span", kind, "faint wide"), made("span", "", "faint wide written")];
  row.append(asCell(label, "rowheader"), ...others.map((each) => asCell(each)));
  fillPoint(row, index, false);
  return row;
}

export function fillPoint(row, index, glows) {
  const [name, table, address, kind] = unit().points[index];
  const value = row.querySelector(".value");
  const text = view.points.get(index);
  const isSwitch = kind === "bit";
  const shown = text === undefined ? "…" : text;
  if (value.textContent !== shown) {
    value.textContent = shown;
    if (glows) glow(value);
  }
  value.title = shown;
  value.classList.toggle("wrong", shown.startsWith("? ") || shown === "no such cells");
  value.setAttribute("aria-label", `${name}: ${shown}${isSwitch ? "" : ", change"}`);
  if (isSwitch) {
    value.setAttribute("role", "switch");
    value.setAttribute("aria-checked", String(text === "on"));
  }
  fillSpark(row.querySelector(".drawing svg"), view.sparks.get(index) || []);
  row.classList.toggle("held", view.moving.get(index) === false);
  row.classList.toggle("selected", view.edited?.point === index);
  const last = lastWrite(table, address);
  const written = row.querySelector(".written");
  written.textContent = last ? `${clock(last.time)} ${last.who.replace(/:[0-9]+$/, "")}` : "";
  written.title = last ? `${clock(last.time)} by ${last.who}` : "";
}

export function cellRow(index) {
  const first = addressOf(index);
  const row = made("div", undefined, "row cells");
  row.style.gridTemplateColumns = template();
  row.append(asCell(made("span", String(first), "at"), "rowheader"));
  for (let at = first; at < first + layout.each; at += 1) {
    if (!has(at)) { row.append(asCell(made("span", "·", "hole"))); continue; }
    const cell = made("button", "", isBits(view.what) ? "value bit" : "value");
    cell.type = "button";
    cell.dataset.cell = at;
    cell.tabIndex = at === view.chosen || (view.chosen === null && at === firstCell()) ? 0 : -1;
    fillCell(cell, at, false);
    row.append(asCell(cell));
  }
  return row;
}

function firstCell() {
  return unit()?.tables[view.what]?.[0]?.[0];
}

export function fillCell(cell, address, glows) {
  const value = view.cells.get(address);
  const shown = value === undefined ? "…" : String(value);
  if (cell.textContent !== shown) {
    cell.textContent = shown;
    if (glows) glow(cell);
  }
  cell.classList.toggle("zero", value === 0);
  cell.classList.toggle("on", isBits(view.what) && value === 1);
  cell.classList.toggle("chosen", view.edited?.address === address);
  const last = lastWrite(view.what, address);
  const who = last ? `, written at ${clock(last.time)} by ${last.who}` : "";
  cell.title = `${SHORT[view.what]} ${address}${who}`;
  cell.setAttribute("aria-label", `${SHORT[view.what]} ${address}: ${shown}${who}`);
}
