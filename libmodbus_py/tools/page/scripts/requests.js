// Requests to the server.

export async function post(path, body) {
  const response = await fetch(path, {
    method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body),
  });
  const found = await response.json();
  if (!response.ok) throw new Error(found.error);
  return found;
}

// Views are requested one at a time: each request has its own connection and may overtake another one, and the
// server shows the view of the last request.

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

// The server sends the whole next view, even if it is the same view.
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
