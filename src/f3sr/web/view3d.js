// A small WebGL 2 view of meshes. World axes are Z up; cameras are OpenCV's; matrices are row-major here.
"use strict";

/** The view on a canvas, or null where WebGL 2 is not there.
 *
 *  `data`: bounds [low, high] that presets frame, objects [{mesh, parts}], textures, path [x, y, z, ...],
 *  strips (first points of its lines).
 *  `look(fromPhoto)` says what is to be seen now: camera {width, height, K, T}, poses (4x4 each), shade, colors {grid,
 *  path, glow}, and, where wanted, parts (instead of meshes), grid, lights and passed (points of the path that are behind).
 *  `turns`: what keys turn by, [right, down]. `painted()` is called after every picture. An object without a pose is not
 *  shown. `grab(x, y)` may take over a pointer that goes down there: it returns {move(ray), end()} or null. */
function view3d(canvas, data, { look, turns, painted = () => {}, grab = () => null }) {
  const gl = canvas.getContext("webgl2", { alpha: true, antialias: true, premultipliedAlpha: true });
  if (!gl) return null;

  // --- matrices ---------------------------------------------------------------------------------------------

  const multiply = (a, b) => {
    const c = new Array(16).fill(0);
    for (let i = 0; i < 4; i++) for (let j = 0; j < 4; j++) for (let k = 0; k < 4; k++) c[4 * i + j] += a[4 * i + k] * b[4 * k + j];
    return c;
  };
  const inverseRigid = (T) => {
    const t = [T[3], T[7], T[11]], u = [0, 1, 2].map((i) => -(T[i] * t[0] + T[4 + i] * t[1] + T[8 + i] * t[2]));
    return [T[0], T[4], T[8], u[0], T[1], T[5], T[9], u[1], T[2], T[6], T[10], u[2], 0, 0, 0, 1];
  };
  const add = (a, b, s = 1) => a.map((x, i) => x + s * b[i]);
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const column = (T, i) => [T[i], T[4 + i], T[8 + i]];
  const clamp = (x, low, high) => Math.max(low, Math.min(high, x));
  const IDENTITY = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];

  // --- the graphics card ------------------------------------------------------------------------------------

  const VERTEX = `#version 300 es
    in vec3 position; in vec2 uv; in vec4 color;
    uniform mat4 clip, model; uniform vec4 uvBox; uniform vec3 middle, extent;
    out vec3 world; out vec2 texel; out vec4 tint;
    void main() {
      vec4 p = model * vec4(middle + extent * position, 1.0);
      world = p.xyz; texel = uvBox.xy + uvBox.zw * uv; tint = color; gl_Position = clip * p;
    }`;
  const FRAGMENT = `#version 300 es
    precision highp float;
    in vec3 world; in vec2 texel; in vec4 tint;
    uniform vec3 base, eye, glowColor; uniform vec2 gridMiddle; uniform float shade, textured, fade, alpha, glow; uniform sampler2D image;
    out vec4 result;
    void main() {
      vec3 c = base * tint.rgb;
      if (textured > 0.5) c *= texture(image, texel).rgb;
      if (shade > 0.0) {
        vec3 n = normalize(cross(dFdx(world), dFdy(world)) + 1e-20);
        c *= 1.0 - shade + shade * (0.75 * abs(dot(n, normalize(eye - world))) + 0.25 * abs(n.z));
      }
      c = mix(c, glowColor, glow);
      float a = fade > 0.0 ? alpha * (1.0 - smoothstep(0.4 * fade, fade, length(world.xy - gridMiddle))) : alpha;
      result = vec4(c * a, a);
    }`;
  const compile = (kind, source) => {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    return shader;
  };
  const program = gl.createProgram();
  gl.attachShader(program, compile(gl.VERTEX_SHADER, VERTEX));
  gl.attachShader(program, compile(gl.FRAGMENT_SHADER, FRAGMENT));
  ["position", "uv", "color"].forEach((name, i) => gl.bindAttribLocation(program, i, name));
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) return null;
  const place = {};
  for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); i++) {
    const { name } = gl.getActiveUniform(program, i);
    place[name] = gl.getUniformLocation(program, name);
  }

  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const upload = (target, array) => {
    gl.bindBuffer(target, gl.createBuffer());
    gl.bufferData(target, array, gl.STATIC_DRAW);
  };
  const attribute = (index, array, size, type, normalized, stride) => {
    upload(gl.ARRAY_BUFFER, array);
    gl.enableVertexAttribArray(index);
    gl.vertexAttribPointer(index, size, type, normalized, stride, 0);
  };
  const meshOf = (packed) => {
    const mesh = { vao: gl.createVertexArray(), box: packed.box, runs: packed.runs, uvBox: packed.uvBox || [0, 0, 1, 1] };
    gl.bindVertexArray(mesh.vao);
    attribute(0, bytes(packed.vertices), 3, gl.SHORT, true, 8);
    if (packed.uv) attribute(1, bytes(packed.uv), 2, gl.UNSIGNED_SHORT, true, 4);
    if (packed.colors) attribute(2, bytes(packed.colors), 4, gl.UNSIGNED_BYTE, true, 4);
    upload(gl.ELEMENT_ARRAY_BUFFER, bytes(packed.faces.data));
    [mesh.type, mesh.step] = packed.faces.wide ? [gl.UNSIGNED_INT, 4] : [gl.UNSIGNED_SHORT, 2];
    gl.bindVertexArray(null);
    return mesh;
  };
  const linesOf = (points) => {
    const lines = { vao: gl.createVertexArray(), count: points.length / 3 };
    gl.bindVertexArray(lines.vao);
    attribute(0, new Float32Array(points), 3, gl.FLOAT, false, 0);
    gl.bindVertexArray(null);
    return lines;
  };
  let loaded = 0;
  const textures = data.textures.map((uri) => {
    const texture = gl.createTexture(), image = new Image();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 1, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array([150, 150, 150, 255]));
    image.onload = () => {
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.pixelStorei(gl.UNPACK_FLIP_Y_WEBGL, true);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, image);
      gl.generateMipmap(gl.TEXTURE_2D);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
      loaded++;
      draw();
    };
    image.src = uri;
    return texture;
  });
  const meshes = data.objects.map((o) => ({ mesh: meshOf(o.mesh), parts: o.parts ? meshOf(o.parts) : null }));

  // --- the ground grid: some ten cells across the scene -------------------------------------------------------

  const [lx, ly, lz, hx, hy, hz] = data.bounds;
  const middle = [(lx + hx) / 2, (ly + hy) / 2, (lz + hz) / 2];
  const radius = Math.max(1e-6, Math.hypot(hx - lx, hy - ly, hz - lz) / 2);
  const power = 10 ** Math.floor(Math.log10(radius / 4));
  const cell = [1, 2, 5, 10].map((k) => k * power).find((s) => s >= radius / 6) || power;
  const CELLS = 24;
  const grid = (() => {
    const cx = Math.round(middle[0] / cell) * cell, cy = Math.round(middle[1] / cell) * cell, points = [];
    for (let i = -CELLS; i <= CELLS; i++) for (let j = -CELLS; j < CELLS; j++) { // long lines past the camera are clipped badly
      points.push(cx + i * cell, cy + j * cell, 0, cx + i * cell, cy + (j + 1) * cell, 0);
      points.push(cx + j * cell, cy + i * cell, 0, cx + (j + 1) * cell, cy + i * cell, 0);
    }
    return linesOf(points);
  })();
  const path = linesOf(data.path || []), strips = data.strips || [0];

  // --- the camera ---------------------------------------------------------------------------------------------

  let orbit = null; // null: the photo's own camera; else target, distance, azimuth, elevation
  const now = () => look(orbit === null);

  const orbitPose = ({ target, distance, azimuth, elevation }) => {
    const forward = [Math.cos(elevation) * Math.cos(azimuth), Math.cos(elevation) * Math.sin(azimuth), -Math.sin(elevation)];
    const right = [Math.sin(azimuth), -Math.cos(azimuth), 0], down = cross(forward, right), eye = add(target, forward, -distance);
    return [right[0], down[0], forward[0], eye[0], right[1], down[1], forward[1], eye[1], right[2], down[2], forward[2], eye[2], 0, 0, 0, 1];
  };
  const photoOrbit = () => {
    const { T } = now().camera, eye = column(T, 3), forward = column(T, 2), off = add(middle, eye, -1);
    const distance = Math.max(off[0] * forward[0] + off[1] * forward[1] + off[2] * forward[2], 0.5 * radius);
    return { target: add(eye, forward, distance), distance, azimuth: Math.atan2(forward[1], forward[0]), elevation: Math.asin(clamp(-forward[2], -1, 1)) };
  };
  const clipOf = ({ K, width, height }, T) => {
    const away = Math.hypot(...add(middle, column(T, 3), -1));
    const far = away + 2 * radius + 2 * CELLS * cell, near = Math.max(far / 2000, away - 40 * radius);
    const P = [
      2 * K[0] / width, 2 * K[1] / width, 2 * K[2] / width - 1, 0,
      0, -2 * K[4] / height, 1 - 2 * K[5] / height, 0,
      0, 0, (far + near) / (far - near), -2 * far * near / (far - near),
      0, 0, 1, 0,
    ];
    return multiply(P, inverseRigid(T));
  };
  const from = (name) => {
    const { azimuth } = photoOrbit(), { K, width, height } = now().camera;
    const fit = 0.95 * radius / Math.sin(Math.atan(Math.min(width / 2 / K[0], height / 2 / K[4])));
    if (name === "photo") orbit = null;
    else if (name === "top") orbit = { target: middle, distance: fit, azimuth, elevation: Math.PI / 2 };
    else orbit = { target: middle, distance: fit, azimuth: azimuth + Math.PI / 2, elevation: 0.12 };
    draw();
  };
  const turn = (dx, dy) => {
    orbit = orbit || photoOrbit();
    orbit.azimuth -= dx;
    orbit.elevation = clamp(orbit.elevation + dy, -1.2, Math.PI / 2);
    draw();
  };
  const pan = (dx, dy) => { // in shares of the view's height
    orbit = orbit || photoOrbit();
    const { K, height } = now().camera, T = orbitPose(orbit), scale = orbit.distance * height / K[4];
    orbit.target = add(add(orbit.target, column(T, 0), -dx * scale), column(T, 1), -dy * scale);
    draw();
  };
  const zoom = (factor) => {
    orbit = orbit || photoOrbit();
    orbit.distance = clamp(orbit.distance * factor, 0.05 * radius, 60 * radius);
    draw();
  };

  // --- drawing ------------------------------------------------------------------------------------------------

  let asked = false;
  const draw = () => {
    if (asked) return;
    asked = true;
    requestAnimationFrame(() => { asked = false; paint(); });
  };
  const begin = ({ camera }) => {
    const ratio = Math.min(devicePixelRatio || 1, 2);
    const width = Math.max(1, Math.round(canvas.clientWidth * ratio)), height = Math.max(1, Math.round(canvas.clientHeight * ratio));
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    const T = orbit ? orbitPose(orbit) : camera.T;
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.useProgram(program);
    gl.uniformMatrix4fv(place.clip, true, clipOf(camera, T));
    gl.uniform3f(place.eye, T[3], T[7], T[11]);
    gl.uniform1i(place.image, 0);
    gl.vertexAttrib4f(2, 1, 1, 1, 1);
  };
  const set = (values) => { for (const [name, value] of Object.entries(values)) gl.uniform1f(place[name], value); };
  const paintMeshes = ({ poses, parts }, before) => meshes.forEach((both, i) => {
    if (!poses[i]) return;
    const mesh = (parts && both.parts) || both.mesh;
    gl.uniformMatrix4fv(place.model, true, poses[i]);
    gl.uniform3f(place.middle, ...mesh.box.slice(0, 3));
    gl.uniform3f(place.extent, ...mesh.box.slice(3));
    gl.uniform4f(place.uvBox, ...mesh.uvBox);
    gl.bindVertexArray(mesh.vao);
    let first = 0;
    mesh.runs.forEach((run, k) => {
      before(run, i, k);
      gl.drawElements(gl.TRIANGLES, run.count, mesh.type, first * mesh.step);
      first += run.count;
    });
  });
  const paintLines = (lines, kind, color, start = 0, count = lines.count) => {
    if (count < 2) return;
    gl.uniform3f(place.base, ...color);
    gl.bindVertexArray(lines.vao);
    gl.drawArrays(kind, start, count);
  };
  const PARTS = [[0.35, 0.55, 0.85], [0.9, 0.6, 0.3], [0.45, 0.7, 0.45], [0.8, 0.45, 0.55], [0.6, 0.5, 0.8], [0.75, 0.7, 0.35], [0.4, 0.7, 0.75], [0.7, 0.55, 0.45]];
  const paint = () => {
    const shown = now(), { colors, grid: gridShown = true, lights = [], passed = 0 } = shown;
    begin(shown);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.uniform3f(place.glowColor, ...colors.glow);
    set({ fade: 0, alpha: 1 });
    paintMeshes(shown, (run, i, k) => { // runs of parts have no material
      const textured = Number.isInteger(run.texture);
      gl.uniform3f(place.base, ...(run.color || PARTS[k % PARTS.length]));
      set({ textured: textured ? 1 : 0, shade: run.color ? shown.shade : 0.6, glow: 0.5 * (lights[i] || 0) });
      if (textured) gl.bindTexture(gl.TEXTURE_2D, textures[run.texture]);
    });
    gl.uniformMatrix4fv(place.model, true, IDENTITY);
    gl.uniform3f(place.middle, 0, 0, 0);
    gl.uniform3f(place.extent, 1, 1, 1);
    gl.uniform2f(place.gridMiddle, middle[0], middle[1]);
    set({ textured: 0, shade: 0, glow: 0, fade: CELLS * cell, alpha: 0.55 });
    if (gridShown) paintLines(grid, gl.LINES, colors.grid);
    set({ fade: 0, alpha: 1 });
    const paintPath = (from, to) => { // points from..to-1, a line per strip
      for (const [k, start] of strips.entries()) {
        const first = Math.max(from, start), end = Math.min(to, strips[k + 1] ?? path.count);
        if (end > first) paintLines(path, gl.LINE_STRIP, colors.path, first, end - first);
      }
    };
    paintPath(0, passed + 1);
    set({ alpha: 0.35 });
    paintPath(passed, path.count);
    gl.bindVertexArray(null);
    painted();
  };
  /** Where the middle of an object's box is on the canvas (CSS pixels), null behind the camera. */
  const middleOf = (i) => {
    const { camera, poses } = now(), [mx, my, mz] = meshes[i].mesh.box;
    const M = multiply(clipOf(camera, orbit ? orbitPose(orbit) : camera.T), poses[i]);
    const [x, y, , w] = [0, 1, 2, 3].map((r) => M[4 * r] * mx + M[4 * r + 1] * my + M[4 * r + 2] * mz + M[4 * r + 3]);
    return w > 0 ? [(0.5 + x / w / 2) * canvas.clientWidth, (0.5 - y / w / 2) * canvas.clientHeight] : null;
  };

  /** The ray through a place of the canvas (CSS pixels): origin and direction in the world. */
  const ray = (x, y) => {
    const { camera } = now(), T = orbit ? orbitPose(orbit) : camera.T, { K, width, height } = camera;
    const a = (x / canvas.clientWidth * width - K[2]) / K[0], b = (y / canvas.clientHeight * height - K[5]) / K[4];
    return { origin: column(T, 3), direction: add(add(column(T, 2), column(T, 0), a), column(T, 1), b) };
  };

  /** Index of the object at a place of the canvas (CSS pixels), -1 for none. */
  let picking = null;
  const pick = (x, y) => {
    picking = picking || { frame: gl.createFramebuffer(), color: gl.createRenderbuffer(), depth: gl.createRenderbuffer() };
    gl.bindFramebuffer(gl.FRAMEBUFFER, picking.frame);
    for (const [buffer, format, role] of [[picking.color, gl.RGBA8, gl.COLOR_ATTACHMENT0], [picking.depth, gl.DEPTH_COMPONENT16, gl.DEPTH_ATTACHMENT]]) {
      gl.bindRenderbuffer(gl.RENDERBUFFER, buffer);
      gl.renderbufferStorage(gl.RENDERBUFFER, format, canvas.width, canvas.height);
      gl.framebufferRenderbuffer(gl.FRAMEBUFFER, role, gl.RENDERBUFFER, buffer);
    }
    const px = Math.floor(x * canvas.width / canvas.clientWidth), py = canvas.height - 1 - Math.floor(y * canvas.height / canvas.clientHeight);
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(px, py, 1, 1);
    const shown = now();
    begin(shown);
    gl.disable(gl.BLEND);
    set({ textured: 0, shade: 0, fade: 0, alpha: 1, glow: 1 });
    paintMeshes(shown, (_, i) => gl.uniform3f(place.glowColor, ((i + 1) & 255) / 255, ((i + 1) >> 8) / 255, 0));
    const found = new Uint8Array(4);
    gl.readPixels(px, py, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, found);
    gl.disable(gl.SCISSOR_TEST);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.bindVertexArray(null);
    return found[0] + 256 * found[1] - 1;
  };

  // --- hands --------------------------------------------------------------------------------------------------

  const pointers = new Map();
  let held = null; // what `grab` took over: {id, move, end}
  const placeOf = (e) => {
    const box = canvas.getBoundingClientRect();
    return [e.clientX - box.left, e.clientY - box.top];
  };
  canvas.addEventListener("pointerdown", (e) => {
    canvas.setPointerCapture(e.pointerId);
    canvas.focus({ preventScroll: true });
    const taken = e.button === 0 && !e.shiftKey && !pointers.size && !held ? grab(...placeOf(e)) : null;
    if (taken) return void (held = { id: e.pointerId, ...taken });
    pointers.set(e.pointerId, [e.clientX, e.clientY]);
  });
  canvas.addEventListener("pointermove", (e) => {
    if (held?.id === e.pointerId) return held.move(ray(...placeOf(e)));
    const before = pointers.get(e.pointerId);
    if (!before) return;
    const now = [e.clientX, e.clientY], dx = now[0] - before[0], dy = now[1] - before[1], h = canvas.clientHeight;
    if (pointers.size === 1) {
      if (e.shiftKey || e.buttons & 6) pan(dx / h, dy / h);
      else turn(dx * 3 / h, dy * 3 / h);
    } else if (pointers.size === 2) {
      const other = [...pointers].find(([id]) => id !== e.pointerId)[1];
      zoom(Math.hypot(before[0] - other[0], before[1] - other[1]) / Math.max(1, Math.hypot(now[0] - other[0], now[1] - other[1])));
      pan(dx / h / 2, dy / h / 2);
    }
    pointers.set(e.pointerId, now);
  });
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (e) => {
    pointers.delete(e.pointerId);
    if (held?.id !== e.pointerId) return;
    const { end } = held;
    held = null;
    end();
  });
  canvas.addEventListener("contextmenu", (e) => e.preventDefault());
  canvas.addEventListener("wheel", (e) => {
    if (document.activeElement !== canvas) return; // the page scrolls on
    e.preventDefault();
    zoom(Math.exp(0.0015 * e.deltaY));
  }, { passive: false });
  canvas.addEventListener("keydown", (e) => {
    if (e.ctrlKey || e.metaKey || e.altKey) return;
    const [dx, dy] = turns[e.key] || turns[e.key.toLowerCase()] || [0, 0];
    if (dx || dy) (e.shiftKey ? pan : turn)(0.08 * dx, 0.08 * dy);
    else if (e.key === "+" || e.key === "=") zoom(0.9);
    else if (e.key === "-") zoom(1.1);
    else return;
    e.preventDefault();
  });
  new ResizeObserver(draw).observe(canvas);

  return {
    cell, from, pick, draw, middleOf, ray,
    get busy() { return pointers.size > 0; },
    get fromPhoto() { return orbit === null; },
    get loaded() { return loaded === textures.length; },
  };
}
