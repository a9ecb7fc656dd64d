// The log of transactions.

import { $, clock, made } from "./elements.js";
import { known } from "./state.js";

const MOST_LOG = 300;
const GOOD = new Set(["answered", "broadcast"]);

let paused = false;
let cleared = 0;

function logRow([, time, , unitNumber, , asked, outcome, kind, seconds]) {
  const row = made("li", undefined, GOOD.has(kind) ? "" : "bad");
  const said = made("span", asked || "bytes", "said");
  said.append(" ", made("span", `→ ${outcome}`, "outcome"));
  const took = seconds === null ? "" : `${(seconds * 1000).toFixed(seconds < 0.01 ? 1 : 0)} ms`;
  row.append(made("time", clock(time)), made("span", unitNumber ?? "", "unit"), said, made("span", took, "took"));
  return row;
}

function wanted([number, , , unitNumber]) {
  const filter = $("filter").value;
  return number > cleared && (filter === "" || filter === "null" || JSON.stringify(unitNumber) === filter);
}

function showLog() {
  $("log").replaceChildren(...known.log.filter(wanted).reverse().map(logRow));
}

export function addToLog(entries) {
  known.log.push(...entries);
  known.log.splice(0, Math.max(0, known.log.length - MOST_LOG));
  if (paused) return;
  const log = $("log");
  log.prepend(...entries.slice(-MOST_LOG).filter(wanted).reverse().map(logRow));
  while (log.children.length > MOST_LOG) log.lastElementChild.remove();
}

$("pause").addEventListener("click", () => {
  paused = !paused;
  $("pause").setAttribute("aria-pressed", String(paused));
  $("pause").textContent = paused ? "Go on" : "Pause";
  if (!paused) showLog();
});
$("clear").addEventListener("click", () => {
  cleared = known.log.at(-1)?.[0] || cleared;
  showLog();
});
$("filter").addEventListener("change", showLog);
