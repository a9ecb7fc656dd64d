// Takes the messages of the server and shows them.

import { closeChart } from "./chart.js";
import { connect } from "./connection.js";
import { showCounters } from "./counters.js";
import { showHold } from "./editor.js";
import { $, made } from "./elements.js";
import { showFaults, showSetting } from "./faults.js";
import { look, refill } from "./list.js";
import { addToLog } from "./log.js";
import { known, unitName, view } from "./state.js";
import { showUnits } from "./units.js";

function fillWords(words) {
  known.words = words;
  const options = (names) => names.map((name) => made("option", name));
  $("type").replaceChildren(...options(words.types));
  $("order").replaceChildren(...options(words.orders));
  if (!$("fault-kind").options.length) {
    $("fault-kind").replaceChildren(...Object.keys(words.kinds).map((name) => {
      const option = made("option", name.replaceAll("_", " "));
      option.value = name;
      return option;
    }));
    showSetting();
  }
}

function takeWritten(entries) {
  for (const [count, where, table, start, stop, time, who] of entries) {
    const key = `${unitName(where)}/${table}`;
    const ranges = (known.written.get(key) || []).filter((each) => each.start !== start || each.stop !== stop);
    ranges.push({ number: count, start, stop, time, who });
    known.written.set(key, ranges.slice(-1000));
  }
}

function take(message) {
  if (message.all) {
    known.stream = message.stream;
    known.log = [];
    known.written.clear();
    known.counters = {};
    if (!known.words) fillWords(message.words);
    $("log").replaceChildren();
  }
  if (message.counters) Object.assign(known.counters, message.counters);
  if (message.faults) { known.faults = message.faults; showFaults(); }
  if (message.written) takeWritten(message.written);
  if (message.units) { known.units = message.units; showUnits(); }
  if (message.log) addToLog(message.log);
  const isHere = message.unit === view.unit && message.what === view.what;
  if (isHere && message.points) {
    for (const [index, text] of Object.entries(message.points)) view.points.set(Number(index), text);
  }
  const keep = (name) => {
    for (const [index, value] of Object.entries(message[name] || {})) view[name].set(Number(index), value);
  };
  if (isHere) { keep("moving"); keep("sparks"); }
  if (isHere && message.moving) showHold();
  if (isHere && message.cells) {
    for (const [first, values] of Object.entries(message.cells)) {
      values.forEach((value, at) => view.cells.set(Number(first) + at, value));
    }
  }
  if ((isHere && (message.points || message.cells || message.moving || message.sparks)) || message.written) refill(!message.all);
  if (message.all) { showCounters(); look(); }
}

closeChart();
connect(take);
