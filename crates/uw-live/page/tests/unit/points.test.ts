import assert from "node:assert/strict";
import { test } from "node:test";
import { BLOCK_POINTS, Points } from "../../src/points.ts";
import { pointsMessage } from "./messages.ts";

/** `count` points that tell their index: x in steps of 1 mm below 60000, y the thousands above. */
const numbered = (first: number, count: number, more: object = {}) =>
  pointsMessage({ first, places: Array.from({ length: count }, (_, i) => [(first + i) % 60000, Math.floor((first + i) / 60000), 7]), brightness: Array.from({ length: count }, (_, i) => (first + i) & 255), ...more });
const index = (points: Points) => { const { positions } = points.unpacked(); return Array.from({ length: points.count }, (_, i) => positions[3 * i]! + 60000 * positions[3 * i + 1]!); };

test("points are corner + step × places, in order, over blocks and boxes", () => {
  const points = new Points();
  const count = BLOCK_POINTS + 5000;
  for (let first = 0; first < count; first += 3333) points.add(numbered(first, Math.min(3333, count - first)));
  assert.equal(points.count, count);
  assert.equal(points.blocks.length, 2);
  assert.deepEqual(index(points), Array.from({ length: count }, (_, i) => i));
  const other = new Points();
  other.add(pointsMessage({ corner: [-3, 4, 600], step: 0.25, places: [[0, 8, 65535]], brightness: [9] }));
  other.add(pointsMessage({ first: 1, corner: [1, 1, 1], step: 2, places: [[1, 2, 3]], brightness: [255] }));
  assert.deepEqual([...other.unpacked().positions], [-3, 6, 600 + 0.25 * 65535, 3, 5, 7]);
  assert.deepEqual([...other.unpacked().brightness], [9, 255]);
  assert.equal(other.step(), 2);
});

test("more boxes than a block has slots open another block, and none is mistaken for another", () => {
  const points = new Points();
  for (let i = 0; i < 700; i++) points.add(pointsMessage({ first: i, corner: [i, 0, 0], places: [[0, 0, 0], [1, 0, 0]].slice(0, 1) }));
  assert.equal(points.blocks.length, 3);
  assert.deepEqual(index(points), Array.from({ length: 700 }, (_, i) => i));
});

test("what came twice is taken once; what is missing is counted", () => {
  const points = new Points();
  assert.deepEqual(points.add(numbered(0, 10)), { restarted: true, added: 10, missed: 0 });
  assert.deepEqual(points.add(numbered(5, 10)), { restarted: false, added: 5, missed: 0 });
  assert.deepEqual(points.add(numbered(0, 10)), { restarted: false, added: 0, missed: 0 });
  assert.deepEqual(index(points), Array.from({ length: 15 }, (_, i) => i));
  assert.deepEqual(points.add(numbered(20, 2)), { restarted: false, added: 2, missed: 5 });
  assert.deepEqual([points.count, points.next, points.missed], [17, 22, 5]);
});

test("a new epoch empties the cloud", () => {
  const points = new Points();
  points.add(numbered(0, 100));
  assert.equal(points.add(numbered(0, 3, { epoch: 2 })).restarted, true);
  assert.deepEqual([points.count, points.next, points.epoch], [3, 3, 2]);
  points.clear();
  assert.deepEqual([points.count, points.epoch, points.extent()], [0, null, null]);
});

test("no more than the cap is kept, and the rest is counted, not asked for again", () => {
  const points = new Points(1000);
  for (let first = 0; first < 2000; first += 300) points.add(numbered(first, 300));
  assert.deepEqual([points.count, points.refused, points.next], [1000, 1100, 2100]);
  assert.deepEqual(index(points), Array.from({ length: 1000 }, (_, i) => i));
});

test("the extent leaves out a few points that lie far off", () => {
  const points = new Points();
  const places = Array.from({ length: 20000 }, (_, i) => (i % 500 === 3 ? [65000, 65000, 65000] : [1000 + (i % 100), 2000 + ((i * 7) % 50), 3000 + ((i * 13) % 10)]));
  points.add(pointsMessage({ places }));
  const { low, high } = points.extent()!;
  for (const [k, from, span] of [[0, 1000, 100], [1, 2000, 50], [2, 3000, 10]] as const) {
    assert.ok(low[k]! >= from && low[k]! <= from + 0.1 * span && high[k]! <= from + span && high[k]! >= from + 0.8 * span, `${k}: ${low[k]} to ${high[k]}`);
  }
});

test("the extent follows the cloud as it grows, and starts anew with it", () => {
  const points = new Points();
  const row = (first: number, epoch: number, at: number) => pointsMessage({ epoch, first, places: Array.from({ length: 500 }, (_, i) => [at + i, 0, 0]) });
  points.add(row(0, 1, 0));
  assert.ok(points.extent()!.high[0] <= 499);
  points.add(row(500, 1, 10_000));
  assert.ok(points.extent()!.high[0] > 10_400);
  points.add(row(0, 2, 100));
  assert.ok(points.extent()!.high[0] <= 599 && points.extent()!.low[0] >= 100);
});
