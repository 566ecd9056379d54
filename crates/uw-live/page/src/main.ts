// The live page: what comes in goes to the views, what is pressed goes out.
import { showLink } from "./banner.ts";
import { CloudView } from "./cloud-view.ts";
import { cividis, cividisOnDark, grey, ramp } from "./colour.ts";
import { Connection, type Link } from "./connection.ts";
import { Controls, titleOf } from "./controls.ts";
import { bindSettings, TokenDialogue } from "./dialogues.ts";
import { bare, count, length, niceStep, mmPer } from "./format.ts";
import { ImageView } from "./image-view.ts";
import { Log } from "./log.ts";
import { Points, type Extent } from "./points.ts";
import { ProfileView } from "./profile-view.ts";
import type { BinaryMessage, State, TextMessage, Welcome } from "./protocol.ts";
import { Replay } from "./replay.ts";
import { load, save, token, type Settings } from "./settings.ts";
import { showState, showWelcome } from "./status.ts";
import { element, mark, say } from "./surface.ts";

const settings = load();
const log = new Log();
const points = new Points(settings.cap);
const image = new ImageView((text) => log.own("warning", text));
const profile = new ProfileView();
const cloud = openCloud();
let welcome: Welcome | null = null;
let state: State | null = null;
let capTold = false;
const faults = new Set<string>();

const connection = new Connection(new URL("ws", location.href.replace(/^http/, "ws")).href, {
  hello: () => ({ token: token(), client: settings.client || "a browser", bandwidth_kbps: settings.bandwidth_kbps }),
  have: () => (points.epoch === null ? null : { epoch: points.epoch, points: points.next }),
  greet: () => [view(), { type: "captures" }],
  text: takeText,
  binary: takeBinary,
  link: takeLink,
  fault: (text) => {
    // Once each: a program that talks nonsense does so often.
    if (!faults.has(text)) log.own("warning", `The program sent what this page can't read: ${text}. They may be of different versions.`);
    faults.add(text);
  },
});
const dialogue = new TokenDialogue(() => connection.retry());
const controls = new Controls(connection, log, () => settings.keys, () => dialogue.ask(false));
const replay = new Replay(connection, log, () => settings.keys);

function takeText(message: TextMessage): void {
  switch (message.type) {
    case "welcome":
      welcome = message;
      dialogue.close();
      image.lines(message.across);
      profile.lines(message.across);
      replay.mode(message.mode === "replay");
      showWelcome(message);
      break;
    case "state":
      state = message;
      // The program was started anew: what is here is of a scan that it does not know.
      if (message.phase === "idle" && message.points === 0 && points.count > 0) empty();
      if (welcome) showState(message, welcome.rights);
      cloudNote();
      break;
    case "signal":
      image.measure(message);
      return;
    case "note":
      log.note(message);
      return;
    case "timeline":
      replay.update(message);
      return;
    case "captures":
      replay.captures(message.names);
      return;
    case "answer":
      return;
  }
  refresh();
}

function takeBinary(message: BinaryMessage): void {
  switch (message.kind) {
    case "image":
      image.show(message);
      return;
    case "profile":
      profile.show(message);
      cloud?.profile(message.points);
      return;
    case "points": {
      const { restarted, missed } = points.add(message);
      if (restarted) capTold = false;
      if (missed) log.own("warning", `${count(missed)} points did not reach this page. The recording has them.`);
      if (points.refused && !capTold) {
        capTold = true;
        log.own("warning", `This page keeps ${count(points.cap)} points at most: later ones are not shown here. The recording has them all; the settings can raise the limit.`);
      }
      cloudNote();
      cloud?.draw();
    }
  }
}

function takeLink(link: Link): void {
  if (link.kind === "token") dialogue.ask(link.wrong);
  if (link.kind === "refused") log.own("error", link.why);
  refresh();
}

function refresh(): void {
  showLink(connection, welcome, state);
  controls.update(welcome, state);
  document.title = titleOf(state, connection.link.kind === "live");
}

/** What this page wishes to be sent. A page that nobody sees wants no images. */
function view(): object {
  const wish = { type: "view", bandwidth_kbps: settings.bandwidth_kbps, image: settings.image && !document.hidden, points: settings.points };
  return settings.density === null ? wish : { ...wish, density: settings.density };
}

function empty(): void {
  points.clear();
  image.clear();
  profile.clear();
  cloud?.profile(null);
  cloud?.home();
}

function openCloud(): CloudView | null {
  try {
    return new CloudView(element<HTMLCanvasElement>("cloud"), points);
  } catch {
    say(element("cloud-empty"), "This browser has no WebGL 2: the cloud can't be shown. All else works.");
    for (const id of ["nearer", "farther", "reset"]) element<HTMLButtonElement>(id).disabled = true;
    return null;
  }
}

function cloudNote(): void {
  const total = Math.max(state?.points ?? 0, points.count);
  say(element("cloud-note"), total > points.count ? `${count(points.count)} of ${count(total)} points` : `${count(points.count)} points`);
  if (cloud) element("cloud-empty").hidden = points.count > 0;
}

/** Legend, size and ruler beside the cloud. */
function measures(extent: Extent | null, mmPerPixel: number): void {
  const [legend, ruler] = [element("legend"), element("ruler")];
  legend.hidden = ruler.hidden = !extent;
  if (!extent) return;
  const { unit } = settings;
  const depth = settings.colour === "depth";
  const [low, high] = [extent.low[2], extent.high[2]];
  say(element("legend-low"), depth ? `near ${bare(low, unit)}` : "dark");
  say(element("legend-high"), depth ? `${length(high, unit)} far` : "bright");
  mark(legend, "aria-label", depth ? `Colour by depth, from ${length(low, unit)} to ${length(high, unit)}` : "Colour by brightness, from dark to bright");
  const size = extent.high.map((high, k) => length(high - extent.low[k]!, unit, 1));
  mark(element("cloud"), "aria-label", `Cloud of ${points.count} points, ${size.join(" by ")}`);
  const per = mmPer(unit);
  const step = niceStep((120 * mmPerPixel) / per, 1) * per;
  const fits = step / mmPerPixel > 160 ? step / 2 : step;
  ruler.style.width = `${(fits / mmPerPixel).toFixed(1)}px`;
  say(ruler, length(fits, unit, Math.min(fits, 1 / mmPer(unit) === 1 ? 1 : fits)));
}

function dark(): boolean {
  return settings.theme === "dark" || (settings.theme === "auto" && matchMedia("(prefers-color-scheme: dark)").matches);
}

function legendBar(): void {
  const pen = element<HTMLCanvasElement>("legend-bar").getContext("2d");
  if (!pen) return;
  const colours = ramp(settings.colour === "depth" ? (share) => (dark() ? cividisOnDark : cividis)(1 - share) : grey);
  pen.putImageData(new ImageData(new Uint8ClampedArray(colours), 256, 1), 0, 0);
}

function apply(name: keyof Settings | null): void {
  if (settings.theme === "auto") delete document.documentElement.dataset["theme"];
  else document.documentElement.dataset["theme"] = settings.theme;
  points.cap = settings.cap;
  profile.unit = settings.unit;
  image.stripe = settings.stripe;
  if (cloud) {
    cloud.pointSize = settings.pointSize;
    cloud.colourBy(settings.colour, dark());
    mark(element("cloud"), "data-colour", settings.colour);
  }
  legendBar();
  image.draw();
  profile.draw();
  if (name === "client") connection.retry();
  else if (name && ["bandwidth_kbps", "image", "points", "density"].includes(name)) connection.send(view());
}

if (cloud) {
  cloud.onDraw = measures;
  element("nearer").addEventListener("click", () => cloud.zoom(0.8));
  element("farther").addEventListener("click", () => cloud.zoom(1.25));
  element("reset").addEventListener("click", () => cloud.home());
}
for (const radio of document.querySelectorAll<HTMLInputElement>("[name=colour]")) {
  radio.checked = radio.value === settings.colour;
  radio.addEventListener("change", () => {
    settings.colour = radio.value as Settings["colour"];
    save(settings);
    apply(null);
  });
}
const tick = element<HTMLInputElement>("stripe");
tick.checked = settings.stripe;
tick.addEventListener("change", () => {
  settings.stripe = tick.checked;
  save(settings);
  apply(null);
});
bindSettings(settings, apply, () => dialogue.ask(false));
element("retry").addEventListener("click", () => connection.retry());
addEventListener("online", () => { if (connection.link.kind === "down") connection.retry(); });
document.addEventListener("visibilitychange", () => connection.send(view()));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => apply(null));
setInterval(() => {
  showLink(connection, welcome, state);
  controls.tick();
}, 250);
apply(null);
connection.start();

// For tests, and for whoever wants to look: what is kept here, nothing that acts.
Object.defineProperty(globalThis, "uwscan", {
  value: Object.freeze({
    points: () => points.unpacked(),
    counts: () => ({ epoch: points.epoch, next: points.next, count: points.count, missed: points.missed, refused: points.refused, step: points.step() }),
    link: () => connection.link.kind,
    age: () => connection.age(),
    state: () => state,
  }),
});
