// A synthetic scan for the mock: a sheet swept over a ball and a step on a rippled floor, 0.6 m from the camera.
import { encodeGrey } from "./jpeg.mjs";

export const WIDTH = 768, HEIGHT = 576, FRAMES = 101;
export const VOLTS = { from: -2, to: 2 };
const FOCAL = 900, SMALL = 2;

function depth(x, y) {
  const floor = 640 + 5 * Math.sin(x / 18) * Math.cos(y / 23) + 0.05 * x;
  const r2 = (x + 30) ** 2 + (y - 8) ** 2;
  const ball = r2 < 60 ** 2 ? 620 - Math.sqrt(60 ** 2 - r2) : Infinity;
  const step = x > 60 && x < 130 && Math.abs(y + 20) < 50 ? 600 - 0.1 * (y + 20) : Infinity;
  return Math.min(floor, ball, step);
}

/** A number that looks random and is the same each time, 0 to 1. */
const noise = (a, b) => { const s = Math.sin(a * 127.1 + b * 311.7) * 43758.5453; return s - Math.floor(s); };

export const voltage = (i) => VOLTS.from + ((VOLTS.to - VOLTS.from) * i) / (FRAMES - 1);

/** Frame `i`: stripe (px a row, NaN where none), points (n × 3 mm), brightness, signal in 64 parts. */
export function frame(i) {
  const sheet = -170 + (340 * i) / (FRAMES - 1);
  const stripe = new Float64Array(HEIGHT).fill(NaN);
  const points = [], brightness = [];
  const parts = Array.from({ length: 64 }, () => []);
  let found = 0;
  for (let v = 0; v < HEIGHT; v++) {
    // Shade from a cable, and a murky corner.
    if ((v > 250 && v < 266) || noise(v, i) < 0.012 + (v > 500 ? 0.25 : 0)) continue;
    let z = 620;
    for (let k = 0; k < 12; k++) z = 0.5 * z + 0.5 * depth(sheet + 0.25 * (640 - z), ((v - HEIGHT / 2) * z) / FOCAL);
    const x = sheet + 0.25 * (640 - z) + 0.05 * (noise(i, v + 9) - 0.5);
    const u = (x * FOCAL) / z + WIDTH / 2;
    if (u < 1 || u > WIDTH - 2) continue;
    const level = 60 + 130 * Math.exp(-(((v - HEIGHT / 2) / 300) ** 2)) + 25 * noise(v >> 2, 3);
    stripe[v] = u;
    points.push(x, ((v - HEIGHT / 2) * z) / FOCAL, z + 0.06 * (noise(v, i + 5) - 0.5));
    brightness.push(Math.min(255, Math.round(level)));
    parts[Math.floor((64 * v) / HEIGHT)].push([level, (v > 500 ? 0.35 : 0.04) + 4 / level]);
    found++;
  }
  const median = (list, k) => (list.length ? list.map((p) => p[k]).sort((a, b) => a - b)[list.length >> 1] : null);
  return {
    stripe, points: Float64Array.from(points), brightness: Uint8Array.from(brightness),
    signal: { frame: i, found: found / HEIGHT, amplitude: parts.map((p) => median(p, 0)), sigma_px: parts.map((p) => median(p, 1)) },
  };
}

/** The camera's image of a frame, at half size. */
export function jpeg({ stripe }, quality = 60) {
  const [w, h] = [WIDTH / SMALL, HEIGHT / SMALL];
  const pixels = new Uint8Array(w * h);
  for (let y = 0; y < h; y++) {
    const at = stripe[y * SMALL] / SMALL;
    for (let x = 0; x < w; x++) {
      const water = 14 + 22 * Math.exp(-(((x - w / 2) / 140) ** 2) - ((y - h / 2) / 120) ** 2) + 5 * noise(x, y);
      const line = Number.isNaN(at) ? 0 : 190 * Math.exp(-(((x - at) / 1.6) ** 2) / 2) + 22 * Math.exp(-Math.abs(x - at) / 14);
      pixels[y * w + x] = Math.min(255, water + line);
    }
  }
  return encodeGrey(w, h, pixels, quality);
}

const known = new Map();
/** Frames, made once. */
export function cached(i) {
  if (!known.has(i)) {
    const made = frame(i);
    known.set(i, { ...made, jpeg: jpeg(made) });
  }
  return known.get(i);
}
