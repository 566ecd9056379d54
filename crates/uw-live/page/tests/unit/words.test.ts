import assert from "node:assert/strict";
import { test } from "node:test";
import { ageWords, linkWords } from "../../src/banner.ts";
import { cividis, ramp } from "../../src/colour.ts";
import { age, bare, count, duration, length, lost, median, niceStep, volts } from "../../src/format.ts";
import { settle } from "../../src/profile-view.ts";
import type { State, Welcome } from "../../src/protocol.ts";
import { DEFAULTS, parse } from "../../src/settings.ts";
import { endingWords } from "../../src/status.ts";

const plain = (text: string) => text.replaceAll("\u202f", " ");
const state = (more: Partial<State>): State => ({
  type: "state", phase: "scanning", laser: "on", voltage_v: 0, frames: 31, planned: 101, points: 19990, lost: {}, rate_hz: 9.7, elapsed_s: 3, left_s: 7, recording: "scan-0001.mcap",
  ended: null, controller: null, you_control: false, viewers: 1, stamp_ns: 0, ...more,
});

test("numbers are written as people write them", () => {
  assert.equal(plain(count(1234567)), "1 234 567");
  assert.deepEqual([7, 200, 3600, 7500].map((s) => plain(duration(s))), ["7 s", "3 min 20 s", "1 h", "2 h 5 min"]);
  assert.deepEqual([age(340), age(12_300)].map(plain), ["0.3 s", "12 s"]);
  assert.equal(plain(length(612.34, "mm")), "612.3 mm");
  assert.equal(plain(length(612.34, "m")), "0.6123 m");
  assert.equal(bare(25.4, "in", 2.54), "1.0");
  assert.deepEqual([volts(0.12), volts(-2), volts(-0.0001)].map(plain), ["+0.120 V", "−2.000 V", "0.000 V"]);
});

test("losses are told with their reasons, the most frequent first", () => {
  assert.deepEqual(lost({ not_reached: 1, camera_dropped: 4, unusable: 0 }), { total: 5, text: "5: 4 camera dropped, 1 not reached" });
  assert.deepEqual(lost({}), { total: 0, text: "none" });
  assert.deepEqual(lost(undefined), { total: 0, text: "none" });
});

test("steps of a scale are 1, 2 or 5 times a power of ten, and no more than asked for", () => {
  for (const span of [0.003, 0.7, 1, 4, 9.99, 123, 5000]) {
    for (const most of [2, 5, 9]) {
      const step = niceStep(span, most);
      assert.ok(span / step <= most * (1 + 1e-9), `${span} / ${step} > ${most}`);
      assert.ok([1, 2, 5].includes(Math.round(step / 10 ** Math.floor(Math.log10(step) + 1e-9))), `${step}`);
    }
  }
  assert.equal(niceStep(0, 5), 1);
});

test("a median passes over what is not there", () => {
  assert.equal(median([3, null, 1, 2, null]), 2);
  assert.equal(median([4, 1]), 2.5);
  assert.equal(median([null, Number.NaN]), null);
});

test("an axis holds still while what it shows fits, and then takes it in whole", () => {
  const first = settle(null, { low: 600, high: 620 });
  assert.ok(first.low <= 600 && first.high >= 620);
  assert.equal(settle(first, { low: 601, high: 619 }), first);
  const wider = settle(first, { low: 580, high: 620 });
  assert.ok(wider !== first && wider.low <= 580 && wider.high >= 620);
  const closer = settle(first, { low: 610, high: 611 });
  assert.ok(closer.high - closer.low < first.high - first.low && closer.low <= 610 && closer.high >= 611);
});

test("the colours are cividis, from end to end", () => {
  assert.deepEqual([cividis(0), cividis(1), cividis(-3), cividis(9)], [[0, 34, 78], [253, 232, 55], [0, 34, 78], [253, 232, 55]]);
  assert.equal(ramp(cividis).length, 1024);
});

test("a lost link says what goes on without it", () => {
  const down = { kind: "down", since: 0, retryAt: 14_000, why: null } as const;
  const welcome = (mode: Welcome["mode"]) => ({ mode }) as Welcome;
  assert.match(linkWords(down, welcome("station"), state({}))!, /^The link is down\. The scan goes on without this page; the laser may be on\./);
  assert.doesNotMatch(linkWords(down, welcome("replay"), state({ phase: "replaying" }))!, /laser/);
  assert.match(linkWords(down, welcome("scan"), state({ phase: "finished" }))!, /the program has ended with it/);
  assert.match(linkWords(down, null, null)!, /can't be reached/);
  assert.equal(linkWords({ kind: "live", since: 0 }, welcome("scan"), state({})), null);
  assert.equal(plain(ageWords(down, 13_000, 12_000)), "Down for 12 s. The view is 13 s old. Next attempt in 2 s.");
});

test("an ending says what there is and why", () => {
  assert.equal(plain(endingWords(state({ phase: "finished", frames: 101 }))), "The scan is finished. 101 of 101 images, 19 990 points, recorded in scan-0001.mcap.");
  assert.equal(plain(endingWords(state({ phase: "failed", ended: "the camera is silent", lost: { camera_silent: 2 } }))),
    "The scan failed. The camera is silent. 31 of 101 images, 19 990 points, recorded in scan-0001.mcap. Lost: 2, camera silent.");
});

test("settings that were kept are taken where they are of the right kind", () => {
  assert.deepEqual(parse(null), DEFAULTS);
  assert.deepEqual(parse("not JSON"), DEFAULTS);
  assert.deepEqual(parse("null"), DEFAULTS);
  assert.deepEqual(parse('{"unit":"m","cap":"many","bandwidth_kbps":500,"density":"x","other":1}'), { ...DEFAULTS, unit: "m", bandwidth_kbps: 500 });
});
