// The link to the server: one event stream, and the requests that can wait. A browser opens at most six connections to
// a server for all its windows, so they share one link in a worker. A stop is not sent here: its window sends it, and
// every link then ends its requests, so that the stop finds a connection free.
export const JOURNAL_SHOWN = 7;
const RUNS_SHOWN = 6;
const REOPEN_MS = 500;
const RUNS_MS = 3000;
const COMMAND_MS = 15000; // the server answers a start within 10 s
export const CHANNEL = "stop";

export class Link {
  // tell(message) hands a message to every window that listens; alone: no other window uses this link.
  constructor(tell, alone) {
    this.tell = tell;
    this.source = null;
    this.requests = new Set();
    this.last = { events: [] };
    this.reading = false;
    this.again = false;
    this.channel = new BroadcastChannel(CHANNEL);
    this.channel.onmessage = () => this.makeWay(alone);
  }

  listen() {
    if (this.source !== null) return;
    this.last.events = [];
    const source = new EventSource(`/events?frames=true&replay=${JOURNAL_SHOWN}`);
    this.source = source;
    source.addEventListener("status", (message) => this.onStatus(JSON.parse(message.data)));
    source.addEventListener("event", (message) => this.onEvent(JSON.parse(message.data)));
    source.addEventListener("frame", (message) => this.tell({ kind: "frame", data: JSON.parse(message.data) }));
    source.addEventListener("resync", () => this.readRuns());
    source.addEventListener("error", () => {
      this.last.status = null;
      this.tell({ kind: "lost" });
      if (source.readyState === EventSource.CLOSED) this.reopen(); // the answer was no stream: it stays closed
    });
  }

  hush() {
    this.source?.close();
    this.source = null;
    this.last = { events: [] };
  }

  reopen() {
    this.hush();
    setTimeout(() => this.listen(), REOPEN_MS);
  }

  onStatus(status) {
    const known = this.last.status?.run;
    this.last.status = status;
    this.tell({ kind: "status", data: status });
    if (!this.last.runs || `${status.run?.id} ${status.run?.state}` !== `${known?.id} ${known?.state}`) this.readRuns();
  }

  onEvent(event) {
    this.last.events = [...this.last.events, event].slice(-JOURNAL_SHOWN);
    this.tell({ kind: "event", data: event });
    this.readRuns();
  }

  // One request at a time, however many windows and events ask for it.
  async readRuns() {
    this.again = this.reading;
    if (this.reading) return;
    this.reading = true;
    const answer = await this.request(`/runs?limit=${RUNS_SHOWN}`, {}, RUNS_MS);
    this.reading = false;
    if (answer.ok) {
      this.last.runs = answer.document;
      this.tell({ kind: "runs", data: answer.document });
    }
    if (this.again) this.readRuns();
  }

  command(path, body, headers) {
    const options = { method: "POST", headers: { "Content-Type": "application/json", ...headers }, body: JSON.stringify(body) };
    return this.request(path, options, COMMAND_MS);
  }

  // The answer, or { ok: false, document: null } where there is none.
  async request(path, options, timeoutMs) {
    const abort = new AbortController();
    const timer = setTimeout(() => abort.abort(), timeoutMs);
    this.requests.add(abort);
    try {
      const response = await fetch(path, { ...options, signal: abort.signal });
      return { ok: response.ok, document: await response.json() };
    } catch {
      return { ok: false, document: null };
    } finally {
      clearTimeout(timer);
      this.requests.delete(abort);
    }
  }

  makeWay(alone) {
    this.again = false;
    for (const abort of this.requests) abort.abort();
    if (alone && this.source !== null) {
      this.reopen(); // every window has a stream of its own then
    }
  }
}
