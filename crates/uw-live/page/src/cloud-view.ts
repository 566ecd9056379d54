// The cloud in space: blocks of quantised points, as they came, drawn by the GPU; the latest profile on top of them.
import {
  BufferAttribute, BufferGeometry, Color, DataTexture, DynamicDrawUsage, FloatType, GLSL3, NearestFilter, PerspectiveCamera, Points as Dots,
  RawShaderMaterial, RGBAFormat, Scene, UnsignedByteType, Vector2, Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import { cividis, cividisOnDark, grey, ramp, type Rgb } from "./colour.ts";
import { BLOCK_SLOTS, STRIDE, type Block, type Extent, type Points } from "./points.ts";

const FIELD_OF_VIEW = 40;
/** From where the cloud is first seen: behind the instrument, a little from above and from the side (camera's frame: y down, z forward). */
const HOME = new Vector3(-0.42, -0.5, -1).normalize();
const UP = new Vector3(0, -1, 0);

const VERTEX = `precision highp float; precision highp sampler2D;
in vec4 position; uniform mat4 modelViewMatrix; uniform mat4 projectionMatrix;
uniform sampler2D boxes; uniform vec2 depth; uniform float mode; uniform float size; uniform float home; out float share;
void main() {
  float slot = floor(position.w / 256.0);
  vec4 box = texelFetch(boxes, ivec2(int(slot), 0), 0);
  vec3 place = box.xyz + box.w * position.xyz;
  share = mode > 0.5 ? (position.w - 256.0 * slot) / 255.0 : 1.0 - (place.z - depth.x) / max(depth.y - depth.x, 1e-6);
  vec4 seen = modelViewMatrix * vec4(place, 1.0);
  gl_Position = projectionMatrix * seen;
  gl_PointSize = clamp(size * home / max(-seen.z, 1e-3), size * 0.5, size * 6.0);
}`;
const FRAGMENT = `precision highp float; precision highp sampler2D; in float share; uniform sampler2D colours; out vec4 pixel;
void main() {
  if (length(gl_PointCoord - 0.5) > 0.5) discard;
  pixel = vec4(texture(colours, vec2(clamp(share, 0.002, 0.998), 0.5)).rgb, 1.0);
}`;
const PLAIN_VERTEX = `precision highp float; in vec3 position; uniform mat4 modelViewMatrix; uniform mat4 projectionMatrix; uniform float size;
void main() { gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0); gl_Position.z -= 0.0005 * gl_Position.w; gl_PointSize = size; }`;
const PLAIN_FRAGMENT = `precision highp float; uniform vec3 colour; out vec4 pixel; void main() { pixel = vec4(colour, 1.0); }`;

/** A block on the GPU, and how much of it is there. */
interface Drawn {
  block: Block;
  data: Uint16Array;
  dots: Dots<BufferGeometry, RawShaderMaterial>;
  place: BufferAttribute;
  boxes: DataTexture;
  count: number;
  slots: number;
}

export type Colouring = "depth" | "brightness";

export class CloudView {
  private readonly renderer: WebGLRenderer;
  private readonly scene = new Scene();
  private readonly eye = new PerspectiveCamera(FIELD_OF_VIEW, 1, 1, 10_000);
  private readonly orbit: OrbitControls;
  private readonly drawn: Drawn[] = [];
  private readonly ramps: Record<"light" | "dark" | "brightness", DataTexture>;
  private readonly shared;
  private readonly line;
  private readonly lineColour = { value: new Color() };
  private readonly lineSize = { value: 3 };
  private fitted: Extent | null = null;
  private touched = false;
  private drawing = false;
  private version = -1;
  /** Distance at which points have the size that was set, mm. */
  private distance = 1000;
  pointSize = 2;
  /** What has to be told elsewhere: the extent for the legend, mm a pixel at the middle for the ruler. */
  onDraw: (extent: Extent | null, mmPerPixel: number) => void = () => {};

  /** Throws where the browser has no WebGL 2. */
  constructor(private readonly canvas: HTMLCanvasElement, private readonly points: Points) {
    this.renderer = new WebGLRenderer({ canvas, antialias: true, alpha: true, powerPreference: "high-performance" });
    this.renderer.setClearColor(0, 0);
    const ramped = (colour: (share: number) => Rgb) => texture(ramp(colour), 256, UnsignedByteType);
    this.ramps = { light: ramped(cividis), dark: ramped(cividisOnDark), brightness: ramped(grey) };
    this.shared = {
      depth: { value: new Vector2(0, 1) }, mode: { value: 0 }, size: { value: 2 }, home: { value: 1000 }, colours: { value: this.ramps.light },
    };
    this.eye.up.copy(UP);
    this.orbit = new OrbitControls(this.eye, canvas);
    this.orbit.enableDamping = false;
    this.orbit.zoomToCursor = true;
    this.orbit.minDistance = 1;
    this.orbit.maxDistance = 100_000;
    this.orbit.addEventListener("start", () => { this.touched = true; });
    this.orbit.addEventListener("change", () => this.draw());
    this.line = new Dots(new BufferGeometry(), new RawShaderMaterial({
      glslVersion: GLSL3, vertexShader: PLAIN_VERTEX, fragmentShader: PLAIN_FRAGMENT, uniforms: { colour: this.lineColour, size: this.lineSize },
    }));
    this.line.frustumCulled = false;
    this.line.renderOrder = 1;
    this.scene.add(this.line);
    canvas.addEventListener("keydown", (event) => this.key(event));
    canvas.addEventListener("webglcontextrestored", () => this.draw());
    new ResizeObserver(() => this.draw()).observe(canvas);
    this.home();
  }

  colourBy(colouring: Colouring, dark: boolean): void {
    this.shared.mode.value = colouring === "brightness" ? 1 : 0;
    this.shared.colours.value = this.ramps[colouring === "brightness" ? "brightness" : dark ? "dark" : "light"];
    this.draw();
  }

  /** Shows where the sheet is now: (n, 3) mm, or nothing. */
  profile(points: Float32Array | null): void {
    const old = this.line.geometry;
    this.line.geometry = new BufferGeometry();
    this.line.geometry.setAttribute("position", new BufferAttribute(points ?? new Float32Array(0), 3));
    old.dispose();
    this.draw();
  }

  /** Sees the whole cloud again, and goes on doing so while it grows. */
  home(): void {
    this.touched = false;
    this.fitted = null;
    this.fit();
    this.draw();
  }

  zoom(factor: number): void {
    this.touched = true;
    this.eye.position.sub(this.orbit.target).multiplyScalar(factor).add(this.orbit.target);
    this.orbit.update();
    this.draw();
  }

  draw(): void {
    if (this.drawing) return;
    this.drawing = true;
    requestAnimationFrame(() => this.now());
  }

  private now(): void {
    this.drawing = false;
    if (this.version !== this.points.version) {
      this.version = this.points.version;
      this.upload();
      this.fit();
    }
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    const sharp = Math.min(devicePixelRatio || 1, 2);
    if (this.renderer.getPixelRatio() !== sharp) this.renderer.setPixelRatio(sharp);
    const size = this.renderer.getSize(new Vector2());
    if (size.x !== width || size.y !== height) {
      this.renderer.setSize(width, height, false);
      this.eye.aspect = width / height;
      this.fitted = null;
      this.fit();
    }
    const away = this.eye.position.distanceTo(this.orbit.target);
    [this.eye.near, this.eye.far] = [away / 100, away * 50];
    this.eye.updateProjectionMatrix();
    this.shared.size.value = this.pointSize * sharp;
    this.shared.home.value = this.distance;
    this.lineSize.value = (this.pointSize + 1) * sharp;
    this.lineColour.value.set(getComputedStyle(this.canvas).getPropertyValue("--found").trim() || "#d55e00").convertLinearToSRGB();
    this.renderer.render(this.scene, this.eye);
    this.onDraw(this.points.extent(), (2 * away * Math.tan((FIELD_OF_VIEW * Math.PI) / 360)) / height);
  }

  /** Brings to the GPU what it has not got: whole blocks that are new or grew, else only the points that were added. */
  private upload(): void {
    const { blocks } = this.points;
    for (let i = 0; i < Math.max(blocks.length, this.drawn.length); i++) {
      const block = blocks[i];
      let drawn = this.drawn[i];
      if (drawn && (!block || drawn.block !== block || drawn.data !== block.data)) {
        this.scene.remove(drawn.dots);
        drawn.dots.geometry.dispose();
        drawn.dots.material.dispose();
        drawn.boxes.dispose();
        drawn = undefined;
      }
      if (!block) continue;
      drawn ??= this.open(block);
      this.drawn[i] = drawn;
      if (drawn.count < block.count) {
        drawn.place.addUpdateRange(STRIDE * drawn.count, STRIDE * (block.count - drawn.count));
        drawn.place.needsUpdate = true;
        drawn.count = block.count;
        drawn.dots.geometry.setDrawRange(0, block.count);
      }
      if (drawn.slots < block.slots) {
        drawn.boxes.needsUpdate = true;
        drawn.slots = block.slots;
      }
    }
    this.drawn.length = blocks.length;
    const extent = this.points.extent();
    if (extent) this.shared.depth.value.set(extent.low[2], extent.high[2]);
  }

  private open(block: Block): Drawn {
    const place = new BufferAttribute(block.data, STRIDE);
    place.setUsage(DynamicDrawUsage);
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", place);
    geometry.setDrawRange(0, block.count);
    const boxes = texture(block.boxes, BLOCK_SLOTS, FloatType);
    const material = new RawShaderMaterial({
      glslVersion: GLSL3, vertexShader: VERTEX, fragmentShader: FRAGMENT, uniforms: { ...this.shared, boxes: { value: boxes } },
    });
    const dots = new Dots(geometry, material);
    dots.frustumCulled = false;
    this.scene.add(dots);
    return { block, data: block.data, dots, place, boxes, count: block.count, slots: block.slots };
  }

  /** While nobody has turned the cloud, it is kept in sight; moved only when it has grown out of what was seen. */
  private fit(): void {
    const extent = this.points.extent();
    if (!extent) {
      this.fitted = null;
      if (!this.touched) this.place(new Vector3(0, 0, 600), 800);
      return;
    }
    if (this.touched || (this.fitted && inside(extent, this.fitted))) return;
    const [low, high] = [new Vector3(...extent.low), new Vector3(...extent.high)];
    const radius = Math.max(1, high.distanceTo(low) / 2);
    const slack = radius * 0.06;
    this.fitted = { low: low.clone().subScalar(slack).toArray(), high: high.clone().addScalar(slack).toArray() };
    this.place(low.clone().add(high).multiplyScalar(0.5), 1.12 * this.distanceOf(low, high));
  }

  /** How far away the box has to be so that its corners are all in sight from the home direction, mm. */
  private distanceOf(low: Vector3, high: Vector3): number {
    const right = new Vector3().crossVectors(UP, HOME).normalize();
    const above = new Vector3().crossVectors(HOME, right);
    const tall = Math.tan((FIELD_OF_VIEW * Math.PI) / 360);
    const half = high.clone().sub(low).multiplyScalar(0.5);
    let away = 1;
    for (let corner = 0; corner < 8; corner++) {
      const at = new Vector3(corner & 1 ? half.x : -half.x, corner & 2 ? half.y : -half.y, corner & 4 ? half.z : -half.z);
      const reach = Math.max(Math.abs(at.dot(right)) / (tall * this.eye.aspect), Math.abs(at.dot(above)) / tall);
      away = Math.max(away, reach + at.dot(HOME));
    }
    return away;
  }

  private place(target: Vector3, distance: number): void {
    this.distance = distance;
    this.orbit.target.copy(target);
    this.eye.position.copy(target).addScaledVector(HOME, distance);
    this.orbit.update();
  }

  private key(event: KeyboardEvent): void {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const arrow = ({ ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] } as Record<string, [number, number]>)[event.key];
    if (arrow && event.shiftKey) this.shift(arrow);
    else if (arrow) this.turn(arrow[0] / 12, arrow[1] / 12);
    else if (event.key === "+" || event.key === "=") this.zoom(0.85);
    else if (event.key === "-") this.zoom(1 / 0.85);
    else if (event.key === "0") this.home();
    else return;
    event.preventDefault();
  }

  /** Turns the cloud: yaw about the upright, pitch about the line from left to right, rad. */
  private turn(yaw: number, pitch: number): void {
    this.touched = true;
    const arm = this.eye.position.clone().sub(this.orbit.target);
    arm.applyAxisAngle(UP, -yaw);
    const side = new Vector3().crossVectors(UP, arm).normalize();
    const tilt = arm.angleTo(UP);
    arm.applyAxisAngle(side, Math.max(0.03 - tilt, Math.min(Math.PI - 0.03 - tilt, -pitch)));
    this.eye.position.copy(this.orbit.target).add(arm);
    this.orbit.update();
    this.draw();
  }

  private shift([right, down]: [number, number]): void {
    this.touched = true;
    const step = this.eye.position.distanceTo(this.orbit.target) / 25;
    const move = new Vector3().setFromMatrixColumn(this.eye.matrix, 0).multiplyScalar(-right * step);
    move.addScaledVector(new Vector3().setFromMatrixColumn(this.eye.matrix, 1), down * step);
    this.orbit.target.add(move);
    this.eye.position.add(move);
    this.orbit.update();
    this.draw();
  }
}

function texture(data: Uint8Array | Float32Array, width: number, type: typeof UnsignedByteType | typeof FloatType): DataTexture {
  const made = new DataTexture(data as Float32Array<ArrayBuffer>, width, 1, RGBAFormat, type);
  made.minFilter = made.magFilter = NearestFilter;
  made.needsUpdate = true;
  return made;
}

function inside(inner: Extent, outer: Extent): boolean {
  return [0, 1, 2].every((k) => inner.low[k]! >= outer.low[k]! && inner.high[k]! <= outer.high[k]!);
}
