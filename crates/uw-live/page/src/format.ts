// Numbers and states in plain words.
import type { Laser, Phase, State } from "./protocol.ts";

export type Unit = "mm" | "m" | "in";
const PER_MM: Record<Unit, number> = { mm: 1, m: 1e-3, in: 1 / 25.4 };

/** A length with its unit, to about the resolution `step` (mm). */
export function length(mm: number, unit: Unit, step = 0.1): string {
  return `${bare(mm, unit, step)}\u202f${unit}`;
}

/** The same without the unit. */
export function bare(mm: number, unit: Unit, step = 0.1): string {
  const digits = Math.max(0, Math.min(6, Math.ceil(-Math.log10(step * PER_MM[unit]) - 1e-9)));
  return minus((mm * PER_MM[unit]).toFixed(digits));
}

/** mm of one of the unit. */
export function mmPer(unit: Unit): number {
  return 1 / PER_MM[unit];
}

/** Thousands apart by narrow spaces. */
export function count(n: number): string {
  return minus(String(Math.round(n)).replace(/\B(?=(\d{3})+(?!\d))/g, "\u202f"));
}

/** Seconds as 7 s, 3 min 20 s, 2 h 5 min. */
export function duration(seconds: number): string {
  const s = Math.max(0, Math.round(seconds));
  if (s < 60) return `${s}\u202fs`;
  if (s < 3600) return `${Math.floor(s / 60)}\u202fmin${s % 60 ? ` ${s % 60}\u202fs` : ""}`;
  return `${Math.floor(s / 3600)}\u202fh${Math.floor((s % 3600) / 60) ? ` ${Math.floor((s % 3600) / 60)}\u202fmin` : ""}`;
}

/** An age: with a tenth below ten seconds. */
export function age(ms: number): string {
  return ms < 9950 ? `${(ms / 1000).toFixed(1)}\u202fs` : duration(ms / 1000);
}

/** Volts with their sign. */
export function volts(v: number): string {
  return `${v > 0 ? "+" : ""}${minus(v.toFixed(3))}\u202fV`;
}

export function minus(text: string): string {
  return text.replace(/^-/, "\u2212").replace(/^\u2212(0(\.0*)?)$/, "$1");
}

const PHASES: Record<Phase, string> = {
  idle: "Ready", starting: "Starting", scanning: "Scanning", paused: "Paused", stopping: "Stopping", finished: "Finished", failed: "Failed",
  replaying: "Replay",
};
export const phaseWord = (phase: Phase): string => PHASES[phase] ?? phase;

const LASERS: Record<Laser, string> = { on: "Laser on", off: "Laser off", unknown: "Laser unknown" };
export const laserWord = (laser: Laser): string => LASERS[laser] ?? LASERS.unknown;

/** A reason's name as the program has it, in words. */
export const words = (name: string): string => name.replace(/[_-]+/g, " ");

/** What was lost and why: "3: 2 camera dropped, 1 not reached". */
export function lost(reasons: State["lost"] | undefined): { total: number; text: string } {
  const some = Object.entries(reasons ?? {}).filter(([, n]) => n > 0).sort((a, b) => b[1] - a[1]);
  const total = some.reduce((sum, [, n]) => sum + n, 0);
  const text = some.length === 1 ? `${count(total)}, ${words(some[0]![0])}` : `${count(total)}: ${some.map(([why, n]) => `${count(n)} ${words(why)}`).join(", ")}`;
  return { total, text: total ? text : "none" };
}

/** Round steps for the lines of a scale: 1, 2 or 5 times a power of ten, at most `most` of them. */
export function niceStep(span: number, most: number): number {
  const least = span / Math.max(1, most);
  if (!(least > 0) || !Number.isFinite(least)) return 1;
  const ten = 10 ** Math.floor(Math.log10(least));
  return [1, 2, 5, 10].map((n) => n * ten).find((step) => step >= least * (1 - 1e-9)) ?? 10 * ten;
}

/** The middle value of those that are there. */
export function median(values: (number | null)[]): number | null {
  const there = values.filter((v): v is number => v !== null && Number.isFinite(v)).sort((a, b) => a - b);
  if (!there.length) return null;
  const half = there.length >> 1;
  return there.length % 2 ? there[half]! : (there[half - 1]! + there[half]!) / 2;
}
