// The cloud as it is kept: quantised as it came, in blocks that a GPU can draw as they are.
import { POINT_BYTES, type PointsMessage } from "./protocol.ts";

/** Points of one block at most. */
export const BLOCK_POINTS = 65536;
/** Messages whose points one block can hold: the slot is a byte. */
export const BLOCK_SLOTS = 256;
/** u16 of one point: three places and, in the fourth, brightness in the low byte and slot in the high one. */
export const STRIDE = 4;
const FIRST_CAPACITY = 4096;
const SAMPLES = 4096;

/** Points of up to 256 messages. A point's place in mm is corner + step × its three numbers. */
export interface Block {
  /** Grows by doubling; replaced then. */
  data: Uint16Array;
  count: number;
  /** Four a slot: corner x, y, z and step, mm. */
  boxes: Float32Array;
  slots: number;
}

/** What `add` did with a message. */
export type Added = { restarted: boolean; added: number; missed: number };

/** Extents that leave out the outermost hundredth, mm. */
export interface Extent {
  low: [number, number, number];
  high: [number, number, number];
}

/** The cloud of one epoch, in the order in which it was measured. */
export class Points {
  readonly blocks: Block[] = [];
  epoch: number | null = null;
  /** Index that the next point has: what `have` tells the server. */
  next = 0;
  /** Points kept here. */
  count = 0;
  /** Points that came when there was no more room. */
  refused = 0;
  /** Points that never came. */
  missed = 0;
  /** Changes with each change of the cloud. */
  version = 0;
  private sample = new Float32Array(3 * SAMPLES);
  private sampled = 0;
  private random = 1;
  private known: { sampled: number; extent: Extent } | null = null;

  constructor(public cap = 4_194_304) {}

  /** Takes in a message: what is new of it. A new epoch empties the cloud first. */
  add(message: PointsMessage): Added {
    const restarted = message.epoch !== this.epoch;
    if (restarted) {
      this.clear();
      this.epoch = message.epoch;
    }
    const known = Math.min(message.count, Math.max(0, this.next - message.first));
    const missed = Math.max(0, message.first - this.next);
    this.missed += missed;
    const room = Math.max(0, this.cap - this.count);
    const fresh = message.count - known;
    const taken = Math.min(fresh, room);
    this.refused += fresh - taken;
    this.next = Math.max(this.next, message.first + message.count);
    let at = known;
    while (at < known + taken) at += this.fill(message, at, known + taken);
    this.count += taken;
    this.version++;
    return { restarted, added: taken, missed };
  }

  /** Forgets everything, the epoch too. */
  clear(): void {
    this.blocks.length = 0;
    this.epoch = null;
    this.next = this.count = this.refused = this.missed = this.sampled = 0;
    this.random = 1;
    this.known = null;
    this.version++;
  }

  /** Places, (n, 3) float64, mm, camera's frame, and brightnesses, in the order in which they were measured. */
  unpacked(): { positions: Float64Array; brightness: Uint8Array } {
    const positions = new Float64Array(3 * this.count);
    const brightness = new Uint8Array(this.count);
    let at = 0;
    for (const block of this.blocks) {
      for (let i = 0; i < block.count; i++, at++) {
        const last = block.data[STRIDE * i + 3]!;
        const box = 4 * (last >> 8);
        for (let k = 0; k < 3; k++) positions[3 * at + k] = block.boxes[box + k]! + block.boxes[box + 3]! * block.data[STRIDE * i + k]!;
        brightness[at] = last & 255;
      }
    }
    return { positions, brightness };
  }

  /** The coarsest step of those that the places are told in, mm: no point is more than half of it off. */
  step(): number {
    let most = 0;
    for (const { boxes, slots } of this.blocks) for (let slot = 0; slot < slots; slot++) most = Math.max(most, boxes[4 * slot + 3]!);
    return most;
  }

  /** Where the cloud lies but for the outermost hundredth on each side, from a sample; `null` while it is empty. */
  extent(): Extent | null {
    const n = Math.min(this.sampled, SAMPLES);
    if (!n) return null;
    // Asked for with each picture: worked out anew only when the cloud has grown by a hundredth.
    if (this.known && this.sampled < 1.01 * this.known.sampled) return this.known.extent;
    const sides = [0, 1, 2].map((k) => {
      const values = new Float32Array(n);
      for (let i = 0; i < n; i++) values[i] = this.sample[3 * i + k]!;
      values.sort();
      const cut = Math.floor(0.01 * (n - 1));
      return [values[cut]!, values[n - 1 - cut]!] as const;
    });
    const extent = { low: sides.map((s) => s[0]) as Extent["low"], high: sides.map((s) => s[1]) as Extent["high"] };
    this.known = { sampled: this.sampled, extent };
    return extent;
  }

  /** Puts points from `at` up to `end` into the last block, as far as it goes; how many. */
  private fill(message: PointsMessage, at: number, end: number): number {
    let block = this.blocks.at(-1);
    if (!block || block.count === BLOCK_POINTS) block = this.open();
    const slot = this.slot(block, message);
    if (slot === null) {
      this.open();
      return 0;
    }
    const count = Math.min(end - at, BLOCK_POINTS - block.count);
    grow(block, block.count + count);
    const { packed, corner, step } = message;
    for (let i = 0; i < count; i++) {
      const from = POINT_BYTES * (at + i);
      const to = STRIDE * (block.count + i);
      const [x, y, z] = [packed.getUint16(from, true), packed.getUint16(from + 2, true), packed.getUint16(from + 4, true)];
      block.data[to] = x;
      block.data[to + 1] = y;
      block.data[to + 2] = z;
      block.data[to + 3] = packed.getUint8(from + 6) | (slot << 8);
      this.pick(corner[0] + step * x, corner[1] + step * y, corner[2] + step * z);
    }
    block.count += count;
    return count;
  }

  private open(): Block {
    const block: Block = { data: new Uint16Array(STRIDE * FIRST_CAPACITY), count: 0, boxes: new Float32Array(4 * BLOCK_SLOTS), slots: 0 };
    this.blocks.push(block);
    return block;
  }

  /** The slot with the message's box, a new one where the last is another; `null` where there is none left. */
  private slot(block: Block, { corner, step }: PointsMessage): number | null {
    const box = [...corner, step];
    const last = 4 * (block.slots - 1);
    if (block.slots && box.every((v, k) => block.boxes[last + k] === v)) return block.slots - 1;
    if (block.slots === BLOCK_SLOTS) return null;
    block.boxes.set(box, 4 * block.slots);
    return block.slots++;
  }

  /** Keeps a sample of all points, each with the same chance (Vitter's algorithm R), by a generator that starts alike each time. */
  private pick(x: number, y: number, z: number): void {
    let at = this.sampled++;
    if (at >= SAMPLES) {
      this.random = (Math.imul(this.random, 1664525) + 1013904223) >>> 0;
      at = Math.floor((this.random / 2 ** 32) * this.sampled);
      if (at >= SAMPLES) return;
    }
    this.sample.set([x, y, z], 3 * at);
  }
}

function grow(block: Block, count: number): void {
  let capacity = block.data.length / STRIDE;
  if (count <= capacity) return;
  while (capacity < count) capacity *= 2;
  const data = new Uint16Array(STRIDE * Math.min(capacity, BLOCK_POINTS));
  data.set(block.data.subarray(0, STRIDE * block.count));
  block.data = data;
}
