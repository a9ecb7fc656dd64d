// The page of a fleet, a gateway or a watch: a table, a search, and what the head says first.

import { openChart, setJournal } from "./chart.js";
import { $, figure } from "./elements.js";
import { fill, grid, onView, range, setClock, setColumns, setCount } from "./grid.js";
import { lookAt, onRows, rowsOf } from "./rows.js";

const finding = () => $("find").value.trim();
const head = (name) => rowsOf("head").get(name);
const isSpark = ({ kind }) => kind === "spark";

let timer = null;

function look() {
  timer = null;
  const [first, stop] = range();
  lookAt({ find: finding(), problems: $("problems").checked, first, stop: Math.max(stop, first + 60) });
}

grid.cells = (at) => rowsOf("rows").get(String(at));
onView(() => { timer = timer || setTimeout(look, 60); });

function search(text) {
  $("find").value = text ?? $("find").value;
  history.replaceState(null, "", `/#${encodeURIComponent(finding())}`);
  $("scroll").scrollTop = 0;
  look();
}

$("find").addEventListener("input", () => search());
$("problems").addEventListener("change", () => {
  document.body.classList.toggle("problems", $("problems").checked);  // rows with room for long reasons
  search();
});
$("finding").addEventListener("submit", (event) => event.preventDefault());

// A click on a row opens the chart of the sparkline that was clicked, or of the first one. A device, which has
// none, is searched for, and so are its values.
$("rows").addEventListener("click", (event) => {
  const row = event.target.closest("tr[data-at]");
  const cells = row && grid.cells(row.dataset.at);
  if (!cells) return;
  const { columns } = grid;
  const at = [...row.children].indexOf(event.target.closest("td, th"));
  const drawn = columns.filter((column) => isSpark(column) && cells[column.title]);
  const { group, own } = cells.name;
  if (!drawn.length) { if (!group) search(own); return; }
  const column = (drawn.includes(columns[at]) ? columns[at] : drawn[0]).title;
  const isOne = columns.filter(isSpark).length === 1;
  openChart({ row: [group, own], column }, [group, own, isOne ? "" : column].filter(Boolean).join("  "), cells.name);
});

function showHead() {
  $("title").textContent = head("title");
  $("kind").textContent = head("kind");
  const status = head("status");
  $("status").textContent = status.text;
  $("status").classList.toggle("problem", status.is_problem);
  const figures = [...rowsOf("figures")];
  $("figures").replaceChildren(...figures.map(([name, value]) => figure(name, value, name === "down" && value ? "problem" : "")));
  const down = rowsOf("figures").get("down");
  document.title = `${down ? `${down} down - ` : ""}${head("title")} - ${head("kind")}`;
}

export function show() {
  setClock();
  setJournal(head("has_journal"));
  for (const id of ["status", "finding"]) $(id).hidden = false;
  $("logging").hidden = !head("has_log");
  document.body.classList.toggle("logs", head("has_log"));
  if (!grid.columns.length) $("find").value = decodeURIComponent(location.hash.slice(1));
  setColumns(head("columns"), head("kind"));
  showHead();
  look();
}

onRows((message) => {
  if (message.page) show();
  else if (message.head || message.figures) showHead();
  if (message.view) setCount(rowsOf("view").get("count") ?? 0);
  if (message.rows) fill(!message.view);
});
