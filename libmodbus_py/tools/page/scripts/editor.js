// Changing a value.

import { openChart } from "./chart.js";
import { $, clock, made } from "./elements.js";
import { chooseCell, refill } from "./list.js";
import { post } from "./requests.js";
import { SHORT, isBits, lastWrite, unit, view } from "./state.js";

function openEditor(what) {
  view.edited = what;
  const { table, address, name, text, isPoint, note } = what;
  $("edited").textContent = isPoint ? name : `${SHORT[table]} ${address}`;
  $("edited-note").textContent = note;
  for (const each of document.querySelectorAll(".typed")) each.hidden = isPoint;
  $("meanings").hidden = isPoint;
  $("meanings").open = false;
  $("text").value = text;
  $("text").removeAttribute("aria-invalid");
  say("", true);
  $("editor").hidden = false;
  showHold();
  refill(false);
  $("text").focus();
  $("text").select();
}

// A moving value of a simulator can be held, and then set.
export function showHold() {
  const moves = view.edited?.isPoint ? view.moving.get(view.edited.point) : undefined;
  $("hold").hidden = moves === undefined;
  $("hold").textContent = moves === false ? "Release" : "Hold";
  $("hold").setAttribute("aria-pressed", String(moves === false));
}

$("hold").addEventListener("click", () => {
  const { point, name } = view.edited;
  const on = view.moving.get(point) === true;
  post("/hold", { unit: view.unit, point, name, on }).then(() => say(on ? "held" : "released", true),
    (error) => say(error.message, false));
});

export function closeEditor(isFocused) {
  const was = view.edited;
  view.edited = null;
  $("editor").hidden = true;
  refill(false);
  if (isFocused && was) {
    const again = was.isPoint ? `[data-point="${was.point}"]` : `[data-cell="${was.address}"]`;
    (document.querySelector(again) || $("list")).focus();
  }
}

function say(text, isGood) {
  const answer = $("answer");
  answer.textContent = text;
  answer.className = isGood ? "good" : "";
  if (isGood) $("text").removeAttribute("aria-invalid");
  else $("text").setAttribute("aria-invalid", "true");
}

function editPoint(index) {
  const [name, table, address, kind, measure, access, description] = unit().points[index];
  const text = view.points.get(index) ?? "";
  if (kind === "bit") {
    const value = text === "on" ? "off" : "on";
    send({ unit: view.unit, point: index, name, text: value }).catch((error) => {
      openEditor({ isPoint: true, point: index, name, table, address, text: value, note: "" });
      say(error.message, false);
    });
    return;
  }
  const note = [`${SHORT[table]} ${address}`, kind, measure, access === "read" ? "read-only for clients" : "",
    description].filter(Boolean).join(" · ");
  openEditor({ isPoint: true, point: index, name, table, address, text, note });
}

function editCell(address) {
  chooseCell(address);
  if (isBits(view.what)) {
    const body = { unit: view.unit, table: view.what, address, type: "", order: "ABCD",
      text: view.cells.get(address) ? "off" : "on" };
    send(body).catch((error) => {
      openEditor({ table: view.what, address, text: body.text, note: "" });
      say(error.message, false);
    });
    return;
  }
  const last = lastWrite(view.what, address);
  openEditor({ table: view.what, address, text: String(view.cells.get(address) ?? ""),
    note: last ? `written at ${clock(last.time)} by ${last.who}` : "" });
  $("type").value = "uint16";
  $("order").value = "ABCD";
}

function send(body) {
  return post("/value", body);
}

$("editor").addEventListener("submit", (event) => {
  event.preventDefault();
  const text = $("text").value;
  const body = view.edited.isPoint
    ? { unit: view.unit, point: view.edited.point, name: view.edited.name, text }
    : { unit: view.unit, table: view.edited.table, address: view.edited.address, type: $("type").value,
        order: $("order").value, text };
  send(body).then(() => say("set", true), (error) => say(error.message, false));
});

$("editor").addEventListener("keydown", (event) => {
  if (event.key === "Escape") closeEditor(true);
});
$("close").addEventListener("click", () => closeEditor(true));

$("meanings").addEventListener("toggle", () => {
  if (!$("meanings").open || !view.edited) return;
  post("/readings", { unit: view.unit, table: view.edited.table, address: view.edited.address }).then((found) => {
    $("readings").replaceChildren(...Object.values(found).map(([type, order, text]) => {
      const button = made("button");
      button.type = "button";
      button.append(made("span", `${type} ${order}`), made("b", text));
      button.addEventListener("click", () => {
        if (![...$("type").options].some((each) => each.value === type)) return;
        $("type").value = type;
        $("order").value = order;
        $("text").value = text;
        $("text").focus();
      });
      return button;
    }));
  }, (error) => say(error.message, false));
});

$("list").addEventListener("click", (event) => {
  const button = event.target.closest("button");
  if (!button) return;
  if (button.dataset.chart !== undefined) {
    const [name] = unit().points[Number(button.dataset.chart)];
    openChart({ row: [view.unit, name] }, name);
    return;
  }
  if (button.dataset.point !== undefined) editPoint(Number(button.dataset.point));
  else editCell(Number(button.dataset.cell));
});
