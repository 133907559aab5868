// The report's 3-D view: input, result or proxies, seen from the photo's camera or from anywhere.
(() => {
  "use strict";
  const $ = (id) => document.getElementById(id);
  addEventListener("beforeprint", () => document.querySelectorAll("details").forEach((d) => { d.open = true; }));

  const live = $("view-live"), stage = $("view-stage"), canvas = stage.querySelector("canvas");
  const data = JSON.parse($("scene-data").textContent);
  const MODES = ["direct", "ours", "proxies"], COLORS = { grid: [0.12, 0.6, 0.24], path: [0, 0, 0], glow: [0, 0, 0] };
  let mode = "ours", photoBehind = true, namesShown = false;

  const scene = () => (mode === "direct" ? "direct" : "ours");
  const view = view3d(canvas, { ...data, bounds: data.bounds.ours }, {
    look: (fromPhoto) => ({
      camera: data.cameras[scene()], poses: data.objects.map((o) => o[scene()]), parts: mode === "proxies",
      shade: fromPhoto ? 0 : 0.25, grid: !(photoBehind && fromPhoto), colors: COLORS,
    }),
    turns: { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] },
    painted: () => {
      stage.querySelector(".behind").style.visibility = photoBehind && view.fromPhoto ? "visible" : "hidden";
      placeNames();
    },
  });
  if (!view) return;
  const { cell } = view;
  $("grid-step").textContent = `The grid on the ground has cells of ${cell >= 1 ? `${+cell.toPrecision(3)} m` : `${+(100 * cell).toPrecision(3)} cm`}.`;

  const labels = data.objects.map((o) => {
    const span = document.createElement("span");
    span.textContent = `${o.id} ${o.label}`.trim();
    span.hidden = true;
    stage.querySelector(".names").append(span);
    return span;
  });
  const placeNames = () => labels.forEach((label, i) => {
    const at = namesShown ? view.middleOf(i) : null;
    label.hidden = !at;
    if (at) label.style.transform = `translate(${at[0]}px, ${at[1]}px) translate(-50%, -50%)`;
  });

  const press = (id, on) => $(id).setAttribute("aria-pressed", String(on));
  const choose = (next) => {
    mode = next;
    for (const name of MODES) press(`mode-${name}`, name === mode);
    view.draw();
  };
  for (const name of MODES) $(`mode-${name}`).addEventListener("click", () => choose(name));
  $("photo-view").addEventListener("click", () => view.from("photo"));
  $("photo-behind").addEventListener("click", () => { photoBehind = !photoBehind; press("photo-behind", photoBehind); view.draw(); });
  $("names").addEventListener("click", () => { namesShown = !namesShown; press("names", namesShown); view.draw(); });
  canvas.addEventListener("keydown", (e) => {
    if (e.key === "0") view.from("photo");
    else if ("123".includes(e.key)) choose(MODES[e.key - 1]);
    else return;
    e.preventDefault();
  });
  canvas.addEventListener("webglcontextlost", (e) => { e.preventDefault(); live.hidden = true; $("view-still").hidden = false; });

  live.hidden = false;
  $("view-still").hidden = true;
  const { width, height } = data.cameras.ours;
  stage.style.aspectRatio = `${width} / ${height}`;
  view.draw();
})();
