// The tabs of units and tables.

import { closeChart } from "./chart.js";
import { closeEditor } from "./editor.js";
import { $, made } from "./elements.js";
import { clearRows, rebuild } from "./list.js";
import { forgetView } from "./requests.js";
import { TABLES, known, unit, unitName, view } from "./state.js";

function choose(number, what) {
  const other = number !== view.unit || what !== view.what;
  view.unit = number;
  view.what = what;
  if (other) {
    clearRows();  // they belong to the previous view
    view.points.clear();
    view.moving.clear();
    view.sparks.clear();
    closeChart();
    view.cells.clear();
    $("list").scrollTop = 0;
    view.chosen = null;
    closeEditor(false);
  }
  location.hash = `${unitName(number)}/${what}`;
  showTabs();
  rebuild();
}

function showTabs() {
  const buttons = known.units.map((each) => {
    const button = made("button", each.name || `Unit ${unitName(each.number)}`);
    if (each.name) button.append(made("small", `unit ${unitName(each.number)}`));
    return tab(button, each.number === view.unit, () => choose(each.number, firstOf(each)));
  });
  refocused($("units"), buttons);
  const here = unit();
  if (!here) return;
  document.title = `${here.name || `Unit ${unitName(here.number)}`} - libmodbus-py`;
  $("unit-name").textContent = here.name || `Unit ${unitName(here.number)}`;
  document.querySelector("#values .head").hidden = !here.description;
  $("unit-description").textContent = here.description;
  refocused($("tables"), tablesOf(here).map(([what, count]) => {
    const button = made("button", TABLES[what]);
    button.append(made("small", String(count)));
    return tab(button, what === view.what, () => choose(here.number, what));
  }));
}

function refocused(parent, buttons) {
  const at = [...parent.children].indexOf(document.activeElement);
  parent.replaceChildren(...buttons);
  if (at >= 0) buttons[at]?.focus();
}

function tab(button, isCurrent, press) {
  button.type = "button";
  button.setAttribute("aria-current", String(isCurrent));
  button.addEventListener("click", press);
  return button;
}

function tablesOf(each) {
  const found = each.points.length ? [["points", each.points.length]] : [];
  for (const [table, ranges] of Object.entries(each.tables)) {
    found.push([table, ranges.reduce((sum, [start, stop]) => sum + stop - start, 0)]);
  }
  return found;
}

function firstOf(each) {
  return tablesOf(each)[0]?.[0] || "points";
}

export function showUnits() {
  const [number, what] = decodeURIComponent(location.hash.slice(1)).split("/");
  const here = unit() || known.units.find((each) => unitName(each.number) === number) || known.units[0];
  if (!here) return;
  const wanted = view.what || what;
  const is = tablesOf(here).some(([each]) => each === wanted);
  forgetView();
  choose(here.number, is ? wanted : firstOf(here));
  const options = known.units.map((each) => {
    const option = made("option", unitName(each.number));
    option.value = JSON.stringify(each.number);
    return option;
  });
  const filter = $("filter").value;
  $("filter").replaceChildren(made("option", "all"), ...options.map((each) => each.cloneNode(true)));
  $("filter").options[0].value = "";
  $("filter").value = filter;
  const every = made("option", "every");
  every.value = "null";
  $("fault-unit").replaceChildren(every, ...options.filter((each) => each.value !== "null"));
}
