// The operator's page. It shows measurements and reports of the last second; without any it shows UNKNOWN.
import { CHANNEL, JOURNAL_SHOWN, Link } from "./link.js";
import { LivePlots } from "./plots.js";

const SILENCE_MS = 1000;
const CONFIRM_MS = 1000;
const STOP_MS = 10000;
const WORKER_MS = 3000; // a worker that says nothing for so long is gone
const OWN_STOP = "Use the robot's own emergency stop.";
const MARKS = { READY: "✓", PREFLIGHT: "▶", APPROACH: "▶", RUNNING: "▶", RETRACT: "▶", STOPPING: "■", LATCHED: "■",
  OFFLINE: "○", CONNECTING: "○", UNKNOWN: "?" };
const WORDS = { READY: "The arm stands still. You can start.", PREFLIGHT: "Checking before motion.",
  APPROACH: "Moving to the hole.", RUNNING: "Inserting.", RETRACT: "Moving away.", STOPPING: "Stopping. Standstill is not measured yet.",
  OFFLINE: "The arm is not connected.", CONNECTING: "Connecting to the arm." };

const at = (id) => document.getElementById(id);
const number = (value, digits) => (value === null || value === undefined ? "–" : value.toFixed(digits));
const clock = (seconds) => new Date(1e3 * seconds).toLocaleTimeString("en-GB");
const plots = new LivePlots(at("force-plot"), at("depth-plot"));

let status = null; // the last status received
let heardAt = -Infinity; // time of its arrival on performance.now()'s clock, ms
let linkHeardAt = performance.now();
let stops = 0;
let unconfirmed = false; // the last stop is not confirmed

// --- display

function show() {
  const live = performance.now() - heardAt <= SILENCE_MS;
  const state = live && status ? status.state : "UNKNOWN";
  if (document.body.dataset.state !== state) {
    document.body.dataset.state = state;
    at("state").textContent = state;
    at("mark").textContent = MARKS[state] ?? "?";
    if (!unconfirmed) at("answer").className = "";
    document.title = `${state} – ${document.body.dataset.cell}`;
  }
  setText("reason", reason(state, live));
  const age = !status || status.heartbeat_age_s === null ? null : status.heartbeat_age_s + (performance.now() - heardAt) / 1e3;
  setText("age", age === null ? "never" : age < 1 ? "now" : `${age.toFixed(0)} s ago`);
  at("start").disabled = state === "UNKNOWN" || !status.can_start;
  at("start").title = at("start").disabled ? reason(state, live) : "";
  at("reset").disabled = state !== "LATCHED";
  const measured = state === "UNKNOWN" ? null : status.measured;
  setText("force", number(measured?.force_magnitude_n, 1));
  setText("fz", number(measured?.force_n[2], 1));
  setText("speed", number(measured && 1e3 * measured.tcp_speed_m_s, 1));
  setText("sample-age", number(measured && 1e3 * measured.sample_age_s, 0));
  if (state === "UNKNOWN") for (const id of ["depth", "ceiling"]) setText(id, "–");
  setText("latch", state === "LATCHED" && status.latch
    ? `${status.latch.code} since ${clock(status.latch.latched_at)}` : "Nothing is latched.");
  if (state === "UNKNOWN") setText("latch", "Not known.");
}

function reason(state, live) {
  if (!live) return "No connection to the server. The robot's state is not known here.";
  if (state === "UNKNOWN") return `${status.why_not ?? ""} The robot's state is not known here.`;
  if (state === "LATCHED" && status.latch) return `${status.latch.code}: ${status.latch.text} – look at the cell, then reset below.`;
  const run = status.run;
  if (run && run.state === "ACTIVE") {
    const step = run.steps ? `, step ${run.steps}` : "";
    return `${WORDS[state] ?? ""} ${run.recipe}, seed ${run.seed ?? "none"}${step}, peak ${number(run.peak_force_n, 1)} N`;
  }
  return status.can_start ? WORDS[state] ?? "" : status.why_not ?? WORDS[state] ?? "";
}

function setText(id, text) {
  const element = at(id);
  if (element.textContent !== text) element.textContent = text;
}

function answer(text, kind) {
  unconfirmed = false;
  // The time keeps an old answer from looking like the present state.
  setText("answer", `${clock(Date.now() / 1e3)} ${text}`);
  at("answer").className = kind;
}

function rows(runs) {
  const good = { SUCCEEDED: "✓ inserted", ACTIVE: "… under way" };
  return runs.map((run) => {
    const row = document.createElement("tr");
    const outcome = good[run.state] ?? `✗ ${run.code ?? run.state}`;
    // A control process that died took its measurements with it.
    const measured = run.state !== "INTERRUPTED" || run.peak_force_n > 0;
    const cells = [clock(run.requested_at), run.recipe, run.seed ?? "–", outcome,
      run.depth_m === null ? "–" : `${number(1e3 * run.depth_m, 1)} mm`,
      measured ? `${number(run.peak_force_n, 1)} N` : "–", measured ? `${number(run.duration_s, 1)} s` : "–"];
    for (const text of cells) row.insertCell().textContent = text;
    row.cells[3].className = run.state === "SUCCEEDED" ? "good" : run.state === "ACTIVE" ? "" : "bad";
    row.title = run.text;
    return row;
  });
}

function note(event) {
  const line = document.createElement("li");
  const time = document.createElement("time");
  time.textContent = clock(event.time);
  line.append(time, [event.kind, event.text.includes(event.code) ? null : event.code, event.text || event.state].filter(Boolean).join(" · "));
  line.title = line.textContent;
  at("journal").prepend(line);
  while (at("journal").children.length > JOURNAL_SHOWN) at("journal").lastChild.remove();
}

// --- the link to the server

const take = {
  status(told) {
    status = told;
    heardAt = performance.now();
    plots.ceiling = status.force_ceiling_n;
    setText("ceiling", number(status.force_ceiling_n, 0));
    if (status.driver !== null) setText("driver", `${status.driver}${status.mode === "lockstep" ? ", lockstep" : ""}`);
    show();
  },
  event: note,
  frame(frame) {
    plots.add(frame);
    setText("depth", number(frame.depth_m === null ? null : 1e3 * frame.depth_m, 1));
  },
  runs(page) {
    if (page.runs.length) at("runs").replaceChildren(...rows(page.runs));
  },
  lost() {
    heardAt = -Infinity;
    show();
  },
  before(last) {
    at("journal").replaceChildren();
    last.events.forEach(note);
    if (last.runs) take.runs(last.runs);
    if (last.status) take.status(last.status);
  },
};

function receive(message) {
  linkHeardAt = performance.now();
  take[message.kind](message.data);
}

// The link in the worker that all windows share.
class SharedLink {
  constructor() {
    this.asked = new Map();
    const worker = new SharedWorker("/page/shared-link.js", { type: "module" });
    this.port = worker.port;
    this.port.onmessage = ({ data }) => {
      if (data.kind !== "answer") return receive(data);
      this.asked.get(data.id)?.(data.data);
      this.asked.delete(data.id);
    };
  }

  listen() {
    this.port.postMessage({ kind: "listen" });
  }

  hush() {
    this.port.postMessage({ kind: "hush" });
  }

  command(path, body, headers) {
    const id = newKey();
    return new Promise((resolve) => {
      this.asked.set(id, resolve);
      this.port.postMessage({ kind: "command", id, path, body, headers });
    });
  }
}

let link = typeof SharedWorker === "undefined" ? new Link(receive, true) : new SharedLink();

function listen() {
  linkHeardAt = performance.now();
  at("journal").replaceChildren();
  link.listen();
}

function hush() {
  link.hush();
  heardAt = -Infinity;
}

function watchLink() {
  if (document.hidden || link instanceof Link || performance.now() - linkHeardAt <= WORKER_MS) return;
  for (const resolve of link.asked.values()) resolve({ ok: false, document: null });
  link = new Link(receive, true);
  listen();
}

document.addEventListener("visibilitychange", () => (document.hidden ? hush() : listen()));
addEventListener("pagehide", hush);
addEventListener("pageshow", ({ persisted }) => persisted && !document.hidden && listen());

// --- commands

const channel = new BroadcastChannel(CHANNEL);

async function post(path, body, headers = {}) {
  const { ok, document: told } = await link.command(path, body, headers);
  if (told === null) throw new TypeError("no answer");
  if (!ok) throw new Error(told.detail || told.title);
  return told;
}

// The stop is sent from here and waits for no other request: the links of all windows end theirs.
at("stop").addEventListener("click", async () => {
  stops += 1;
  const mine = stops;
  const say = (text, kind) => {
    if (mine !== stops) return;
    answer(text, kind);
    unconfirmed = kind === "bad";
  };
  say("Stop sent …", "");
  const late = setTimeout(() => say(`STOP NOT CONFIRMED within a second. ${OWN_STOP}`, "bad"), CONFIRM_MS);
  channel.postMessage("make way");
  if (link instanceof Link) link.makeWay(true);
  try {
    const name = encodeURIComponent(at("operator").value.trim());
    const response = await fetch(`/stop?operator=${name}`,
      { method: "POST", keepalive: true, priority: "high", signal: AbortSignal.timeout(STOP_MS) });
    const told = await response.json();
    if (told.confirmed) say("Stopped: standstill is measured.", "good");
    else say(`STOP ${told.detail}`, "bad");
  } catch {
    say(`STOP NOT CONFIRMED. The server does not answer. ${OWN_STOP}`, "bad");
  } finally {
    clearTimeout(late);
  }
});

let pending = null; // a start without an answer is repeated with the same key, so that it starts nothing twice

at("start-form").addEventListener("submit", async (submit) => {
  submit.preventDefault();
  const seed = at("seed").value.trim();
  const body = { recipe: at("recipe").value, ...(seed === "" ? {} : { seed: Number(seed) }) };
  const text = JSON.stringify(body);
  if (pending?.text !== text) pending = { text, key: newKey() };
  const before = stops;
  const say = (words, kind) => before === stops && answer(words, kind); // a stop's answer stays
  say("Start sent …", "");
  try {
    const run = await post("/start", body, { "Idempotency-Key": pending.key });
    pending = null;
    say(`Accepted: run ${run.id}, seed ${run.seed ?? "none"}.`, "good");
  } catch (error) {
    if (!(error instanceof TypeError)) pending = null;
    say(`Not started. ${error instanceof TypeError ? "The server does not answer." : error.message}`, "bad");
  }
});

at("reset-form").addEventListener("submit", async (submit) => {
  submit.preventDefault();
  const before = stops;
  const say = (words, kind) => before === stops && answer(words, kind);
  try {
    await post("/reset", { operator: at("operator").value.trim(), comment: at("comment").value, acknowledge: status?.latch?.code ?? null });
    at("looked").checked = false;
    at("comment").value = "";
    say("Acknowledged. Nothing moves.", "good");
  } catch (error) {
    say(`Not reset. ${error instanceof TypeError ? "The server does not answer." : error.message}`, "bad");
  }
});

function newKey() {
  return Array.from(crypto.getRandomValues(new Uint8Array(16)), (byte) => byte.toString(16).padStart(2, "0")).join("");
}

function draw() {
  plots.draw();
  requestAnimationFrame(draw);
}

listen();
setInterval(show, 100);
setInterval(watchLink, 500);
requestAnimationFrame(draw);
