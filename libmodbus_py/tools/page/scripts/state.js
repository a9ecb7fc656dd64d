// The state: what the server has sent, and the view of it.

export const TABLES = {
  points: "Points",
  coils: "Coils",
  discrete_inputs: "Discrete inputs",
  holding_registers: "Holding registers",
  input_registers: "Input registers",
};
export const SHORT = {
  coils: "coil", discrete_inputs: "discrete", holding_registers: "holding", input_registers: "input",
};

export const known = {
  units: [], faults: [], counters: {}, log: [], written: new Map(), words: null, stream: "",
};

// The view: the unit's number, "points" or a table, and its values; the value that is edited, and the
// cell that has the focus.
export const view = {
  unit: undefined, what: "", points: new Map(), moving: new Map(), sparks: new Map(), cells: new Map(),
  edited: null, chosen: null,
};

export function unitName(number) {
  return number === null ? "every" : String(number);
}

export function unit() {
  return known.units.find((each) => each.number === view.unit);
}

export function isBits(table) {
  return table === "coils" || table === "discrete_inputs";
}

export function has(address) {
  const ranges = unit()?.tables[view.what] || [];
  let low = 0;
  let high = ranges.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (ranges[middle][1] <= address) low = middle + 1; else high = middle;
  }
  return low < ranges.length && ranges[low][0] <= address;
}

export function lastWrite(table, address) {
  const ranges = known.written.get(`${unitName(view.unit)}/${table}`) || [];
  let found = null;
  for (const each of ranges) {
    if (each.start <= address && address < each.stop && (!found || each.number > found.number)) found = each;
  }
  return found;
}
