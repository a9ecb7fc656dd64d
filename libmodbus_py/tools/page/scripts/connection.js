// The stream of messages from the server; while it is lost, the page is grey and shows since when.

import { $, clock } from "./elements.js";

const DOCUMENTS = new Set(["page.html", "tables.html"]);
const here = document.body.classList.contains("tabular") ? "tables.html" : "page.html";

function say(text, name) {
  $("state").textContent = text;
  $("state").className = name;
  document.body.classList.toggle("lost", name === "lost");
}

let since = 0;

export function connect(take) {
  const events = new EventSource("/events");
  events.onopen = () => { since = 0; say("live", "live"); };
  events.onmessage = (event) => {
    const message = JSON.parse(event.data);
    // Another program, with another page, may listen at this address now.
    if (message.all && message.page !== here && DOCUMENTS.has(message.page)) location.reload();
    else take(message);
  };
  events.onerror = () => {
    since = since || Date.now() / 1000;
    say(`no connection to the server since ${clock(since)}; the page shows the last known values`, "lost");
    if (events.readyState !== EventSource.CLOSED) return;
    events.close();
    setTimeout(() => connect(take), 2000);
    fetch("/icon.svg").then((response) => {
      if (response.status === 403) say("the server has a new token: open the URL that it printed", "lost");
    }, () => {});
  };
}

// The token is in a cookie now, and need not stay in the history.
history.replaceState(null, "", `/${location.hash}`);
