// The 3-D view: a small WebGL 2 viewer. World axes are Z up; cameras are OpenCV's; matrices are row-major here.
(() => {
  "use strict";
  const $ = (id) => document.getElementById(id);
  addEventListener("beforeprint", () => document.querySelectorAll("details").forEach((d) => { d.open = true; }));

  const live = $("view-live"), stage = $("view-stage"), canvas = stage.querySelector("canvas");
  const gl = canvas.getContext("webgl2", { alpha: true, antialias: true, premultipliedAlpha: true });
  if (!gl) return;
  const data = JSON.parse($("scene-data").textContent);

  // --- matrices ---------------------------------------------------------------------------------------------

  const multiply = (a, b) => {
    const c = new Array(16).fill(0);
    for (let i = 0; i < 4; i++) for (let j = 0; j < 4; j++) for (let k = 0; k < 4; k++) c[4 * i + j] += a[4 * i + k] * b[4 * k + j];
    return c;
  };
  const inverseRigid = (T) => {
    const R = [T[0], T[4], T[8], T[1], T[5], T[9], T[2], T[6], T[10]], t = [T[3], T[7], T[11]];
    const u = [0, 1, 2].map((i) => -(R[3 * i] * t[0] + R[3 * i + 1] * t[1] + R[3 * i + 2] * t[2]));
    return [R[0], R[1], R[2], u[0], R[3], R[4], R[5], u[1], R[6], R[7], R[8], u[2], 0, 0, 0, 1];
  };
  const add = (a, b, s = 1) => a.map((x, i) => x + s * b[i]);
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const norm = (a) => Math.hypot(...a);
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

  // --- the graphics card ------------------------------------------------------------------------------------

  const VERTEX = `#version 300 es
    in vec3 position; in vec2 uv; in vec4 color;
    uniform mat4 clip, model; uniform vec4 uvBox; uniform vec3 middle, half_;
    out vec3 world; out vec2 texel; out vec4 tint;
    void main() {
      vec4 p = model * vec4(middle + half_ * position, 1.0);
      world = p.xyz; texel = uvBox.xy + uvBox.zw * uv; tint = color; gl_Position = clip * p;
    }`;
  const FRAGMENT = `#version 300 es
    precision highp float;
    in vec3 world; in vec2 texel; in vec4 tint;
    uniform vec3 base, eye; uniform vec2 gridMiddle; uniform float shade, textured, fade; uniform sampler2D image;
    out vec4 result;
    void main() {
      vec3 c = base * tint.rgb;
      if (textured > 0.5) c *= texture(image, texel).rgb;
      if (shade > 0.0) {
        vec3 n = normalize(cross(dFdx(world), dFdy(world)) + 1e-20);
        c *= 1.0 - shade + shade * (0.75 * abs(dot(n, normalize(eye - world))) + 0.25 * abs(n.z));
      }
      float a = fade > 0.0 ? 0.55 * (1.0 - smoothstep(0.5 * fade, fade, length(world.xy - gridMiddle))) : 1.0;
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
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) return;
  const place = {};
  for (const name of ["clip", "model", "uvBox", "middle", "half_", "base", "eye", "shade", "textured", "fade", "image", "gridMiddle"]) {
    place[name] = gl.getUniformLocation(program, name);
  }

  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const upload = (target, array) => {
    const buffer = gl.createBuffer();
    gl.bindBuffer(target, buffer);
    gl.bufferData(target, array, gl.STATIC_DRAW);
    return buffer;
  };
  const attribute = (index, text, size, type, normalized, stride) => {
    upload(gl.ARRAY_BUFFER, bytes(text));
    gl.enableVertexAttribArray(index);
    gl.vertexAttribPointer(index, size, type, normalized, stride, 0);
  };
  const meshOf = (packed) => {
    if (!packed) return null;
    const mesh = { vao: gl.createVertexArray(), box: packed.box, runs: packed.runs, uvBox: packed.uvBox || [0, 0, 1, 1] };
    gl.bindVertexArray(mesh.vao);
    attribute(0, packed.vertices, 3, gl.SHORT, true, 8);
    if (packed.uv) attribute(1, packed.uv, 2, gl.UNSIGNED_SHORT, true, 4);
    if (packed.colors) attribute(2, packed.colors, 4, gl.UNSIGNED_BYTE, true, 4);
    upload(gl.ELEMENT_ARRAY_BUFFER, bytes(packed.faces.data));
    mesh.type = packed.faces.wide ? gl.UNSIGNED_INT : gl.UNSIGNED_SHORT;
    mesh.step = packed.faces.wide ? 4 : 2;
    gl.bindVertexArray(null);
    return mesh;
  };
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
      draw();
    };
    image.src = uri;
    return texture;
  });
  const objects = data.objects.map((o) => ({ ...o, mesh: meshOf(o.mesh), parts: meshOf(o.parts) }));

  // --- the ground grid: some ten cells across the scene -------------------------------------------------------

  const [lx, ly, lz, hx, hy, hz] = data.bounds.ours;
  const middle = [(lx + hx) / 2, (ly + hy) / 2, (lz + hz) / 2];
  const radius = Math.max(1e-6, Math.hypot(hx - lx, hy - ly, hz - lz) / 2);
  const power = 10 ** Math.floor(Math.log10(radius / 4));
  const step = [1, 2, 5, 10].map((k) => k * power).find((s) => s >= radius / 6) || power;
  const grid = (() => {
    const n = 24, cx = Math.round(middle[0] / step) * step, cy = Math.round(middle[1] / step) * step, points = [];
    for (let i = -n; i <= n; i++) for (let j = -n; j < n; j++) { // cell by cell: long lines past the camera are clipped badly
      points.push(cx + i * step, cy + j * step, 0, cx + i * step, cy + (j + 1) * step, 0);
      points.push(cx + j * step, cy + i * step, 0, cx + (j + 1) * step, cy + i * step, 0);
    }
    const vao = gl.createVertexArray();
    gl.bindVertexArray(vao);
    upload(gl.ARRAY_BUFFER, new Float32Array(points));
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
    gl.bindVertexArray(null);
    return { vao, count: points.length / 3, reach: n * step };
  })();
  $("grid-step").textContent = `The grid on the ground has cells of ${step >= 1 ? `${+step.toPrecision(3)} m` : `${+(100 * step).toPrecision(3)} cm`}.`;

  // --- state ------------------------------------------------------------------------------------------------

  let mode = "ours";
  let orbit = null; // null: the photo's own camera; else target, distance, azimuth, elevation
  let photoBehind = true, namesShown = false;

  const camera = () => data.cameras[mode === "direct" ? "direct" : "ours"];
  const poseOf = () => (orbit ? orbitPose(orbit) : camera().T);
  const orbitPose = ({ target, distance, azimuth, elevation }) => {
    const forward = [Math.cos(elevation) * Math.cos(azimuth), Math.cos(elevation) * Math.sin(azimuth), -Math.sin(elevation)];
    const right = [Math.sin(azimuth), -Math.cos(azimuth), 0], down = cross(forward, right), eye = add(target, forward, -distance);
    return [right[0], down[0], forward[0], eye[0], right[1], down[1], forward[1], eye[1], right[2], down[2], forward[2], eye[2], 0, 0, 0, 1];
  };
  const startOrbit = () => { // from the photo's camera, about the point of its axis that is nearest to the scene's middle
    if (orbit) return;
    const T = camera().T, eye = [T[3], T[7], T[11]], forward = [T[2], T[6], T[10]];
    const distance = Math.max(dot(add(middle, eye, -1), forward), 0.5 * radius);
    orbit = {
      target: add(eye, forward, distance), distance,
      azimuth: Math.atan2(forward[1], forward[0]), elevation: Math.asin(Math.max(-1, Math.min(1, -forward[2]))),
    };
  };

  // --- drawing ----------------------------------------------------------------------------------------------

  const clipOf = (T) => {
    const { K, width, height } = camera(), eye = [T[3], T[7], T[11]];
    const far = norm(add(middle, eye, -1)) + 2 * radius + 2 * grid.reach, near = Math.max(far / 2000, norm(add(middle, eye, -1)) - 40 * radius);
    const P = [
      2 * K[0] / width, 2 * K[1] / width, 2 * K[2] / width - 1, 0,
      0, -2 * K[4] / height, 1 - 2 * K[5] / height, 0,
      0, 0, (far + near) / (far - near), -2 * far * near / (far - near),
      0, 0, 1, 0,
    ];
    return multiply(P, inverseRigid(T));
  };
  const PARTS = [[0.35, 0.55, 0.85], [0.9, 0.6, 0.3], [0.45, 0.7, 0.45], [0.8, 0.45, 0.55], [0.6, 0.5, 0.8], [0.75, 0.7, 0.35], [0.4, 0.7, 0.75], [0.7, 0.55, 0.45]];

  const drawMesh = (mesh, model, paint) => {
    gl.uniformMatrix4fv(place.model, true, model);
    gl.uniform3f(place.middle, ...mesh.box.slice(0, 3));
    gl.uniform3f(place.half_, ...mesh.box.slice(3));
    gl.uniform4f(place.uvBox, ...mesh.uvBox);
    gl.bindVertexArray(mesh.vao);
    let first = 0;
    mesh.runs.forEach((run, k) => {
      paint(run, k);
      gl.drawElements(gl.TRIANGLES, run.count, mesh.type, first * mesh.step);
      first += run.count;
    });
  };
  const paintMaterial = (run) => {
    const textured = run.texture !== null;
    gl.uniform3f(place.base, ...run.color);
    gl.uniform1f(place.textured, textured ? 1 : 0);
    if (textured) gl.bindTexture(gl.TEXTURE_2D, textures[run.texture]);
  };

  let asked = false;
  const draw = () => {
    if (asked) return;
    asked = true;
    requestAnimationFrame(() => { asked = false; paint(); });
  };
  const paint = () => {
    const ratio = Math.min(devicePixelRatio || 1, 2);
    const width = Math.max(1, Math.round(canvas.clientWidth * ratio)), height = Math.max(1, Math.round(canvas.clientHeight * ratio));
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    const behind = photoBehind && !orbit, T = poseOf(), clip = clipOf(T);
    stage.querySelector(".behind").style.visibility = behind ? "visible" : "hidden";
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.useProgram(program);
    gl.uniformMatrix4fv(place.clip, true, clip);
    gl.uniform3f(place.eye, T[3], T[7], T[11]);
    gl.uniform1i(place.image, 0);
    gl.uniform1f(place.fade, 0);
    gl.vertexAttrib4f(2, 1, 1, 1, 1);
    for (const o of objects) {
      const proxies = mode === "proxies" && o.parts, model = mode === "direct" ? o.direct : o.ours;
      gl.uniform1f(place.shade, proxies ? 0.6 : orbit ? 0.25 : 0);
      if (proxies) {
        gl.uniform1f(place.textured, 0);
        drawMesh(o.parts, model, (_, k) => gl.uniform3f(place.base, ...PARTS[k % PARTS.length]));
      } else drawMesh(o.mesh, model, paintMaterial);
    }
    if (!behind) {
      gl.uniformMatrix4fv(place.model, true, [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);
      gl.uniform3f(place.middle, 0, 0, 0);
      gl.uniform3f(place.half_, 1, 1, 1);
      gl.uniform1f(place.textured, 0);
      gl.uniform1f(place.shade, 0);
      gl.uniform1f(place.fade, grid.reach);
      gl.uniform2f(place.gridMiddle, middle[0], middle[1]);
      gl.uniform3f(place.base, 0.12, 0.6, 0.24);
      gl.bindVertexArray(grid.vao);
      gl.drawArrays(gl.LINES, 0, grid.count);
    }
    gl.bindVertexArray(null);
    placeNames(clip);
  };

  const labels = objects.map((o) => {
    const span = document.createElement("span");
    span.textContent = `${o.id} ${o.label}`.trim();
    span.hidden = true;
    stage.querySelector(".names").append(span);
    return span;
  });
  const placeNames = (clip) => objects.forEach((o, i) => {
    const M = multiply(clip, mode === "direct" ? o.direct : o.ours), p = [...o.mesh.box.slice(0, 3), 1];
    const [x, y, , w] = [0, 1, 2, 3].map((r) => M[4 * r] * p[0] + M[4 * r + 1] * p[1] + M[4 * r + 2] * p[2] + M[4 * r + 3]);
    labels[i].hidden = !namesShown || w <= 0;
    labels[i].style.transform =
      `translate(${(0.5 + x / w / 2) * canvas.clientWidth}px, ${(0.5 - y / w / 2) * canvas.clientHeight}px) translate(-50%, -50%)`;
  });

  // --- hands ------------------------------------------------------------------------------------------------

  const turn = (dx, dy) => {
    startOrbit();
    orbit.azimuth -= dx;
    orbit.elevation = Math.max(-1.2, Math.min(1.57, orbit.elevation + dy));
    draw();
  };
  const pan = (dx, dy) => { // in shares of the view's height
    startOrbit();
    const T = orbitPose(orbit), { K, height } = camera(), scale = orbit.distance * height / K[4];
    orbit.target = add(add(orbit.target, [T[0], T[4], T[8]], -dx * scale), [T[1], T[5], T[9]], -dy * scale);
    draw();
  };
  const zoom = (factor) => {
    startOrbit();
    orbit.distance = Math.max(0.05 * radius, Math.min(60 * radius, orbit.distance * factor));
    draw();
  };
  const press = (id, on) => $(id).setAttribute("aria-pressed", String(on));
  const choose = (next) => {
    mode = next;
    for (const name of ["direct", "ours", "proxies"]) press(`mode-${name}`, name === mode);
    draw();
  };
  const toPhoto = () => { orbit = null; draw(); };

  const pointers = new Map();
  canvas.addEventListener("pointerdown", (e) => {
    canvas.setPointerCapture(e.pointerId);
    canvas.focus({ preventScroll: true });
    pointers.set(e.pointerId, [e.clientX, e.clientY]);
  });
  canvas.addEventListener("pointermove", (e) => {
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
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (e) => pointers.delete(e.pointerId));
  canvas.addEventListener("contextmenu", (e) => e.preventDefault());
  canvas.addEventListener("wheel", (e) => {
    if (document.activeElement !== canvas) return; // the page scrolls on
    e.preventDefault();
    zoom(Math.exp(0.0015 * e.deltaY));
  }, { passive: false });
  canvas.addEventListener("keydown", (e) => {
    const [dx, dy] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[e.key] || [0, 0];
    if (dx || dy) (e.shiftKey ? pan : turn)(0.08 * dx, 0.08 * dy);
    else if (e.key === "+" || e.key === "=") zoom(0.9);
    else if (e.key === "-") zoom(1.1);
    else if (e.key === "0") toPhoto();
    else if ("123".includes(e.key)) choose(["direct", "ours", "proxies"][e.key - 1]);
    else return;
    e.preventDefault();
  });
  for (const name of ["direct", "ours", "proxies"]) $(`mode-${name}`).addEventListener("click", () => choose(name));
  $("photo-view").addEventListener("click", toPhoto);
  $("photo-behind").addEventListener("click", () => { photoBehind = !photoBehind; press("photo-behind", photoBehind); draw(); });
  $("names").addEventListener("click", () => { namesShown = !namesShown; press("names", namesShown); draw(); });
  canvas.addEventListener("webglcontextlost", (e) => { e.preventDefault(); live.hidden = true; $("view-still").hidden = false; });

  live.hidden = false;
  $("view-still").hidden = true;
  const { width, height } = data.cameras.ours;
  stage.style.aspectRatio = `${width} / ${height}`;
  new ResizeObserver(draw).observe(stage);
  draw();
})();
