// The picture of the live page in README: a station of `uwscan demo`'s instrument most of the way through a scan.
//
//     node docs/images/live.mjs target/release/uwscan target/demo/vehicle.toml docs/images/live.png
import { spawn } from "node:child_process";
import { mkdtemp, rm } from "node:fs/promises";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { launch, open, until } from "../../crates/uw-live/page/tests/browser.mjs";

const [uwscan, vehicle, picture] = process.argv.slice(2);
const MOST_OF_IT = 78; // of the vehicle file's 101 images

const folder = await mkdtemp(join(tmpdir(), "uwscan-picture-"));
const station = spawn(uwscan, ["serve", "--config", vehicle, "-o", folder, "--listen", "127.0.0.1:0", "--foxglove", "off"]);
let said = "";
for (const stream of [station.stdout, station.stderr]) stream.on("data", (data) => { said += data; });
const browser = await launch();
try {
  const [url] = await until(() => /http:\/\/127\.0\.0\.1:\d+/.exec(said), "an address", 30_000);
  const page = await open(browser, `${url}/`, { viewport: { width: 1360, height: 800 } });
  await page.click("#start");
  await until(() => page.evaluate((n) => globalThis.uwscan.state().frames >= n, MOST_OF_IT), "images", 60_000);
  await page.screenshot({ path: picture });
} finally {
  await browser.close();
  station.kill("SIGINT");
  await new Promise((resolve) => station.on("exit", resolve));
  await rm(folder, { recursive: true, force: true });
}
