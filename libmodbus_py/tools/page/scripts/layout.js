// The cells of each row of the list.

import { $ } from "./elements.js";
import { isBits, unit, view } from "./state.js";

export const HEIGHT = 28;

function perRow() {
  const width = $("list").clientWidth - 70;
  const cell = isBits(view.what) ? 34 : 58;
  return [16, 10, 8, 5, 4].find((count) => count * cell <= width) || 4;
}

// Rows of cells, without those in gaps: [address of the first, number of cells].
export let layout = { count: 0, each: 10, runs: [] };

export function layOut() {
  const here = unit();
  if (!here) { layout = { count: 0, each: 10, runs: [] }; return; }
  if (view.what === "points") { layout = { count: here.points.length, each: 1, runs: [] }; return; }
  const each = perRow();
  const runs = [];
  let count = 0;
  for (const [start, stop] of here.tables[view.what] || []) {
    const first = Math.max(Math.floor(start / each), runs.length ? runs.at(-1).last + 1 : 0);
    const last = Math.floor((stop - 1) / each);
    if (last >= first) {
      runs.push({ at: count, first, last });
      count += last - first + 1;
    }
  }
  layout = { count, each, runs };
}

function runOf(index) {
  let low = 0;
  let high = layout.runs.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (layout.runs[middle].at <= index) low = middle; else high = middle - 1;
  }
  return layout.runs[low];
}

export function addressOf(index) {
  const run = runOf(index);
  return (run.first + index - run.at) * layout.each;
}

export function indexOf(address) {
  const wanted = Math.floor(address / layout.each);
  const run = layout.runs.find((each) => each.first <= wanted && wanted <= each.last);
  return run ? run.at + wanted - run.first : -1;
}
