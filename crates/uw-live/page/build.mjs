// Builds the page into ../assets (or a folder given with --out); with --tests, the unit tests into out/tests instead.
// The same sources and the same package-lock.json give the same bytes: nothing of the machine or the hour goes in.
import { build } from "esbuild";
import { copyFile, mkdir, readdir, readFile, rm, writeFile } from "node:fs/promises";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

const here = dirname(fileURLToPath(import.meta.url));
const common = { bundle: true, format: "esm", target: "es2022", charset: "utf8", absWorkingDir: here, logLevel: "warning" };
const at = process.argv.indexOf("--out");

if (process.argv.includes("--tests")) {
  const names = (await readdir(join(here, "tests/unit"))).filter((name) => name.endsWith(".test.ts"));
  await rm(join(here, "out/tests"), { recursive: true, force: true });
  await build({
    ...common,
    entryPoints: names.map((name) => `tests/unit/${name}`),
    outdir: "out/tests",
    outExtension: { ".js": ".mjs" },
    platform: "node",
  });
} else {
  const out = at > 0 ? process.argv[at + 1] : join(here, "../assets");
  await mkdir(out, { recursive: true });
  await build({ ...common, entryPoints: ["src/main.ts"], outfile: join(out, "app.js"), minify: true, legalComments: "none" });
  await build({ ...common, entryPoints: ["src/style.css"], outfile: join(out, "style.css"), minify: true });
  for (const name of ["index.html", "icon.svg"]) await copyFile(join(here, "src", name), join(out, name));
  const three = JSON.parse(await readFile(join(here, "node_modules/three/package.json"), "utf8"));
  const licence = await readFile(join(here, "node_modules/three/LICENSE"), "utf8");
  await writeFile(join(out, "licences.txt"), `app.js contains three.js ${three.version} (https://threejs.org), under this licence:\n\n${licence.trim()}\n`);
}
