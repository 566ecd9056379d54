import assert from "node:assert/strict";
import { test } from "node:test";
import { BACK_OFF_MS, Connection, KEEP_URGENT_MS, SILENCE_ASK_MS, SILENCE_DOWN_MS, type Link, type Surroundings } from "../../src/connection.ts";
import type { Welcome } from "../../src/protocol.ts";
import { bytes, u16, u32, u8 } from "./messages.ts";

class Socket {
  binaryType = "";
  readyState = 0;
  sent: Record<string, unknown>[] = [];
  onopen: (() => void) | null = null;
  onmessage: ((event: { data: unknown }) => void) | null = null;
  onclose: ((event: { code: number }) => void) | null = null;
  send(text: string) { this.sent.push(JSON.parse(text)); }
  close() { this.end(1000); }
  open() { this.readyState = 1; this.onopen?.(); }
  end(code: number) { if (this.readyState < 3) { this.readyState = 3; this.onclose?.({ code }); } }
  say(message: object) { this.onmessage?.({ data: JSON.stringify(message) }); }
  types() { return this.sent.map((message) => message["type"]); }
}

/** A connection with sockets and a clock of the test's own. */
function made({ token = null as string | null } = {}) {
  const sockets: Socket[] = [];
  const links: Link[] = [];
  const faults: string[] = [];
  let timers: { at: number; run: () => void }[] = [];
  let now = 1_000_000;
  const around: Surroundings = {
    now: () => now,
    socket: () => { const socket = new Socket(); sockets.push(socket); return socket as unknown as WebSocket; },
    after: (ms, run) => { const timer = { at: now + ms, run }; timers.push(timer); return timer; },
    cancel: (timer) => { timers = timers.filter((other) => other !== timer); },
    random: () => 0.5,
  };
  const order: string[] = [];
  const held = { have: null as { epoch: number; points: number } | null };
  const connection = new Connection("ws://here/ws", {
    hello: () => ({ token, client: "test", bandwidth_kbps: 500 }),
    have: () => held.have,
    greet: () => [{ type: "view" }],
    text: () => {},
    binary: () => { order.push(`handled, ${sockets.at(-1)!.types().filter((t) => t === "ack").length} acknowledged`); },
    link: (link) => links.push(link),
    fault: (text) => faults.push(text),
  }, around);
  const pass = (ms: number) => {
    const end = now + ms;
    for (;;) {
      const next = timers.filter((timer) => timer.at <= end).sort((a, b) => a.at - b.at)[0];
      if (!next) break;
      timers = timers.filter((timer) => timer !== next);
      now = next.at;
      next.run();
    }
    now = end;
  };
  const welcome: Welcome = { type: "welcome", version: "0", mode: "station", rights: "control", server_ns: now * 1e6, camera: null, volts: null, across: "row" };
  const up = () => { const socket = sockets.at(-1)!; socket.open(); socket.say({ ...welcome, server_ns: now * 1e6 }); return socket; };
  connection.start();
  return { connection, sockets, links, faults, pass, up, order, held, last: () => sockets.at(-1)!, state: (stamp_ns: number, phase = "scanning") => ({ type: "state", phase, laser: "off", frames: 0, points: 0, stamp_ns }), now: () => now };
}

/** Why the link is down; fails where it is not. */
function why({ link }: Connection): string {
  assert.equal(link.kind, "down");
  return (link as Extract<Link, { kind: "down" }>).why ?? "";
}

test("the hello comes first, wishes after the welcome", () => {
  const { up, links } = made();
  const socket = up();
  assert.deepEqual(socket.sent, [{ type: "hello", token: null, client: "test", bandwidth_kbps: 500 }, { type: "view" }]);
  assert.deepEqual(links.map((link) => link.kind), ["connecting", "live"]);
});

test("a binary message is acknowledged after it was handled, also one that can't be read", () => {
  const { up, order, faults } = made();
  const socket = up();
  socket.onmessage?.({ data: bytes(u8(3), u8(0), u16(0), u32(41), u32(0), u32(0), u32(0), u32(0), u32(0)) });
  assert.deepEqual(order, ["handled, 0 acknowledged"]);
  socket.onmessage?.({ data: bytes(u8(1), u8(0), u16(0), u32(42)) });
  assert.deepEqual(socket.sent.slice(2), [{ type: "ack", sequence: 41 }, { type: "ack", sequence: 42 }]);
  assert.match(faults[0]!, /ends at byte 8/);
});

test("attempts come later and later, up to a limit, and soon again after a success", () => {
  const { sockets, pass, up, links, last, connection } = made();
  for (const wait of [...BACK_OFF_MS, BACK_OFF_MS.at(-1)!, BACK_OFF_MS.at(-1)!]) {
    last().end(1006);
    const before = sockets.length;
    pass(wait - 1);
    assert.equal(sockets.length, before, `before ${wait} ms`);
    pass(1);
    assert.equal(sockets.length, before + 1, `after ${wait} ms`);
  }
  const downs = links.filter((link) => link.kind === "down");
  assert.equal(new Set(downs.map((link) => link.since)).size, 1, "down since the first loss");
  up();
  last().end(1006);
  pass(BACK_OFF_MS[0]!);
  assert.equal(connection.link.kind, "down");
  up();
  assert.equal(connection.link.kind, "live");
});

test("after a loss the page says what it has, before anything else but the hello", () => {
  const { up, pass, held, last } = made();
  up();
  held.have = { epoch: 4, points: 1234 };
  last().end(1006);
  pass(1000);
  assert.deepEqual(up().sent[1], { type: "have", epoch: 4, points: 1234 });
});

test("a link that is silent is asked, and given up if it stays so", () => {
  const { up, pass, connection, sockets } = made();
  const socket = up();
  pass(SILENCE_ASK_MS + 1500);
  assert.equal(socket.types().at(-1), "captures");
  socket.say({ type: "captures", names: [] });
  pass(SILENCE_ASK_MS);
  assert.equal(connection.link.kind, "live", "an answer is enough");
  pass(SILENCE_DOWN_MS + 2000);
  assert.match(why(connection), /Nothing comes/);
  assert.equal(socket.readyState, 3);
  pass(BACK_OFF_MS[0]! + 1);
  assert.equal(sockets.length, 2);
});

test("a program that takes the call but never answers is given up", () => {
  const { pass, connection, last } = made();
  last().open();
  pass(10_001);
  assert.equal(why(connection), "The program does not answer.");
});

test("a token that is wanted or wrong is asked for, not tried again and again", () => {
  for (const [token, wrong] of [[null, false], ["x", true]] as const) {
    const { last, connection, pass, sockets } = made({ token });
    last().open();
    last().end(4401);
    assert.deepEqual(connection.link, { kind: "token", wrong });
    pass(60_000);
    assert.equal(sockets.length, 1);
  }
});

test("a refused origin is final, too many clients is not", () => {
  const first = made();
  first.last().end(4403);
  first.pass(60_000);
  assert.equal(first.connection.link.kind, "refused");
  assert.equal(first.sockets.length, 1);
  const second = made();
  second.last().end(4429);
  assert.match(why(second.connection), /Too many pages/);
});

test("a command gets its own answer, or is told to have none", async () => {
  const { connection, up, pass, last } = made();
  const socket = up();
  const [pause, start] = [connection.command("pause"), connection.command("start")];
  const [first, second] = socket.sent.slice(-2) as { id: number; do: string }[];
  assert.deepEqual([first!.do, second!.do], ["pause", "start"]);
  socket.say({ type: "answer", id: second!.id, ok: false, error: "no scan" });
  socket.say({ type: "answer", id: first!.id, ok: true, error: null });
  assert.equal((await pause).ok, true);
  assert.equal((await start).error, "no scan");
  const silent = connection.command("resume");
  pass(4000);
  assert.match((await silent).error!, /No answer for 4 s/);
  const lost = connection.command("pause");
  last().end(1006);
  assert.match((await lost).error!, /went down before the answer/);
  assert.match((await connection.command("start")).error!, /was not sent/);
});

test("laser off and stop wait for the link and go first; other commands do not", async () => {
  const { connection, up, pass, last } = made();
  up();
  last().end(1006);
  const off = connection.command("laser-off");
  assert.deepEqual(connection.waiting(), ["laser-off"]);
  pass(1000);
  const socket = up();
  assert.deepEqual(socket.sent.map((m) => m["do"] ?? m["type"]), ["hello", "laser-off", "view"]);
  socket.say({ type: "answer", id: socket.sent[1]!["id"], ok: true, error: null });
  assert.equal((await off).ok, true);
  assert.deepEqual(connection.waiting(), []);
});

test("a stop that is older than a minute is not sent to whatever runs now", async () => {
  const { connection, up, pass, last } = made();
  up();
  last().end(1006);
  const stop = connection.command("stop");
  pass(KEEP_URGENT_MS - 1);
  assert.deepEqual(connection.waiting(), ["stop"]);
  pass(5000);
  assert.deepEqual(connection.waiting(), []);
  const socket = up();
  assert.equal(socket.types().includes("command"), false);
  assert.match((await stop).error!, /down for too long/);
});

test("the age is the time since the latest state, and by how much it came late", () => {
  const { connection, up, pass, state, now } = made();
  const socket = up();
  assert.equal(connection.age(), null);
  socket.say(state(now() * 1e6));
  pass(700);
  assert.equal(Math.round(connection.age()!), 700);
  socket.say(state((now() - 1500) * 1e6));
  assert.equal(Math.round(connection.age()!), 1500);
});

test("while nothing moves, nothing need come: the age is the time since anything did", () => {
  const { connection, up, pass, state, now } = made();
  const socket = up();
  socket.say(state((now() - 60_000) * 1e6, "idle"));
  pass(3000);
  socket.say({ type: "captures", names: [] });
  pass(500);
  assert.equal(connection.age(), 500);
});

test("a second welcome of the same link is told on, and starts nothing anew", () => {
  const { up } = made();
  const socket = up();
  const before = socket.sent.length;
  socket.say({ type: "welcome", version: "0", mode: "scan", rights: "control", server_ns: 0, camera: null, volts: null, across: "row" });
  assert.equal(socket.sent.length, before);
});
