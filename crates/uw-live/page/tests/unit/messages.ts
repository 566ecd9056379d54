// Messages as the program would send them.
import { decodeBinary, type PointsMessage } from "../../src/protocol.ts";

type Part = [number, (view: DataView, at: number) => void];
export const u8 = (v: number): Part => [1, (view, at) => view.setUint8(at, v)];
export const u16 = (v: number): Part => [2, (view, at) => view.setUint16(at, v, true)];
export const u32 = (v: number): Part => [4, (view, at) => view.setUint32(at, v, true)];
export const u64 = (v: bigint): Part => [8, (view, at) => view.setBigUint64(at, v, true)];
export const f32 = (v: number): Part => [4, (view, at) => view.setFloat32(at, v, true)];

export function bytes(...parts: Part[]): ArrayBuffer {
  const buffer = new ArrayBuffer(parts.reduce((sum, [length]) => sum + length, 0));
  const view = new DataView(buffer);
  let at = 0;
  for (const [length, put] of parts) {
    put(view, at);
    at += length;
  }
  return buffer;
}

export interface Given {
  epoch?: number;
  first?: number;
  corner?: [number, number, number];
  step?: number;
  places: number[][];
  brightness?: number[];
}

export function pointsMessage({ epoch = 1, first = 0, corner = [0, 0, 0], step = 1, places, brightness }: Given): PointsMessage {
  const body = places.flatMap((place, i) => [...place.map(u16), u8(brightness?.[i] ?? 0)]);
  const message = decodeBinary(bytes(u8(2), u8(0), u16(0), u32(1), u32(epoch), u64(BigInt(first)), u32(places.length), ...corner.map(f32), f32(step), ...body));
  if (message?.kind !== "points") throw new Error("no points");
  return message;
}
