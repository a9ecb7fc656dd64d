// The page: starts the script that the server names, which shows its tables.

import { closeChart } from "./chart.js";
import "./log.js";
import { connect, onRows } from "./rows.js";

let script = "";

onRows(async (message) => {
  if (!message.page) return;
  // Another program, with another page, may listen at this address now.
  if (script && message.page.script !== script) location.reload();
  if (script) return;
  script = message.page.script;
  document.body.classList.add(script.split(".")[0]);
  const { show } = await (script === "server.js" ? import("./server.js") : import("./table.js"));
  show();
});

// The token is in a cookie now, and need not stay in the history.
history.replaceState(null, "", `.${location.hash}`);
closeChart();
connect();
