// Shows Rerun's viewer in a frame, and loads it again when the server that feeds it was restarted.
"use strict";

const LOOK_MS = 500; // between two looks at the server
const PATIENCE_MS = 2000; // for its answer

const frame = document.getElementById("viewer");
const lost = document.getElementById("lost");
let shown = null; // instance of the server whose data the frame shows

async function look() {
  try {
    const answer = await fetch("instance", {
      cache: "no-store",
      signal: AbortSignal.timeout(PATIENCE_MS),
    });
    if (!answer.ok) throw new Error(`status ${answer.status}`);
    const { instance, query } = await answer.json();
    if (instance !== shown) {
      shown = instance;
      const own = window.location.search.slice(1); // of this page, e.g. renderer=webgl
      frame.src = `viewer.html?${query}${own && "&" + own}`;
    }
    lost.hidden = true;
  } catch {
    lost.hidden = shown === null;
  }
  setTimeout(look, LOOK_MS);
}

look();
