// Shows Rerun's viewer in a frame and feeds it from the server: the present first, the past once it
// is current. Loads the frame again when the server was restarted, and says when what it shows is
// old, when the session has ended, and when this browser draws so slowly that it shows less.
"use strict";

const TICK_MS = 250; // between two looks at whether the server answers
const PATIENCE_TICKS = 16; // for its answer; ticks that a slow picture holds up do not count
const RETRY_MS = 500; // after a question that failed
const TAKEN_MS = 2000; // in which the viewer should have drawn what it was given
const LATE_S = 3; // behind the server, from which on it is said
const CURRENT_S = 1.5; // behind the server, from which on a page that was opened is shown
const OPENING_MS = 30000; // after which it is shown in any case
const SLOW_MS = 400; // of a picture, the median of SLOW_COUNT, from which on less is shown
const SLOW_COUNT = 20;
const STILL_LATE_MS = 8000; // for which a page is late before less is shown
const NOTHING_NEW = 1e15; // a number beyond all blocks: a question for no data
const TIMELINE = "time";
const CHANNEL = "session";

const frame = document.getElementById("viewer");
const strip = document.getElementById("strip");
const full = document.getElementById("full");
const own = new URLSearchParams(window.location.search); // e.g. renderer=webgl, layout=full
const page = Math.random().toString(36).slice(2);
let instance = null; // of the server whose data the frame shows
let viewer = null; // its handle, once it has started
let newest = -1; // number of the newest block it was given
let gaps = []; // [[low, high]]: blocks between them are missing, both excluded
let opened = null; // [ms] when a page was opened that is not yet shown; null: it is shown
let behind = null; // [s] behind the newest data that were sent; null if not known
let lateSince = null; // [ms]
let waited = 0; // ticks since the server was asked
let failed = 0; // questions in a row
let ended = ""; // why no more will come
let light = null; // the layout [count] in whose place the light one is shown; null: it is not
const pictures = []; // [ms] that the last ones took

async function follow() {
  while (!ended) {
    try {
      await step();
      failed = 0;
    } catch {
      failed += 1;
      behind = null;
      await pause(RETRY_MS);
    }
    show();
  }
}

async function step() {
  const wait = gaps.length > 0 ? "&wait=0" : ""; // the past of a recording, to which nothing is added
  const { said, bytes } = await ask(document.hidden ? `newer=${NOTHING_NEW}` : `newer=${newest}${wait}`);
  if (said.instance !== instance) {
    await start(said.instance);
    return;
  }
  ended = said.ended;
  if (document.hidden || ended) {
    behind = null;
    return;
  }
  const shown = newestShown();
  behind = said.newest_s === 0 ? 0 : shown === null ? null : Math.max(0, said.newest_s - shown);
  if (said.oldest > Math.max(newest, 0) + 1) gaps.push([Math.max(newest, 0), said.oldest]);
  newest = said.newest;
  give(bytes);
  if (light !== null && light !== said.layout) await lighten(said.layout);
  else if (light === null && own.get("layout") !== "full" && isSlow()) await lighten(said.layout);
  await taken(said.newest_s);
  if (gaps.length > 0 && behind !== null && behind < CURRENT_S) await fill();
}

// Load the viewer anew, and forget what the last one had.
async function start(name) {
  open();
  viewer = null;
  newest = -1;
  gaps = [];
  light = null;
  frame.contentWindow._handle = undefined; // of the last one
  frame.src = `viewer.html?theme=dark&hide_welcome_screen=&${own}`;
  for (; viewer === null; await pause(50)) viewer = frame.contentWindow._handle ?? null;
  viewer.open_channel(CHANNEL, "session");
  instance = name;
}

// Ask for blocks; returns what the server says, and messages of Rerun.
async function ask(question) {
  const report = behind === null ? "" : `&behind=${behind.toFixed(1)}`;
  waited = 1;
  const answer = await fetch(`blocks?page=${page}&${question}${report}`, { cache: "no-store" });
  if (!answer.ok) throw new Error(`status ${answer.status}`);
  const bytes = new Uint8Array(await answer.arrayBuffer());
  waited = 0;
  return { said: JSON.parse(answer.headers.get("X-View")), bytes };
}

function give(bytes) {
  if (bytes.length > 0) viewer.send_rrd_to_channel(CHANNEL, bytes);
}

// Wait until the viewer has the newest data, so that no more of them queue than it can draw.
async function taken(newest_s) {
  const end = performance.now() + TAKEN_MS;
  while (newest_s > 0 && performance.now() < end && !(newestShown() >= newest_s - CURRENT_S / 3)) await pause(30);
}

// Get some of the newest of the data that are missing.
async function fill() {
  const [low, high] = gaps.at(-1);
  const { said, bytes } = await ask(`newer=${low}&older=${high}`);
  if (said.instance !== instance) return;
  gaps.pop();
  give(bytes);
  if (bytes.length > 0 && said.oldest > low + 1) gaps.push([low, said.oldest]);
}

// Let the viewer draw into a small frame until it has the newest data: with each picture it takes in
// little, and a large one takes a browser that draws by software half a second.
function open() {
  opened = performance.now();
  pictures.length = 0;
  lateSince = null;
}

function isSlow() {
  if (opened !== null) return false;
  const sorted = [...pictures].sort((a, b) => a - b);
  const total = sorted.reduce((sum, took) => sum + took, 0);
  const enough = sorted.length === SLOW_COUNT || (sorted.length > 2 && total > SLOW_COUNT * SLOW_MS);
  const slow = enough && sorted[Math.floor(sorted.length / 2)] > SLOW_MS;
  return slow || (lateSince !== null && performance.now() - lateSince > STILL_LATE_MS);
}

// Show state, force and link alone, which are drawn soonest.
async function lighten(layout) {
  const answer = await fetch("light.rbl", { cache: "no-store" });
  if (!answer.ok) throw new Error(`status ${answer.status}`);
  give(new Uint8Array(await answer.arrayBuffer()));
  light = layout;
}

// Say what is to be said, beside the viewer.
function show() {
  const now = performance.now();
  const current = behind !== null && behind < CURRENT_S;
  if (opened !== null && (current || ended || now - opened > OPENING_MS)) opened = null;
  document.body.classList.toggle("opening", opened !== null);
  const late = behind !== null && behind > LATE_S && opened === null;
  lateSince = late ? (lateSince ?? now) : null;
  const lost = instance !== null && !ended && (waited > PATIENCE_TICKS || failed > 1);
  let text = "";
  if (ended) text = ended;
  else if (lost) text = "View interrupted: what you see is old. It returns by itself when the view does.";
  else if (late) text = `This page is late: what you see is ${Math.round(behind)} s old.`;
  else if (light !== null) text = "This browser draws slowly: state, force and link only.";
  strip.hidden = text === "";
  strip.classList.toggle("warning", lost || late);
  document.getElementById("text").textContent = text;
  full.hidden = light === null || lost || ended !== "";
}

function tick() {
  if (waited > 0) waited += 1;
  show();
}

// Time pictures: this page's frames wait for those of the viewer. Short ones drew nothing.
let last = null;
function time(now) {
  const took = last === null ? 0 : now - last;
  last = document.hidden ? null : now;
  if (opened === null && took > 50 && pictures.push(took) > SLOW_COUNT) pictures.shift();
  requestAnimationFrame(time);
}

const pause = (ms) => new Promise((done) => setTimeout(done, ms));

full.addEventListener("click", () => {
  own.set("layout", "full");
  window.location.search = own.toString();
});

document.addEventListener("visibilitychange", () => {
  if (!document.hidden && instance !== null && !ended) open(); // it stood still while it was hidden
});

// The newest time [s] of the data that the viewer has, from its `GetStateResponse` (Rerun 0.41):
// recording (3) > timeline (2) > name (1, 1) and range (3) > end (2) [ns].
function newestShown() {
  try {
    const state = viewer.viewer_state();
    for (const recording of messages(state, 3)) {
      for (const timeline of messages(recording, 2)) {
        const name = new TextDecoder().decode(first(first(timeline, 1), 1));
        if (name === TIMELINE) return first(first(timeline, 3), 2) * 1e-9;
      }
    }
  } catch {
    // it has no data yet
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

setInterval(tick, TICK_MS);
requestAnimationFrame(time);
follow();
