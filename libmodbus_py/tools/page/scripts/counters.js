// The counters of the server.

import { $, made } from "./elements.js";
import { known } from "./state.js";

const GLANCE = ["connections", "requests", "refused"];

let before = null;
let perSecond = 0;

export function showCounters() {
  const now = performance.now();
  const requests = known.counters.requests || 0;
  if (before && now - before.at >= 1000) {
    perSecond = Math.max(0, (requests - before.requests) * 1000 / (now - before.at));
    before = { at: now, requests };
  }
  before = before || { at: now, requests };
  const glance = GLANCE.map((name) => [name, known.counters[name]]);
  glance.push(["requests/s", perSecond < 10 ? perSecond.toFixed(1) : Math.round(perSecond)]);
  $("figures").replaceChildren(...glance.map(([name, value]) => figure(name, value)));
  const all = Object.entries(known.counters).filter(([name, value]) => value || GLANCE.includes(name));
  $("counters").replaceChildren(...all.map(([name, value]) => figure(name, value)));
}

function figure(name, value) {
  const row = made("div", undefined, value ? "" : "zero");
  row.append(made("dt", name.replaceAll("_", " ")), made("dd", (value ?? 0).toLocaleString("en")));
  return row;
}

setInterval(showCounters, 1000);
