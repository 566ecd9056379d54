// Replay of recordings: which, where, how fast.
import type { Connection } from "./connection.ts";
import { writing } from "./controls.ts";
import { count } from "./format.ts";
import type { Log } from "./log.ts";
import type { Timeline } from "./protocol.ts";
import { element, mark, say } from "./surface.ts";

/** While the slider is dragged, the server is asked no more often. */
const SEEK_MS = 150;

export class Replay {
  private readonly slider = element<HTMLInputElement>("seek");
  private readonly button = element<HTMLButtonElement>("play");
  private readonly chooser = element<HTMLSelectElement>("capture");
  private readonly speed = element<HTMLSelectElement>("speed");
  private line: Timeline | null = null;
  private held = false;
  private timer: ReturnType<typeof setTimeout> | null = null;
  private on = false;

  constructor(private readonly connection: Connection, private readonly log: Log, private readonly keysOn: () => boolean) {
    this.button.addEventListener("click", () => this.ask({ do: this.line?.playing ? "pause" : "play" }));
    element("step-back").addEventListener("click", () => this.step(-1));
    element("step-on").addEventListener("click", () => this.step(1));
    this.slider.addEventListener("input", () => {
      this.held = true;
      this.show();
      this.timer ??= setTimeout(() => this.seek(), SEEK_MS);
    });
    this.slider.addEventListener("change", () => {
      if (this.timer) clearTimeout(this.timer);
      this.seek();
      this.held = false;
    });
    this.speed.addEventListener("change", () => this.ask({ do: "rate", rate: Number(this.speed.value) }));
    this.chooser.addEventListener("change", () => this.ask({ do: "open", capture: this.chooser.value }));
    document.addEventListener("keydown", (event) => this.key(event));
  }

  mode(replay: boolean): void {
    this.on = replay;
    element("replay").hidden = !replay;
  }

  captures(names: string[]): void {
    const now = [...this.chooser.options].map((option) => option.value);
    if (now.length === names.length && names.every((name, i) => name === now[i])) return;
    this.chooser.replaceChildren(...names.map((name) => new Option(name, name)));
  }

  update(line: Timeline): void {
    this.line = line;
    if (line.capture && this.chooser.value !== line.capture) this.chooser.value = line.capture;
    this.slider.max = String(Math.max(0, line.frames - 1));
    if (!this.held) this.slider.value = String(line.at_frame);
    const rate = [...this.speed.options].find((option) => Number(option.value) === line.rate);
    if (rate && document.activeElement !== this.speed) this.speed.value = rate.value;
    this.show();
  }

  private show(): void {
    const { line } = this;
    if (!line) return;
    say(this.button, line.playing ? "Pause" : "Play");
    const at = Number(this.slider.value);
    const seconds = Math.max(0, (line.end_ns - line.start_ns) / 1e9);
    const into = line.frames > 1 ? (seconds * at) / (line.frames - 1) : 0;
    const text = `Image ${count(at + 1)} of ${count(line.frames)} · ${clock(into)} of ${clock(seconds)}`;
    say(element("seek-text"), text);
    mark(this.slider, "aria-valuetext", text);
  }

  private step(by: number): void {
    if (!this.line) return;
    const at = Math.max(0, Math.min(this.line.frames - 1, Number(this.slider.value) + by));
    this.slider.value = String(at);
    this.show();
    if (this.line.playing) this.ask({ do: "pause" });
    this.seek();
  }

  private seek(): void {
    this.timer = null;
    this.ask({ do: "seek", frame: Number(this.slider.value) });
  }

  private ask(message: object): void {
    void this.connection.ask({ type: "replay", ...message }).then((answer) => {
      if (!answer.ok) this.log.own("warning", `The replay did not follow: ${answer.error ?? "no reason was given"}`);
    });
  }

  private key(event: KeyboardEvent): void {
    if (!this.on || !this.keysOn() || event.ctrlKey || event.metaKey || event.altKey || writing(event.target) || document.querySelector("dialog[open]")) return;
    if (event.key.toLowerCase() === "k" && !event.repeat) this.button.click();
    else if (event.key === ",") this.step(-1);
    else if (event.key === ".") this.step(1);
    else return;
    event.preventDefault();
  }
}

function clock(seconds: number): string {
  const whole = Math.floor(seconds / 60);
  return `${whole}:${(seconds - 60 * whole).toFixed(1).padStart(4, "0")}`;
}
