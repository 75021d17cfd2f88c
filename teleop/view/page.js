// Shows Rerun's viewer in a frame, loads it again when the server that feeds it was restarted, and
// says when what it shows is old.
"use strict";

const LOOK_MS = 500; // between two looks at the server
const PATIENCE_MS = 2000; // for its answer
const LATE_S = 3; // behind the server, from which on it is said
const CURRENT_S = 1.5; // behind the server, from which on a page that was opened is shown
const OPENING_MS = 30000; // after which it is shown in any case
const TIMELINE = "time";

const frame = document.getElementById("viewer");
const lost = document.getElementById("lost");
const late = document.getElementById("late");
let shown = null; // instance of the server whose data the frame shows
let opened = null; // [ms] when a page was opened that is not yet shown; null: it is shown
let behind = null; // [s] behind the newest data that were sent; null if not known

async function look() {
  try {
    const report = behind === null ? "" : `?behind=${behind.toFixed(1)}`;
    const answer = await fetch(`instance${report}`, {
      cache: "no-store",
      signal: AbortSignal.timeout(PATIENCE_MS),
    });
    if (!answer.ok) throw new Error(`status ${answer.status}`);
    const { instance, query, newest_s } = await answer.json();
    if (instance !== shown) {
      shown = instance;
      const own = window.location.search.slice(1); // of this page, e.g. renderer=webgl
      open();
      frame.src = `viewer.html?${query}${own && "&" + own}`;
    }
    const newest = newest_s === 0 && frame.contentWindow._handle ? 0 : newestShown(); // 0: nothing to wait for
    behind = newest === null || document.hidden ? null : Math.max(0, newest_s - newest);
    lost.hidden = true;
  } catch {
    behind = null;
    lost.hidden = shown === null;
  }
  const current = behind !== null && behind < CURRENT_S;
  if (opened !== null && (current || performance.now() - opened > OPENING_MS)) opened = null;
  document.body.classList.toggle("opening", opened !== null);
  late.hidden = behind === null || behind < LATE_S || opened !== null;
  if (!late.hidden) late.textContent = `This page is late: what you see is ${Math.round(behind)} s old.`;
  setTimeout(look, LOOK_MS);
}

// Let the viewer draw into a small frame until it has the newest data: with each picture it takes in
// little, and a large one takes a browser that draws by software half a second.
function open() {
  opened = performance.now();
}

document.addEventListener("visibilitychange", () => {
  if (!document.hidden && shown !== null) open(); // it stood still while it was hidden
});

// The newest time [s] of the data that the viewer has, from its `GetStateResponse` (Rerun 0.41):
// recording (3) > timeline (2) > name (1, 1) and range (3) > end (2) [ns].
function newestShown() {
  try {
    const state = frame.contentWindow._handle.viewer_state();
    for (const recording of messages(state, 3)) {
      for (const timeline of messages(recording, 2)) {
        const name = new TextDecoder().decode(first(first(timeline, 1), 1));
        if (name === TIMELINE) return first(first(timeline, 3), 2) * 1e-9;
      }
    }
  } catch {
    // the viewer has not started, or has no data yet
  }
  return null;
}

const first = (bytes, number) => messages(bytes, number)[0];

// The values of a field of a protobuf message: numbers, or bytes.
function messages(bytes, number) {
  let at = 0;
  const varint = () => {
    for (let value = 0, factor = 1; ; factor *= 128) {
      value += (bytes[at] & 127) * factor;
      if (bytes[at++] < 128) return value;
    }
  };
  const values = [];
  while (at < bytes.length) {
    const key = varint();
    const kind = key % 8;
    let value = null;
    if (kind === 0) value = varint();
    else if (kind === 2) {
      const length = varint();
      value = bytes.subarray(at, at + length);
      at += length;
    } else at += kind === 1 ? 8 : 4;
    if (Math.floor(key / 8) === number) values.push(value);
  }
  return values;
}

look();
