// What the page and the program say to each other (docs/live-protocol.md): types, and decoding without side effects.

/** Where a scan stands. */
export type Phase = "idle" | "starting" | "scanning" | "paused" | "stopping" | "finished" | "failed" | "replaying";
export type Laser = "on" | "off" | "unknown";
export type Level = "info" | "warning" | "error";
export type Action = "take-control" | "release-control" | "start" | "pause" | "resume" | "stop" | "laser-off";

export interface Welcome {
  type: "welcome";
  version: string;
  mode: "scan" | "station" | "replay";
  rights: "view" | "control";
  server_ns: number;
  camera: { width: number; height: number } | null;
  volts: { from: number; to: number } | null;
  /** `row`: one measurement a row, for a stripe that runs down the image. */
  across: "row" | "column";
}

export interface State {
  type: "state";
  phase: Phase;
  laser: Laser;
  voltage_v: number | null;
  frames: number;
  planned: number | null;
  points: number;
  lost: Record<string, number>;
  rate_hz: number | null;
  elapsed_s: number | null;
  left_s: number | null;
  recording: string | null;
  ended: string | null;
  controller: string | null;
  you_control: boolean;
  viewers: number;
  stamp_ns: number;
}

export interface Signal {
  type: "signal";
  frame: number;
  /** Share of the lines on which a stripe was found, 0 to 1. */
  found: number;
  amplitude: (number | null)[];
  sigma_px: (number | null)[];
}

export interface Note {
  type: "note";
  level: Level;
  text: string;
  stamp_ns: number;
}

export interface Answer {
  type: "answer";
  id: number;
  ok: boolean;
  error: string | null;
}

export interface Timeline {
  type: "timeline";
  start_ns: number;
  end_ns: number;
  frames: number;
  at_frame: number;
  playing: boolean;
  rate: number;
  /** Which capture this is, where the server says so. */
  capture?: string | null;
}

export interface Captures {
  type: "captures";
  names: string[];
}

export type TextMessage = Welcome | State | Signal | Note | Answer | Timeline | Captures;

export interface ImageMessage {
  kind: "image";
  sequence: number;
  stampNs: bigint;
  frame: number;
  width: number;
  height: number;
  /** Steps along each line; 65535 where there is none. */
  stripe: Uint16Array;
  /** px: 1/64, doubled for each of the message's flags, so that wide images fit. */
  stripeStep: number;
  jpeg: Uint8Array;
}

export interface PointsMessage {
  kind: "points";
  sequence: number;
  epoch: number;
  /** Index of the first point within the epoch. */
  first: number;
  count: number;
  /** Corner of the box, mm, camera's frame. */
  corner: [number, number, number];
  /** mm. */
  step: number;
  /** `count` × 7 bytes: u16 × 3 steps from the corner, u8 brightness. */
  packed: DataView;
}

export interface ProfileMessage {
  kind: "profile";
  sequence: number;
  stampNs: bigint;
  frame: number;
  voltage: number;
  /** n × 3, mm, camera's frame. */
  points: Float32Array;
}

export type BinaryMessage = ImageMessage | PointsMessage | ProfileMessage;

/** No stripe on this line. */
export const NO_STRIPE = 65535;
/** Bytes of one point. */
export const POINT_BYTES = 7;
const HEADER_BYTES = 8;

/** A message that is not as docs/live-protocol.md says. */
export class ProtocolError extends Error {}

const TYPES = new Set(["welcome", "state", "signal", "note", "answer", "timeline", "captures"]);

/** A text message, or `null` for a type that this page does not know (a newer server's). Throws `ProtocolError`. */
export function decodeText(text: string): TextMessage | null {
  let message: unknown;
  try {
    message = JSON.parse(text);
  } catch {
    throw new ProtocolError("a text message is not JSON");
  }
  if (typeof message !== "object" || message === null || typeof (message as { type?: unknown }).type !== "string") {
    throw new ProtocolError("a text message has no type");
  }
  const type = (message as { type: string }).type;
  if (!TYPES.has(type)) return null;
  const lacking = REQUIRED[type]?.filter((name) => !(name in (message as object)));
  if (lacking?.length) throw new ProtocolError(`a message "${type}" lacks ${lacking.join(", ")}`);
  return message as TextMessage;
}

const REQUIRED: Record<string, string[]> = {
  welcome: ["mode", "rights", "server_ns"],
  state: ["phase", "laser", "frames", "points", "stamp_ns"],
  signal: ["amplitude", "sigma_px"],
  note: ["level", "text"],
  answer: ["id", "ok"],
  timeline: ["frames", "at_frame", "playing"],
  captures: ["names"],
};

/** A binary message, or `null` for a kind that this page does not know. Its arrays are views into `buffer`. Throws `ProtocolError`. */
export function decodeBinary(buffer: ArrayBuffer): BinaryMessage | null {
  const reader = new Reader(buffer);
  const kind = reader.u8();
  const flags = reader.u8();
  reader.u16();
  const sequence = reader.u32();
  switch (kind) {
    case 1: {
      const [stampNs, frame, width, height, lines] = [reader.u64(), reader.u32(), reader.u16(), reader.u16(), reader.u32()];
      const stripe = reader.u16s(lines);
      return { kind: "image", sequence, stampNs, frame, width, height, stripe, stripeStep: 2 ** flags / 64, jpeg: reader.bytes(reader.u32()) };
    }
    case 2: {
      const [epoch, first, count] = [reader.u32(), reader.u64(), reader.u32()];
      const corner: [number, number, number] = [reader.f32(), reader.f32(), reader.f32()];
      const step = reader.f32();
      const packed = reader.bytes(count * POINT_BYTES);
      if (![...corner, step].every(Number.isFinite)) throw new ProtocolError("a box of points is not of numbers");
      return {
        kind: "points", sequence, epoch, first: Number(first), count, corner, step,
        packed: new DataView(packed.buffer, packed.byteOffset, packed.byteLength),
      };
    }
    case 3: {
      const [stampNs, frame, voltage, count] = [reader.u64(), reader.u32(), reader.f32(), reader.u32()];
      return { kind: "profile", sequence, stampNs, frame, voltage, points: reader.f32s(count * 3) };
    }
    default:
      return null;
  }
}

/** The sequence number of a binary message, known even where its kind is not. */
export function sequenceOf(buffer: ArrayBuffer): number | null {
  return buffer.byteLength >= HEADER_BYTES ? new DataView(buffer).getUint32(4, true) : null;
}

/** Reads little-endian numbers one after another and says where a message ends too soon. */
class Reader {
  private readonly view: DataView;
  private at = 0;

  constructor(private readonly buffer: ArrayBuffer) {
    this.view = new DataView(buffer);
  }

  u8(): number { return this.view.getUint8(this.take(1)); }
  u16(): number { return this.view.getUint16(this.take(2), true); }
  u32(): number { return this.view.getUint32(this.take(4), true); }
  u64(): bigint { return this.view.getBigUint64(this.take(8), true); }
  f32(): number { return this.view.getFloat32(this.take(4), true); }
  bytes(count: number): Uint8Array { return new Uint8Array(this.buffer, this.take(count), count); }

  // Copied: a view needs its start at a multiple of its width, and the header does not see to that.
  u16s(count: number): Uint16Array { const at = this.take(2 * count); return new Uint16Array(this.buffer.slice(at, this.at)); }
  f32s(count: number): Float32Array { const at = this.take(4 * count); return new Float32Array(this.buffer.slice(at, this.at)); }

  private take(count: number): number {
    const at = this.at;
    if (at + count > this.view.byteLength) {
      throw new ProtocolError(`a binary message ends at byte ${this.view.byteLength}, where ${at + count} are needed`);
    }
    this.at = at + count;
    return at;
  }
}
