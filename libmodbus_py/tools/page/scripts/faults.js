// The faults of the server, on and off.

import { $, made } from "./elements.js";
import { post } from "./requests.js";
import { known, unitName } from "./state.js";

export function showFaults() {
  const rowsNow = known.faults.map(([number, where, kind, words, isOn]) => {
    const row = made("li", undefined, isOn ? "" : "off");
    const what = made("span");
    what.append(made("span", kind.replaceAll("_", " "), "kind"), " ", made("span", words, "what"));
    const button = made("button", isOn ? "on" : "off", "value");
    button.type = "button";
    button.setAttribute("role", "switch");
    button.setAttribute("aria-checked", String(isOn));
    button.setAttribute("aria-label", `${kind} ${words}, unit ${unitName(where)}`);
    button.addEventListener("click", () => {
      post("/fault", { number, on: !isOn }).then(() => sayFault(""), (error) => sayFault(error.message));
    });
    row.append(made("span", where === null ? "every" : `unit ${where}`, "where"), what, button);
    return row;
  });
  const at = [...$("faults").querySelectorAll("button")].indexOf(document.activeElement);
  $("faults").replaceChildren(...(rowsNow.length ? rowsNow : [made("li", "No faults.", "none")]));
  if (at >= 0) $("faults").querySelectorAll("button")[at]?.focus();
}

function sayFault(text) {
  $("fault-answer").textContent = text;
}

export function showSetting() {
  const setting = known.words?.kinds[$("fault-kind").value];
  $("fault-setting-label").hidden = !setting;
  $("fault-setting-label").firstElementChild.textContent = setting || "";
}

function number(text) {
  return text.trim() === "" ? null : Number.isNaN(Number(text)) ? text : Number(text);
}

$("fault-kind").addEventListener("change", showSetting);
$("adding").addEventListener("submit", (event) => {
  event.preventDefault();
  const kind = $("fault-kind").value;
  const setting = known.words.kinds[kind];
  const body = { unit: JSON.parse($("fault-unit").value), kind,
    function: number($("fault-function").value), every: number($("fault-every").value) };
  if (setting) body[setting] = number($("fault-setting").value);
  post("/faults", body).then(() => sayFault(""), (error) => sayFault(error.message));
});
