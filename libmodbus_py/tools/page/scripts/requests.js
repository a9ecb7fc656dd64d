// Requests to the server.

export async function post(path, body) {
  const response = await fetch(path, {
    method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body),
  });
  const found = await response.json();
  if (!response.ok) throw new Error(found.error);
  return found;
}

// One view is asked for at a time: each request has a connection of its own and may overtake another one, and the
// server shows the view that it was asked for last.

let latest = "";
let next = null;
let isAsking = false;

export function lookAt(view) {
  const text = JSON.stringify(view);
  if (text === latest) return;
  latest = text;
  next = view;
  if (!isAsking) askForViews();
}

// The server sends all of the next view, even if it is the same one.
export function forgetView() { latest = ""; }

async function askForViews() {
  isAsking = true;
  while (next) {
    const view = next;
    next = null;
    await post("/view", view).catch(() => { if (!next) forgetView(); });
  }
  isAsking = false;
}
