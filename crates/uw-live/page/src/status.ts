// How the scan stands, in letters and figures.
import { count, duration, laserWord, lost, minus, phaseWord, volts } from "./format.ts";
import type { State, Welcome } from "./protocol.ts";
import { element, mark, say } from "./surface.ts";

let range = { from: -10, to: 10 };

/** Takes the mirror's range and the kind of service from a welcome. */
export function showWelcome(welcome: Welcome): void {
  if (welcome.volts) range = { from: Math.min(welcome.volts.from, welcome.volts.to), to: Math.max(welcome.volts.from, welcome.volts.to) };
  const gauge = element("gauge");
  mark(gauge, "aria-valuemin", String(range.from));
  mark(gauge, "aria-valuemax", String(range.to));
  say(element("gauge-low"), volts(range.from));
  say(element("gauge-high"), volts(range.to));
  say(element("mode"), welcome.mode === "replay" ? "replay" : "live");
  say(element("version"), welcome.version ?? "");
  for (const id of ["laser", "people"]) element(id).hidden = welcome.mode === "replay";
}

export function showState(state: State, rights: Welcome["rights"]): void {
  const phase = element("phase");
  say(phase, phaseWord(state.phase));
  mark(phase, "data-phase", state.phase);
  const laser = element("laser");
  say(laser, laserWord(state.laser));
  mark(laser, "data-laser", state.laser);
  say(element("people"), people(state, rights));
  progress(state);
  voltage(state.voltage_v);
  say(element("frames"), state.planned ? `${count(state.frames)} of ${count(state.planned)}` : count(state.frames));
  say(element("rate"), state.rate_hz === null || state.rate_hz === undefined ? "–" : `${state.rate_hz.toFixed(1)}\u202f/s`);
  say(element("points"), count(state.points));
  say(element("elapsed"), state.elapsed_s === null || state.elapsed_s === undefined ? "–" : duration(state.elapsed_s));
  const gone = lost(state.lost);
  say(element("lost"), gone.text);
  mark(element("lost-tile"), "data-lost", gone.total ? "some" : "none");
  say(element("recording"), state.recording ?? "");
  const ending = element("ending");
  const over = state.phase === "finished" || state.phase === "failed";
  ending.hidden = !over;
  mark(ending, "class", `banner ${state.phase === "failed" ? "error" : gone.total || state.ended ? "warning" : "done"}`);
  if (over) say(element("ending-text"), endingWords(state, gone));
}

/** What came out of a scan that is over. */
export function endingWords(state: State, gone = lost(state.lost)): string {
  const got = `${count(state.frames)}${state.planned ? ` of ${count(state.planned)}` : ""} images, ${count(state.points)} points`;
  const where = state.recording ? `, recorded in ${state.recording}` : "";
  const why = state.ended ? ` ${sentence(state.ended)}` : "";
  const without = gone.total ? ` Lost: ${gone.text}.` : "";
  return `${state.phase === "failed" ? "The scan failed." : state.ended ? "The scan was ended early." : "The scan is finished."}${why} ${got}${where}.${without}`;
}

function sentence(text: string): string {
  const trimmed = text.trim();
  return `${trimmed.charAt(0).toUpperCase()}${trimmed.slice(1)}${/[.!?]$/.test(trimmed) ? "" : "."}`;
}

function people(state: State, rights: Welcome["rights"]): string {
  const others = state.viewers === 1 ? "1 page open" : `${state.viewers ?? 0} pages open`;
  const who = state.you_control ? "You control" : state.controller ? `${state.controller} controls` : rights === "control" ? "Nobody controls" : "You watch";
  return `${who} · ${others}`;
}

function progress(state: State): void {
  const bar = element<HTMLProgressElement>("progress");
  const share = state.planned ? Math.min(1, state.frames / state.planned) : state.phase === "finished" ? 1 : null;
  if (share !== null) bar.value = share;
  else if (state.phase === "scanning") bar.removeAttribute("value");
  else bar.value = 0;
  const left = state.left_s !== null && state.left_s !== undefined && (state.phase === "scanning" || state.phase === "paused")
    ? `, ${duration(state.left_s)} left${state.phase === "paused" ? " once it goes on" : ""}` : "";
  const text = share !== null && (state.frames > 0 || state.phase !== "idle") ? `${Math.round(100 * share)}\u202f%${left}` : state.phase === "scanning" ? "Runs until it is stopped" : "Nothing yet";
  say(element("progress-text"), text);
  mark(bar, "aria-valuetext", text);
}

function voltage(v: number | null): void {
  const there = v !== null && v !== undefined && Number.isFinite(v);
  say(element("volts-text"), `Mirror ${there ? volts(v) : "–"}`);
  const at = element("gauge-mark");
  at.hidden = !there;
  if (!there) return;
  const share = Math.max(0, Math.min(1, (v - range.from) / (range.to - range.from || 1)));
  at.style.left = `${(100 * share).toFixed(2)}%`;
  mark(element("gauge"), "aria-valuenow", v.toFixed(3));
  mark(element("gauge"), "aria-valuetext", minus(`${v.toFixed(3)} volts`));
}
