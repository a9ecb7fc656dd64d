// The log of transactions.

import { $, clock, made } from "./elements.js";
import { known } from "./state.js";

const MOST_LOG = 300;
const GOOD = new Set(["answered", "broadcast"]);

let paused = false;
let cleared = 0;

function logRow([, time, peer, unitNumber, , asked, outcome, kind, seconds, named]) {
  const row = made("li", undefined, GOOD.has(kind) ? "" : "bad");
  const said = made("span", asked || "bytes", "said");
  said.append(" ", made("span", `→ ${outcome}`, "outcome"));
  if (named) said.append(made("span", named, "named"));
  row.title = peer;
  const took = seconds === null ? "" : `${(seconds * 1000).toFixed(seconds < 0.01 ? 1 : 0)} ms`;
  row.append(made("time", clock(time)), made("span", unitNumber ?? "", "unit"), said, made("span", took, "took"));
  return row;
}

function wanted([number, , , unitNumber, , , , kind, , , isWrite]) {
  const filter = $("filter").value;
  if (number <= cleared || (filter !== "" && filter !== "null" && JSON.stringify(unitNumber) !== filter)) return false;
  const [writes, errors] = [$("only-writes").checked, $("only-errors").checked];
  return !(writes || errors) || (writes && isWrite) || (errors && !GOOD.has(kind));
}

// Save downloads the rows that the filters choose.
function aim() {
  const fields = new URLSearchParams();
  if (!["", "null"].includes($("filter").value)) fields.set("unit", $("filter").value);
  if ($("only-writes").checked) fields.set("writes", "1");
  if ($("only-errors").checked) fields.set("errors", "1");
  $("save").href = `/log.csv${fields.size ? "?" : ""}${fields}`;
}

// If the units are not known beforehand, the filter lists the units in the log.
function addUnits(entries) {
  const filter = $("filter");
  const known = new Set([...filter.options].map((each) => each.value));
  for (const [, , , unit] of entries) {
    const name = JSON.stringify(unit);
    if (unit === null || known.has(name) || known.size > 256) continue;
    known.add(name);
    const option = made("option", String(unit));
    option.value = name;
    filter.append(option);
  }
}

function showLog() {
  $("log").replaceChildren(...known.log.filter(wanted).reverse().map(logRow));
}

export function addToLog(entries) {
  known.log.push(...entries);
  known.log.splice(0, Math.max(0, known.log.length - MOST_LOG));
  if (!known.units.length) addUnits(entries);
  if (paused) return;
  const log = $("log");
  log.prepend(...entries.slice(-MOST_LOG).filter(wanted).reverse().map(logRow));
  while (log.children.length > MOST_LOG) log.lastElementChild.remove();
}

$("pause").addEventListener("click", () => {
  paused = !paused;
  $("pause").setAttribute("aria-pressed", String(paused));
  $("pause").textContent = paused ? "Resume" : "Pause";
  if (!paused) showLog();
});
$("clear").addEventListener("click", () => {
  cleared = known.log.at(-1)?.[0] || cleared;
  showLog();
});
for (const id of ["filter", "only-writes", "only-errors"]) {
  $(id).addEventListener("change", () => { aim(); showLog(); });
}
