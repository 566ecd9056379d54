// The page's viewer: points or triangles that turn. WebGL 2 where there is one, else points on a plain canvas.
"use strict";
for (const figure of document.querySelectorAll(".view3d")) {
  const canvas = figure.querySelector("canvas"), data = figure.dataset;
  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const numbers = (text) => text.split(",").map(Number);
  const places = new Uint16Array(bytes(data.positions).buffer);
  const triangles = new Uint32Array(bytes(data.triangles).buffer);
  const colours = [...figure.querySelectorAll("[data-colours]")].map((label) => bytes(label.dataset.colours));
  const count = places.length / 3, side = Number(data.side);
  const still = matchMedia("(prefers-reduced-motion: reduce)");

  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const unit = (a) => { const l = Math.hypot(...a) || 1; return a.map((v) => v / l); };
  // Rows: right, up and towards the eye, in the points' frame.
  const right = unit(cross(numbers(data.up), numbers(data.eye)));
  const up = unit(cross(numbers(data.eye), right));
  const home = [right, up, cross(right, up)];

  const start = () => ({ yaw: 0, pitch: 0, away: 1.5, x: 0, y: 0 });
  let eye = start(), shown = 0, turning = false, drawing = false;

  // Yaw about the upright, then pitch about the line from left to right; rows of the turned frame.
  const frame = () => {
    const [cy, sy, cp, sp] = [Math.cos(eye.yaw), Math.sin(eye.yaw), Math.cos(eye.pitch), Math.sin(eye.pitch)];
    const mix = (a, b, c) => [0, 1, 2].map((i) => a * home[0][i] + b * home[1][i] + c * home[2][i]);
    return [mix(cy, 0, sy), mix(sp * sy, cp, -sp * cy), mix(-cp * sy, sp, cp * cy)];
  };
  // From the screen's middle to its nearer edge there are so many lengths for one of distance.
  const LENS = 1.9;

  const gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true, failIfMajorPerformanceCaveat: false });
  const paint = gl ? withGpu() : withoutGpu();

  function withGpu() {
    const compile = (kind, text) => {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      return shader;
    };
    const program = gl.createProgram();
    gl.attachShader(program, compile(gl.VERTEX_SHADER, `#version 300 es
      in vec3 place; in vec3 colour; uniform mat3 turn; uniform vec4 eye; uniform vec2 lens; uniform float size;
      out vec3 seen; out vec3 at;
      void main() {
        at = turn * (place - 0.5) + vec3(eye.xy, 0.0);
        float z = eye.z - at.z;
        gl_Position = vec4(at.xy * lens, (z - 0.02) / 8.0 * z, z);
        gl_PointSize = size / z; seen = colour;
      }`));
    gl.attachShader(program, compile(gl.FRAGMENT_SHADER, `#version 300 es
      precision highp float; in vec3 seen; in vec3 at; uniform bool solid; out vec4 pixel;
      void main() {
        float light = 1.0;
        if (solid) light = 0.35 + 0.65 * abs(normalize(cross(dFdx(at), dFdy(at))).z);
        else if (length(gl_PointCoord - 0.5) > 0.5) discard;
        pixel = vec4(seen * light, 1.0);
      }`));
    gl.linkProgram(program);
    gl.useProgram(program);
    const buffer = (kind, content) => { gl.bindBuffer(kind, gl.createBuffer()); gl.bufferData(kind, content, gl.STATIC_DRAW); };
    const attribute = (name, kind) => {
      const at = gl.getAttribLocation(program, name);
      gl.enableVertexAttribArray(at);
      gl.vertexAttribPointer(at, 3, kind, true, 0, 0);
    };
    buffer(gl.ARRAY_BUFFER, places);
    attribute("place", gl.UNSIGNED_SHORT);
    buffer(gl.ARRAY_BUFFER, colours[0]);
    attribute("colour", gl.UNSIGNED_BYTE);
    if (triangles.length) buffer(gl.ELEMENT_ARRAY_BUFFER, triangles);
    const u = (name) => gl.getUniformLocation(program, name);
    const [turn, at, lens, size, solid] = ["turn", "eye", "lens", "size", "solid"].map(u);
    gl.enable(gl.DEPTH_TEST);
    let loaded = 0;
    return () => {
      if (loaded !== shown) { gl.bufferData(gl.ARRAY_BUFFER, colours[shown], gl.STATIC_DRAW); loaded = shown; }
      const [w, h] = [canvas.width, canvas.height], f = frame();
      gl.viewport(0, 0, w, h);
      gl.clearColor(0, 0, 0, 0);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      gl.uniformMatrix3fv(turn, false, [0, 1, 2].flatMap((c) => f.map((row) => row[c])));
      gl.uniform4f(at, eye.x, eye.y, eye.away, 0);
      const least = Math.min(w, h);
      gl.uniform2f(lens, LENS * least / w, LENS * least / h);
      gl.uniform1f(size, Math.max(2, least / 110) * 2.1);
      gl.uniform1i(solid, triangles.length ? 1 : 0);
      if (triangles.length) gl.drawElements(gl.TRIANGLES, triangles.length, gl.UNSIGNED_INT, 0);
      else gl.drawArrays(gl.POINTS, 0, count);
    };
  }

  function withoutGpu() {
    const pen = canvas.getContext("2d");
    if (!pen) { figure.querySelector(".fallback").hidden = false; return () => {}; }
    return () => {
      const [w, h] = [canvas.width, canvas.height], f = frame(), reach = 0.5 * LENS * Math.min(w, h);
      pen.clearRect(0, 0, w, h);
      const spots = [];
      for (let i = 0; i < count; i++) {
        const p = [0, 1, 2].map((k) => places[3 * i + k] / 65535 - 0.5);
        const [x, y, z] = f.map((row) => row[0] * p[0] + row[1] * p[1] + row[2] * p[2]);
        const away = eye.away - z;
        if (away > 0.02) spots.push([away, w / 2 + reach * (x + eye.x) / away, h / 2 - reach * (y + eye.y) / away, i]);
      }
      spots.sort((a, b) => b[0] - a[0]);
      const c = colours[shown], size = Math.max(2, Math.min(w, h) / 160);
      for (const [away, x, y, i] of spots) {
        pen.fillStyle = `rgb(${c[3 * i]},${c[3 * i + 1]},${c[3 * i + 2]})`;
        const s = size * 2.1 / away;
        pen.fillRect(x - s / 2, y - s / 2, s, s);
      }
    };
  }

  const ruler = document.createElement("span");
  ruler.className = "ruler";
  ruler.setAttribute("aria-hidden", "true");
  figure.append(ruler);
  function measure() {
    const perMm = 0.5 * LENS * Math.min(canvas.clientWidth, canvas.clientHeight) / eye.away / side;
    const most = 120 / perMm, ten = 10 ** Math.floor(Math.log10(most));
    const length = [5, 2, 1].map((n) => n * ten).find((l) => l <= most) || ten;
    ruler.style.width = `${length * perMm}px`;
    ruler.textContent = `${Number(length.toPrecision(3))} mm`;
  }

  function draw() {
    if (drawing) return;
    drawing = true;
    requestAnimationFrame(now);
  }
  function now() {
    drawing = false;
    const sharp = Math.min(devicePixelRatio || 1, 2);
    const [w, h] = [canvas.clientWidth, canvas.clientHeight].map((v) => Math.max(1, Math.round(v * sharp)));
    if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
    paint();
    measure();
    if (turning) { eye.yaw += 0.01; draw(); }
  }

  const change = (by) => {
    eye.yaw += by.yaw || 0;
    eye.pitch = Math.max(-1.55, Math.min(1.55, eye.pitch + (by.pitch || 0)));
    eye.away = Math.max(0.3, Math.min(6, eye.away * (by.away || 1)));
    eye.x += by.x || 0;
    eye.y += by.y || 0;
    draw();
  };
  const button = figure.querySelector("[data-do=turn]");
  const stop = () => { turning = false; button.setAttribute("aria-pressed", "false"); };

  const fingers = new Map();
  canvas.addEventListener("pointerdown", (e) => { stop(); fingers.set(e.pointerId, e); canvas.setPointerCapture(e.pointerId); });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (e) => fingers.delete(e.pointerId));
  canvas.addEventListener("pointermove", (e) => {
    const before = fingers.get(e.pointerId);
    if (!before) return;
    const [dx, dy] = [e.clientX - before.clientX, e.clientY - before.clientY], per = eye.away / canvas.clientHeight;
    if (fingers.size > 1) {
      const other = [...fingers.values()].find((f) => f.pointerId !== e.pointerId);
      const apart = (f) => Math.hypot(f.clientX - other.clientX, f.clientY - other.clientY) || 1;
      change({ away: apart(before) / apart(e), x: dx * per / 2, y: -dy * per / 2 });
    } else if (e.shiftKey || before.button === 2) change({ x: dx * per, y: -dy * per });
    else change({ yaw: dx / 150, pitch: dy / 150 });
    fingers.set(e.pointerId, e);
  });
  // A wheel alone scrolls the page.
  canvas.addEventListener("wheel", (e) => {
    if (!e.ctrlKey && !e.metaKey) return;
    e.preventDefault();
    change({ away: Math.exp(e.deltaY / 500) });
  }, { passive: false });
  canvas.addEventListener("keydown", (e) => {
    const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[e.key];
    if (step && e.shiftKey) change({ x: step[0] / 20, y: -step[1] / 20 });
    else if (step) change({ yaw: step[0] / 12, pitch: step[1] / 12 });
    else if (e.key === "+" || e.key === "=") change({ away: 0.87 });
    else if (e.key === "-") change({ away: 1.15 });
    else if (e.key === "0") { eye = start(); draw(); }
    else return;
    stop();
    e.preventDefault();
  });
  figure.querySelector(".controls").addEventListener("click", (e) => {
    const what = e.target.dataset.do;
    if (what === "nearer") change({ away: 0.8 });
    if (what === "farther") change({ away: 1.25 });
    if (what === "reset") { stop(); eye = start(); draw(); }
    // Whoever wants no motion gets a step.
    if (what === "turn" && still.matches) change({ yaw: Math.PI / 12 });
    else if (what === "turn") { turning = !turning; button.setAttribute("aria-pressed", String(turning)); draw(); }
  });
  figure.querySelector(".controls").addEventListener("change", (e) => {
    shown = Number(e.target.value);
    for (const scale of figure.querySelectorAll(".of")) scale.hidden = Number(scale.dataset.of) !== shown;
    draw();
  });
  new ResizeObserver(draw).observe(canvas);
  addEventListener("beforeprint", () => { stop(); now(); });
  addEventListener("afterprint", draw);
  draw();
}
