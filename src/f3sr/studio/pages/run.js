// The step in which the scene is made: options, stages as they go on, pictures as they come, what was decided.
import { $, busy, complain, element, say, seconds } from "./ask.js";

const WORDS = {
  read: "read the input", assemble: "put the objects into one frame", level: "find gravity and ground", align: "align camera and objects with the masks",
  relate: "find what stands on what", decompose: "cover meshes with convex parts", separate: "take objects apart", settle: "let everything come to rest",
  close: "close gaps", refine: "stand up what fell, align again", coarsen: "use fewer convex parts", describe: "describe the scene",
  uncertainty: "estimate how well poses are known", evaluate: "measure", inpaint: "complete the photo behind the objects", kernels: "compile kernels", pictures: "draw pictures", package: "write the package",
};
const TITLES = { level: "As it came", align: "Aligned", rest: "At rest" };
const OPTIONS = { geometry: "run-geometry", assets: "run-assets", background: "run-background", known: "run-known", focal: "run-focal", camera_height: "run-height" };
const NUMBERS = new Set(["focal", "camera_height"]);

let job = null, done = 0;

const options = () => {
  const given = {};
  for (const [name, id] of Object.entries(OPTIONS)) {
    const text = $(id).value.trim();
    if (!text) continue;
    given[name] = NUMBERS.has(name) ? Number(text.replace(",", ".")) : text;
    if (NUMBERS.has(name) && !(given[name] > 0)) throw new Error(`${$(id).labels[0].textContent}: found ${text}; accepted: a number above 0`);
  }
  return given;
};

const clear = () => {
  done = 0;
  for (const place of ["run-stages", "run-told", "run-pictures"]) $(place).replaceChildren();
  $("run-legend").hidden = true;
};

const heard = (project) => (event) => {
  const stages = $("run-stages");
  if (event.event === "step" && event.state === "told") $("run-state").textContent = event.name;
  else if (event.event === "again") clear();
  else if (event.event === "step") {
    const id = `stage-${event.name.replace(/\W/g, "-")}`;
    const line = $(id) || stages.appendChild(element("li", { id }));
    const words = WORDS[event.name] || event.name;
    line.className = event.state;
    line.replaceChildren(element("span", { text: words }), element("span", { class: "time", text: event.state === "done" ? seconds(event.seconds) : event.state === "resumed" ? "done before" : event.state === "skipped" ? "left out" : "…" }));
    if (event.state !== "started") $("run-progress").value = ++done / Object.keys(WORDS).length;
    else say(words);
  } else if (event.event === "picture") {
    $("run-given").hidden = true;
    $("run-legend").hidden = false;
    const title = TITLES[event.name] || event.name;
    $("run-pictures").append(element("figure", {}, element("img", { src: `jobs/${job}/pictures/${event.file}`, alt: `${title}: the scene over the photo` }), element("figcaption", { text: title })));
  } else if (event.event === "decision" && event.fallback) {
    $("run-told").append(element("li", {}, element("b", { text: event.choice }), ` ${event.reason}`));
  }
};

const follow = async (project, id) => {
  job = id;
  clear();
  $("run-start").hidden = true;
  $("run-next").hidden = true;
  for (const place of ["run-cancel", "run-progress"]) $(place).hidden = false;
  $("run-state").textContent = "";
  try {
    const ended = await project.follow(id, heard(project));
    tell(ended);
  } finally {
    job = null;
    $("run-start").hidden = false;
    for (const place of ["run-cancel", "run-progress"]) $(place).hidden = true;
    for (const line of $("run-stages").querySelectorAll(".started")) line.className = "ended";
    run.changed(project);
  }
};

const tell = (ended) => {
  const words = { done: "The scene stands.", cancelled: "Cancelled. What was there before is unchanged.", failed: ended.problem, interrupted: "The program ended. Start it again: finished stages are known." };
  $("run-state").textContent = words[ended.state] || ended.state;
  $("run-state").className = ended.state === "failed" ? "bad" : "";
  say($("run-state").textContent);
};

export const run = {
  begin(project) {
    const choices = project.state.choices;
    for (const [name, none] of [["geometry", "from the photo, or as the folder has it"], ["assets", "lifted from the masks, or as the folder has them"], ["background", "completed by f3sr"]]) {
      $(OPTIONS[name]).append(element("option", { value: "", text: none }), ...choices[name].filter((c) => c.met).map((c) => element("option", { value: c.name, text: c.name })));
      const absent = choices[name].filter((c) => !c.met).length;
      if (absent) $(OPTIONS[name]).append(element("option", { disabled: true, text: `${absent} more need something: f3sr doctor says what` }));
    }
    for (const [name, id] of Object.entries(OPTIONS)) if (project.state.options[name] !== undefined) $(id).value = project.state.options[name];
    $("run-form").addEventListener("submit", (e) => {
      e.preventDefault();
      busy($("run-start"), async () => {
        const made = await project.ask("jobs", { kind: "reconstruct", options: options() });
        await follow(project, made.id);
      });
    });
    $("run-cancel").addEventListener("click", (e) => busy(e.currentTarget, () => project.ask(`jobs/${job}/cancel`, {})));
    const last = project.state.jobs.filter((j) => j.kind === "reconstruct").at(-1);
    if (last) follow(project, last.id).catch(complain);
  },
  changed({ state }) {
    $("run-what").replaceChildren(...(state.outlined ? [`${state.masks} ${state.masks === 1 ? "object is" : "objects are"} outlined.`, state.outdated ? element("b", { text: " The outlines are newer than the scene: make it again." }) : ""] : ["Nothing is outlined yet: ", element("a", { href: "#outline", text: "outline the objects" }), " first."]));
    $("run-given").hidden = $("run-pictures").childElementCount > 0 || !state.outlined;
    if (!$("run-given").hidden) $("run-given").querySelector("img").src = `masks.jpg?${state.masks}-${state.outdated}`;
    $("run-start").classList.toggle("main", !state.scene || state.outdated);
    $("run-remarks").replaceChildren(...state.remarks.map((text) => element("li", { text })));
    $("run-start").disabled = !state.outlined;
    $("run-start").textContent = state.scene ? "Make it again" : "Make the scene";
    $("run-next").hidden = !state.scene || job !== null;
    $("report").hidden = !state.scene;
    const page = state.scene && `${state.framed}package/report.html?${state.version}`;
    if (page && $("report-frame").dataset.page !== page) {
      $("report-frame").dataset.page = page;
      if ($("report").open) $("report-frame").src = page;
      else $("report").addEventListener("toggle", () => { $("report-frame").src = page; }, { once: true });
    }
  },
};
