// The link to the program: says hello, acknowledges, notices when the link is down, comes back by itself and goes on where it was.
import {
  decodeBinary, decodeText, ProtocolError, sequenceOf, type Action, type Answer, type BinaryMessage, type TextMessage, type Welcome,
} from "./protocol.ts";

export const SUBPROTOCOL = "uwscan.live.v1";

/** How the link stands. */
export type Link =
  | { kind: "connecting" }
  | { kind: "live"; since: number }
  /** `since` and `retryAt`: ms of the page's clock. `why`: plain words, where there is more to say than that it is gone. */
  | { kind: "down"; since: number; retryAt: number; why: string | null }
  /** The server wants a token, or another one than it got. */
  | { kind: "token"; wrong: boolean }
  /** No use trying again. */
  | { kind: "refused"; why: string };

/** What the connection asks of the page, and tells it. */
export interface Peer {
  hello(): { token: string | null; client: string; bandwidth_kbps: number | null };
  /** What is there of the cloud already. */
  have(): { epoch: number; points: number } | null;
  /** What is said after each welcome: wishes, questions. */
  greet(welcome: Welcome): object[];
  text(message: TextMessage): void;
  binary(message: BinaryMessage): void;
  link(link: Link): void;
  /** Something came that is not as it should be. */
  fault(text: string): void;
}

/** What of a browser is used, so that a test can put its own in place. */
export interface Surroundings {
  now(): number;
  socket(url: string, protocol: string): WebSocket;
  after(ms: number, run: () => void): unknown;
  cancel(timer: unknown): void;
  random(): number;
}

const BROWSER: Surroundings = {
  now: () => Date.now(),
  socket: (url, protocol) => new WebSocket(url, protocol),
  after: (ms, run) => setTimeout(run, ms),
  cancel: (timer) => clearTimeout(timer as number),
  random: () => Math.random(),
};

/** Waits between attempts, ms; the last one for good. */
export const BACK_OFF_MS = [250, 500, 1000, 2000, 4000, 5000];
/** A socket or a welcome that takes longer is given up. */
const OPENING_MS = 10_000;
/** Silence after which a question is asked that has to be answered, and after which the link counts as down. */
export const SILENCE_ASK_MS = 4_000;
export const SILENCE_DOWN_MS = 9_000;
/** Phases in which the state changes all the time. */
const AT_WORK = new Set(["starting", "scanning", "stopping"]);
/** A command unanswered for so long is told as such. */
export const ANSWER_MS = 4_000;
/** Laser off and stop, asked for while the link is down, are sent if it is back within this time. */
export const KEEP_URGENT_MS = 60_000;

const CLOSED: Record<number, string> = {
  1001: "The program was ended.",
  4400: "The program did not understand this page. Reload it: they may be of different versions.",
  4408: "The program did not hear from this page in time.",
  4413: "The program refused a message of this page as too large.",
  4429: "Too many pages are open, or they ask too often. Close one that nobody looks at.",
};

interface Pending {
  resolve(answer: Answer): void;
  timer: unknown;
}

export class Connection {
  link: Link = { kind: "connecting" };
  private socket: WebSocket | null = null;
  private attempts = 0;
  private downSince: number | null = null;
  private timer: unknown = null;
  private watch: unknown = null;
  private nextId = 1;
  private readonly pending = new Map<number, Pending>();
  private readonly urgent = new Map<Action, Pending>();
  private heard = 0;
  private asked = false;
  /** Server's clock less ours where a message took the least time, ms. */
  private offset: number | null = null;
  private stamp: { server: number; received: number; atWork: boolean } | null = null;
  private greeted = false;

  constructor(private readonly url: string, private readonly peer: Peer, private readonly around: Surroundings = BROWSER) {}

  /** Connects, at once; whatever went on before is given up. */
  start(): void {
    this.drop();
    if (this.link.kind !== "down") this.become({ kind: "connecting" });
    let socket: WebSocket;
    try {
      socket = this.around.socket(this.url, SUBPROTOCOL);
    } catch {
      this.become({ kind: "refused", why: `The browser opens no connection to ${this.url}.` });
      return;
    }
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    this.timer = this.around.after(OPENING_MS, () => this.lost(socket, "The program does not answer."));
    socket.onopen = () => this.send({ type: "hello", ...this.peer.hello() });
    socket.onmessage = (event) => this.receive(socket, event.data);
    socket.onclose = (event) => this.closed(socket, event.code);
  }

  /** Tries again now instead of at the next attempt's time. */
  retry(): void {
    this.attempts = 0;
    this.start();
  }

  /** Sends a message; whether there was a link to take it. */
  send(message: object): boolean {
    if (this.socket?.readyState !== 1) return false;
    this.socket.send(JSON.stringify(message));
    return true;
  }

  /** Asks for something; the server's answer, or one in its place where none comes. Never rejects. */
  command(action: Action): Promise<Answer> {
    const waits = action === "stop" || action === "laser-off";
    if (this.link.kind !== "live" && waits) {
      return new Promise((resolve) => {
        const before = this.urgent.get(action);
        const both = before ? (answer: Answer) => { before.resolve(answer); resolve(answer); } : resolve;
        if (before) this.around.cancel(before.timer);
        const timer = this.around.after(KEEP_URGENT_MS, () => {
          this.urgent.delete(action);
          both({ type: "answer", id: 0, ok: false, error: "The link was down for too long: this was not sent. Press again if it is still wanted." });
        });
        this.urgent.set(action, { timer, resolve: both });
      });
    }
    return this.ask({ type: "command", do: action });
  }

  /** What is still to be sent when the link is back. */
  waiting(): Action[] {
    return [...this.urgent.keys()];
  }

  /** Sends a message with an id; its answer, or one in its place. */
  ask(message: object): Promise<Answer> {
    const id = this.nextId++;
    return new Promise((resolve) => {
      if (this.link.kind !== "live" || !this.send({ ...message, id })) {
        resolve({ type: "answer", id, ok: false, error: "The link is down: this was not sent." });
        return;
      }
      const timer = this.around.after(ANSWER_MS, () => this.settle({
        type: "answer", id, ok: false, error: `No answer for ${ANSWER_MS / 1000} s. Whether it was done is not known: look at the state.`,
      }));
      this.pending.set(id, { resolve, timer });
    });
  }

  /**
   * How old what is shown is, ms; `null` before the first state. While something moves: time since the latest state came, and what it was late by. Else nothing
   * need come, and it is the time since anything did.
   */
  age(): number | null {
    if (!this.stamp || this.offset === null) return null;
    if (!this.stamp.atWork) return Math.max(0, this.around.now() - this.heard);
    const late = this.stamp.received + this.offset - this.stamp.server;
    return Math.max(0, this.around.now() - this.stamp.received) + Math.max(0, late);
  }

  private receive(socket: WebSocket, data: unknown): void {
    if (socket !== this.socket) return;
    this.heard = this.around.now();
    this.asked = false;
    try {
      if (typeof data === "string") this.text(data);
      else if (data instanceof ArrayBuffer) this.binary(data);
    } catch (error) {
      if (!(error instanceof ProtocolError)) throw error;
      this.peer.fault(error.message);
    }
  }

  private text(data: string): void {
    const message = decodeText(data);
    if (!message) return;
    if (message.type === "welcome") this.welcome(message);
    if (message.type === "state") this.clock(message.stamp_ns / 1e6, AT_WORK.has(message.phase));
    if (message.type === "answer") this.settle(message);
    this.peer.text(message);
  }

  private binary(data: ArrayBuffer): void {
    const sequence = sequenceOf(data);
    try {
      const message = decodeBinary(data);
      if (message) this.peer.binary(message);
    } finally {
      // After the work, so that a page that is slow is not sent more than it can show; also for what it could not read.
      if (sequence !== null) this.send({ type: "ack", sequence });
    }
  }

  private welcome(message: Welcome): void {
    // A server may welcome again when what it said has changed.
    if (this.greeted) return;
    this.greeted = true;
    this.around.cancel(this.timer);
    this.attempts = 0;
    this.downSince = null;
    this.stamp = null;
    this.offset = message.server_ns / 1e6 - this.around.now();
    const have = this.peer.have();
    if (have) this.send({ type: "have", ...have });
    this.become({ kind: "live", since: this.around.now() });
    for (const [action, { timer, resolve }] of this.urgent) {
      this.around.cancel(timer);
      void this.ask({ type: "command", do: action }).then(resolve);
    }
    this.urgent.clear();
    for (const wish of this.peer.greet(message)) this.send(wish);
    this.watching();
  }

  private clock(server: number, atWork: boolean): void {
    const received = this.around.now();
    if (atWork) this.offset = Math.max(this.offset ?? -Infinity, server - received);
    this.stamp = { server, received, atWork };
  }

  /** A cut cable closes no socket: whoever says nothing is asked, and whoever does not answer is gone. */
  private watching(): void {
    this.around.cancel(this.watch);
    this.watch = this.around.after(1000, () => {
      const silent = this.around.now() - this.heard;
      if (silent > SILENCE_DOWN_MS && this.asked && this.socket) {
        this.lost(this.socket, "Nothing comes over the link any more.");
        return;
      }
      if (silent > SILENCE_ASK_MS && !this.asked) {
        this.asked = true;
        this.send({ type: "captures" });
      }
      this.watching();
    });
  }

  private closed(socket: WebSocket, code: number): void {
    if (socket !== this.socket) return;
    if (code === 4401) {
      this.drop();
      this.become({ kind: "token", wrong: this.peer.hello().token !== null });
    } else if (code === 4403) {
      this.drop();
      this.become({ kind: "refused", why: "The program does not serve pages from this address. Open the address that it printed when it started." });
    } else {
      this.lost(socket, CLOSED[code] ?? null);
    }
  }

  private lost(socket: WebSocket, why: string | null): void {
    if (socket !== this.socket) return;
    this.drop();
    const now = this.around.now();
    this.downSince ??= now;
    const wait = BACK_OFF_MS[Math.min(this.attempts++, BACK_OFF_MS.length - 1)]! * (0.75 + 0.5 * this.around.random());
    this.timer = this.around.after(wait, () => this.start());
    this.become({ kind: "down", since: this.downSince, retryAt: now + wait, why });
  }

  /** Lets go of the socket, and answers whatever still waits for an answer. */
  private drop(): void {
    this.around.cancel(this.timer);
    this.around.cancel(this.watch);
    const socket = this.socket;
    this.socket = null;
    this.greeted = false;
    if (socket && socket.readyState < 2) socket.close();
    for (const id of [...this.pending.keys()]) {
      this.settle({ type: "answer", id, ok: false, error: "The link went down before the answer came. Whether it was done is not known: look at the state." });
    }
  }

  private settle(answer: Answer): void {
    const pending = this.pending.get(answer.id);
    if (!pending) return;
    this.pending.delete(answer.id);
    this.around.cancel(pending.timer);
    pending.resolve(answer);
  }

  private become(link: Link): void {
    this.link = link;
    this.peer.link(link);
  }
}
