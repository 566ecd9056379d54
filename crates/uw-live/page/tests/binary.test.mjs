// The page in headless Chromium against the program itself, with a simulated instrument. UWSCAN_BINARY names the program; UWSCAN_VEHICLE a vehicle file,
// else `uwscan demo` makes one; UWSCAN_PICTURES a folder for pictures.
import assert from "node:assert/strict";
import { execFile, spawn } from "node:child_process";
import { mkdir, mkdtemp, readdir, readFile, rm } from "node:fs/promises";
import { tmpdir } from "node:os";
import { join, resolve } from "node:path";
import { promisify } from "node:util";
import { after, before, test } from "node:test";
import WebSocket from "ws";
import { axe, findChromium, launch, open, until } from "./browser.mjs";
import { readPly } from "./ply.mjs";

const BINARY = process.env.UWSCAN_BINARY && resolve(process.env.UWSCAN_BINARY);
// Half the distance of neighbouring points along the demo's stripes, and as much for the two methods' difference.
const SURFACE_MM = 0.5;
const run = promisify(execFile);
let browser, folder, vehicle;

before(async () => {
  assert.ok(BINARY, "UWSCAN_BINARY is not set");
  assert.ok(findChromium(), "no Chromium: apt-get install chromium, or set UWSCAN_CHROMIUM");
  folder = await mkdtemp(join(tmpdir(), "uwscan-page-"));
  vehicle = process.env.UWSCAN_VEHICLE;
  if (!vehicle) {
    await run(BINARY, ["demo", "-o", join(folder, "demo"), "-q"], { maxBuffer: 1 << 24 });
    vehicle = join(folder, "demo/vehicle.toml");
  }
  browser = await launch();
}, { timeout: 600_000 });
after(async () => {
  await browser?.close();
  if (folder) await rm(folder, { recursive: true, force: true });
});

/** Starts the program and gives its address, as it prints it; what it printed is in `said`. */
async function serve(args) {
  const { UWSCAN_VIEW_TOKEN: _view, UWSCAN_CONTROL_TOKEN: _control, ...env } = process.env;
  const child = spawn(BINARY, [...args, "--listen", "127.0.0.1:0", "--foxglove", "off"], { cwd: folder, env, stdio: ["ignore", "pipe", "pipe"] });
  const program = { child, said: "", ended: new Promise((resolve) => child.on("exit", resolve)) };
  for (const stream of [child.stdout, child.stderr]) stream.on("data", (data) => { program.said += data; });
  program.url = await until(() => {
    if (child.exitCode !== null) throw new Error(`the program ended: ${program.said}`);
    const found = /https?:\/\/127\.0\.0\.1:\d+/.exec(program.said);
    return found && `${found[0]}/`;
  }, "an address", 30_000).catch((error) => { throw new Error(`${error.message}; it said: ${program.said}`); });
  program.stop = async () => { child.kill("SIGINT"); await Promise.race([program.ended, new Promise((resolve) => setTimeout(resolve, 5000))]); child.kill("SIGKILL"); };
  return program;
}

/** A second client: all points of the last epoch, as they came. */
function listen(url) {
  const socket = new WebSocket(`${url.replace(/^http/, "ws")}ws`, "uwscan.live.v1", { origin: url.replace(/\/$/, "") });
  const cloud = { epoch: null, positions: [], step: 0, socket };
  socket.on("open", () => socket.send(JSON.stringify({ type: "hello", token: null, client: "second", bandwidth_kbps: null })));
  socket.on("message", (data, binary) => {
    if (!binary) return;
    socket.send(JSON.stringify({ type: "ack", sequence: data.readUInt32LE(4) }));
    if (data[0] !== 2) return;
    const epoch = data.readUInt32LE(8);
    if (epoch !== cloud.epoch) Object.assign(cloud, { epoch, positions: [], step: 0 });
    const [first, count] = [Number(data.readBigUInt64LE(12)), data.readUInt32LE(20)];
    assert.equal(first, cloud.positions.length / 3, "points come in order");
    const corner = [24, 28, 32].map((at) => data.readFloatLE(at));
    const step = data.readFloatLE(36);
    if (count) cloud.step = Math.max(cloud.step, step);
    for (let i = 0; i < count; i++) for (let k = 0; k < 3; k++) cloud.positions.push(corner[k] + step * data.readUInt16LE(40 + 7 * i + 2 * k));
  });
  return cloud;
}

const state = (page, wanted, ms = 30_000) => until(() => page.evaluate((p) => p.includes(globalThis.uwscan.state()?.phase), [wanted].flat()), `phase ${wanted}`, ms);
const frames = (page, n) => until(() => page.evaluate((m) => globalThis.uwscan.state().frames >= m, n), `${n} images`, 60_000);
const frameAt = (page, n) => until(() => page.evaluate((m) => globalThis.uwscan.state().frames === m, n), `image ${n}`, 20_000);
/** From each point of `a` to the nearest of `b`, mm, sorted. */
function nearest(a, b) {
  const out = [];
  for (let i = 0; i < a.length; i += 3) {
    let least = Infinity;
    for (let j = 0; j < b.length; j += 3) least = Math.min(least, (a[i] - b[j]) ** 2 + (a[i + 1] - b[j + 1]) ** 2 + (a[i + 2] - b[j + 2]) ** 2);
    out.push(Math.sqrt(least));
  }
  return out.sort((x, y) => x - y);
}
const worst = (a, b) => a.reduce((most, v, i) => Math.max(most, Math.abs(v - b[i])), 0);

test("station: started, watched, paused, resumed and stopped from the page; its points are the cloud's", { timeout: 300_000 }, async () => {
  const out = join(folder, "scans");
  await mkdir(out);
  const program = await serve(["serve", "--config", vehicle, "-o", out]);
  try {
    const page = await open(browser, program.url, { viewport: { width: 1280, height: 800 } });
    await state(page, "idle");
    const second = listen(program.url);
    await page.click("#start");
    await state(page, "scanning");
    await frames(page, 8);
    assert.equal(await page.locator("#laser").innerText(), "Laser on");
    await page.click("#pause");
    await state(page, "paused");
    await until(async () => (await page.locator("#laser").innerText()) === "Laser off", "the laser off in a pause");
    const still = await page.evaluate(() => globalThis.uwscan.state().frames);
    await page.waitForTimeout(1000);
    assert.ok((await page.evaluate(() => globalThis.uwscan.state().frames)) <= still + 1, "a pause is a pause");
    await page.click("#pause");
    await state(page, "scanning");
    await frames(page, still + 6);
    assert.deepEqual(await axe(page), []);
    if (process.env.UWSCAN_PICTURES) await page.screenshot({ path: join(process.env.UWSCAN_PICTURES, "program-station.png") });
    await page.click("#stop");
    await state(page, ["finished", "failed", "idle"]);
    await until(async () => (await page.locator("#laser").innerText()) === "Laser off", "the laser off at the end");
    const total = await until(() => page.evaluate(() => { const s = globalThis.uwscan.state(); return ["finished", "failed", "idle"].includes(s.phase) && s.points; }), "a number of points");
    await until(() => page.evaluate((n) => globalThis.uwscan.counts().count === n, total), `${total} points on the page`, 20_000);
    await until(() => second.positions.length === 3 * total, `${total} points at the second client`, 20_000);
    const mine = await page.evaluate(() => ({ positions: [...globalThis.uwscan.points().positions], ...globalThis.uwscan.counts() }));
    assert.equal(mine.missed, 0);
    const apart = worst(mine.positions, second.positions);
    assert.ok(apart <= 1.0002 * (mine.step + second.step) / 2, `page and second client are ${apart} mm apart, steps ${mine.step} and ${second.step} mm`);
    const name = await until(async () => (await readdir(out).catch(() => [])).find((file) => /^scan-0001.*\.ply$/.test(file)), "a cloud in a file", 30_000);
    assert.ok((await readdir(out)).includes("scan-0001.mcap"));
    // The file is made anew from the recording, by the slower method and with the sweep as a whole: the same surface, not the same points.
    const file = readPly(await readFile(join(out, name)));
    assert.ok(file.count > 0.8 * total && file.count < 1.25 * total, `${file.count} points in the file, ${total} on the page`);
    const away = nearest(file.positions, mine.positions);
    const [median, most] = [away[away.length >> 1], away[Math.floor(0.9 * away.length)]];
    process.stdout.write(`# ${total} points; page and second client ${apart.toExponential(1)} mm apart at worst, steps ${mine.step.toExponential(1)} and `
      + `${second.step.toExponential(1)} mm; from the file's ${file.count} points to the page's ${median.toFixed(3)} mm in the median, 90 % below ${most.toFixed(3)} mm\n`);
    assert.ok(median < SURFACE_MM, `${median} mm`);
    assert.deepEqual(page.faults, []);
    second.socket.close();
    await page.context().close();
  } finally {
    await program.stop();
  }
});

test("laser off ends the scan at once", { timeout: 300_000 }, async () => {
  await mkdir(join(folder, "off"));
  const program = await serve(["serve", "--config", vehicle, "-o", join(folder, "off")]);
  try {
    const page = await open(browser, program.url);
    await state(page, "idle");
    await page.click("#start");
    await state(page, "scanning");
    await frames(page, 3);
    // In the page, from the press until the page shows it; the machine may be busy with other things.
    const took = await page.evaluate(() => new Promise((resolve) => {
      const began = performance.now();
      document.getElementById("laser-off").click();
      const timer = setInterval(() => {
        if (globalThis.uwscan.state().laser !== "off") return;
        clearInterval(timer);
        resolve(performance.now() - began);
      }, 2);
    }));
    process.stdout.write(`# laser off shown ${took.toFixed(0)} ms after the press\n`);
    assert.ok(took < 1000, `${took} ms`);
    await state(page, ["finished", "failed", "idle"]);
    assert.deepEqual(page.faults, []);
    await page.context().close();
  } finally {
    await program.stop();
  }
});

test("the recording is replayed: pause, seek, play, with its points", { timeout: 300_000 }, async () => {
  const program = await serve(["serve", join(folder, "scans/scan-0001.mcap")]);
  try {
    const page = await open(browser, program.url);
    await state(page, ["replaying", "paused"]);
    assert.equal(await page.isVisible("#controls"), false);
    assert.deepEqual(await page.locator("#capture option").allInnerTexts(), ["scan-0001.mcap"]);
    await page.click("#play");
    await state(page, "paused");
    // The demo's first images pass the cover by.
    await page.locator("#seek").fill("25");
    await frameAt(page, 26);
    await until(() => page.evaluate(() => { const [s, c] = [globalThis.uwscan.state(), globalThis.uwscan.counts()]; return s.points > 0 && c.count === s.points; }), "the points up to there", 20_000);
    await page.keyboard.press(".");
    await frameAt(page, 27);
    await page.selectOption("#speed", "10");
    await page.click("#play");
    await until(() => page.evaluate(() => globalThis.uwscan.state().frames > 30), "more images", 20_000);
    if (process.env.UWSCAN_PICTURES) await page.screenshot({ path: join(process.env.UWSCAN_PICTURES, "program-replay.png") });
    assert.deepEqual(page.faults, []);
    await page.context().close();
  } finally {
    await program.stop();
  }
});

test("over https the page finds its socket by itself", { timeout: 120_000 }, async (context) => {
  const [cert, key] = ["cert.pem", "key.pem"].map((name) => join(folder, name));
  try {
    await run("openssl", ["req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "2", "-keyout", key, "-out", cert,
      "-subj", "/CN=vehicle", "-addext", "subjectAltName=IP:127.0.0.1"]);
  } catch (error) {
    if (error.code !== "ENOENT") throw error;
    context.skip("no openssl to make a certificate with");
    return;
  }
  const program = await serve(["serve", join(folder, "scans/scan-0001.mcap"), "--tls-cert", cert, "--tls-key", key]);
  try {
    assert.match(program.url, /^https:/);
    const page = await open(browser, program.url, { ignoreHTTPSErrors: true });
    await state(page, ["replaying", "paused"]);
    await page.click("#play");
    await state(page, "paused");
    await page.locator("#seek").fill("25");
    await frameAt(page, 26);
    assert.deepEqual(page.faults, []);
    await page.context().close();
  } finally {
    await program.stop();
  }
});
