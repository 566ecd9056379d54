// Pictures of the page in its states, to be looked at: `npm run pictures -- FOLDER [PART-OF-A-NAME]`.
import { mkdir } from "node:fs/promises";
import { join } from "node:path";
import { axe, launch, open, until } from "./browser.mjs";
import { Mock } from "./mock.mjs";

const folder = process.argv[2] ?? "out/pictures";
await mkdir(folder, { recursive: true });
const browser = await launch();
const sizes = { desktop: { width: 1440, height: 860 }, tablet: { width: 820, height: 1180 }, phone: { width: 390, height: 844 } };
const phase = (page, name) => until(() => page.evaluate((p) => globalThis.uwscan.state()?.phase === p, name), name, 20_000);
const faults = [];

const wanted = process.argv[3];
async function shot(name, { mode = "station", size = "desktop", scheme = "light", tokens = null, act = async () => {}, full = false, hz = 25 } = {}) {
  if (wanted && !name.includes(wanted)) return;
  const mock = new Mock({ mode, tokens, hz });
  const url = await mock.listen();
  const page = await open(browser, url, { viewport: sizes[size], colorScheme: scheme, hasTouch: size !== "desktop", deviceScaleFactor: size === "phone" ? 2 : 1 });
  try {
    await page.waitForTimeout(300);
    await act(page, mock);
    await page.waitForTimeout(500);
    await page.screenshot({ path: join(folder, `${name}.png`), fullPage: full });
    const link = /WebSocket connection to .* failed/;
    for (const text of [...page.faults.filter((t) => !link.test(t)), ...(await axe(page))]) faults.push(`${name}: ${text}`);
  } catch (error) {
    faults.push(`${name}: ${error}`);
  }
  await page.context().close();
  await mock.close();
}
const scan = (wait) => async (page, mock) => {
  mock.note("info", "The camera runs at 10 images a second, 2.0 ms exposure");
  await page.click("#start");
  await phase(page, "scanning");
  await page.waitForTimeout(wait);
  mock.state.lost = { camera_dropped: 2 };
  mock.note("warning", "The stripe is weak in the lower part of the image: turbid water, or the laser's window is dirty.");
};
await shot("desktop-light-scanning", { act: scan(3300) });
await shot("desktop-dark-scanning", { scheme: "dark", act: scan(3300) });
await shot("desktop-idle", {});
await shot("desktop-paused", { act: async (page, mock) => { await scan(2500)(page, mock); await page.click("#pause"); await phase(page, "paused"); } });
await shot("desktop-finished-brightness", { hz: 60, act: async (page, mock) => { await scan(100)(page, mock); await phase(page, "finished"); await page.check("[name=colour][value=brightness]"); } });
await shot("desktop-link-lost", { act: async (page, mock) => { await scan(2500)(page, mock); mock.cut(); await page.waitForTimeout(3000); } });
await shot("desktop-failed", { act: async (page, mock) => { await scan(1500)(page, mock); Object.assign(mock.state, { phase: "failed", laser: "unknown", ended: "the camera has not answered for 2 s; check its cable and its power" }); mock.note("error", "The camera has not answered for 2 s. Check its cable and its power."); } });
await shot("desktop-replay-dark", { mode: "replay", scheme: "dark", act: async (page) => { await page.click("#play"); await page.waitForTimeout(2000); } });
await shot("desktop-token", { tokens: { view: "v", control: "c" }, act: async (page) => { await page.fill("#token", "wrong"); await page.keyboard.press("Enter"); } });
await shot("desktop-settings", { act: async (page) => { await page.click("#open-settings"); await page.click("summary"); } });
await shot("tablet-scanning", { size: "tablet", act: scan(3300) });
await shot("phone-scanning", { size: "phone", act: scan(3300) });
await shot("phone-scanning-full", { size: "phone", act: scan(3300), full: true });
await shot("phone-dark-link-lost", { size: "phone", scheme: "dark", act: async (page, mock) => { await scan(2500)(page, mock); mock.cut(); await page.waitForTimeout(2000); } });
await shot("phone-replay", { size: "phone", mode: "replay", act: async (page) => { await page.click("#play"); await page.waitForTimeout(1500); } });
await browser.close();
process.stdout.write(faults.length ? `${faults.join("\n")}\n` : "no faults\n");
