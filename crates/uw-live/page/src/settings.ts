// What a person sets, kept by the browser; the token only as long as the tab is open.
import type { Unit } from "./format.ts";

export interface Settings {
  client: string;
  bandwidth_kbps: number | null;
  image: boolean;
  points: boolean;
  /** Share of the points wished for; `null`: as the link allows. */
  density: number | null;
  cap: number;
  unit: Unit;
  keys: boolean;
  theme: "auto" | "light" | "dark";
  colour: "depth" | "brightness";
  pointSize: number;
  stripe: boolean;
}

export const DEFAULTS: Settings = {
  client: "", bandwidth_kbps: null, image: true, points: true, density: null, cap: 4_194_304, unit: "mm", keys: true, theme: "auto",
  colour: "depth", pointSize: 2, stripe: true,
};
const NAME = "uwscan.live.settings";
const TOKEN = "uwscan.live.token";

/** The settings, with those in place of the defaults that were kept and are of the right kind. */
export function parse(text: string | null): Settings {
  const settings: Record<string, unknown> = { ...DEFAULTS };
  let kept: unknown;
  try {
    kept = JSON.parse(text ?? "{}");
  } catch {
    kept = {};
  }
  for (const [key, value] of Object.entries(DEFAULTS)) {
    const other = (kept as Record<string, unknown> | null)?.[key];
    if (other === undefined) continue;
    const fits = value === null ? other === null || typeof other === "number" : typeof other === typeof value;
    if (fits) settings[key] = other;
  }
  return settings as unknown as Settings;
}

// A browser may refuse to keep anything: the page works without.
function attempt<T>(run: () => T): T | null {
  try {
    return run();
  } catch {
    return null;
  }
}

export const load = (): Settings => parse(attempt(() => localStorage.getItem(NAME)));
export const save = (settings: Settings): void => void attempt(() => localStorage.setItem(NAME, JSON.stringify(settings)));
export const token = (): string | null => attempt(() => sessionStorage.getItem(TOKEN));
export function keepToken(value: string | null): void {
  attempt(() => (value === null ? sessionStorage.removeItem(TOKEN) : sessionStorage.setItem(TOKEN, value)));
}
