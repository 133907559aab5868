// Where the photo is on the canvas, and which gesture means what: one pointer draws, two or Space move and zoom.
const viewportOf = (canvas, photo, hands) => {
  "use strict";
  const { onView, onStart, onMove, onEnd, onDrop } = hands;
  const MOST = 24; // CSS pixels of a pixel of the photo
  const STEP = 1.25; // of a key and of a button
  let scale = 1, x = 0, y = 0; // CSS pixels per pixel of the photo, and the photo's corner
  let fitted = true, space = false;
  const size = () => ({ width: canvas.clientWidth, height: canvas.clientHeight });
  const fitScale = () => Math.min(size().width / photo.width, size().height / photo.height) || 1;

  const bounded = () => { // centred, or so that it fills a good part of the canvas
    const { width, height } = size();
    const wide = photo.width * scale, tall = photo.height * scale;
    if (wide <= width) x = (width - wide) / 2;
    else x = Math.max(width * 0.7 - wide, Math.min(x, width * 0.3));
    if (tall <= height) y = (height - tall) / 2;
    else y = Math.max(height * 0.7 - tall, Math.min(y, height * 0.3));
  };
  const fit = () => {
    scale = fitScale();
    fitted = true;
    bounded();
    onView();
  };
  const zoom = (factor, cx = size().width / 2, cy = size().height / 2) => {
    const next = Math.max(fitScale(), Math.min(MOST, scale * factor));
    x = cx - ((cx - x) * next) / scale;
    y = cy - ((cy - y) * next) / scale;
    scale = next;
    fitted = next <= fitScale() * 1.001;
    bounded();
    onView();
  };
  const pan = (dx, dy) => {
    x += dx;
    y += dy;
    bounded();
    onView();
  };
  const toPhoto = (cx, cy) => [
    Math.max(0, Math.min(photo.width, (cx - x) / scale)), Math.max(0, Math.min(photo.height, (cy - y) / scale)),
  ];

  scale = fitScale();
  bounded();

  // --- gestures ----------------------------------------------------------------------------------------------------

  const pointers = new Map();
  let doing = null; // "draw", "pan", "pinch", or "over": fingers that are left after a pinch
  const place = (e) => {
    const at = canvas.getBoundingClientRect();
    return [e.clientX - at.left, e.clientY - at.top];
  };
  const spread = () => {
    const [a, b] = [...pointers.values()];
    return { cx: (a[0] + b[0]) / 2, cy: (a[1] + b[1]) / 2, apart: Math.max(1, Math.hypot(a[0] - b[0], a[1] - b[1])) };
  };
  let before = null;
  canvas.addEventListener("pointerdown", (e) => {
    if (e.pointerType === "mouse" && e.button > 1) return;
    canvas.setPointerCapture(e.pointerId);
    canvas.focus({ preventScroll: true });
    pointers.set(e.pointerId, place(e));
    if (pointers.size === 2) {
      if (doing === "draw") onDrop();
      doing = "pinch";
      before = spread();
    } else if (pointers.size > 2) doing = "over";
    else if (e.button === 1 || space) doing = "pan";
    else {
      doing = "draw";
      onStart(place(e), e.pointerType);
    }
    e.preventDefault();
  });
  canvas.addEventListener("pointermove", (e) => {
    const last = pointers.get(e.pointerId);
    if (!last) return;
    const events = doing === "draw" && e.getCoalescedEvents ? e.getCoalescedEvents() : [];
    const at = place(e);
    pointers.set(e.pointerId, at);
    if (doing === "draw") for (const one of events.length ? events : [e]) onMove(place(one));
    else if (doing === "pan") pan(at[0] - last[0], at[1] - last[1]);
    else if (doing === "pinch") {
      const now = spread();
      pan(now.cx - before.cx, now.cy - before.cy);
      zoom(now.apart / before.apart, now.cx, now.cy);
      before = now;
    }
  });
  const ended = (e, dropped) => {
    if (!pointers.delete(e.pointerId)) return;
    if (doing === "draw") (dropped ? onDrop : onEnd)();
    doing = pointers.size ? "over" : null;
  };
  canvas.addEventListener("pointerup", (e) => ended(e, false));
  canvas.addEventListener("pointercancel", (e) => ended(e, true));
  canvas.addEventListener("wheel", (e) => {
    e.preventDefault();
    if (e.shiftKey) return pan(-e.deltaY - e.deltaX, 0);
    zoom(Math.exp(-Math.max(-60, Math.min(60, e.deltaMode ? 20 * e.deltaY : e.deltaY)) / (e.ctrlKey ? 80 : 300)), ...place(e));
  }, { passive: false });
  new ResizeObserver(() => {
    if (fitted) fit();
    else zoom(1);
  }).observe(canvas);

  return {
    fit, pan, toPhoto,
    zoomIn: () => zoom(STEP),
    zoomOut: () => zoom(1 / STEP),
    toCanvas: ([px, py]) => [x + scale * px, y + scale * py],
    drop() {
      if (doing !== "draw") return;
      doing = "over";
      onDrop();
    },
    set panning(on) {
      space = on;
      canvas.classList.toggle("pans", on);
    },
    get scale() { return scale; },
    get fitScale() { return fitScale(); },
  };
};
