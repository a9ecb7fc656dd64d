// The tables of rows that the server has sent, and the stream of their changes. A message has the rows that
// changed, by table and key, and null for a row or a table that is gone.

import { $, clock } from "./elements.js";

const tables = new Map();
const watching = [];

// The rows of a table by their keys, which are text.
export function rowsOf(table) { return tables.get(table) || new Map(); }

// Call a function with each message, once its rows are in the tables. Everything is new if it has a `page`.
export function onRows(call) { watching.push(call); }

function take(message) {
  for (const [name, changed] of Object.entries(message)) {
    if (changed === null) { tables.delete(name); continue; }
    const rows = rowsOf(name);
    tables.set(name, rows);
    for (const [key, row] of Object.entries(changed)) if (row === null) rows.delete(key); else rows.set(key, row);
  }
  for (const call of watching) call(message);
}

// --- the stream; while it is lost, the page is grey and shows since when ----------------------------------

let since = 0;

function say(text, name) {
  $("state").textContent = text;
  $("state").className = name;
  document.body.classList.toggle("lost", name === "lost");
}

export function connect() {
  const events = new EventSource("events");
  events.onopen = () => { tables.clear(); since = 0; say("connected", ""); };
  events.onmessage = (event) => take(JSON.parse(event.data));
  events.onerror = () => {
    since = since || Date.now() / 1000;
    say(`no connection to the server since ${clock(since)}; the page shows the last known values`, "lost");
    if (events.readyState !== EventSource.CLOSED) return;
    events.close();
    setTimeout(connect, 2000);
    fetch("icon.svg").then((response) => {
      if (response.status === 403) say("the server has a new token: open the URL that it printed", "lost");
    }, () => {});
  };
}

// --- requests ---------------------------------------------------------------------------------------------

export async function post(path, body) {
  const response = await fetch(`.${path}`, {
    method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body),
  });
  const found = await response.json();
  if (!response.ok) throw new Error(found.error);
  return found;
}

// Views are requested one at a time: each request has its own connection and may overtake another one, and the
// server shows the view of the last request.

let latest = "";
let next = null;
let isAsking = false;

export async function lookAt(view) {
  const stream = rowsOf("page").get("stream");
  const text = JSON.stringify({ ...view, stream });
  if (!stream || text === latest) return;
  latest = next = text;
  if (isAsking) return;
  isAsking = true;
  while (next) {
    const body = JSON.parse(next);
    next = null;
    await post("/view", body).catch(() => { latest = ""; });
  }
  isAsking = false;
}
