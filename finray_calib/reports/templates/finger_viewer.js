"use strict";
(() => {
  const canvas = document.getElementById("finger");
  const gl = canvas.getContext("webgl", { antialias: true });
  if (!gl) return;
  const scene = JSON.parse(document.getElementById("scene").textContent);
  const show = (on) => {
    document.getElementById("viewer").hidden = !on;
    document.getElementById("no-viewer").hidden = on;
  };

  const shader = (type, source) => {
    const made = gl.createShader(type);
    gl.shaderSource(made, source);
    gl.compileShader(made);
    return made;
  };
  const program = gl.createProgram();
  gl.attachShader(program, shader(gl.VERTEX_SHADER, `
    attribute vec3 place; attribute vec3 normal; uniform mat3 turn; uniform vec3 scale; uniform vec3 shift;
    varying vec3 facing;
    void main() { facing = turn * normal; gl_Position = vec4(turn * place * scale + shift, 1.0); }`));
  gl.attachShader(program, shader(gl.FRAGMENT_SHADER, `
    precision mediump float; uniform vec3 colour; uniform float lit; varying vec3 facing;
    void main() {
      vec3 n = normalize(facing + vec3(0.0, 0.0, 1e-4));
      float light = 0.6 + 0.4 * abs(dot(n, normalize(vec3(-0.3, 0.5, 0.8))));
      gl_FragColor = vec4(colour * mix(1.0, light, lit), 1.0);
    }`));
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) return;
  gl.useProgram(program);
  const at = (name) => gl.getUniformLocation(program, name);
  const uniform = { turn: at("turn"), scale: at("scale"), shift: at("shift"), colour: at("colour"), lit: at("lit") };
  const place = gl.getAttribLocation(program, "place"), normal = gl.getAttribLocation(program, "normal");

  const numbers = (text, Kind) => new Kind(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
  const buffer = (values) => {
    const made = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, made);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(values), gl.STATIC_DRAW);
    return made;
  };
  const parts = scene.parts.map((part) => {
    const Kind = part.wide ? Uint32Array : Uint16Array;
    const steps = numbers(part.vertices, Int16Array);
    const point = (i) => [0, 1, 2].map((k) => steps[3 * i + k] / 32767 * scene.reach_mm);
    const places = [], normals = [], triangles = numbers(part.triangles, Kind);
    for (let t = 0; t < triangles.length; t += 3) {
      const [a, b, c] = [0, 1, 2].map((k) => point(triangles[t + k]));
      const u = b.map((value, k) => value - a[k]), v = c.map((value, k) => value - a[k]);
      const n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
      const length = Math.hypot(...n) || 1;
      places.push(...a, ...b, ...c);
      for (let k = 0; k < 3; k++) normals.push(...n.map((value) => value / length));
    }
    const lines = Array.from(numbers(part.edges, Kind)).flatMap(point);
    return { colour: part.colour, shown: part.shown, count: places.length / 3, lineCount: lines.length / 3,
             places: buffer(places), normals: buffer(normals), lines: buffer(lines) };
  });

  // yaw about the finger's y, then pitch about the screen's horizontal; (0, 0) looks along x: z to the right, y up
  const views = { oblique: [0.6, 0.55], side: [0, 0], front: [0, Math.PI / 2], back: [0, -Math.PI / 2], base: [1.4, 0.2] };
  const start = { yaw: views.oblique[0], pitch: views.oblique[1], zoom: 1, x: 0, y: 0 };
  const eye = { ...start };
  const turn = () => {
    const cy = Math.cos(eye.yaw), sy = Math.sin(eye.yaw), cp = Math.cos(eye.pitch), sp = Math.sin(eye.pitch);
    // rows of the turned axes, given column by column
    return [-sy, sp * cy, -cp * cy, 0, cp, sp, cy, sp * sy, -cp * sy];
  };
  const perMm = () => 0.95 * eye.zoom * Math.min(canvas.width, canvas.height * 1.35) / (2 * scene.radius_mm);
  const attribute = (where, data) => {
    gl.bindBuffer(gl.ARRAY_BUFFER, data);
    gl.enableVertexAttribArray(where);
    gl.vertexAttribPointer(where, 3, gl.FLOAT, false, 0, 0);
  };
  const draw = () => {
    const density = window.devicePixelRatio || 1;
    canvas.width = Math.round(canvas.clientWidth * density);
    canvas.height = Math.round(canvas.clientHeight * density);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(1, 1, 1, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    const size = perMm();
    gl.uniformMatrix3fv(uniform.turn, false, turn());
    gl.uniform3f(uniform.scale, 2 * size / canvas.width, 2 * size / canvas.height, -1 / (2 * scene.reach_mm));
    // lines lie a pixel before their faces: gl.polygonOffset would move lines as well where they are drawn as quads
    const lift = -Math.min(1.5 / size, 0.5) / (2 * scene.reach_mm);
    for (const part of parts.filter((one) => one.shown)) {
      gl.uniform3fv(uniform.colour, part.colour);
      gl.uniform1f(uniform.lit, 1);
      gl.uniform3f(uniform.shift, eye.x, eye.y, 0);
      attribute(place, part.places);
      attribute(normal, part.normals);
      gl.drawArrays(gl.TRIANGLES, 0, part.count);
      gl.uniform3fv(uniform.colour, part.colour.map((value) => 0.45 * value));
      gl.uniform1f(uniform.lit, 0);
      gl.uniform3f(uniform.shift, eye.x, eye.y, lift);
      attribute(place, part.lines);
      gl.disableVertexAttribArray(normal);
      gl.drawArrays(gl.LINES, 0, part.lineCount);
    }
  };
  let waits = false;
  const redraw = () => {
    if (waits) return;
    waits = true;
    requestAnimationFrame(() => { waits = false; draw(); });
  };
  const rotate = (yaw, pitch) => {
    eye.yaw += yaw;
    eye.pitch = Math.max(-Math.PI / 2, Math.min(Math.PI / 2, eye.pitch + pitch));
  };
  const zoom = (factor) => { eye.zoom = Math.max(0.3, Math.min(20, eye.zoom * factor)); };
  const move = (x, y) => { eye.x += x; eye.y += y; };

  const fingers = new Map();
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  for (const kind of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(kind, (event) => fingers.delete(event.pointerId));
  }
  canvas.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    const now = [event.clientX, event.clientY], dx = now[0] - before[0], dy = now[1] - before[1];
    if (fingers.size === 2) {
      const [other] = [...fingers].filter(([id]) => id !== event.pointerId).map(([, where]) => where);
      const gap = (where) => Math.max(10, Math.hypot(where[0] - other[0], where[1] - other[1]));
      zoom(gap(now) / gap(before));
      move(dx / canvas.clientWidth, -dy / canvas.clientHeight);
    } else if (event.shiftKey) {
      move(2 * dx / canvas.clientWidth, -2 * dy / canvas.clientHeight);
    } else {
      rotate(0.008 * dx, 0.008 * dy);
    }
    fingers.set(event.pointerId, now);
    redraw();
  });
  canvas.addEventListener("wheel", (event) => {
    if (document.activeElement !== canvas) return;
    event.preventDefault();
    zoom(Math.exp(-0.0015 * event.deltaY));
    redraw();
  }, { passive: false });
  const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    if (event.key in arrows) {
      const [right, down] = arrows[event.key];
      if (event.shiftKey) move(0.05 * right, -0.05 * down);
      else rotate(0.09 * right, 0.09 * down);
    } else if (event.key === "+" || event.key === "=") zoom(1.15);
    else if (event.key === "-") zoom(1 / 1.15);
    else if (event.key === "0") Object.assign(eye, start);
    else return;
    event.preventDefault();
    redraw();
  });
  for (const button of document.querySelectorAll("[data-view]")) {
    button.addEventListener("click", () => {
      const [yaw, pitch] = views[button.dataset.view];
      Object.assign(eye, start, { yaw, pitch });
      redraw();
    });
  }
  for (const button of document.querySelectorAll("[data-zoom]")) {
    button.addEventListener("click", () => { zoom(Number(button.dataset.zoom)); redraw(); });
  }
  for (const box of document.querySelectorAll("[data-part]")) {
    box.addEventListener("change", () => { parts[box.dataset.part].shown = box.checked; redraw(); });
  }
  canvas.addEventListener("webglcontextlost", () => show(false));
  show(true);
  new ResizeObserver(redraw).observe(canvas);
})();
