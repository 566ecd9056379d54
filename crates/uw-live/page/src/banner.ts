// How the link stands and how old the view is, in plain words.
import type { Connection, Link } from "./connection.ts";
import { age, duration } from "./format.ts";
import type { State, Welcome } from "./protocol.ts";
import { element, mark, say } from "./surface.ts";

/** A view older than this is said to be old, ms. */
export const OLD_MS = 2000;
const AT_WORK = new Set(["starting", "scanning", "stopping"]);

/** What the banner says of a link, or `null` where there is nothing to say. Without figures that change: those are in `ageWords`. */
export function linkWords(link: Link, welcome: Welcome | null, state: State | null): string | null {
  switch (link.kind) {
    case "connecting":
    case "live":
      return null;
    case "token":
      return "The program wants a token before it shows anything.";
    case "refused":
      return link.why;
    case "down": {
      if (!welcome) return `${link.why ?? "The program can't be reached."} This page goes on trying.`;
      const over = state?.phase === "finished" || state?.phase === "failed";
      if (welcome.mode === "scan" && over) return "The scan is over, and the program has ended with it. What is seen here stays.";
      const rest = welcome.mode === "replay" ? "" : state && (state.phase === "scanning" || state.phase === "paused" || state.phase === "starting")
        ? " The scan goes on without this page; the laser may be on." : "";
      return `The link is down${link.why ? `: ${link.why.charAt(0).toLowerCase()}${link.why.slice(1)}` : "."}${rest} This page comes back by itself.`;
    }
  }
}

/** How long ago, and when the next attempt comes. */
export function ageWords(link: Link, viewAge: number | null, now: number): string {
  if (link.kind !== "down") return "";
  const since = `Down for ${duration((now - link.since) / 1000)}.`;
  const old = viewAge === null ? "" : ` The view is ${duration(viewAge / 1000)} old.`;
  const wait = Math.ceil((link.retryAt - now) / 1000);
  return `${since}${old}${wait > 0 ? ` Next attempt in ${wait}\u202fs.` : " Trying now."}`;
}

/** Brings link and age onto the page; called on each change and a few times a second. */
export function showLink(connection: Connection, welcome: Welcome | null, state: State | null): void {
  const { link } = connection;
  const viewAge = connection.age();
  const text = linkWords(link, welcome, state);
  const banner = element("banner");
  banner.hidden = text === null;
  say(element("banner-text"), text ?? "");
  say(element("banner-age"), ageWords(link, viewAge, Date.now()));
  element("retry").hidden = link.kind === "refused" || link.kind === "token";
  const word = { connecting: "Connecting", live: "Connected", down: "Link down", token: "Token wanted", refused: "Refused" }[link.kind];
  say(element("link-word"), word);
  const moving = state !== null && AT_WORK.has(state.phase);
  const old = viewAge !== null && (link.kind === "down" || (moving && viewAge > OLD_MS));
  say(element("link-age"), viewAge !== null && (moving || link.kind === "down") ? `${age(viewAge)} old` : "");
  mark(element("link"), "data-link", link.kind === "live" && old ? "old" : link.kind);
  mark(document.body, "data-stale", old ? "yes" : "no");
}
