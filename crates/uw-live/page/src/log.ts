// Messages in plain words, the latest first; errors are also told at once and stay until they were seen.
import type { Level, Note } from "./protocol.ts";
import { element, say } from "./surface.ts";

const KEPT = 300;
const WORD: Record<Level, string> = { info: "", warning: "Warning", error: "Error" };
const SIGN: Record<Level, string> = { info: "i", warning: "!", error: "×" };

export class Log {
  private readonly list = element<HTMLOListElement>("log");
  private readonly seen = new Set<string>();
  private readonly counts = { warning: 0, error: 0 };

  constructor() {
    element("fault-close").addEventListener("click", () => { element("fault").hidden = true; });
  }

  /** A message of the program; one that came before, as after a reconnection, is not repeated. */
  note(note: Note): void {
    const key = `${note.stamp_ns} ${note.level} ${note.text}`;
    if (this.seen.has(key)) return;
    this.seen.add(key);
    this.write(note.level, note.text, note.stamp_ns ? note.stamp_ns / 1e6 : Date.now());
  }

  /** A message of the page itself. */
  own(level: Level, text: string): void {
    this.write(level, text, Date.now());
  }

  private write(level: Level, text: string, at: number): void {
    const item = document.createElement("li");
    item.className = level;
    const sign = document.createElement("span");
    sign.className = "sign";
    sign.setAttribute("aria-hidden", "true");
    sign.textContent = SIGN[level] ?? "i";
    const time = document.createElement("time");
    const when = new Date(at);
    time.dateTime = Number.isFinite(at) && Math.abs(at) < 8e15 ? when.toISOString() : "";
    time.textContent = time.dateTime ? when.toLocaleTimeString([], { hour12: false }) : "";
    const body = document.createElement("span");
    body.className = "text";
    if (WORD[level]) {
      const word = document.createElement("strong");
      word.textContent = `${WORD[level]}: `;
      body.append(word);
    }
    body.append(text);
    item.append(sign, time, body);
    this.list.prepend(item);
    while (this.list.children.length > KEPT) this.list.lastElementChild?.remove();
    if (level === "warning" || level === "error") this.counts[level]++;
    const { warning, error } = this.counts;
    say(element("log-note"), [error && `${error} error${error > 1 ? "s" : ""}`, warning && `${warning} warning${warning > 1 ? "s" : ""}`].filter(Boolean).join(", "));
    if (level === "error") {
      say(element("fault-text"), text);
      element("fault").hidden = false;
    }
  }
}
