// The step in which the scene is looked at and mended: photo and 3-D view beside each other, one object selected.
import { $, ask, busy, complain, element, say, seconds } from "./ask.js";

const COLORS = { grid: [0.12, 0.6, 0.24], path: [0, 0, 0], glow: [1, 0.48, 0.1] };
const TURNS = { a: [-1, 0], d: [1, 0], w: [0, -1], s: [0, 1] };
const NUDGE = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
const STEPS_M = [0.001, 0.005, 0.01, 0.05, 0.1];
const MEASURES = { mIoU_visible: "visible IoU", N_cross: "crossing pairs of triangles", D_max_cm: "moves at rest [cm]", K_max_J: "kinetic energy at rest [J]", gap_pct: "gap [% of size]" };

let view = null, data = null, state = null, labels = null, selected = null, shift = null, parts = false, step = 0.01, project = null;

const of = (id) => state.objects.find((o) => o.id === id);
const indexOf = (id) => data.objects.findIndex((o) => o.id === id);
const nameOf = (id) => (id === -1 ? "the ground" : of(id)?.name || `object ${id}`);

// --- edits: one question at a time ---------------------------------------------------------------------------------

const changed = async (path, value, words, done) => {
  const focused = document.activeElement?.getAttribute("aria-label");
  $("edit-state").textContent = `${words} …`;
  $("scene-work").setAttribute("aria-busy", "true");
  for (const b of $("step-scene").querySelectorAll(".inspector button, .inspector input, .inspector select")) b.disabled = true;
  try {
    complain(null);
    state = await ask(path, value);
    if (state.meshes !== data.meshes) await open(); // the sizes of an edited package are in its meshes
    $("edit-state").textContent = done || `At rest again after ${seconds(state.seconds)}.`;
    say($("edit-state").textContent);
  } catch (error) {
    $("edit-state").textContent = "";
    complain(error);
  } finally {
    shift = null;
    $("scene-work").removeAttribute("aria-busy");
    show();
    if (focused) document.querySelector(`.inspector [aria-label="${CSS.escape(focused)}"]`)?.focus({ preventScroll: true });
  }
};
const edit = (made, words, done) => changed("scene/edits", { edit: made }, words, done);
const move = (id, by) => edit({ kind: "move", id, by }, "Moving");

// --- what is selected ----------------------------------------------------------------------------------------------

const select = (id, { focus = false } = {}) => {
  selected = of(id) ? id : null;
  complain(null);
  show();
  if (selected === null) return;
  const button = document.querySelector(`#objects [data-id="${id}"]`);
  if (focus) button?.focus();
  else button?.scrollIntoView({ block: "nearest" });
};

const paintMark = () => {
  const canvas = $("scene-mark"), { width, height } = labels;
  [canvas.width, canvas.height] = [width, height];
  const paper = canvas.getContext("2d");
  if (selected === null) return;
  const picture = paper.createImageData(width, height), own = data.masks.indexOf(selected) + 1;
  for (let i = 0; i < width * height; i++) {
    const at = labels.data[4 * i] === own;
    const edge = at && (labels.data[4 * (i - 1)] !== own || labels.data[4 * (i + 1)] !== own || labels.data[4 * (i - width)] !== own || labels.data[4 * (i + width)] !== own);
    picture.data.set(edge ? [255, 122, 26, 255] : at ? [255, 122, 26, 60] : [0, 0, 0, 0], 4 * i);
  }
  paper.putImageData(picture, 0, 0);
};

// --- the inspector -------------------------------------------------------------------------------------------------

const field = (label, input, unit = "") => element("label", { class: "field" }, element("span", { text: label }), input, unit ? element("span", { class: "unit", text: unit }) : null);
const number = (value, { digits = 3, words, low, high }, apply) => {
  const shown = Number(value).toPrecision(digits), input = element("input", { inputmode: "decimal", value: String(Number(shown)) });
  input.addEventListener("change", () => {
    const given = Number(input.value.replace(",", "."));
    if (!(given >= low && given <= high)) {
      complain(new Error(`${words}: found ${input.value}; accepted: ${low} to ${high}`));
      input.value = String(Number(shown));
    } else apply(given);
  });
  return input;
};
const press = (text, label, work) => element("button", { type: "button", text, "aria-label": label, title: label, onclick: work });

/** Directions on the ground as the photo sees them: to the right, and away from the camera. */
const onGround = () => {
  const T = state.camera.T, right = [T[0], T[4]], length = Math.hypot(...right) || 1;
  const r = [right[0] / length, right[1] / length];
  return { right: [r[0], r[1], 0], away: [-r[1], r[0], 0] };
};
const nudge = (across, away, up = 0) => {
  const g = onGround();
  return [0, 1, 2].map((k) => step * (across * g.right[k] + away * g.away[k]) + (k === 2 ? step * up : 0));
};

const inspector = (o) => {
  const moves = [["←", "to the left", -1, 0, 0], ["→", "to the right", 1, 0, 0], ["↑", "away from the camera", 0, 1, 0], ["↓", "towards the camera", 0, -1, 0], ["up", "up", 0, 0, 1], ["down", "down", 0, 0, -1]];
  const steps = element("select", { "aria-label": "Step of a move", onchange: (e) => { step = Number(e.target.value); } }, ...STEPS_M.map((s) => element("option", { value: s, text: s < 0.01 ? `${1000 * s} mm` : `${100 * s} cm`, selected: s === step })));
  const turns = [-90, -15, -5, 5, 15, 90];
  const axis = element("select", { "aria-label": "Axis of a turn" }, ...[["vertical", "about the vertical axis"], ["away", "about the axis away from the camera"], ["right", "about the axis to the right"]].map(([value, text]) => element("option", { value, text })));
  const axisNow = () => ({ vertical: [0, 0, 1], ...onGround() })[axis.value];
  const support = element("select", { onchange: (e) => edit({ kind: "support", id: o.id, on: Number(e.target.value) }, "Moving it there") },
    ...[-1, ...state.objects.filter((p) => p.id !== o.id).map((p) => p.id)].map((id) => element("option", { value: id, text: nameOf(id), selected: id === o.support })));
  const label = element("input", { value: o.label, maxlength: 200, spellcheck: "false", onchange: (e) => edit({ kind: "label", id: o.id, to: e.target.value.trim() }, "Naming it", "Named.") });
  const fixed = element("input", { type: "checkbox", checked: o.mobility === "fixed", onchange: (e) => edit({ kind: e.target.checked ? "fix" : "release", id: o.id }, "Changing it", e.target.checked ? "Fixed: nothing moves it." : "No longer fixed.") });
  const remove = press("Delete", `Delete ${nameOf(o.id)}`, () => edit({ kind: "delete", id: o.id }, "Deleting it"));
  const size = o.size.map((s) => `${(100 * s).toFixed(1)}`).join(" × ");
  return [
    element("h3", {}, element("bdi", { text: nameOf(o.id) })),
    element("p", { class: "fine", text: `${size} cm, ${o.material}; ${o.support === null ? "rests on nothing known" : `stands on ${nameOf(o.support)}`}.${o.iou === null ? "" : ` It agrees with ${Math.round(100 * o.iou)} % of its outline (visible IoU).`}` }),
    element("div", { class: "edit-row", role: "group", "aria-label": "Move" }, ...moves.map(([text, words, x, y, z]) => press(text, `Move ${words}`, () => move(o.id, nudge(x, y, z)))), steps),
    element("div", { class: "edit-row", role: "group", "aria-label": "Turn" }, ...turns.map((t) => press(`${t > 0 ? "+" : "−"}${Math.abs(t)}°`, `Turn by ${t} degrees`, () => edit({ kind: "turn", id: o.id, axis: axisNow(), degrees: t }, "Turning"))), axis),
    field("Size", number(100, { words: "Size", low: 20, high: 500 }, (value) => value !== 100 && edit({ kind: "scale", id: o.id, factor: value / 100 }, "Scaling")), "% of its size now"),
    field("Stands on", support),
    field("Mass", number(o.mass, { words: "Mass", low: 1e-4, high: 1e4 }, (value) => edit({ kind: "material", id: o.id, mass: value }, "Weighing")), "kg"),
    field("Friction", number(o.friction, { words: "Friction", low: 0, high: 2 }, (value) => edit({ kind: "material", id: o.id, friction: value }, "Changing it"))),
    field("Name", label),
    element("div", { class: "edit-row" }, element("label", { class: "check" }, fixed, " fixed: nothing moves it"), remove),
    element("details", {}, element("summary", { text: "What was decided, and why" }),
      element("ul", { class: "decisions" }, ...o.decisions.map((d) => element("li", { class: d.fallback ? "fallback" : null }, element("b", { text: `${d.stage}: ${d.choice}` }), ` ${d.reason}`))),
      o.decisions.length ? null : element("p", { class: "quiet", text: "Nothing was decided about it alone." })),
  ];
};

/** The measures in a sentence. */
const verdict = () => {
  const { N_cross: crossings, D_max_cm: drift, mIoU_visible: iou } = state.measures, said = [];
  if (iou !== undefined) said.push(`The scene agrees with ${Math.round(100 * iou)} % of the outlines.`);
  if (crossings !== undefined) said.push(crossings ? `${crossings} pairs of triangles cross.` : "Nothing penetrates anything.");
  if (drift !== undefined) said.push(drift <= 0.1 ? "Everything rests." : `Something moves by ${drift.toPrecision(2)} cm when it is released.`);
  return said.join(" ");
};

// --- everything shown ------------------------------------------------------------------------------------------------

const show = () => {
  if (!state) return;
  if (selected !== null && !of(selected)) selected = null;
  $("undo").disabled = !state.undo;
  $("redo").disabled = !state.redo;
  $("edit-told").replaceChildren(...state.told.map((d) => element("li", {}, element("b", { text: d.choice }), ` ${d.reason}`)));
  const focused = document.activeElement?.dataset?.id;
  $("objects").replaceChildren(...state.objects.map((o) => element("li", {}, element("button", {
    type: "button", "data-id": o.id, "aria-pressed": String(o.id === selected), onclick: () => select(o.id === selected ? null : o.id),
  }, element("bdi", { text: nameOf(o.id) }), o.mobility === "fixed" ? element("span", { class: "tag", text: " fixed" }) : null))));
  if (focused !== undefined) document.querySelector(`#objects [data-id="${focused}"]`)?.focus({ preventScroll: true });
  $("object").hidden = selected === null;
  $("object").replaceChildren(...(selected === null ? [] : inspector(of(selected))));
  $("measures").replaceChildren(...Object.entries(MEASURES).filter(([k]) => state.measures[k] !== undefined).map(([k, words]) => element("div", {}, element("dt", { text: words }), element("dd", { text: k === "N_cross" ? String(state.measures[k]) : Number(state.measures[k].toPrecision(3)).toString() }))));
  $("verdict").textContent = verdict();
  $("edits").replaceChildren(...state.edits.map((words) => element("li", { text: words })));
  $("edits-none").hidden = state.edits.length > 0;
  paintMark();
  view?.draw();
};

const poseOf = (i) => {
  const o = of(data.objects[i].id);
  if (!o) return null;
  if (!shift || shift.id !== o.id) return o.pose;
  const pose = [...o.pose];
  for (const k of [0, 1, 2]) pose[4 * k + 3] += shift.by[k];
  return pose;
};

/** Where a ray meets the horizontal plane at height `z`; null where it looks along it. */
const meets = ({ origin, direction }, z) => {
  const t = (z - origin[2]) / direction[2];
  return Math.abs(direction[2]) > 0.02 && t > 0 ? [0, 1, 2].map((k) => origin[k] + t * direction[k]) : null;
};
const grab = (x, y) => {
  const i = view.pick(x, y);
  if (i < 0 || $("scene-work").getAttribute("aria-busy")) return null;
  const id = data.objects[i].id, box = of(id).center, from = meets(view.ray(x, y), box[2]);
  if (id !== selected) select(id);
  return {
    move(to) {
      const at = from && meets(to, box[2]);
      shift = at && { id, by: [at[0] - from[0], at[1] - from[1], 0] };
      view.draw();
    },
    end() {
      if (shift && Math.hypot(...shift.by) > 1e-4) move(id, shift.by);
      else shift = null;
    },
  };
};

const pixels = (image) => {
  const canvas = element("canvas", { width: image.naturalWidth, height: image.naturalHeight }), paper = canvas.getContext("2d", { willReadFrequently: true });
  paper.drawImage(image, 0, 0);
  return paper.getImageData(0, 0, canvas.width, canvas.height);
};
const loaded = (src) => new Promise((done, failed) => {
  const image = new Image();
  image.onload = () => done(image);
  image.onerror = () => failed(new Error("a picture of the server cannot be shown"));
  image.src = src;
});

const open = async () => {
  const version = project.state.version;
  $("scene-wait").hidden = false;
  $("scene-photo").src = `photo.jpg?${version}`;
  const [picture, packed, light] = await Promise.all([loaded(`scene/labels.png?${version}`), ask("scene/view"), ask("scene/state")]);
  [labels, data, state] = [pixels(picture), packed, light];
  scene.version = version;
  $("scene-wait").hidden = true;
  for (const id of ["photo-stage", "view-stage"]) $(id).style.aspectRatio = `${state.camera.width} / ${state.camera.height}`;
  const fresh = $("scene-view").cloneNode(); // a canvas keeps its context: another scene gets another canvas
  $("scene-view").replaceWith(fresh);
  view = view3d(fresh, data, {
    look: (fromPhoto) => ({ camera: state.camera, poses: data.objects.map((_, i) => poseOf(i)), parts, shade: fromPhoto ? 0 : 0.25, grid: true, colors: COLORS, lights: data.objects.map((o) => (o.id === selected ? 0.6 : 0)) }),
    turns: TURNS, grab,
  });
  $("scene-no-view").hidden = Boolean(view);
  fresh.addEventListener("keydown", (e) => {
    if (e.ctrlKey || e.metaKey || e.altKey) return;
    if (e.key === "1") view?.from("photo");
    else if (NUDGE[e.key] && selected !== null) move(selected, nudge(...NUDGE[e.key]));
    else if (e.key === "Escape") select(null);
    else return;
    e.preventDefault();
  });
  show();
};

export const scene = {
  begin(given) {
    project = given;
    for (const name of ["photo", "top", "side"]) $(`from-${name}`).addEventListener("click", () => view?.from(name));
    $("show-parts").addEventListener("click", () => {
      parts = !parts;
      $("show-parts").setAttribute("aria-pressed", String(parts));
      view?.draw();
    });
    $("undo").addEventListener("click", () => changed("scene/undo", {}, "Undoing", "Undone."));
    $("redo").addEventListener("click", () => changed("scene/redo", {}, "Doing it again", "Done again."));
    $("photo-stage").addEventListener("click", (e) => {
      if (!labels) return;
      const box = $("photo-stage").getBoundingClientRect();
      const x = Math.floor((e.clientX - box.left) / box.width * labels.width), y = Math.floor((e.clientY - box.top) / box.height * labels.height);
      const own = labels.data[4 * (y * labels.width + x)];
      select(own ? data.masks[own - 1] : null);
    });
    addEventListener("keydown", (e) => {
      if (project.shown !== "scene" || e.target.matches("input, select") || !(e.ctrlKey || e.metaKey) || e.key.toLowerCase() !== "z") return;
      e.preventDefault();
      $(e.shiftKey ? "redo" : "undo").click();
    });
  },
  async shown() {
    $("scene-none").hidden = project.state.scene;
    $("scene-work").hidden = !project.state.scene;
    if (!project.state.scene) return;
    if (scene.version !== project.state.version) await open();
    view?.draw();
  },
  get view() { return view; },
  get state() { return state; },
  get selected() { return selected; },
  select,
};
