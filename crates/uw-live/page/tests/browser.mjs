// Chromium for the tests, without a window, and what was wrong on a page.
import { accessSync, constants } from "node:fs";
import { delimiter, join } from "node:path";
import { createRequire } from "node:module";
import { chromium } from "playwright-core";

// Software rendering, so that it is the same on machines without a GPU.
const FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"];

/** The browser's path: UWSCAN_CHROMIUM, or the first found on PATH; `null` without one. */
export function findChromium() {
  if (process.env.UWSCAN_CHROMIUM) return process.env.UWSCAN_CHROMIUM;
  for (const name of ["chromium", "chromium-browser", "google-chrome"]) {
    for (const folder of (process.env.PATH ?? "").split(delimiter)) {
      try {
        accessSync(join(folder, name), constants.X_OK);
        return join(folder, name);
      } catch { /* not there */ }
    }
  }
  return null;
}

export const launch = () => chromium.launch({ executablePath: findChromium(), args: FLAGS });

/** A page that notes each fault: what the console says in anger, what it asks of others, what breaks the content policy. */
export async function open(browser, url, { faults = [], allow = [], ...options } = {}) {
  const context = await browser.newContext({ viewport: { width: 1366, height: 820 }, ...options });
  const page = await context.newPage();
  const fault = (text) => { if (!allow.some((pattern) => pattern.test(text))) faults.push(text); };
  page.on("console", (m) => { if (["error", "warning"].includes(m.type())) fault(`console: ${m.text()}`); });
  page.on("pageerror", (error) => fault(`error: ${error}`));
  page.on("request", (request) => { if (!request.url().startsWith(url) && !/^(data|blob):/.test(request.url())) fault(`asks for ${request.url()}`); });
  await page.goto(url);
  return Object.assign(page, { faults });
}

/** Rules of WCAG 2.2 A and AA that the page breaks, as axe finds them. */
export async function axe(page) {
  // Run as a debugger would, past the content policy.
  const source = createRequire(import.meta.url).resolve("axe-core/axe.min.js");
  const { readFile } = await import("node:fs/promises");
  await page.evaluate(await readFile(source, "utf8"));
  const found = await page.evaluate(() => globalThis.axe.run(document, { runOnly: ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"] }));
  return found.violations.map((v) => `${v.id}: ${v.help}: ${v.nodes.map((n) => `${n.target.join(" ")} (${n.any.map((a) => a.message).join("; ")})`).join(" | ")}`);
}

/** Waits until `check` gives something true; that. */
export async function until(check, what, ms = 10_000) {
  const end = Date.now() + ms;
  for (;;) {
    const value = await check();
    if (value) return value;
    if (Date.now() > end) throw new Error(`not within ${ms} ms: ${what}`);
    await new Promise((resolve) => setTimeout(resolve, 50));
  }
}
