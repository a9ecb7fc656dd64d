// A page of tables: takes the messages of the server and shows them.

import { closeChart, onChosen, openChart, setJournal } from "./chart.js";
import { connect } from "./connection.js";
import { $, made } from "./elements.js";
import { choose, clear, grid, onView, range, setTable, take as takeRows } from "./grid.js";
import { addToLog } from "./log.js";
import { forgetView, lookAt } from "./requests.js";
import { known } from "./state.js";

const page = { tables: [], kind: "", title: "", stream: "", figures: {} };

// --- the view ---------------------------------------------------------------------------

const finding = () => $("find").value.trim();
let timer = null;

function look() {
  timer = null;
  if (!page.stream || !grid.table) return;
  const [first, stop] = range();
  lookAt({ stream: page.stream, table: grid.table.name, find: finding(), trouble: $("trouble").checked,
    first, stop: Math.max(stop, first + 60) });
}

// The changes of a view without rows.
function lookAfresh() {
  remember();
  forgetView();
  look();
}

onView(() => { timer = timer || setTimeout(look, 60); });

function show(name, find) {
  const table = page.tables.find((each) => each.name === name) || page.tables[0];
  if (find !== undefined) $("find").value = find;
  setTable(table);
  showTabs();
  lookAfresh();
}

function remember() {
  const words = [grid.table.name, finding()].filter(Boolean).map(encodeURIComponent);
  history.replaceState(null, "", `/#${words.join("/")}`);
}

function showTabs() {
  const focused = [...$("tables").children].indexOf(document.activeElement);
  $("tables").replaceChildren(...page.tables.map((each) => {
    const button = made("button", each.title);
    button.type = "button";
    button.setAttribute("aria-current", String(each === grid.table));
    button.addEventListener("click", () => show(each.name));
    return button;
  }));
  if (focused >= 0) $("tables").children[focused]?.focus();
}

$("find").addEventListener("input", () => { clear(); lookAfresh(); });
$("trouble").addEventListener("change", () => { clear(); lookAfresh(); });
$("finding").addEventListener("submit", (event) => event.preventDefault());
const isSpark = ([, kind]) => kind === "spark";

// The sparkline that was clicked, or the first one of the row.
function sparkOf(at) {
  const { columns } = grid.table;
  return (columns[at] && isSpark(columns[at]) ? columns[at] : columns.find(isSpark))?.[0];
}

$("rows").addEventListener("click", (event) => {
  const row = event.target.closest("tr");
  const cells = row && grid.rows.get(Number(row.dataset.at));
  if (!cells) return;
  const column = sparkOf([...row.children].indexOf(event.target.closest("td, th")));
  if (column) {
    const name = cells[0].slice(0, 2);
    const isOne = grid.table.columns.filter(isSpark).length === 1;
    openChart({ table: grid.table.name, row: name, column }, [...name, isOne ? "" : column].filter(Boolean).join("  "));
  }
  else if (page.tables[0].name === "values" && grid.table.name === "devices") show("values", cells[0][1]);
});

// --- messages of the server -----------------------------------------------------------------------

function take(message) {
  if (message.now) grid.behind = Date.now() / 1000 - message.now;
  if (message.all) begin(message);
  if (message.figures) { page.figures = message.figures; showFigures(); }
  if (message.log) addToLog(message.log);
  const isHere = grid.table && message.table === grid.table.name && message.find === finding().toLowerCase()
    && message.trouble === $("trouble").checked;
  if (isHere) takeRows(message.count, message.rows);
}

function begin(message) {
  page.stream = message.stream;
  known.log = [];
  $("log").replaceChildren();
  forgetView();
  if (message.tables) {
    page.tables = message.tables;
    page.kind = message.kind;
    page.title = message.title;
    setJournal(message.has_journal);
    $("title").textContent = page.title;
    $("kind").textContent = page.kind;
    $("logging").hidden = !message.has_log;
    document.body.classList.toggle("logs", message.has_log);
    if (!grid.table || !page.tables.some((each) => each.name === grid.table.name)) {
      const [name, find] = location.hash.slice(1).split("/").map(decodeURIComponent);
      show(name, find || "");
    }
  }
  look();
}

function showFigures() {
  const rows = Object.entries(page.figures).map(([name, value]) => {
    const row = made("div", undefined, name === "down" && value ? "trouble" : "");
    row.append(made("dt", name), made("dd", value.toLocaleString("en")));
    return row;
  });
  $("figures").replaceChildren(...rows);
  const down = page.figures.down ? `${page.figures.down} down - ` : "";
  document.title = `${down}${page.title} - ${page.kind}`;
}

onChosen(choose);
closeChart();
connect(take);
