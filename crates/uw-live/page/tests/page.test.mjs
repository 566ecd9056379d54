// The page in headless Chromium against the mock: what an operator does and sees.
import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { axe, findChromium, launch, open, until } from "./browser.mjs";
import { Mock } from "./mock.mjs";
import { FRAMES, HEIGHT } from "./scene.mjs";

// The browser itself says so when a connection fails; a page can't keep it from doing that.
const LOST_LINK = /WebSocket connection to .* failed/;
// Positions go over the link in steps of the message's box; the mock's are never larger than this, mm.
const STEP_MM = 0.02;

let browser;
before(async () => {
  assert.ok(findChromium(), "no Chromium: apt-get install chromium, or set UWSCAN_CHROMIUM");
  browser = await launch();
});
after(() => browser?.close());

/** Runs `run` with a mock and a page on it; fails on whatever the page complained of. */
async function on({ mock: wishes = {}, page: options = {}, allow = [] }, run) {
  const mock = new Mock({ hz: 20, ...wishes });
  const page = await open(browser, await mock.listen(), { allow, ...options });
  try {
    await run(page, mock);
    assert.deepEqual(page.faults, []);
  } finally {
    await page.context().close();
    await mock.close();
  }
}
const state = (page, name, ms) => until(() => page.evaluate((p) => globalThis.uwscan.state()?.phase === p, name), `phase ${name}`, ms);
const link = (page, kind, ms) => until(() => page.evaluate((k) => globalThis.uwscan.link() === k, kind), `link ${kind}`, ms);
const counts = (page) => page.evaluate(() => globalThis.uwscan.counts());

/** Whether the page has the same points as were measured, in the same order. */
async function sameCloud(page, mock) {
  const { positions, brightness } = mock.cloud();
  await until(async () => (await counts(page)).count === brightness.length, `${brightness.length} points on the page`, 15_000);
  const seen = await page.evaluate(() => { const { positions: p, brightness: b } = globalThis.uwscan.points(); return { p: [...p], b: [...b] }; });
  const worst = seen.p.reduce((most, v, i) => Math.max(most, Math.abs(v - positions[i])), 0);
  assert.ok(worst <= STEP_MM / 2, `a point lies ${worst} mm off`);
  assert.deepEqual(seen.b, brightness);
}
const text = (page, id) => page.locator(id).innerText();

test("a scan is started, watched, paused, resumed and stopped", async () => {
  await on({ mock: { hz: 12 } }, async (page, mock) => {
    await state(page, "idle");
    assert.equal(await text(page, "#laser"), "Laser off");
    await page.click("#start");
    await state(page, "scanning");
    assert.deepEqual(mock.commands, ["take-control", "start"]);
    assert.equal(await text(page, "#laser"), "Laser on");
    await until(() => page.evaluate(() => globalThis.uwscan.state().frames > 8), "frames");
    await page.click("#pause");
    await state(page, "paused");
    assert.equal(await text(page, "#laser"), "Laser off");
    assert.equal(await text(page, "#pause"), "Resume");
    const still = mock.state.frames;
    await page.waitForTimeout(400);
    assert.equal(mock.state.frames, still);
    await sameCloud(page, mock);
    await page.click("#pause");
    await state(page, "scanning");
    await until(() => page.evaluate((n) => globalThis.uwscan.state().frames > n + 4, still), "more frames");
    await page.click("#stop");
    await state(page, "finished");
    assert.equal(await text(page, "#laser"), "Laser off");
    assert.match(await text(page, "#ending-text"), /ended early\. Stopped from the live page\..*scan-0001\.mcap/);
    assert.deepEqual(mock.commands, ["take-control", "start", "pause", "resume", "stop"]);
    await sameCloud(page, mock);
  });
});

test("image, stripe, profile, cloud and figures are those of the scan", async () => {
  await on({}, async (page, mock) => {
    await page.click("#start");
    await state(page, "finished", 30_000);
    await sameCloud(page, mock);
    await until(async () => /image 100/.test(await text(page, "#image-note")), "the last image");
    assert.equal((await text(page, "#frames")).trim(), `${FRAMES} of ${FRAMES}`);
    assert.equal((await text(page, "#volts-text")).replace(/\s/g, " "), "Mirror +2.000 V");
    assert.match(await text(page, "#signal-found"), /^9\d\s%/);
    const label = await page.getAttribute("#image", "aria-label");
    assert.match(label, new RegExp(`of ${HEIGHT} lines`));
    // Something of each colour is drawn: the stripe on the image, the curve, the cloud in colours of the scale.
    const drawn = await page.evaluate(() => ["image", "profile"].map((id) => {
      const canvas = document.getElementById(id);
      const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
      let found = 0;
      for (let i = 0; i < data.length; i += 4) if (Math.abs(data[i] - 213) < 25 && Math.abs(data[i + 1] - 94) < 40 && data[i + 2] < 60) found++;
      return found;
    }));
    assert.ok(drawn.every((n) => n > 100), `pixels of the stripe's colour: ${drawn}`);
    const colours = await page.evaluate(() => new Promise((resolve) => {
      const canvas = document.getElementById("cloud");
      document.getElementById("reset").click();
      // Within the frame in which it is drawn, as the drawing buffer is not kept.
      requestAnimationFrame(() => setTimeout(() => {}, 0));
      requestAnimationFrame(() => {
        const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d");
        copy.drawImage(canvas, 0, 0);
        const { data } = copy.getImageData(0, 0, canvas.width, canvas.height);
        let [dark, bright] = [0, 0];
        for (let i = 0; i < data.length; i += 4) {
          if (data[i + 3] < 250) continue;
          if (data[i] < 60 && data[i + 2] > 70) dark++;
          if (data[i] > 200 && data[i + 1] > 180 && data[i + 2] < 120) bright++;
        }
        resolve({ dark, bright });
      });
    }));
    assert.ok(colours.dark > 2000 && colours.bright > 200, JSON.stringify(colours));
  });
});

test("the view turns by mouse and keyboard, and comes back with 0", async () => {
  await on({ mock: { hz: 60 } }, async (page) => {
    await page.click("#start");
    await state(page, "finished", 30_000);
    await page.waitForTimeout(500);
    const canvas = page.locator("#cloud");
    const seen = async () => { await page.waitForTimeout(300); return (await canvas.screenshot()).toString("base64"); };
    await canvas.focus();
    await page.keyboard.press("0");
    const home = await seen();
    await page.keyboard.press("ArrowLeft");
    const typed = await seen();
    assert.notEqual(typed, home);
    const box = await canvas.boundingBox();
    await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
    await page.mouse.down();
    await page.mouse.move(box.x + box.width / 2 + 90, box.y + box.height / 2 + 40, { steps: 5 });
    await page.mouse.up();
    await page.mouse.move(5, 5);
    assert.notEqual(await seen(), typed);
    await canvas.focus();
    await page.keyboard.press("0");
    assert.equal(await seen(), home);
    await page.click("#nearer");
    assert.notEqual(await seen(), home);
  });
});

test("keys do what the buttons do, not while somebody writes, and not when turned off", async () => {
  await on({}, async (page, mock) => {
    await state(page, "idle");
    await page.keyboard.press("s");
    await state(page, "scanning");
    await page.keyboard.press("p");
    await state(page, "paused");
    await page.click("#open-settings");
    await page.fill("[name=client]", "lax pilot");
    assert.equal(mock.state.phase, "paused");
    await page.uncheck("[name=keys]");
    await page.keyboard.press("l");
    await page.waitForTimeout(200);
    assert.equal(mock.commands.includes("laser-off"), false);
    await page.check("[name=keys]");
    // The dialogue is open, and the laser is one key, or one click, away.
    await page.keyboard.press("l");
    await state(page, "finished");
    assert.equal(mock.commands.at(-1), "laser-off");
    await page.click("#laser-off");
    await until(() => mock.commands.filter((c) => c === "laser-off").length === 2, "a second laser-off");
    await page.keyboard.press("Escape");
  });
});

test("two pages: one controls, the other can stop and turn the laser off", async () => {
  await on({ mock: { hz: 4 } }, async (page, mock) => {
    await page.click("#start");
    await state(page, "scanning");
    const other = await open(browser, mock.url);
    await state(other, "scanning");
    await until(async () => /controls\. You can stop the scan/.test(await text(other, "#control-note")), "who controls");
    assert.deepEqual(await other.evaluate(() => ["start", "pause", "stop", "laser-off", "take"].map((id) => document.getElementById(id).disabled)), [true, true, false, false, true]);
    await other.click("#laser-off");
    await state(other, "finished");
    await state(page, "finished");
    assert.match(await text(page, "#ending-text"), /laser was turned off/);
    await sameCloud(other, mock);
    assert.deepEqual(other.faults, []);
    await other.context().close();
  });
});

test("a cut link is told in words with the view's age, and the page catches up by itself", async () => {
  await on({ mock: { hz: 5 }, allow: [LOST_LINK] }, async (page, mock) => {
    await page.click("#start");
    await state(page, "scanning");
    await until(async () => (await counts(page)).count > 3000, "some points");
    const { epoch } = await counts(page);
    mock.note("warning", "The stripe is weak.");
    await page.waitForTimeout(300);
    mock.cut();
    await link(page, "down");
    await until(async () => /The link is down.*scan goes on without this page.*laser may be on/.test(await text(page, "#banner-text")), "the banner");
    await page.waitForTimeout(2000);
    const [, down, old] = /Down for (\d+)\ss\. The view is (\d+)\ss old\./.exec(await text(page, "#banner-age"));
    assert.ok(Number(down) >= 1 && Number(old) >= Number(down), `down for ${down} s, ${old} s old`);
    assert.match(await text(page, "#link"), /Link down/);
    assert.match(await page.locator("#link-age").innerText(), /^\d+(\.\d)?\ss old$/);
    assert.equal(await page.isDisabled("#stop"), false);
    assert.equal(await page.isDisabled("#laser-off"), false);
    assert.equal(await page.isDisabled("#pause"), true);
    assert.equal(await page.isVisible("#retry"), true);
    mock.mend();
    await link(page, "live");
    assert.equal(await page.isVisible("#banner"), false);
    await page.click("#stop");
    await state(page, "finished");
    await sameCloud(page, mock);
    const now = await counts(page);
    assert.deepEqual([now.epoch, now.missed], [epoch, 0]);
    assert.equal(await page.locator("#log .warning").count(), 1, "a message that comes again is not shown again");
  });
});

test("a program that was started anew is not shown with the old one's cloud", async () => {
  await on({ mock: { hz: 30 }, allow: [LOST_LINK] }, async (page, mock) => {
    await page.click("#start");
    await state(page, "scanning");
    await until(async () => (await counts(page)).count > 2000, "some points");
    mock.cut();
    await link(page, "down");
    mock.clear();
    mock.mend();
    await state(page, "idle", 15_000);
    await until(async () => (await counts(page)).count === 0, "an empty cloud");
    await page.click("#start");
    await state(page, "finished", 30_000);
    await sameCloud(page, mock);
    assert.equal((await counts(page)).missed, 0);
  });
});

test("laser off pressed while the link is down is sent when it is back", async () => {
  await on({ mock: { hz: 5 }, allow: [LOST_LINK] }, async (page, mock) => {
    await page.click("#start");
    await state(page, "scanning");
    mock.cut();
    await link(page, "down");
    await page.click("#laser-off");
    assert.match(await text(page, "#control-note"), /^Laser off will be sent as soon as the link is back/);
    mock.mend();
    await state(page, "finished", 15_000);
    assert.equal(mock.commands.at(-1), "laser-off");
  });
});

test("a link that dies without a word is noticed", async () => {
  await on({ allow: [LOST_LINK] }, async (page, mock) => {
    await page.click("#start");
    await state(page, "scanning");
    mock.freeze();
    await until(async () => (await page.getAttribute("body", "data-stale")) === "yes", "an old view");
    assert.ok(parseFloat(await text(page, "#link-age")) >= 2);
    await link(page, "down", 15_000);
    mock.mend();
    await link(page, "live", 10_000);
    await state(page, "finished", 15_000);
    await sameCloud(page, mock);
  });
});

test("over 1 Mbit/s and 300 ms the page answers within a second, and ends with the whole cloud", async () => {
  await on({ mock: { kbps: 1000, delay: 300, hz: 10 } }, async (page, mock) => {
    await state(page, "idle");
    await page.click("#start");
    await state(page, "scanning");
    await page.waitForTimeout(3000);
    const age = await page.evaluate(() => globalThis.uwscan.age());
    assert.ok(age < 2000, `the view is ${age} ms old`);
    // From the press until the page has the new state; the best of three, as the machine may have other things to do.
    const took = [];
    for (const [id, phase] of [["pause", "paused"], ["pause", "scanning"], ["stop", "finished"]]) {
      took.push(await page.evaluate(([button, wanted]) => new Promise((resolve) => {
        const began = performance.now();
        document.getElementById(button).click();
        const timer = setInterval(() => {
          if (globalThis.uwscan.state().phase !== wanted) return;
          clearInterval(timer);
          resolve(performance.now() - began);
        }, 5);
      }), [id, phase]));
    }
    assert.ok(Math.min(...took) < 1000, `answered after ${took.map(Math.round)} ms`);
    await sameCloud(page, mock);
  });
});

test("a thinner cloud is asked for and told", async () => {
  await on({ mock: { hz: 60 } }, async (page, mock) => {
    await page.click("#start");
    await state(page, "finished", 30_000);
    await sameCloud(page, mock);
    await page.click("#open-settings");
    await page.selectOption("[name=density]", "0.25");
    const all = mock.cloud().brightness.length;
    await until(async () => (await counts(page)).count === Math.ceil(all / 4), "a quarter of the points");
    assert.match((await text(page, "#cloud-note")).replace(/[\s\u202f]/g, ""), new RegExp(`^${Math.ceil(all / 4)}of${all}points$`));
  });
});

test("tokens: none, wrong, to view, to control; kept in the tab only", async () => {
  await on({ mock: { tokens: { view: "see", control: "steer" } } }, async (page) => {
    await link(page, "token");
    assert.equal(await page.isVisible("#token"), true);
    await page.fill("#token", "wrong");
    await page.keyboard.press("Enter");
    await until(async () => /does not know this token/.test(await text(page, "#token-wrong")), "the refusal");
    await page.fill("#token", "see");
    await page.keyboard.press("Enter");
    await link(page, "live");
    assert.equal(await page.isVisible("#token"), false);
    assert.deepEqual(await page.evaluate(() => ["start", "pause", "stop", "laser-off"].map((id) => document.getElementById(id).disabled)), [true, true, true, true]);
    assert.match(await text(page, "#control-note"), /You may watch/);
    await page.click("#take");
    await page.fill("#token", "steer");
    await page.keyboard.press("Enter");
    await until(async () => !(await page.isDisabled("#start")), "the right to start");
    assert.deepEqual(await page.evaluate(() => [JSON.stringify(localStorage).includes("steer"), location.href.includes("steer"), document.cookie]), [false, false, ""]);
    await page.reload();
    await link(page, "live");
  });
});

test("warnings are told politely, errors at once", async () => {
  await on({}, async (page, mock) => {
    await link(page, "live");
    mock.note("warning", "The window is dirty. <b>Clean it.</b>");
    mock.note("error", "The camera is silent. Check its cable.");
    await until(async () => (await page.locator("#log li").count()) === 2, "two messages");
    assert.match(await text(page, "#log .warning .text"), /^Warning: The window is dirty\. <b>Clean it\.<\/b>$/);
    assert.equal(await page.locator("#fault-text[role=alert]").innerText(), "The camera is silent. Check its cable.");
    await page.click("#fault-close");
    assert.equal(await page.isVisible("#fault"), false);
  });
});

test("a recording is replayed: play, pause, seek, one image on, faster, another one", async () => {
  await on({ mock: { mode: "replay" } }, async (page, mock) => {
    await link(page, "live");
    assert.equal(await page.isVisible("#controls"), false);
    assert.deepEqual(await page.locator("#capture option").allInnerTexts(), ["tank-morning.mcap", "weld-seam-3.mcap"]);
    await page.keyboard.press("k");
    await until(() => mock.line.frame > 5, "frames played");
    await page.click("#play");
    await until(() => !mock.line.playing, "a pause");
    await page.locator("#seek").fill("60");
    await until(() => mock.line.frame === 60, "the seek");
    await sameCloud(page, mock);
    await page.keyboard.press(".");
    await until(() => mock.line.frame === 61, "one image on");
    assert.match(await text(page, "#seek-text"), /^Image 62 of 101 · 0:06\.1 of 0:10\.0$/);
    await page.selectOption("#speed", "5");
    await until(() => mock.line.rate === 5, "the speed");
    await page.selectOption("#capture", "weld-seam-3.mcap");
    await until(() => mock.line.capture === "weld-seam-3.mcap" && mock.line.frame === 0, "the other recording");
    await sameCloud(page, mock);
  });
});

test("every control has a name, contrast is enough, nothing is wider than a phone", async () => {
  for (const [name, options] of [
    ["light", { colorScheme: "light" }], ["dark", { colorScheme: "dark" }], ["phone", { viewport: { width: 360, height: 740 }, hasTouch: true }],
  ]) {
    await on({ page: options }, async (page, mock) => {
      mock.note("warning", "The stripe is weak in the lower part of the image.");
      mock.note("error", "The camera is silent.");
      await page.click("#start");
      await state(page, "scanning");
      await page.waitForTimeout(600);
      assert.deepEqual(await axe(page), [], name);
      await page.click("#open-settings");
      assert.deepEqual(await axe(page), [], `${name}, settings`);
      const over = await page.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth);
      assert.ok(over <= 0, `${name}: ${over} px too wide`);
      const inView = await page.evaluate(() => ["stop", "laser-off"].every((id) => {
        const box = document.getElementById(id).getBoundingClientRect();
        const at = document.elementFromPoint(box.x + box.width / 2, box.y + box.height / 2);
        return at?.id === id && box.bottom <= innerHeight && box.height >= 44;
      }));
      assert.ok(inView, `${name}: Stop and Laser off can be pressed whatever else is open`);
    });
  }
});

test("nonsense from the program is told once and stops nothing", async () => {
  await on({}, async (page, mock) => {
    await link(page, "live");
    for (const client of mock.clients) for (let i = 0; i < 5; i++) { client.ws.send("{"); client.ws.send(Buffer.from([1, 0, 0, 0, 9, 0, 0, 0, 1])); client.ws.send('{"type":"later"}'); }
    await page.click("#start");
    await state(page, "scanning");
    assert.equal(await page.locator("#log .warning").count(), 2);
  });
});
