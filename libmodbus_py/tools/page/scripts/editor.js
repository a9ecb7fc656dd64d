// Changing a value.

import { $, madeButton, made } from "./elements.js";
import { fill } from "./grid.js";
import { post, rowsOf } from "./rows.js";

let now = null;  // what is edited: a point or a cell

export const edited = () => now;

export const isBits = (table) => table === "coils" || table === "discrete_inputs";

// A bit changes at once; the editor opens only if it cannot.
export function edit(what) {
  if (what.type !== "bit" && !isBits(what.table)) { openEditor(what); return; }
  const text = ["on", "1"].includes(what.text) ? "off" : "on";
  send({ ...what, text }, "", "ABCD").catch((error) => {
    openEditor({ ...what, text });
    say(error.message, false);
  });
}

function openEditor(what) {
  now = what;
  const isPoint = what.point !== undefined;
  $("edited").textContent = what.title;
  $("edited-note").textContent = what.note;
  for (const each of document.querySelectorAll(".typed")) each.hidden = isPoint;
  $("meanings").hidden = isPoint;
  $("meanings").open = false;
  choose("uint16", "ABCD", what.text);
  say("", true);
  $("editor").hidden = false;
  showHold();
  fill(false);
  $("text").focus();
  $("text").select();
}

function choose(type, order, text) {
  $("type").value = type;
  $("order").value = order;
  $("text").value = text;
}

// A moving value of a simulator can be held, and then set.
const moves = () => (now?.point === undefined ? null : rowsOf(`${now.unit ?? "every"}/points`).get(String(now.point))?.moves ?? null);

export function showHold() {
  $("hold").hidden = moves() === null;
  $("hold").textContent = moves() === false ? "Release" : "Hold";
  $("hold").setAttribute("aria-pressed", String(moves() === false));
}

export function closeEditor(isFocused) {
  const was = now;
  now = null;
  $("editor").hidden = true;
  fill(false);
  if (isFocused && was) {
    const again = was.point !== undefined ? `[data-point="${was.point}"]` : `[data-cell="${was.address}"]`;
    (document.querySelector(again) || $("scroll")).focus();
  }
}

function say(text, isGood) {
  $("answer").textContent = text;
  $("answer").className = isGood ? "good" : "";
  $("text").setAttribute("aria-invalid", String(!isGood));
}

const refused = (error) => say(error.message, false);

function send({ unit, table, address, point, name, text }, type, order) {
  return post("/value", point === undefined ? { unit, table, address, type, order, text } : { unit, point, name, text });
}

$("hold").addEventListener("click", () => {
  const { unit, point, name } = now;
  const on = moves() === true;
  post("/hold", { unit, point, name, on }).then(() => say(on ? "held" : "released", true), refused);
});

$("editor").addEventListener("submit", (event) => {
  event.preventDefault();
  send({ ...now, text: $("text").value }, $("type").value, $("order").value).then(() => say("set", true), refused);
});
$("editor").addEventListener("keydown", (event) => { if (event.key === "Escape") closeEditor(true); });
$("close").addEventListener("click", () => closeEditor(true));

$("meanings").addEventListener("toggle", () => {
  if (!$("meanings").open || !now) return;
  post("/readings", { unit: now.unit, table: now.table, address: now.address }).then(({ readings }) => {
    $("readings").replaceChildren(...readings.map(({ type, order, text }) => {
      const button = madeButton("", () => {
        if (![...$("type").options].some((each) => each.value === type)) return;
        choose(type, order, text);
        $("text").focus();
      });
      button.append(made("span", `${type} ${order}`), made("b", text));
      return button;
    }));
  }, refused);
});
