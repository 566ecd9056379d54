// Start, pause, stop, laser off. The last two are never taken away from whoever may control: not by a state that may be old, not by a question.
import type { Connection } from "./connection.ts";
import { phaseWord } from "./format.ts";
import type { Log } from "./log.ts";
import type { Action, State, Welcome } from "./protocol.ts";
import { element, mark, say } from "./surface.ts";

const NAMES: Record<Action, string> = {
  "take-control": "Take control", "release-control": "Give up control", start: "Start", pause: "Pause", resume: "Resume", stop: "Stop",
  "laser-off": "Laser off",
};

export class Controls {
  private readonly take = element<HTMLButtonElement>("take");
  private readonly start = element<HTMLButtonElement>("start");
  private readonly pause = element<HTMLButtonElement>("pause");
  private readonly stop = element<HTMLButtonElement>("stop");
  private readonly laser = element<HTMLButtonElement>("laser-off");
  private welcome: Welcome | null = null;
  private state: State | null = null;
  private said: string | null = null;
  private until = 0;

  constructor(private readonly connection: Connection, private readonly log: Log, private readonly keysOn: () => boolean, private readonly askToken: () => void) {
    this.take.addEventListener("click", () => {
      if (this.welcome?.rights === "view") this.askToken();
      else void this.run(this.state?.you_control ? "release-control" : "take-control");
    });
    this.start.addEventListener("click", () => void this.led("start"));
    this.pause.addEventListener("click", () => void this.led(this.state?.phase === "paused" ? "resume" : "pause"));
    this.stop.addEventListener("click", () => void this.run("stop"));
    this.laser.addEventListener("click", () => void this.run("laser-off"));
    document.addEventListener("keydown", (event) => this.key(event));
    this.show();
  }

  update(welcome: Welcome | null, state: State | null): void {
    [this.welcome, this.state] = [welcome, state];
    this.show();
  }

  /** Called now and then: what was said of a command goes after a while. */
  tick(): void {
    if (this.said && performance.now() > this.until) {
      this.said = null;
      this.show();
    }
  }

  private show(): void {
    const { welcome, state } = this;
    const live = this.connection.link.kind === "live";
    const may = welcome?.rights === "control";
    const replay = welcome?.mode === "replay";
    document.body.dataset["mode"] = welcome?.mode ?? "";
    element("controls").hidden = replay === true;
    const phase = state?.phase;
    const free = state ? state.you_control || state.controller === null : false;
    const paused = phase === "paused";
    say(this.take, welcome?.rights === "view" ? "Enter a token to control" : state?.you_control ? "Give up control" : "Take control");
    this.take.disabled = !live || (may && !free);
    this.start.disabled = !(live && may && free && welcome?.mode === "station" && (phase === "idle" || phase === "finished" || phase === "failed"));
    this.start.hidden = welcome?.mode === "scan";
    this.pause.disabled = !(live && may && free && (phase === "scanning" || paused));
    say(this.pause, paused ? "Resume" : "Pause");
    mark(this.pause, "class", paused ? "go" : "");
    // Also while the link is down, then they are sent first when it is back.
    this.stop.disabled = this.laser.disabled = welcome !== null && !may;
    say(element("control-note"), this.said ?? this.hint(live, may, free));
  }

  private hint(live: boolean, may: boolean, free: boolean): string {
    const waiting = this.connection.waiting();
    if (waiting.length) return `${waiting.map((action) => NAMES[action]).join(" and ")} will be sent as soon as the link is back.`;
    if (!this.welcome) return "";
    if (!live) return "The link is down. Stop and Laser off are sent when it is back.";
    if (!may) return "You may watch. To control, enter a token that allows it.";
    if (!free) return `${this.state?.controller ?? "Somebody else"} controls. You can stop the scan and turn the laser off.`;
    return "";
  }

  /** What needs the controller's place: takes it first where it is free. */
  private async led(action: Action): Promise<void> {
    if (this.state && !this.state.you_control && !(await this.run("take-control"))) return;
    await this.run(action);
  }

  private async run(action: Action): Promise<boolean> {
    const began = performance.now();
    const asked = this.connection.command(action);
    this.tell(this.connection.link.kind === "live" ? `${NAMES[action]}: asked…` : null);
    const answer = await asked;
    const took = performance.now() - began;
    if (answer.ok) this.tell(`${NAMES[action]}: done, answered in ${took < 1000 ? `${Math.round(took)} ms` : `${(took / 1000).toFixed(1)} s`}.`);
    else {
      this.tell(`${NAMES[action]} was not done.`);
      this.log.own(action === "laser-off" || action === "stop" ? "error" : "warning", `${NAMES[action]} was not done: ${answer.error ?? "no reason was given"}`);
    }
    return answer.ok;
  }

  private tell(text: string | null): void {
    this.said = text;
    this.until = performance.now() + 5000;
    this.show();
  }

  private key(event: KeyboardEvent): void {
    if (!this.keysOn() || this.welcome?.mode === "replay" || event.repeat || event.ctrlKey || event.metaKey || event.altKey || writing(event.target)) return;
    const button = ({ l: this.laser, x: this.stop, p: this.pause, s: this.start, c: this.take } as Record<string, HTMLButtonElement>)[event.key.toLowerCase()];
    if (!button || button.disabled || button.hidden) return;
    // In a dialogue only what is urgent.
    if (document.querySelector("dialog[open]") && button !== this.laser && button !== this.stop) return;
    event.preventDefault();
    button.click();
  }
}

/** Whether a key goes into a text or chooses from a list. */
export function writing(target: EventTarget | null): boolean {
  return target instanceof HTMLElement && (target.matches("input:not([type=checkbox], [type=radio], [type=range]), select, textarea") || target.isContentEditable);
}

/** The page's title: also seen where the page is not. */
export function titleOf(state: State | null, live: boolean): string {
  if (!live) return "Link down – uwscan live";
  if (!state) return "uwscan live";
  const share = state.planned && state.phase === "scanning" ? ` ${Math.floor((100 * state.frames) / state.planned)} %` : "";
  return `${phaseWord(state.phase)}${share} – uwscan live`;
}
