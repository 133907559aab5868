// The page: tools, list and canvas over one set of marks; the server makes the masks.
(async () => {
  "use strict";
  const $ = (id) => document.getElementById(id);
  const COLOURS = ["#ff7a1a", "#2f8dff", "#ffd21a", "#e250d8", "#14c4c9", "#ff4b55", "#a77bff", "#b8e038", "#ff9ec4", "#f2efe6"];
  const LEAST = 4; // CSS pixels that a drag must have to be a box, and pixels of its sides
  const NEAR = { mouse: 9, pen: 14, touch: 24 }; // CSS pixels from a corner that still take it
  const MOST_POINTS = 1000; // of a stroke
  const SAVE = parent === window ? "Save" : "Save and go on";
  const FRAMED = parent !== window; // in another page of the same server, which goes on once this one has saved
  const NO_SERVER = "The program in the terminal does not answer. If it has ended, nothing more can be saved here.";

  const post = async (name, value) => {
    const answer = await fetch(name, { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(value) });
    const text = await answer.text();
    let told = {};
    try { told = JSON.parse(text); } catch { told = { problem: text.trim() }; }
    if (!answer.ok) throw Object.assign(new Error(told.problem || `status ${answer.status}`), { status: answer.status });
    return told;
  };
  const line = (text) => { if ($("line").textContent !== text) $("line").textContent = text; };
  const say = (text) => { $("said").textContent = text; };
  const loaded = (src) => new Promise((done, failed) => {
    const image = new Image();
    image.onload = () => done(image);
    image.onerror = () => failed(new Error("a picture of the server cannot be shown"));
    image.src = src;
  });

  let given, photo;
  try {
    given = await post("open", {});
    photo = await loaded("photo.jpg");
  } catch (error) {
    line(error.status ? error.message : NO_SERVER);
    return;
  }
  const marks = marksOf(given.selection);
  $("stage").style.setProperty("--shape", `${given.photo.width} / ${given.photo.height}`);
  const canvas = $("canvas"), paper = canvas.getContext("2d");
  const shrink = given.photo.shown[0] / given.photo.width; // shown pixels of a pixel of the photo
  const masks = new Map(); // by key: what the server found, as pictures
  let mode = "box", selected = null, drawn = null, sleeping = false, closing = false, done = false; // closing: the server ends with its answer, or goes on

  // --- masks from the server: one question at a time, the last answer counts -------------------------------------------

  const PAUSE = 400; // milliseconds without a change, after which the ground is asked for too
  let revision = given.revision, answered = -1, grounded = -1, asking = false, pause = 0;
  const promptOf = (key) => JSON.stringify([marks.of(key).box, marks.of(key).inside, marks.of(key).outside]);
  const colourOf = (key) => (key === "ground" ? getComputedStyle(document.documentElement).getPropertyValue("--ground-mark").trim() : COLOURS[(key - 1) % COLOURS.length]);
  const changed = () => {
    revision += 1;
    if (selected !== null && !marks.of(selected)) selected = null;
    show();
    ask();
  };
  const ask = async () => {
    if (asking || sleeping || closing || done) return;
    asking = true;
    const asked = revision, prompts = new Map(marks.objects.map((o) => [o.key, promptOf(o.key)]));
    try {
      const told = await post("outline", { page: given.page, revision: asked, selection: marks.selection() });
      if (asked === revision && !told.stale) {
        await taken(told, prompts);
        answered = asked;
        line("");
      }
    } catch (error) {
      if (asked === revision) refused(error);
    }
    asking = false;
    if (asked !== revision) return ask();
    clearTimeout(pause);
    pause = setTimeout(askGround, PAUSE);
    show();
  };
  const askGround = async () => {
    if (done || closing || sleeping) return;
    const asked = revision;
    try {
      const told = await post("ground", { page: given.page, revision: asked });
      if (asked !== revision || told.stale) return;
      await keep("ground", told.ground);
      grounded = asked;
    } catch (error) {
      if (asked === revision) refused(error);
    }
    show();
  };
  const refused = (error) => {
    if (error.status === 409) sleep();
    else answered = revision;
    line(error.status ? error.message : NO_SERVER);
  };
  const sleep = () => {
    sleeping = true;
    for (const b of document.querySelectorAll("#work button, #work input")) b.disabled = true;
  };
  const keep = async (key, mask, prompt) => {
    const old = masks.get(key), png = mask && `${mask.x} ${mask.y} ${mask.png}`;
    if (old && old.png === png) return void (old.prompt = prompt);
    const image = mask && (await loaded(`data:image/png;base64,${mask.png}`));
    masks.set(key, { png, image, prompt, x: mask ? mask.x : 0, y: mask ? mask.y : 0 });
  };
  const taken = async (told, prompts) => {
    for (const key of masks.keys()) if (key !== "ground" && !prompts.has(key)) masks.delete(key);
    await Promise.all([...prompts].map(([key, prompt], k) => keep(key, told.masks[k], prompt)));
    const last = marks.objects.at(-1);
    if (last && masks.get(last.key)?.image) say(`Object ${marks.objects.length} is outlined.`);
  };

  // --- the canvas --------------------------------------------------------------------------------------------------------

  const layerOf = (key, mask) => { // its colour and outline, made once for each size of the canvas
    const thick = Math.max(1, 1.7 / (view.fitScale / shrink));
    const colour = colourOf(key);
    if (mask.layer && mask.layer.thick === thick && mask.layer.colour === colour) return mask.layer;
    const rim = Math.ceil(2 * thick) + 1, { width, height } = mask.image;
    const made = (paint) => {
      const c = document.createElement("canvas");
      c.width = width + 2 * rim;
      c.height = height + 2 * rim;
      paint(c.getContext("2d"), c);
      return c;
    };
    const ring = (radius, paint) => made((d, c) => {
      for (let k = 0; k < 16; k++) d.drawImage(mask.image, rim + radius * Math.cos((k * Math.PI) / 8), rim + radius * Math.sin((k * Math.PI) / 8));
      d.globalCompositeOperation = "source-in";
      d.fillStyle = paint;
      d.fillRect(0, 0, c.width, c.height);
      d.globalCompositeOperation = "destination-out";
      d.drawImage(mask.image, rim, rim);
    });
    const tint = made((d, c) => {
      d.drawImage(mask.image, rim, rim);
      d.globalCompositeOperation = "source-in";
      d.fillStyle = colour;
      d.fillRect(0, 0, c.width, c.height);
    });
    const edge = made((d) => {
      d.drawImage(ring(1.7 * thick, "rgb(0 0 0 / .55)"), 0, 0);
      d.drawImage(ring(thick, colour), 0, 0);
    });
    mask.layer = { tint, edge, rim, thick, colour };
    return mask.layer;
  };
  const drawMask = (key) => {
    const mask = masks.get(key);
    if (!mask || !mask.image) return;
    const { tint, edge, rim } = layerOf(key, mask);
    const [x, y] = view.toCanvas([(mask.x - rim) / shrink, (mask.y - rim) / shrink]);
    const by = view.scale / shrink;
    const chosen = key === selected, quiet = key === "ground" && !chosen && mode !== "ground";
    paper.globalAlpha = quiet ? 0.14 : chosen ? 0.42 : 0.28;
    paper.drawImage(tint, x, y, tint.width * by, tint.height * by);
    paper.globalAlpha = quiet ? 0 : 1;
    paper.drawImage(edge, x, y, edge.width * by, edge.height * by);
    paper.globalAlpha = 1;
  };
  const around = (o) => { // its box; where nobody drew one, what encloses its mask or its strokes
    if (o.box) return o.box;
    const mask = masks.get(o.key);
    if (mask?.image) return [mask.x, mask.y, mask.x + mask.image.width, mask.y + mask.image.height].map((v) => v / shrink);
    const points = o.inside.flat(), xs = points.map((p) => p[0]), ys = points.map((p) => p[1]);
    return [Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)];
  };
  const drawStroke = (stroke, colour) => {
    const way = new Path2D();
    const points = stroke.map(view.toCanvas);
    if (points.length === 1) way.arc(points[0][0], points[0][1], 1.5, 0, 7);
    else points.forEach(([x, y], k) => (k ? way.lineTo(x, y) : way.moveTo(x, y)));
    paper.lineCap = paper.lineJoin = "round";
    for (const [width, paint] of [[6, "#fff"], [3.5, colour]]) {
      paper.lineWidth = width;
      paper.strokeStyle = paint;
      paper.stroke(way);
    }
  };
  const drawBox = (box, colour, { dashed = false, corners = false } = {}) => {
    const [l, t] = view.toCanvas(box), [r, b] = view.toCanvas(box.slice(2));
    paper.setLineDash(dashed ? [6, 4] : []);
    paper.lineDashOffset = asking && !still.matches ? (performance.now() / 40) % 10 : 0;
    for (const [width, paint] of [[3.5, "rgb(0 0 0 / .6)"], [1.75, colour]]) {
      paper.lineWidth = width;
      paper.strokeStyle = paint;
      paper.strokeRect(l, t, r - l, b - t);
    }
    paper.setLineDash([]);
    if (!corners) return;
    for (const [x, y] of [[l, t], [r, t], [r, b], [l, b]]) {
      paper.fillStyle = "#fff";
      paper.strokeStyle = "#000";
      paper.lineWidth = 1;
      paper.fillRect(x - 4.5, y - 4.5, 9, 9);
      paper.strokeRect(x - 4.5, y - 4.5, 9, 9);
    }
  };
  const drawTag = (o, k) => {
    const box = around(o), [x, y] = view.toCanvas(box), [r] = view.toCanvas(box.slice(2));
    paper.font = "600 13px system-ui, sans-serif";
    const wide = (text) => paper.measureText(text).width;
    let text = `${k + 1} ${o.label}`.trim();
    if (o.key !== selected && wide(text) > r - x) text = `${k + 1}`;
    while (text.length > 6 && wide(text) > Math.max(90, r - x)) text = `${text.slice(0, -2).trimEnd()}…`;
    const width = wide(text) + 10, left = Math.max(0, Math.min(x, canvas.clientWidth - width)), top = Math.max(0, y - 20);
    paper.fillStyle = "rgb(12 14 18 / .82)";
    paper.fillRect(left, top, width, 19);
    paper.fillStyle = colourOf(o.key);
    paper.fillRect(left, top, 3, 19);
    paper.fillStyle = "#fff";
    paper.fillText(text, left + 6, top + 14);
  };
  const still = matchMedia("(prefers-reduced-motion: reduce)");
  let drawing = 0;
  const draw = () => {
    cancelAnimationFrame(drawing);
    drawing = requestAnimationFrame(paint);
  };
  const paint = () => {
    const dense = devicePixelRatio || 1, width = Math.round(canvas.clientWidth * dense), height = Math.round(canvas.clientHeight * dense);
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    paper.setTransform(dense, 0, 0, dense, 0, 0);
    paper.clearRect(0, 0, canvas.clientWidth, canvas.clientHeight);
    const [x, y] = view.toCanvas([0, 0]);
    paper.imageSmoothingEnabled = view.scale < 6;
    paper.drawImage(photo, x, y, given.photo.width * view.scale, given.photo.height * view.scale);
    drawMask("ground");
    for (const o of marks.objects) drawMask(o.key);
    for (const o of marks.objects) {
      const dragged = drawn && drawn.kind === "corner" && o.key === drawn.key;
      if (dragged || !o.box) continue;
      const waits = asking && masks.get(o.key)?.prompt !== promptOf(o.key);
      if (o.key === selected || waits || !masks.get(o.key)?.image) {
        drawBox(o.box, colourOf(o.key), { dashed: waits, corners: o.key === selected && mode === "box" });
      }
    }
    const target = selected !== null && marks.of(selected);
    if (target) {
      for (const stroke of target.inside) drawStroke(stroke, "#12823a");
      for (const stroke of target.outside) drawStroke(stroke, "#c81e1e");
    }
    marks.objects.forEach(drawTag);
    if (drawn && drawn.box) drawBox(drawn.box, drawn.key ? colourOf(drawn.key) : "#fff", { dashed: true });
    if (drawn && drawn.stroke) drawStroke(drawn.stroke, drawn.side === "inside" ? "#12823a" : "#c81e1e");
    if (asking && !still.matches) draw(); // dashes move while the server works
  };

  // --- drawing ------------------------------------------------------------------------------------------------------------

  const boxOf = ([a, b], [c, d]) => [Math.min(a, c), Math.min(b, d), Math.max(a, c), Math.max(b, d)];
  const cornerAt = (at, kind) => { // the opposite corner, of the selected box, where one is near
    const o = selected !== "ground" && selected !== null && marks.of(selected);
    if (!o || !o.box) return null;
    const [l, t, r, b] = o.box;
    for (const [x, y, fx, fy] of [[l, t, r, b], [r, t, l, b], [r, b, l, t], [l, b, r, t]]) {
      const [cx, cy] = view.toCanvas([x, y]);
      if (Math.hypot(cx - at[0], cy - at[1]) <= (NEAR[kind] || NEAR.mouse)) return { key: o.key, from: [fx, fy] };
    }
    return null;
  };
  const probe = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
  const covers = (mask, [px, py]) => {
    probe.canvas.width = probe.canvas.height = 1;
    probe.drawImage(mask.image, mask.x - Math.floor(px * shrink), mask.y - Math.floor(py * shrink));
    return probe.getImageData(0, 0, 1, 1).data[3] > 0;
  };
  const objectAt = (p) => { // the one whose mask is there; else the smallest box around the point
    const area = ([l, t, r, b]) => (r - l) * (b - t);
    const inside = marks.objects.map((o) => [o, around(o)]).filter(([, [l, t, r, b]]) => p[0] >= l && p[0] <= r && p[1] >= t && p[1] <= b);
    const smallest = inside.sort(([, a], [, b]) => area(a) - area(b)).map(([o]) => o)[0];
    return marks.objects.find((o) => masks.get(o.key)?.image && covers(masks.get(o.key), p)) || smallest;
  };
  const onStart = (at, kind) => {
    if (sleeping) return;
    const p = view.toPhoto(...at);
    line("");
    if (mode === "box") {
      const corner = cornerAt(at, kind);
      drawn = { kind: corner ? "corner" : "box", pointer: kind, start: at, at, from: corner ? corner.from : p, key: corner ? corner.key : null, box: null };
      return;
    }
    if (mode === "ground") selected = "ground";
    else if (selected === null) selected = marks.objects.length === 1 ? marks.objects[0].key : objectAt(p)?.key ?? null;
    if (selected === null) return line("Select an object first: click its number, or draw a box around it.");
    drawn = { kind: "stroke", side: mode === "remove" ? "outside" : "inside", key: selected, stroke: [p], at };
    show();
  };
  const onMove = (at) => {
    if (!drawn) return;
    const p = view.toPhoto(...at);
    if (drawn.stroke) {
      if (drawn.stroke.length < MOST_POINTS && Math.hypot(at[0] - drawn.at[0], at[1] - drawn.at[1]) >= 2) {
        drawn.stroke.push(p);
        drawn.at = at;
      }
    } else {
      drawn.at = at;
      drawn.box = boxOf(drawn.from, p);
    }
    draw();
  };
  const onEnd = () => {
    const drew = drawn;
    drawn = null;
    if (!drew) return;
    if (drew.stroke) {
      marks.draw(drew.key, drew.side, rounded(drew.stroke));
      return changed();
    }
    const moved = Math.hypot(drew.at[0] - drew.start[0], drew.at[1] - drew.start[1]);
    if (moved < LEAST) {
      select(objectAt(view.toPhoto(...drew.start))?.key ?? null);
    } else if (drew.box[2] - drew.box[0] < LEAST || drew.box[3] - drew.box[1] < LEAST) {
      line("This box is too thin. Drag from one corner of the object to the opposite one.");
      draw();
    } else if (drew.kind === "corner") {
      marks.move(drew.key, rounded([drew.box])[0]);
      changed();
    } else {
      selected = marks.add(rounded([drew.box])[0]);
      changed();
      if (drew.pointer === "mouse") rows.get(selected).input.focus();
    }
  };
  const onDrop = () => {
    drawn = null;
    draw();
  };
  const rounded = (points) => points.map((p) => p.map((v) => Math.round(100 * v) / 100));
  const view = viewportOf(canvas, given.photo, { onView: draw, onStart, onMove, onEnd, onDrop });

  // --- list and tools ---------------------------------------------------------------------------------------------------------

  const rows = new Map();
  const element = (kind, values) => Object.assign(document.createElement(kind), values);
  const rowOf = (key) => {
    const row = element("li", {});
    const pick = element("button", { type: "button", className: "pick" });
    const swatch = element("span", { className: "swatch" }), number = element("span", {});
    swatch.style.background = colourOf(key);
    pick.append(swatch, number);
    const input = element("input", { type: "text", maxLength: 80, autocomplete: "off", placeholder: "name it, e.g. mug", spellcheck: false, enterKeyHint: "done" });
    const state = element("span", { className: "state" });
    const remove = element("button", { type: "button", className: "delete", textContent: "×" });
    row.append(pick, input, state, remove);
    pick.addEventListener("click", () => select(selected === key ? null : key));
    input.addEventListener("focus", () => { if (selected !== key) select(key); });
    input.addEventListener("change", () => {
      marks.name(key, input.value.trim());
      changed();
    });
    input.addEventListener("keydown", (e) => {
      if (e.key !== "Enter" && e.key !== "Escape") return;
      e.preventDefault();
      e.stopPropagation();
      canvas.focus();
    });
    remove.addEventListener("click", () => deleted(key));
    return { row, pick, number, input, state, remove };
  };
  const stateOf = (key) => {
    const mask = masks.get(key);
    if (mask && mask.image && mask.prompt === promptOf(key)) return ["", false];
    if (answered === revision) return ["not found", true];
    return ["…", false];
  };
  const show = () => {
    marks.objects.forEach((o, k) => {
      if (!rows.has(o.key)) rows.set(o.key, rowOf(o.key));
      const { row, pick, number, input, state, remove } = rows.get(o.key);
      if ($("objects").children[k] !== row) $("objects").insertBefore(row, $("objects").children[k] || null);
      const what = `object ${k + 1}${o.label ? `, ${o.label}` : ""}`;
      number.textContent = k + 1;
      pick.setAttribute("aria-label", `Select ${what}`);
      remove.setAttribute("aria-label", `Delete ${what}`);
      remove.title = "Delete (Del)";
      input.setAttribute("aria-label", `Name of object ${k + 1}`);
      if (document.activeElement !== input) input.value = o.label;
      const [text, bad] = stateOf(o.key);
      state.textContent = text;
      state.classList.toggle("bad", bad);
      chosen(row, pick, o.key);
    });
    for (const [key, { row }] of rows) if (!marks.of(key)) {
      row.remove();
      rows.delete(key);
    }
    const strokes = marks.ground.inside.length + marks.ground.outside.length;
    const looking = grounded !== revision && revision > given.revision;
    $("ground-state").textContent = looking ? "…" : strokes ? `${strokes} ${strokes === 1 ? "stroke" : "strokes"}` : "found by itself";
    $("clear-ground").hidden = !strokes;
    chosen($("ground-row"), $("pick-ground"), "ground");
    $("none").hidden = marks.objects.length > 0;
    $("undo").disabled = sleeping || !marks.canUndo;
    $("redo").disabled = sleeping || !marks.canRedo;
    $("save").disabled = sleeping || !marks.objects.length;
    for (const name of ["box", "add", "remove", "ground"]) $(`mode-${name}`).setAttribute("aria-pressed", String(mode === name));
    $("hint").textContent = hint();
    draw();
  };
  const chosen = (row, pick, key) => {
    row.classList.toggle("selected", selected === key);
    pick.setAttribute("aria-pressed", String(selected === key));
  };
  const hint = () => {
    const k = marks.objects.findIndex((o) => o.key === selected);
    const it = k < 0 ? null : marks.objects[k].label || `object ${k + 1}`;
    if (selected === "ground" && mode !== "box") {
      return mode === "remove"
        ? "Draw on what is wrongly taken for the ground."
        : "Is the surface that the objects stand on covered? Else draw on what is missing. Remove takes away.";
    }
    if (mode === "add") return it ? `Draw on parts of ${it} that the colour does not cover.` : "Select an object, then draw on the parts of it that are missing.";
    if (mode === "remove") return it ? `Draw on what the colour covers and is not ${it}.` : "Select an object, then draw on what does not belong to it.";
    if (!marks.objects.length) return "Drag a box around one object, close to its edges. Do so for every object that can move.";
    return it
      ? `Is ${it} covered? Else drag a corner of its box, or use Add and Remove. Then box the next one.`
      : "Drag a box around the next object, or click one to correct it. Save when all are covered.";
  };
  const select = (key) => {
    selected = key;
    if (key === "ground" && mode === "box") mode = "ground";
    else if (key !== "ground" && mode === "ground") mode = "box";
    show();
  };
  const turn = (next) => {
    if (sleeping) return;
    mode = next;
    if (next === "ground") selected = "ground";
    else if (selected === "ground" && next === "box") selected = null;
    show();
  };
  const deleted = (key) => {
    if (sleeping || key === null || (key === "ground" && !marks.ground.inside.length && !marks.ground.outside.length)) return;
    marks.remove(key);
    canvas.focus({ preventScroll: true });
    changed();
  };
  const stepped = (way) => {
    if (sleeping) return;
    marks[way]();
    changed();
  };
  for (const name of ["box", "add", "remove", "ground"]) $(`mode-${name}`).addEventListener("click", () => turn(name));
  $("undo").addEventListener("click", () => stepped("undo"));
  $("redo").addEventListener("click", () => stepped("redo"));
  $("in").addEventListener("click", view.zoomIn);
  $("out").addEventListener("click", view.zoomOut);
  $("fit").addEventListener("click", view.fit);
  $("pick-ground").addEventListener("click", () => select(selected === "ground" ? null : "ground"));
  $("clear-ground").addEventListener("click", () => deleted("ground"));

  // --- keys --------------------------------------------------------------------------------------------------------------------

  const KEYS = {
    b: () => turn("box"), a: () => turn("add"), r: () => turn("remove"), g: () => turn("ground"),
    "+": view.zoomIn, "=": view.zoomIn, "-": view.zoomOut, "0": view.fit,
    delete: () => deleted(selected), backspace: () => deleted(selected),
    escape: () => (drawn ? view.drop() : select(null)),
    arrowleft: () => view.pan(40, 0), arrowright: () => view.pan(-40, 0), arrowup: () => view.pan(0, 40), arrowdown: () => view.pan(0, -40),
  };
  document.addEventListener("keydown", (e) => {
    const key = e.key.toLowerCase(), field = e.target.matches("input, textarea, select");
    if (field || $("work").hidden) return;
    if ((e.ctrlKey || e.metaKey) && !e.altKey && (key === "z" || key === "y")) {
      e.preventDefault();
      return stepped(key === "y" || e.shiftKey ? "redo" : "undo");
    }
    if (e.ctrlKey || e.metaKey || e.altKey) return;
    if (key === "enter" && !e.target.matches("button, summary")) {
      e.preventDefault();
      if ($("save").disabled) return line("There is nothing to save yet: drag a box around an object.");
      $("save").focus();
      say("Press Enter again to save.");
      $("hint").textContent = "Press Enter again to save.";
    } else if (key === " " && !e.target.matches("button, summary")) {
      e.preventDefault();
      view.panning = true;
    } else if (KEYS[key] && !(key.startsWith("arrow") && e.target !== canvas)) {
      e.preventDefault();
      KEYS[key]();
    }
  });
  document.addEventListener("keyup", (e) => { if (e.key === " ") view.panning = false; });
  addEventListener("blur", () => { view.panning = false; });

  // --- the end ------------------------------------------------------------------------------------------------------------------

  const finished = (title, { folder = "", after = "", command = "" }) => {
    done = true;
    $("work").hidden = true;
    document.querySelector(".head").hidden = true;
    $("done-title").textContent = title;
    $("done-where").textContent = folder;
    $("done-after").textContent = after;
    $("done-command").textContent = command;
    $("done-command").hidden = !command;
    $("done").hidden = false;
    $("done").focus();
    if (FRAMED) parent.postMessage("f3sr: outlined", location.origin);
  };
  $("save").addEventListener("click", async () => {
    $("save").disabled = true;
    $("save").textContent = "Saving …";
    const count = marks.objects.length;
    closing = true;
    try {
      const told = await post("save", { page: given.page, revision, selection: marks.selection() });
      return finished(`Saved ${count} ${count === 1 ? "object" : "objects"} and the ground`, told);
    } catch (error) {
      $("save").textContent = SAVE;
      closing = false;
      const behind = answered !== revision; // drawn while it was saved
      show();
      refused(error);
      if (behind) ask();
    }
  });
  let sure = 0;
  $("cancel").addEventListener("click", async () => {
    if (marks.objects.length && Date.now() > sure) {
      sure = Date.now() + 5000;
      $("cancel").textContent = "Discard all?";
      setTimeout(() => { $("cancel").textContent = "Cancel"; }, 5000);
      return;
    }
    closing = true;
    try {
      await post("cancel", { page: given.page });
      finished("Cancelled. Nothing was saved.", {});
    } catch (error) {
      closing = false;
      refused(error);
    }
  });
  addEventListener("beforeunload", (e) => { if (!done && !sleeping && marks.canUndo) e.preventDefault(); });

  const stay = async () => { // an open connection tells the server that the page is there
    for (let missed = 0; !done && !sleeping;) {
      try {
        const reader = (await fetch("alive")).body.getReader();
        if (missed) ask();
        missed = 0;
        while (!(await reader.read()).done);
      } catch { /* asked again below */ }
      missed += 1;
      if (!done && !closing && missed > 2) line(NO_SERVER);
      do await new Promise((next) => setTimeout(next, 500)); while (closing && !done);
    }
  };

  $("where").textContent = `Will be saved in ${given.folder}`;
  for (const id of ["cancel", "where"]) $(id).hidden = FRAMED;
  $("save").textContent = SAVE;
  stay();
  show();
  if (marks.objects.length || marks.ground.inside.length) ask();
  window.page = { // for tests
    marks, masks, view,
    get settled() { return !asking && answered === revision; },
    get grounded() { return grounded === revision; },
    get revision() { return revision; },
    get selected() { return selected; },
    get mode() { return mode; },
    get done() { return done; },
  };
})();
