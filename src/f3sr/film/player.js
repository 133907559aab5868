// The player: one frame number that the film, the 3-D view and the timeline share. Frame k is shown from k / fps on.
(() => {
  "use strict";
  const $ = (id) => document.getElementById(id);
  const data = JSON.parse($("player-data").textContent);
  const last = data.frames - 1, film = $("film"), slider = $("slider");
  let frame = 0, playing = false, rate = 1, repeat = false;
  let filmFrame = -1; // the one that the film really shows, where the browser tells
  let filmFails = false;

  for (const screen of document.querySelectorAll(".screen")) screen.style.aspectRatio = screen.dataset.aspect;
  film.controls = false;
  $("controls").hidden = false;
  slider.disabled = false;
  const framed = parent !== window; // in another page, which knows the goal and gives as much height as is needed
  document.documentElement.classList.toggle("framed", framed);
  if (framed) new ResizeObserver(() => parent.postMessage({ height: document.body.offsetHeight }, "*")).observe(document.body);

  // --- the rollout ----------------------------------------------------------------------------------------------

  const floats = new Float32Array(Uint8Array.from(atob(data.poses), (c) => c.charCodeAt(0)).buffer);
  const count = data.ids.length;
  const matrix = (k, i) => {
    const [x, y, z, w, a, b, c] = floats.subarray(7 * (k * count + i), 7 * (k * count + i) + 7);
    return [
      1 - 2 * (b * b + c * c), 2 * (a * b - w * c), 2 * (a * c + w * b), x,
      2 * (a * b + w * c), 1 - 2 * (a * a + c * c), 2 * (b * c - w * a), y,
      2 * (a * c - w * b), 2 * (b * c + w * a), 1 - 2 * (a * a + b * b), z,
      0, 0, 0, 1,
    ];
  };
  const indexOf = new Map(data.ids.map((id, i) => [id, i]));
  const nameOf = (id) => (id < 0 ? "the ground" : data.names[indexOf.get(id)]);
  const strongest = Math.max(1e-9, ...data.contacts.flatMap((c) => c.forces));
  const touchingAt = (k) => data.contacts.filter((c) => c.forces[k] > 0).sort((c, d) => d.forces[k] - c.forces[k]);
  const lightsAt = (k) => { // what is struck lights up by the root of the force, as high as its bar on the timeline
    const lights = new Array(count).fill(0);
    for (const c of touchingAt(k)) for (const id of [c.a, c.b]) {
      if (id >= 0) lights[indexOf.get(id)] = Math.max(lights[indexOf.get(id)], Math.sqrt(c.forces[k] / strongest));
    }
    return lights;
  };

  // --- the 3-D view ---------------------------------------------------------------------------------------------

  const canvas = $("view");
  const colors = () => {
    const style = getComputedStyle(canvas);
    const read = (name) => style.getPropertyValue(name).trim().split(" ").map((n) => n / 255);
    return { grid: read("--grid"), path: read("--way"), glow: read("--glow") };
  };
  let shown = null; // the last frame's poses, lights and points of the path that are behind
  const look = () => ({ camera: data.view.camera, shade: 0.25, colors: colors(), ...shown });
  let view = view3d(canvas, data.view, { look, turns: { a: [-1, 0], d: [1, 0], w: [0, -1], s: [0, 1] } });
  const withoutView = (lost) => {
    $("no-view").hidden = !lost;
    $("no-view").textContent = "The 3-D view needs WebGL 2, which this browser lacks. The film and the timeline still work.";
    canvas.hidden = lost;
    for (const name of ["photo", "top", "side"]) $(`from-${name}`).disabled = lost;
  };
  withoutView(!view);
  if (view) {
    const cell = view.cell;
    $("cell").textContent = `Grid cells are ${cell >= 1 ? `${+cell.toPrecision(3)} m` : `${+(100 * cell).toPrecision(3)} cm`}.`;
    for (const name of ["photo", "top", "side"]) $(`from-${name}`).addEventListener("click", () => view.from(name));
    canvas.addEventListener("keydown", (e) => {
      if ("123".includes(e.key)) view.from(["photo", "top", "side"][e.key - 1]);
    });
    canvas.addEventListener("webglcontextlost", () => { view = null; withoutView(true); });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => view && view.draw());
  }
  const label = $("name");
  const hover = (e) => {
    const at = canvas.getBoundingClientRect(), x = e.clientX - at.left, y = e.clientY - at.top;
    const found = view && !view.busy && x >= 0 && y >= 0 && x < at.width && y < at.height ? view.pick(x, y) : -1;
    label.hidden = found < 0;
    if (found < 0) return;
    label.textContent = data.names[found];
    label.style.left = `${Math.min(x + 12, at.width - label.offsetWidth - 4)}px`;
    label.style.top = `${Math.min(y + 14, at.height - label.offsetHeight - 4)}px`;
  };
  let hovering = 0;
  canvas.addEventListener("pointermove", (e) => {
    cancelAnimationFrame(hovering);
    hovering = requestAnimationFrame(() => hover(e));
  });
  canvas.addEventListener("pointerleave", () => { cancelAnimationFrame(hovering); label.hidden = true; });

  // --- the shared frame -------------------------------------------------------------------------------------------

  const head = $("head"), lane = $("lane"), where = $("where"), touching = $("touching");
  const moments = [...document.querySelectorAll("#moments button")];
  const secondsAt = (k) => k * data.step;
  const show = (k) => {
    frame = k;
    head.style.left = `${(100 * k) / Math.max(1, last)}%`;
    slider.value = k;
    const time = secondsAt(k).toFixed(2);
    slider.setAttribute("aria-valuetext", `frame ${k} of ${last}, ${time} seconds`);
    where.textContent = `frame ${k} / ${last} · ${time} s`;
    touching.textContent = touchingAt(k).slice(0, 3)
      .map((c) => `${nameOf(c.b)} – ${nameOf(c.a)}: ${c.forces[k] < 10 ? c.forces[k].toFixed(1) : Math.round(c.forces[k])} N`).join("\n");
    const reached = moments.filter((b) => Number(b.dataset.frame) <= k).pop();
    for (const b of moments) b.setAttribute("aria-current", String(b === reached));
    shown = { poses: data.ids.map((_, i) => matrix(k, i)), lights: lightsAt(k), passed: k };
    if (view) view.draw();
  };

  // --- the film: asked for the middle of a frame, one request at a time ---------------------------------------------

  let wanted = null;
  const ask = () => {
    const time = (wanted + 0.5) / data.fps;
    wanted = null;
    if (Math.abs(film.currentTime - time) > 0.25 / data.fps || filmFrame < 0) film.currentTime = time;
  };
  const showFilm = (k) => {
    if (filmFails) return;
    wanted = k;
    if (!film.seeking && film.readyState > 0) ask();
  };
  film.addEventListener("seeked", () => { if (wanted !== null) ask(); });
  film.addEventListener("loadedmetadata", () => showFilm(frame));
  film.addEventListener("error", () => {
    filmFails = true;
    $("no-film").hidden = false;
    if (playing) tick(performance.now());
  });
  const told = "requestVideoFrameCallback" in HTMLVideoElement.prototype;
  const follow = (_, about) => {
    filmFrame = Math.min(last, Math.round(about.mediaTime * data.fps));
    if (playing) show(filmFrame);
    film.requestVideoFrameCallback(follow);
  };
  if (told) film.requestVideoFrameCallback(follow);

  // --- playing: the film leads; where it cannot, or does not tell its frames, a clock does ----------------------------

  let started = null; // of the clock: [time, frame]
  const tick = (now) => {
    if (!playing || (told && !filmFails)) return;
    if (filmFails) {
      started = started || [now, frame];
      const k = Math.min(last, started[1] + Math.floor(((now - started[0]) / 1000) * data.fps * rate));
      if (k !== frame) show(k);
      if (k === last) return ended();
    } else show(Math.min(last, Math.floor(film.currentTime * data.fps + 1e-3)));
    requestAnimationFrame(tick);
  };
  const state = (on) => {
    playing = on;
    started = null;
    $("play").textContent = on ? "Pause" : "Play";
  };
  const pause = () => {
    state(false);
    film.pause();
    showFilm(frame);
  };
  const play = () => {
    if (frame === last) show(0);
    state(true);
    if (filmFails) return requestAnimationFrame(tick);
    film.playbackRate = rate;
    wanted = null;
    film.currentTime = (frame + 0.5) / data.fps;
    film.play().then(() => requestAnimationFrame(tick), () => { if (playing && !filmFails) pause(); });
  };
  const ended = () => {
    if (!playing) return;
    state(false);
    show(last);
    if (repeat) play();
    else showFilm(last);
  };
  film.addEventListener("ended", ended);
  const seek = (k) => {
    const next = Math.max(0, Math.min(last, Math.round(k)));
    if (playing) pause();
    show(next);
    showFilm(next);
  };
  const toggle = () => (playing ? pause() : play());

  // --- hands ------------------------------------------------------------------------------------------------------

  $("play").addEventListener("click", toggle);
  film.addEventListener("click", toggle);
  $("back").addEventListener("click", () => seek(frame - 1));
  $("on").addEventListener("click", () => seek(frame + 1));
  $("speed").addEventListener("change", (e) => {
    rate = Number(e.target.value);
    started = null;
    film.playbackRate = rate;
  });
  $("repeat").addEventListener("click", () => {
    repeat = !repeat;
    $("repeat").setAttribute("aria-pressed", String(repeat));
  });
  slider.addEventListener("input", () => seek(Number(slider.value)));
  for (const b of moments) b.addEventListener("click", () => seek(Number(b.dataset.frame)));
  for (const b of document.querySelectorAll("#timeline .mark")) { // the first frame that shows it
    b.addEventListener("click", () => seek(Math.ceil(b.dataset.time / data.step - 1e-3)));
  }
  for (const at of document.querySelectorAll("[data-at]")) at.style.left = `${100 * at.dataset.at}%`;

  const timeline = $("timeline");
  const seekAt = (e) => {
    const { left, width } = lane.getBoundingClientRect();
    seek(((e.clientX - left) / Math.max(1, width)) * last);
  };
  let dragging = false;
  timeline.addEventListener("pointerdown", (e) => {
    if (e.button !== 0 || !e.target.closest(".track") || e.target.closest("button")) return;
    dragging = true;
    timeline.setPointerCapture(e.pointerId);
    seekAt(e);
  });
  timeline.addEventListener("pointermove", (e) => { if (dragging) seekAt(e); });
  for (const name of ["pointerup", "pointercancel"]) timeline.addEventListener(name, () => { dragging = false; });

  addEventListener("keydown", (e) => {
    if (e.ctrlKey || e.metaKey || e.altKey || e.target === $("speed")) return;
    const step = e.shiftKey ? 10 : 1, control = e.target.closest("button, summary");
    if (e.key === "ArrowLeft") seek(frame - step);
    else if (e.key === "ArrowRight") seek(frame + step);
    else if (e.key === "Home") seek(0);
    else if (e.key === "End") seek(last);
    else if (e.key === " " && !control) toggle();
    else return;
    e.preventDefault();
  });

  show(0);
  if (film.readyState > 0) showFilm(0);
  if (film.error) film.dispatchEvent(new Event("error"));

  /** What tests and curious people may ask. */
  window.player = {
    get frame() { return frame; },
    get filmFrame() { return filmFrame; },
    get playing() { return playing; },
    get view() { return view; },
    frames: data.frames, ids: data.ids, contacts: data.contacts,
    seek, play, pause,
    poseOf: (id) => matrix(frame, indexOf.get(id)),
    touching: () => touchingAt(frame).map((c) => [c.a, c.b]),
    /** Whether the film, or word that there is none, and all textures are here. */
    get loaded() { return (filmFails || film.readyState > 1) && (!view || view.loaded); },
  };
  if (framed) film.addEventListener("loadeddata", play, { once: true }); // somebody has just asked for it
})();
