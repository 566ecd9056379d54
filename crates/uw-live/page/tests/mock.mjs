// A program that speaks docs/live-protocol.md with a synthetic scan: for work on the page without an instrument, and for its tests.
// `npm run mock -- --port 8800 --mode station|scan|replay [--token view:control] [--kbps 1000 --delay 300] [--hz 10]`
import { createServer } from "node:http";
import { readFile } from "node:fs/promises";
import { dirname, extname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { WebSocketServer } from "ws";
import { cached, FRAMES, HEIGHT, VOLTS, voltage, WIDTH } from "./scene.mjs";

const ASSETS = join(dirname(fileURLToPath(import.meta.url)), "../../assets");
const TYPES = { ".html": "text/html; charset=utf-8", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml", ".txt": "text/plain; charset=utf-8" };
export const CSP = "default-src 'self'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' blob: data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";
const UNACKED_BYTES = 128 * 1024, CHUNK = 4000, IDLE_STATE_MS = 1000;

export class Mock {
  constructor({ mode = "station", tokens = null, hz = 10, kbps = null, delay = 0, captures = ["tank-morning.mcap", "weld-seam-3.mcap"] } = {}) {
    Object.assign(this, { mode, tokens, hz, kbps, delay, captures });
    this.clients = new Set();
    this.commands = [];
    this.notes = [];
    this.frozen = this.refusing = false;
    this.epoch = 0;
    this.clear();
    this.state.phase = mode === "replay" ? "replaying" : "idle";
    this.line = { frame: 0, playing: false, rate: 1, capture: captures[0] };
    if (mode === "replay") this.seek(0);
  }

  async listen(port = 0) {
    this.http = createServer((request, response) => void this.serve(request, response));
    this.sockets = new WebSocketServer({ noServer: true, maxPayload: 64 * 1024, handleProtocols: (names) => (names.has("uwscan.live.v1") ? "uwscan.live.v1" : false) });
    this.http.on("upgrade", (request, socket, head) => {
      if (this.refusing || request.url !== "/ws") socket.destroy();
      else this.sockets.handleUpgrade(request, socket, head, (ws) => this.join(ws));
    });
    await new Promise((resolve) => this.http.listen(port, "127.0.0.1", resolve));
    this.timers = [setInterval(() => this.tick(), 1000 / this.hz), setInterval(() => this.publish(), 100)];
    this.url = `http://127.0.0.1:${this.http.address().port}/`;
    return this.url;
  }

  async close() {
    this.timers.forEach(clearInterval);
    for (const client of this.clients) client.ws.terminate();
    this.http.closeAllConnections();
    await new Promise((resolve) => this.http.close(resolve));
  }

  /** The cable is pulled: sockets end and new ones are refused, until `mend`. */
  cut() {
    this.refusing = true;
    for (const client of this.clients) client.ws.terminate();
  }

  /** The cable is pulled where nobody notices: nothing comes or goes, and no socket ends. */
  freeze() { this.frozen = true; }
  mend() { this.refusing = this.frozen = false; }

  note(level, text) {
    const note = { type: "note", level, text, stamp_ns: now() };
    this.notes.push(note);
    this.broadcast(note);
  }

  /** What was measured, in order: (n × 3) mm and brightnesses. */
  cloud() { return { positions: this.positions, brightness: this.brightness }; }

  clear() {
    this.positions = [];
    this.brightness = [];
    this.epoch++;
    this.lastFrame = null;
    this.state = {
      type: "state", phase: "idle", laser: "off", voltage_v: null, frames: 0, planned: this.mode === "replay" ? null : FRAMES, points: 0, lost: {}, rate_hz: null,
      elapsed_s: null, left_s: null, recording: null, ended: null, controller: null,
    };
  }

  async serve(request, response) {
    const name = request.url === "/" ? "index.html" : request.url.slice(1).split("?")[0];
    const head = { "Content-Security-Policy": CSP, "X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer" };
    try {
      if (!/^[\w.-]+$/.test(name)) throw new Error("no such name");
      const body = await readFile(join(ASSETS, name));
      response.writeHead(200, { ...head, "Content-Type": TYPES[extname(name)] ?? "application/octet-stream" }).end(body);
    } catch {
      response.writeHead(404, head).end("not found");
    }
  }

  join(ws) {
    const client = { ws, sequence: 0, unacked: new Map(), at: 0, epoch: -1, view: { image: true, points: true, density: null }, busy: 0, image: null, hello: false };
    ws.on("message", (data, binary) => {
      if (this.frozen || binary) return;
      setTimeout(() => this.receive(client, JSON.parse(String(data))), this.delay / 2);
    });
    ws.on("close", () => {
      this.clients.delete(client);
      if (this.state.controller === client.name) this.state.controller = null;
    });
    ws.on("error", () => {});
    setTimeout(() => client.hello || ws.close(4408), 5000);
  }

  receive(client, message) {
    if (message.type === "hello") return this.hello(client, message);
    if (!client.hello) return client.ws.close(4408);
    if (message.type === "ack") {
      client.unacked.delete(message.sequence);
      if (client.behind) this.show(client);
    }
    if (message.type === "captures") this.send(client, { type: "captures", names: this.mode === "replay" ? this.captures : [] });
    if (message.type === "have" && message.epoch === this.epochOf(client)) [client.epoch, client.at] = [message.epoch, message.points];
    if (message.type === "view") {
      client.view = { image: message.image, points: message.points, density: message.density ?? null };
    }
    if (message.type === "command") this.command(client, message);
    if (message.type === "replay") this.replay(client, message);
    this.pump(client);
  }

  hello(client, { token, client: name }) {
    const rights = !this.tokens ? "control" : token === this.tokens.control ? "control" : token === this.tokens.view ? "view" : null;
    if (!rights) return client.ws.close(4401);
    Object.assign(client, { hello: true, rights, name: `${name} ${++this.joined || (this.joined = 1)}` });
    this.clients.add(client);
    this.send(client, {
      type: "welcome", version: "0.1.0", mode: this.mode, rights, server_ns: now(), camera: { width: WIDTH, height: HEIGHT }, volts: VOLTS, across: "row",
    });
    this.publishTo(client);
    this.notes.slice(-200).forEach((note) => this.send(client, note));
    if (this.mode === "replay") this.timeline(client);
    this.show(client);
  }

  command(client, { id, do: action }) {
    this.commands.push(action);
    const answer = (error = null) => this.send(client, { type: "answer", id, ok: error === null, error });
    if (client.rights !== "control") return answer("this token allows to watch only");
    const { state } = this;
    if (action === "laser-off" || action === "stop") {
      if (action === "stop" && !["scanning", "paused"].includes(state.phase)) return answer("no scan runs");
      if (["scanning", "paused"].includes(state.phase)) this.end(action === "stop" ? "stopped from the live page" : "the laser was turned off from the live page");
      state.laser = "off";
    } else if (action === "take-control") {
      if (state.controller && state.controller !== client.name) return answer(`${state.controller} controls`);
      state.controller = client.name;
    } else if (state.controller !== client.name) {
      return answer(state.controller ? `${state.controller} controls` : "take control first");
    } else if (action === "release-control") state.controller = null;
    else if (action === "start") this.start();
    else if (action === "pause") Object.assign(state, { phase: "paused", laser: "off" });
    else if (action === "resume") Object.assign(state, { phase: "scanning", laser: "on" });
    answer();
    this.publish();
  }

  start() {
    const { controller } = this.state;
    this.clear();
    this.began = Date.now();
    Object.assign(this.state, { phase: "scanning", laser: "on", controller, recording: "scan-0001.mcap", rate_hz: this.hz });
    this.note("info", "The scan was started from the live page");
  }

  end(why = null) {
    Object.assign(this.state, { phase: "finished", laser: "off", left_s: null, ended: why });
    this.note("info", why ? `The scan ended: ${why}` : "The scan is finished");
  }

  tick() {
    const { state, line } = this;
    if (this.mode === "replay") {
      if (!line.playing) return;
      line.due = (line.due ?? 0) + line.rate;
      for (; line.due >= 1 && line.playing; line.due--) {
        if (line.frame >= FRAMES - 1) line.playing = false;
        else this.take(++line.frame);
      }
      this.clients.forEach((client) => { this.timeline(client); this.show(client); });
    } else if (state.phase === "scanning") {
      this.take(state.frames);
      state.left_s = (FRAMES - state.frames) / this.hz;
      state.elapsed_s = (Date.now() - this.began) / 1000;
      this.clients.forEach((client) => this.show(client));
      if (state.frames >= FRAMES) { this.end(); this.publish(); }
    }
  }

  take(i) {
    const made = cached(i);
    this.lastFrame = i;
    for (const v of made.points) this.positions.push(v);
    for (const v of made.brightness) this.brightness.push(v);
    Object.assign(this.state, { frames: this.mode === "replay" ? i + 1 : this.state.frames + 1, points: this.brightness.length, voltage_v: voltage(i) });
  }

  seek(i) {
    this.positions = [];
    this.brightness = [];
    this.epoch++;
    for (let k = 0; k <= i; k++) this.take(k);
    this.line.frame = i;
  }

  replay(client, { id, do: action, frame, rate, capture }) {
    const { line } = this;
    let error = this.mode === "replay" ? null : "nothing is replayed here";
    if (action === "play") line.playing = true;
    if (action === "pause") line.playing = false;
    if (action === "rate") line.rate = rate;
    if (action === "seek") this.seek(Math.max(0, Math.min(FRAMES - 1, frame)));
    if (action === "open") {
      if (this.captures.includes(capture)) { line.capture = capture; this.seek(0); }
      else error = `there is no recording "${capture}"`;
    }
    this.send(client, { type: "answer", id, ok: error === null, error });
    this.clients.forEach((other) => { this.timeline(other); this.show(other); });
  }

  timeline(client) {
    const { frame: at_frame, playing, rate, capture } = this.line;
    this.send(client, { type: "timeline", start_ns: 1.7e18, end_ns: 1.7e18 + 1e9 * (FRAMES - 1) / 10, frames: FRAMES, at_frame, playing, rate, capture });
  }

  publish() {
    const key = JSON.stringify(this.state);
    if (key === this.published && Date.now() - this.publishedAt < IDLE_STATE_MS) { this.clients.forEach((c) => this.pump(c)); return; }
    [this.published, this.publishedAt] = [key, Date.now()];
    this.clients.forEach((client) => { this.publishTo(client); this.pump(client); });
  }

  publishTo(client) {
    this.send(client, { ...this.state, you_control: this.state.controller === client.name, viewers: this.clients.size, stamp_ns: now() });
  }

  /** Image, profile and signal of the latest frame, if the client has none of them on the way. */
  show(client) {
    if (this.lastFrame === null) return;
    const made = cached(this.lastFrame);
    this.send(client, { type: "signal", ...made.signal });
    // The latest wins: while an image is on the way no other is sent, and then the one that is the latest by then.
    client.behind = [...client.unacked.values()].some(({ kind }) => kind === 1);
    if (client.behind) return;
    const head = (length) => { const out = Buffer.alloc(length); out.writeBigUInt64LE(BigInt(Date.now()) * 1_000_000n); out.writeUInt32LE(this.lastFrame, 8); return out; };
    const profile = Buffer.concat([head(20), Buffer.from(Float32Array.from(made.points).buffer)]);
    profile.writeFloatLE(voltage(this.lastFrame), 12);
    profile.writeUInt32LE(made.points.length / 3, 16);
    this.binary(client, 3, profile);
    if (!client.view.image) return;
    const image = head(20);
    image.writeUInt16LE(WIDTH, 12);
    image.writeUInt16LE(HEIGHT, 14);
    image.writeUInt32LE(made.stripe.length, 16);
    const stripe = Uint16Array.from(made.stripe, (u) => (Number.isNaN(u) ? 65535 : Math.round(64 * u)));
    const length = Buffer.alloc(4);
    length.writeUInt32LE(made.jpeg.length);
    this.binary(client, 1, Buffer.concat([image, Buffer.from(stripe.buffer), length, made.jpeg]));
  }

  /** Points that the client has not got, as many as may be on the way. */
  pump(client) {
    if (!client.hello || !client.view.points) return;
    const every = Math.round(1 / (client.view.density ?? 1));
    const total = Math.ceil(this.brightness.length / every);
    if (client.epoch !== this.epochOf(client)) [client.epoch, client.at] = [this.epochOf(client), 0];
    let waiting = [...client.unacked.values()].reduce((sum, m) => sum + m.bytes, 0);
    while (client.at < total && waiting < UNACKED_BYTES) {
      const n = Math.min(CHUNK, total - client.at);
      const body = this.pack(client.epoch, client.at, n, every);
      client.at += n;
      waiting += body.length;
      this.binary(client, 2, body);
    }
  }

  /** Another density is another epoch. */
  epochOf(client) { return 100 * this.epoch + (Math.round(100 * (client.view.density ?? 1)) % 100); }

  pack(epoch, first, n, every) {
    const at = (i, k) => this.positions[3 * (first + i) * every + k];
    const low = [Infinity, Infinity, Infinity];
    let span = 0;
    for (let i = 0; i < n; i++) for (let k = 0; k < 3; k++) low[k] = Math.min(low[k], at(i, k));
    const corner = low.map((v) => Math.fround(v - 1e-3));
    for (let i = 0; i < n; i++) for (let k = 0; k < 3; k++) span = Math.max(span, at(i, k) - corner[k]);
    const step = Math.fround(Math.max(1e-3, span / 65000));
    const body = Buffer.alloc(32 + 7 * n);
    body.writeUInt32LE(epoch);
    body.writeBigUInt64LE(BigInt(first), 4);
    body.writeUInt32LE(n, 12);
    [...corner, step].forEach((v, k) => body.writeFloatLE(v, 16 + 4 * k));
    for (let i = 0; i < n; i++) {
      for (let k = 0; k < 3; k++) body.writeUInt16LE(Math.round((at(i, k) - corner[k]) / step), 32 + 7 * i + 2 * k);
      body.writeUInt8(this.brightness[(first + i) * every], 32 + 7 * i + 6);
    }
    return body;
  }

  binary(client, kind, body) {
    const head = Buffer.alloc(8);
    head.writeUInt8(kind);
    head.writeUInt32LE(++client.sequence, 4);
    client.unacked.set(client.sequence, { kind, bytes: body.length });
    this.wire(client, Buffer.concat([head, body]));
  }

  broadcast(message) { this.clients.forEach((client) => this.send(client, message)); }
  send(client, message) { this.wire(client, JSON.stringify(message)); }

  /** Through the link, which may be slow, long or dead. */
  wire(client, data) {
    if (this.frozen || client.ws.readyState !== 1) return;
    if (!this.kbps && !this.delay) return client.ws.send(data);
    const takes = this.kbps ? (8 * data.length) / this.kbps : 0;
    client.busy = Math.max(client.busy, Date.now()) + takes;
    setTimeout(() => client.ws.readyState === 1 && client.ws.send(data), client.busy - Date.now() + this.delay / 2);
  }
}

const now = () => Date.now() * 1e6;

if (process.argv[1] === fileURLToPath(import.meta.url)) {
  const option = (name, otherwise) => { const at = process.argv.indexOf(`--${name}`); return at > 0 ? process.argv[at + 1] : otherwise; };
  const [view, control] = (option("token", "") || "").split(":");
  const mock = new Mock({
    mode: option("mode", "station"), hz: Number(option("hz", 10)), kbps: Number(option("kbps", 0)) || null, delay: Number(option("delay", 0)),
    tokens: control ? { view, control } : null,
  });
  process.stdout.write(`the mock serves ${await mock.listen(Number(option("port", 8800)))}\n`);
}
