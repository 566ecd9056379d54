import assert from "node:assert/strict";
import { test } from "node:test";
import { decodeBinary, decodeText, NO_STRIPE, ProtocolError, sequenceOf, type ImageMessage, type ProfileMessage } from "../../src/protocol.ts";
import { bytes, f32, pointsMessage, u16, u32, u64, u8 } from "./messages.ts";

const image = () => bytes(
  u8(1), u8(0), u16(0), u32(41), u64(1_700_000_000_123_456_789n), u32(7), u16(768), u16(576), u32(3), u16(64), u16(NO_STRIPE), u16(64 * 300 + 32), u32(4), u8(255), u8(216), u8(255), u8(217),
);
const profile = () => bytes(u8(3), u8(0), u16(0), u32(42), u64(5n), u32(8), f32(-0.25), u32(2), f32(1), f32(2), f32(600), f32(3), f32(4), f32(601.5));

test("an image comes with its stripe and its JPEG", () => {
  const message = decodeBinary(image()) as ImageMessage;
  assert.equal(message.kind, "image");
  assert.equal(message.sequence, 41);
  assert.equal(message.stampNs, 1_700_000_000_123_456_789n);
  assert.deepEqual([message.frame, message.width, message.height], [7, 768, 576]);
  assert.deepEqual([...message.stripe], [64, NO_STRIPE, 19232]);
  assert.deepEqual([...message.jpeg], [255, 216, 255, 217]);
  assert.equal(message.stripeStep, 1 / 64);
  const wide = image();
  new Uint8Array(wide)[1] = 2;
  assert.equal((decodeBinary(wide) as ImageMessage).stripeStep, 1 / 16);
});

test("a profile comes in millimetres", () => {
  const message = decodeBinary(profile()) as ProfileMessage;
  assert.deepEqual([message.kind, message.frame, message.voltage], ["profile", 8, -0.25]);
  assert.deepEqual([...message.points], [1, 2, 600, 3, 4, 601.5]);
});

test("points come with their box", () => {
  const message = pointsMessage({ epoch: 3, first: 2 ** 33, corner: [-10, 5, 600], step: 0.5, places: [[0, 1, 65535]], brightness: [200] });
  assert.deepEqual([message.epoch, message.first, message.count], [3, 2 ** 33, 1]);
  assert.deepEqual([message.corner, message.step], [[-10, 5, 600], 0.5]);
  assert.deepEqual([message.packed.getUint16(2, true), message.packed.getUint16(4, true), message.packed.getUint8(6)], [1, 65535, 200]);
});

test("a message cut short anywhere is told as such, and nothing else happens", () => {
  for (const whole of [image(), profile()]) {
    for (let length = 0; length < whole.byteLength; length++) {
      assert.throws(() => decodeBinary(whole.slice(0, length)), ProtocolError, `${length} bytes`);
    }
  }
});

test("random bytes give a message, nothing, or a ProtocolError", () => {
  let seed = 12345;
  const random = () => (seed = (Math.imul(seed, 1103515245) + 12345) >>> 0) >>> 16;
  for (let round = 0; round < 3000; round++) {
    const junk = Uint8Array.from({ length: random() % 80 }, (_, i) => (i === 0 ? random() % 5 : random() & 255));
    try {
      decodeBinary(junk.buffer);
    } catch (error) {
      assert.ok(error instanceof ProtocolError, String(error));
    }
  }
});

test("a kind of a later version is passed over, and can be acknowledged", () => {
  const later = bytes(u8(9), u8(0), u16(0), u32(77), u32(1));
  assert.equal(decodeBinary(later), null);
  assert.equal(sequenceOf(later), 77);
  assert.equal(sequenceOf(new ArrayBuffer(3)), null);
});

test("texts are checked for what the page relies on", () => {
  assert.deepEqual(decodeText('{"type":"answer","id":7,"ok":true,"error":null}'), { type: "answer", id: 7, ok: true, error: null });
  assert.equal(decodeText('{"type":"weather"}'), null);
  assert.throws(() => decodeText("{"), /not JSON/);
  assert.throws(() => decodeText("[1]"), /no type/);
  assert.throws(() => decodeText("null"), /no type/);
  assert.throws(() => decodeText('{"type":"state","phase":"idle"}'), /"state" lacks laser, frames, points, stamp_ns/);
});
