// The log of transactions.

import { $, clock, made, madeOption } from "./elements.js";
import { onRows, rowsOf } from "./rows.js";

const GOOD = new Set(["answered", "broadcast"]);

const shown = new Map();  // number of a row -> its element
let paused = false;
let cleared = 0;

function logRow({ time, peer, unit, asked, outcome, kind, seconds, named }) {
  const row = made("li", undefined, GOOD.has(kind) ? "" : "bad");
  const said = made("span", asked || "bytes", "said");
  said.append(" ", made("span", `→ ${outcome}`, "outcome"));
  if (named) said.append(made("span", named, "named"));
  row.title = peer;
  const took = seconds === null ? "" : `${(seconds * 1000).toFixed(seconds < 0.01 ? 1 : 0)} ms`;
  row.append(made("time", clock(time)), made("span", unit ?? "", "unit"), said, made("span", took, "took"));
  return row;
}

function wanted({ number, unit, kind, writes: isWrite }) {
  const filter = $("filter").value;
  if (number <= cleared || (filter !== "" && filter !== "null" && JSON.stringify(unit) !== filter)) return false;
  const [writes, errors] = [$("only-writes").checked, $("only-errors").checked];
  return !(writes || errors) || (writes && isWrite) || (errors && !GOOD.has(kind));
}

// Save downloads the rows that the filters choose.
function aim() {
  const fields = new URLSearchParams();
  if (!["", "null"].includes($("filter").value)) fields.set("unit", $("filter").value);
  if ($("only-writes").checked) fields.set("writes", "1");
  if ($("only-errors").checked) fields.set("errors", "1");
  $("save").href = `log.csv${fields.size ? "?" : ""}${fields}`;
}

// The filter lists the units in the log, and those that a server has.
export function addUnits(units) {
  const filter = $("filter");
  const there = new Set([...filter.options].map((each) => each.value));
  for (const unit of units) {
    const name = JSON.stringify(unit);
    if (unit === null || there.has(name) || there.size > 256) continue;
    there.add(name);
    filter.append(madeOption(String(unit), name));
  }
}

function take(number, entry) {
  shown.get(number)?.remove();
  shown.delete(number);
  if (!entry || !wanted(entry)) return;
  shown.set(number, logRow(entry));
  $("log").prepend(shown.get(number));
}

function showLog() {
  $("log").replaceChildren();
  shown.clear();
  for (const [number, entry] of rowsOf("log")) take(number, entry);
}

onRows(({ page, log }) => {
  if (log) addUnits(Object.values(log).filter(Boolean).map(({ unit }) => unit));
  if (paused) return;
  if (page) showLog();
  else for (const [number, entry] of Object.entries(log || {})) take(number, entry);
});

$("pause").addEventListener("click", () => {
  paused = !paused;
  $("pause").setAttribute("aria-pressed", String(paused));
  $("pause").textContent = paused ? "Resume" : "Pause";
  if (!paused) showLog();
});
$("clear").addEventListener("click", () => {
  cleared = Math.max(cleared, ...[...rowsOf("log").keys()].map(Number));
  showLog();
});
for (const id of ["filter", "only-writes", "only-errors"]) {
  $(id).addEventListener("change", () => { aim(); showLog(); });
}
