// The camera's image with the stripe found on it, and beside it, line by line, how good the signal is.
import { count, median } from "./format.ts";
import { NO_STRIPE, type ImageMessage, type Signal, type Welcome } from "./protocol.ts";
import { element, mark, say, Surface, type Area } from "./surface.ts";

/** Scatter up to which a line counts as good, and as fair, px. */
export const GOOD_PX = 0.1;
export const FAIR_PX = 0.3;
const STRIP = 44;
const GAP = 6;

export class ImageView {
  private readonly surface = new Surface(element<HTMLCanvasElement>("image"), (area) => this.paint(area));
  private message: ImageMessage | null = null;
  private bitmap: ImageBitmap | null = null;
  private signal: Signal | null = null;
  private across: Welcome["across"] = "row";
  private decoding = false;
  private next: ImageMessage | null = null;
  private described = 0;
  /** The largest amplitude lately, for the strip's scale. */
  private loudest = 1;
  stripe = true;

  constructor(private readonly fault: (text: string) => void) {}

  lines(across: Welcome["across"]): void {
    this.across = across;
    this.surface.draw();
  }

  /** Shows an image, unless a later one comes before it is decoded. */
  show(message: ImageMessage): void {
    this.next = message;
    if (!this.decoding) void this.decode();
  }

  measure(signal: Signal): void {
    this.signal = signal;
    const most = Math.max(1, ...signal.amplitude.filter((a): a is number => a !== null));
    this.loudest = Math.max(most, this.loudest * 0.98);
    say(element("signal-found"), `${Math.round(100 * (signal.found ?? 0))}\u202f% of lines`);
    const [amplitude, sigma] = [median(signal.amplitude), median(signal.sigma_px)];
    say(element("signal-amplitude"), amplitude === null ? "–" : amplitude.toFixed(amplitude < 10 ? 1 : 0));
    say(element("signal-sigma"), sigma === null ? "–" : `${sigma.toFixed(3)}\u202fpx`);
    this.surface.draw();
  }

  clear(): void {
    this.bitmap?.close();
    this.bitmap = this.message = this.signal = this.next = null;
    for (const id of ["signal-found", "signal-amplitude", "signal-sigma"]) say(element(id), "–");
    this.draw();
  }

  draw(): void {
    this.surface.draw();
  }

  private async decode(): Promise<void> {
    this.decoding = true;
    while (this.next) {
      const message = this.next;
      this.next = null;
      try {
        const bitmap = await createImageBitmap(new Blob([message.jpeg as BlobPart], { type: "image/jpeg" }));
        this.bitmap?.close();
        [this.bitmap, this.message] = [bitmap, message];
        this.describe(message);
        this.surface.draw();
      } catch {
        this.fault(`Image ${message.frame} could not be read`);
      }
    }
    this.decoding = false;
  }

  private describe(message: ImageMessage): void {
    element("image-empty").hidden = true;
    say(element("image-note"), `image ${count(message.frame)}`);
    // A screen reader is not told ten times a second.
    if (performance.now() - this.described < 3000) return;
    this.described = performance.now();
    const found = message.stripe.reduce((sum, at) => sum + (at === NO_STRIPE ? 0 : 1), 0);
    mark(this.surface.canvas, "aria-label",
      `Camera image ${message.frame}, ${message.width} by ${message.height} pixels; stripe found on ${found} of ${message.stripe.length} lines`);
  }

  private paint({ pen, width, height, colour }: Area): void {
    const { bitmap, message } = this;
    element("image-empty").hidden = bitmap !== null;
    if (!bitmap || !message) return;
    const upright = this.across === "row";
    const [freeW, freeH] = [width - (upright ? STRIP + GAP : 0), height - (upright ? 0 : STRIP + GAP)];
    const scale = Math.min(freeW / message.width, freeH / message.height);
    const [w, h] = [message.width * scale, message.height * scale];
    const [x, y] = [(freeW - w) / 2, (freeH - h) / 2];
    pen.imageSmoothingQuality = "high";
    pen.drawImage(bitmap, x, y, w, h);
    if (this.stripe) {
      pen.fillStyle = colour("found");
      const size = Math.max(1.25, scale);
      const { stripe, stripeStep } = message;
      for (let line = 0; line < stripe.length; line++) {
        if (stripe[line] === NO_STRIPE) continue;
        // Pixel (0, 0) is the centre of the top-left pixel.
        const [at, along] = [(stripe[line]! * stripeStep + 0.5) * scale, (line + 0.5) * scale];
        if (upright) pen.fillRect(x + at - size / 2, y + along - size / 2, size, size);
        else pen.fillRect(x + along - size / 2, y + at - size / 2, size, size);
      }
    }
    if (this.signal) this.strip(pen, colour, upright ? [x + w + GAP, y, STRIP, h] : [x, y + h + GAP, w, STRIP], upright);
  }

  private strip(pen: CanvasRenderingContext2D, colour: Area["colour"], [x, y, w, h]: [number, number, number, number], upright: boolean): void {
    const { amplitude, sigma_px: sigma } = this.signal!;
    pen.fillStyle = colour("panel");
    pen.fillRect(x, y, w, h);
    const part = (upright ? h : w) / amplitude.length;
    for (let i = 0; i < amplitude.length; i++) {
      const [a, s] = [amplitude[i], sigma[i]];
      const there = a !== null && a !== undefined;
      pen.fillStyle = colour(!there ? "none" : s === null || s === undefined || s > FAIR_PX ? "poor" : s > GOOD_PX ? "fair" : "good");
      const long = there ? Math.max(2, (STRIP - 2) * Math.min(1, a / this.loudest)) : 3;
      const thick = Math.max(1, part - 1);
      if (upright) pen.fillRect(x, y + i * part, long, thick);
      else pen.fillRect(x + i * part, y + STRIP - long, thick, long);
    }
  }
}
