// The latest profile: depth along the stripe.
import { bare, count, length, mmPer, niceStep, type Unit } from "./format.ts";
import type { ProfileMessage, Welcome } from "./protocol.ts";
import { element, mark, say, Surface, type Area } from "./surface.ts";

/** Least span of an axis, mm: below it noise would fill the view. */
const LEAST_MM = 4;

interface Span { low: number; high: number }

export class ProfileView {
  private readonly surface = new Surface(element<HTMLCanvasElement>("profile"), (area) => this.paint(area));
  private message: ProfileMessage | null = null;
  private along = 1;
  private x: Span | null = null;
  private z: Span | null = null;
  private described = 0;
  unit: Unit = "mm";

  lines(across: Welcome["across"]): void {
    this.along = across === "row" ? 1 : 0;
    this.x = null;
  }

  show(message: ProfileMessage): void {
    this.message = message;
    this.surface.draw();
    if (performance.now() - this.described < 3000) return;
    this.described = performance.now();
    const span = spanOf(message.points, 2);
    const text = span ? `, depth ${length(span.low, this.unit)} to ${length(span.high, this.unit)}` : "";
    mark(this.surface.canvas, "aria-label", `Profile of image ${message.frame}: ${message.points.length / 3} points${text}`);
  }

  clear(): void {
    this.message = this.x = this.z = null;
    this.draw();
  }

  draw(): void {
    this.surface.draw();
  }

  private paint({ pen, width, height, colour }: Area): void {
    const points = this.message?.points;
    element("profile-empty").hidden = Boolean(points?.length);
    if (!points?.length) {
      say(element("profile-note"), "");
      return;
    }
    this.x = settle(this.x, spanOf(points, this.along)!);
    this.z = settle(this.z, spanOf(points, 2)!);
    say(element("profile-note"), `${count(points.length / 3)} points, depth against ${this.along ? "y" : "x"}, ${this.unit}`);
    const box = { left: 58, top: 8, right: width - 12, bottom: height - 24 };
    const toX = (v: number) => box.left + ((v - this.x!.low) / (this.x!.high - this.x!.low)) * (box.right - box.left);
    // What is farther lies lower, as on the sea bed.
    const toY = (v: number) => box.top + ((v - this.z!.low) / (this.z!.high - this.z!.low)) * (box.bottom - box.top);
    pen.font = "12px system-ui, sans-serif";
    pen.lineWidth = 1;
    pen.strokeStyle = colour("line");
    pen.fillStyle = colour("faint");
    pen.textBaseline = "middle";
    pen.textAlign = "right";
    for (const [v, text] of ticks(this.z, Math.max(2, (box.bottom - box.top) / 34), this.unit)) {
      rule(pen, box.left, toY(v), box.right, toY(v));
      pen.fillText(text, box.left - 6, toY(v));
    }
    pen.textBaseline = "top";
    pen.textAlign = "center";
    for (const [v, text] of ticks(this.x, Math.max(2, (box.right - box.left) / 70), this.unit)) {
      rule(pen, toX(v), box.top, toX(v), box.bottom);
      pen.fillText(text, Math.min(toX(v), width - 16), box.bottom + 6);
    }
    pen.save();
    pen.beginPath();
    pen.rect(box.left, box.top - 3, box.right - box.left, box.bottom - box.top + 6);
    pen.clip();
    pen.fillStyle = colour("found");
    for (let i = 0; i < points.length; i += 3) pen.fillRect(toX(points[i + this.along]!) - 1, toY(points[i + 2]!) - 1, 2, 2);
    pen.restore();
  }
}

function rule(pen: CanvasRenderingContext2D, x1: number, y1: number, x2: number, y2: number): void {
  pen.beginPath();
  pen.moveTo(Math.round(x1) + 0.5, Math.round(y1) + 0.5);
  pen.lineTo(Math.round(x2) + 0.5, Math.round(y2) + 0.5);
  pen.stroke();
}

/** From the smallest to the largest of the points' numbers `k`. */
function spanOf(points: Float32Array, k: number): Span | null {
  let [low, high] = [Infinity, -Infinity];
  for (let i = k; i < points.length; i += 3) {
    const v = points[i]!;
    if (v < low) low = v;
    if (v > high) high = v;
  }
  return low <= high ? { low, high } : null;
}

/** An axis stays where it is as long as what is shown fits well: one that jumps with each image can't be read. */
export function settle(axis: Span | null, seen: Span): Span {
  const span = Math.max(LEAST_MM, seen.high - seen.low);
  const fits = axis && seen.low >= axis.low && seen.high <= axis.high && span > 0.35 * (axis.high - axis.low);
  if (fits) return axis;
  const middle = (seen.low + seen.high) / 2;
  const step = niceStep(span, 8);
  return { low: Math.floor((middle - 0.6 * span) / step) * step, high: Math.ceil((middle + 0.6 * span) / step) * step };
}

function ticks(span: Span, most: number, unit: Unit): [number, string][] {
  const per = mmPer(unit);
  const step = niceStep((span.high - span.low) / per, most) * per;
  const out: [number, string][] = [];
  for (let n = Math.ceil(span.low / step - 1e-9); n * step <= span.high * (1 + 1e-9); n++) out.push([n * step, bare(n * step, unit, step)]);
  return out;
}
