// A plain canvas that is as sharp as the screen, drawn at most once a frame and only when something changed.

export interface Area {
  pen: CanvasRenderingContext2D;
  width: number;
  height: number;
  /** The page's colours by their CSS names. */
  colour(name: string): string;
}

export class Surface {
  private drawing = false;
  private readonly pen: CanvasRenderingContext2D | null;

  constructor(readonly canvas: HTMLCanvasElement, private readonly paint: (area: Area) => void) {
    this.pen = canvas.getContext("2d");
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  draw(): void {
    if (this.drawing) return;
    this.drawing = true;
    requestAnimationFrame(() => this.now());
  }

  private now(): void {
    this.drawing = false;
    if (!this.pen) return;
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const sharp = Math.min(devicePixelRatio || 1, 2);
    const [w, h] = [Math.max(1, Math.round(width * sharp)), Math.max(1, Math.round(height * sharp))];
    if (this.canvas.width !== w || this.canvas.height !== h) [this.canvas.width, this.canvas.height] = [w, h];
    this.pen.setTransform(sharp, 0, 0, sharp, 0, 0);
    this.pen.clearRect(0, 0, width, height);
    const style = getComputedStyle(this.canvas);
    this.paint({ pen: this.pen, width, height, colour: (name) => style.getPropertyValue(`--${name}`) });
  }
}

/** An element of the page by its id; a page without it is built wrongly. */
export function element<T extends HTMLElement = HTMLElement>(id: string): T {
  const found = document.getElementById(id);
  if (!found) throw new Error(`the page has no #${id}`);
  return found as T;
}

/** Sets a text where it is another, so that nothing is announced twice. */
export function say(at: HTMLElement, text: string): void {
  if (at.textContent !== text) at.textContent = text;
}

/** Sets an attribute where it is another. */
export function mark(at: HTMLElement, name: string, value: string): void {
  if (at.getAttribute(name) !== value) at.setAttribute(name, value);
}
