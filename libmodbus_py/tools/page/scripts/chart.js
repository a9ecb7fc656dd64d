// The chart of one value: minutes from memory, hours from the journal.

import { $, clock, drawn, madeButton } from "./elements.js";
import { choose } from "./grid.js";
import { post } from "./rows.js";

const SPANS = [["5 min", 300], ["15 min", 900], ["1 h", 3600], ["6 h", 21600], ["24 h", 86400], ["7 d", 604800]];
const ROOM = { left: 64, right: 14, top: 12, bottom: 22 };

const chart = { of: null, seconds: 300, data: null, at: null, asked: 0 };

// `of` names what the chart shows: a row, and in tables a column; `key` is the first cell of the row.
export function openChart(of, name, key) {
  const isNew = JSON.stringify(of) !== JSON.stringify(chart.of);
  if (isNew) { chart.of = of; chart.data = null; chart.at = null; }
  choose(JSON.stringify(key));
  $("charted").textContent = name;
  $("chart").hidden = false;
  showSpans();
  refresh();
}

export function closeChart() {
  chart.of = null;
  $("chart").hidden = true;
  choose("");
}

let hasJournal = false;

export function setJournal(is) { hasJournal = is; }

function showSpans() {
  const some = hasJournal ? SPANS : SPANS.slice(0, 2);
  $("spans").replaceChildren(...some.map(([name, seconds]) => {
    const button = madeButton(name, () => { chart.seconds = seconds; showSpans(); refresh(); });
    button.setAttribute("aria-pressed", String(seconds === chart.seconds));
    return button;
  }));
}

let isAsking = false;

async function refresh() {
  if (!chart.of || isAsking || document.hidden || document.body.classList.contains("lost")) return;
  isAsking = true;
  chart.asked = Date.now();
  const of = chart.of;
  try {
    const found = await post("/history", { ...of, seconds: chart.seconds });
    if (of === chart.of) { chart.data = found; draw(); }
  } catch (error) {
    $("read").textContent = error.message;
  } finally {
    isAsking = false;
  }
}

// A chart of a week hardly changes in a minute, and the journal has to read all of it.
const pause = () => Math.min(60, Math.max(2, chart.seconds / 300));

setInterval(() => { if (Date.now() >= chart.asked + pause() * 1000) refresh(); }, 1000);

// --- drawing -------------------------------------------------------------------------------------

function steps(low, high, most) {
  const rough = (high - low) / most;
  const size = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((each) => each * size).find((each) => each >= rough);
  const found = [];
  for (let at = Math.ceil(low / step); at * step <= high + step * 1e-9; at += 1) found.push(at * step);
  return [found, step];
}

function number(value, step) {
  const digits = Math.max(0, Math.min(10, -Math.floor(Math.log10(step) + 1e-9)));
  return Math.abs(value) >= 1e7 || step < 1e-6 ? value.toExponential(2) : value.toFixed(digits);
}

const TIMES = [10, 30, 60, 120, 300, 600, 1800, 3600, 7200, 14400, 43200, 86400, 172800];

function scales(width, tall) {
  const { now, values } = chart.data;
  const numbers = values.filter((each) => each !== null);
  let low = Math.min(...numbers);
  let high = Math.max(...numbers);
  const extremes = [low, high];
  if (!numbers.length) { low = 0; high = 1; }
  const margin = (high - low) * 0.06 || Math.abs(high) * 0.01 || 1;
  low -= margin; high += margin;
  const start = now - chart.seconds;
  const x = (time) => ROOM.left + (time - start) / chart.seconds * (width - ROOM.left - ROOM.right);
  const y = (value) => tall - ROOM.bottom - (value - low) / (high - low) * (tall - ROOM.top - ROOM.bottom);
  return { x, y, low, high, start, extremes, has: numbers.length > 0 };
}

function draw() {
  const svg = $("plot");
  const width = svg.clientWidth;
  const tall = svg.clientHeight;
  if (!chart.data || !width) return;
  const found = scales(width, tall);
  const { x, y, start } = found;
  const parts = [];
  const line = (name, x1, y1, x2, y2) => parts.push(drawn("line", { class: name, x1, y1, x2, y2 }));
  const text = (words, at, top, anchor) => {
    const element = drawn("text", { x: at, y: top, "text-anchor": anchor });
    element.textContent = words;
    parts.push(element);
  };
  if (found.has) {
    const [ticks, step] = steps(found.low, found.high, Math.max(2, tall / 45));
    for (const each of ticks) {
      line("grid", ROOM.left, y(each), width - ROOM.right, y(each));
      text(number(each, step), ROOM.left - 8, y(each) + 4, "end");
    }
  }
  const every = TIMES.find((each) => chart.seconds / each <= Math.max(2, width / 110)) || 86400;
  const shift = new Date().getTimezoneOffset() * 60;
  for (let at = Math.ceil((start - shift) / every) * every + shift; at < chart.data.now; at += every) {
    line("grid", x(at), ROOM.top, x(at), tall - ROOM.bottom);
    const words = every >= 86400 ? new Date(at * 1000).toLocaleDateString() : clock(at).slice(0, every < 60 ? 8 : 5);
    text(words, x(at), tall - 6, "middle");
  }
  if (found.has) {
    for (const each of found.extremes) line("extreme", ROOM.left, y(each), width - ROOM.right, y(each));
    parts.push(drawn("path", { class: "line", d: path(x, y) }));
  } else text("no numbers in this period", width / 2, tall / 2, "middle");
  if (chart.at !== null && chart.at < chart.data.times.length) {
    const value = chart.data.values[chart.at];
    const left = x(chart.data.times[chart.at]);
    line("cursor", left, ROOM.top, left, tall - ROOM.bottom);
    if (value !== null) parts.push(drawn("circle", { class: "dot", cx: left, cy: y(value), r: 3.5 }));
  }
  svg.replaceChildren(...parts);
  say(found);
}

function path(x, y) {
  let found = "";
  let isOpen = false;
  const { now, times, values, is_stepped: isStepped } = chart.data;
  times.forEach((time, at) => {
    if (values[at] === null) { isOpen = false; return; }
    const [left, top] = [x(time).toFixed(1), y(values[at]).toFixed(1)];
    if (!isOpen) found += `M${left} ${top}`;
    else found += isStepped ? `H${left}V${top}` : `L${left} ${top}`;
    const isLast = at + 1 === times.length;
    if (isStepped && (isLast || values[at + 1] === null)) found += `H${x(isLast ? now : times[at + 1]).toFixed(1)}`;
    else if (!isOpen && (isLast || values[at + 1] === null)) found += "h.1";
    isOpen = true;
  });
  return found;
}

function say({ extremes, has }) {
  const units = chart.data.units ? ` ${chart.data.units}` : "";
  const short = (value) => `${Number(value.toPrecision(8))}${units}`;
  if (chart.at !== null && chart.at < chart.data.times.length) {
    const value = chart.data.values[chart.at];
    $("read").textContent = `${clock(chart.data.times[chart.at])}  ${value === null ? "no value" : short(value)}`;
  } else $("read").textContent = has ? `lowest ${short(extremes[0])}, highest ${short(extremes[1])}` : "";
}

// --- moving along it ------------------------------------------------------------------------------------

function nearest(left) {
  const { x } = scales($("plot").clientWidth, $("plot").clientHeight);
  let best = null;
  chart.data.times.forEach((time, at) => {
    if (best === null || Math.abs(x(time) - left) < Math.abs(x(chart.data.times[best]) - left)) best = at;
  });
  return best;
}

$("plot").addEventListener("pointermove", (event) => {
  if (!chart.data?.times.length) return;
  chart.at = nearest(event.clientX - $("plot").getBoundingClientRect().left);
  draw();
});
$("plot").addEventListener("pointerleave", () => { chart.at = null; draw(); });
$("plot").addEventListener("blur", () => { chart.at = null; draw(); });
$("plot").addEventListener("keydown", (event) => {
  const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
  if (!step || !chart.data?.times.length) return;
  event.preventDefault();
  const last = chart.data.times.length - 1;
  chart.at = Math.max(0, Math.min(last, chart.at === null ? last : chart.at + step));
  draw();
});
$("chart").addEventListener("keydown", (event) => { if (event.key === "Escape") closeChart(); });
$("close-chart").addEventListener("click", closeChart);
new ResizeObserver(draw).observe($("plot"));
