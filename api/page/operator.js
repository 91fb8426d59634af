// The operator's page. It shows measurements and reports of the last second; without any it shows UNKNOWN.
import { LivePlots } from "./plots.js";

const SILENCE_MS = 1000;
const RUNS_SHOWN = 6;
const JOURNAL_SHOWN = 7;
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
let journal = null;
let frames = null;
let shownRun = "";

// --- display

function show() {
  const live = performance.now() - heardAt <= SILENCE_MS;
  const state = live && status ? status.state : "UNKNOWN";
  if (document.body.dataset.state !== state) {
    document.body.dataset.state = state;
    at("state").textContent = state;
    at("mark").textContent = MARKS[state] ?? "?";
    at("answer").className = "";
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

async function readRuns() {
  try {
    const response = await fetch(`/runs?limit=${RUNS_SHOWN}`);
    if (!response.ok) return;
    const page = await response.json();
    if (page.runs.length) at("runs").replaceChildren(...rows(page.runs));
  } catch {
    // The banner tells that the server is gone.
  }
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

// --- streams

function listen() {
  journal ??= openJournal();
  frames ??= openFrames();
}

function openJournal() {
  at("journal").replaceChildren();
  const source = new EventSource(`/events?replay=${JOURNAL_SHOWN}`);
  source.addEventListener("status", (message) => {
    status = JSON.parse(message.data);
    heardAt = performance.now();
    plots.ceiling = status.force_ceiling_n;
    setText("ceiling", number(status.force_ceiling_n, 0));
    if (status.driver !== null) setText("driver", `${status.driver}${status.mode === "lockstep" ? ", lockstep" : ""}`);
    const run = `${status.run?.id} ${status.run?.state}`;
    if (run !== shownRun) {
      shownRun = run;
      readRuns();
    }
    show();
  });
  source.addEventListener("event", (message) => {
    note(JSON.parse(message.data));
    readRuns();
  });
  source.addEventListener("resync", readRuns);
  source.addEventListener("error", () => {
    heardAt = -Infinity;
    show();
    if (source.readyState === EventSource.CLOSED) reopen();
  });
  return source;
}

function openFrames() {
  const source = new EventSource("/telemetry");
  source.addEventListener("frame", (message) => {
    const frame = JSON.parse(message.data);
    plots.add(frame);
    setText("depth", number(frame.depth_m === null ? null : 1e3 * frame.depth_m, 1));
  });
  return source;
}

function reopen() {
  // The browser does not reconnect by itself after an answer that is not a stream.
  setTimeout(() => {
    hush();
    if (!document.hidden) listen();
  }, 500);
}

function hush() {
  journal?.close();
  frames?.close();
  journal = frames = null;
  heardAt = -Infinity;
}

// A browser opens at most six connections to a server for all its windows, so a hidden page holds none.
document.addEventListener("visibilitychange", () => (document.hidden ? hush() : listen()));

// --- commands

async function post(path, body, headers = {}) {
  const json = body === undefined ? {} : { "Content-Type": "application/json" };
  const response = await fetch(path, { method: "POST", headers: { ...json, ...headers },
    body: body === undefined ? undefined : JSON.stringify(body) });
  const document_ = await response.json();
  if (!response.ok) throw new Error(document_.detail || document_.title);
  return { status: response.status, document: document_ };
}

at("stop").addEventListener("click", async () => {
  answer("Stop sent …", "");
  frames?.close(); // frees a connection for the stop
  frames = null;
  try {
    const { document: told } = await post("/stop");
    answer(told.confirmed ? "Stopped: standstill is measured." : `Stop received: ${told.detail}`, told.confirmed ? "good" : "bad");
  } catch (error) {
    answer(`STOP NOT CONFIRMED. ${error instanceof TypeError ? "The server does not answer. Use the robot's own emergency stop." : error.message}`, "bad");
  } finally {
    if (!document.hidden) listen();
  }
});

let pending = null; // a start without an answer is repeated with the same key, so that it starts nothing twice

at("start-form").addEventListener("submit", async (submit) => {
  submit.preventDefault();
  const seed = at("seed").value.trim();
  const body = { recipe: at("recipe").value, ...(seed === "" ? {} : { seed: Number(seed) }) };
  const text = JSON.stringify(body);
  if (pending?.text !== text) pending = { text, key: newKey() };
  answer("Start sent …", "");
  try {
    const { document: run } = await post("/start", body, { "Idempotency-Key": pending.key });
    pending = null;
    answer(`Accepted: run ${run.id}, seed ${run.seed ?? "none"}.`, "good");
    readRuns();
  } catch (error) {
    if (!(error instanceof TypeError)) pending = null;
    answer(`Not started. ${error instanceof TypeError ? "The server does not answer." : error.message}`, "bad");
  }
});

at("reset-form").addEventListener("submit", async (submit) => {
  submit.preventDefault();
  try {
    await post("/reset", { operator: at("operator").value.trim(), comment: at("comment").value, acknowledge: status?.latch?.code ?? null });
    at("looked").checked = false;
    at("comment").value = "";
    answer("Acknowledged. Nothing moves.", "good");
  } catch (error) {
    answer(`Not reset. ${error instanceof TypeError ? "The server does not answer." : error.message}`, "bad");
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
readRuns();
setInterval(show, 100);
requestAnimationFrame(draw);
