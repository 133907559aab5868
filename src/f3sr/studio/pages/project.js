// One project: its steps, and the job that runs.
import { $, ask, complain, say } from "./ask.js";
import { outline } from "./outline.js";
import { run } from "./run.js";
import { scene } from "./scene.js";
import { play } from "./play.js";
import { take } from "./take.js";

const STEPS = { outline, run, scene, play, take };
const JOB_STEPS = { reconstruct: "run", play: "play", vary: "play", export: "take", certify: "take" };
const PAUSE_MS = 400; // between questions while a job runs

/** What the steps share: the project's last known state, questions below its address, jobs. */
const project = {
  state: null,
  ask: (path, value) => ask(path, value),
  async refresh() {
    project.state = await ask("state");
    project.tell();
    return project.state;
  },
  tell() {
    for (const step of Object.values(STEPS)) step.changed?.(project);
    offered();
  },
  /** Begins a job, and follows it: `heard(event)` of each of its events. The job as it ended. */
  async job(kind, options, heard) {
    const job = await ask("jobs", { kind, options });
    return project.follow(job.id, heard);
  },
  async follow(id, heard) {
    for (let after = 0, missed = 0; ;) {
      let told;
      try {
        told = await ask(`jobs/${id}?after=${after}`);
        missed = 0;
      } catch (error) {
        if (error.status || ++missed > 20) throw error; // the server may be started again
        await new Promise((next) => setTimeout(next, 500));
        continue;
      }
      for (const event of told.events) heard(event);
      after += told.events.length;
      if (!told.events.length && !["queued", "running"].includes(told.state)) {
        await project.refresh();
        return told;
      }
      if (!told.events.length) await new Promise((next) => setTimeout(next, PAUSE_MS));
    }
  },
  go: (name) => { location.hash = name; },
  get shown() { return location.hash.slice(1); },
};

const offered = () => {
  const { state } = project;
  for (const link of $("steps").children) {
    const name = link.hash.slice(1), open = name === "outline" || (name === "run" ? state.outlined : state.scene);
    link.toggleAttribute("aria-disabled", false);
    link.setAttribute("aria-disabled", String(!open));
    if (name === project.shown) link.setAttribute("aria-current", "step");
    else link.removeAttribute("aria-current");
  }
};

const show = () => {
  const { state } = project;
  if (!state) return; // the first answer is on its way
  const going = state.jobs.find((j) => ["queued", "running"].includes(j.state));
  const first = going ? JOB_STEPS[going.kind] : state.scene ? "scene" : state.outlined ? "run" : "outline";
  const name = STEPS[project.shown] ? project.shown : first;
  if (name !== project.shown) history.replaceState(null, "", `#${name}`);
  for (const other of Object.keys(STEPS)) $(`step-${other}`).hidden = other !== name;
  offered();
  complain(null);
  Promise.resolve(STEPS[name].shown?.(project)).catch(complain);
};

addEventListener("hashchange", () => {
  show();
  $("main").focus({ preventScroll: true });
});
try {
  project.state = await ask("state");
  for (const step of Object.values(STEPS)) step.begin?.(project); // listeners first: nothing is enabled that nobody hears
  project.tell();
  show();
  say(`Project ${project.state.name}`);
} catch (error) {
  complain(error);
  if (error.status === 422) setTimeout(() => location.assign("../../"), 4000); // it is no longer there
}
window.studio = { project, STEPS };
