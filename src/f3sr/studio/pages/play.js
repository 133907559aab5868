// The step in which goals are played: words, what they are understood as, the film, and what was played before.
import { $, ask, busy, complain, element, say } from "./ask.js";

const WAIT_MS = 250; // after the last key, before the words are read
const MOST_SHOWN = 2; // rollouts beside each other
let job = null, wait = 0, asked = 0, shown = [];

const understand = async () => {
  const words = $("goal").value.trim(), number = ++asked;
  if (!words) return void ($("understood").textContent = "");
  try {
    const told = await ask("goals/understand", { goal: words });
    if (number !== asked) return;
    $("understood").className = told.refused ? "bad" : "quiet";
    $("understood").replaceChildren(told.refused || `Understood as: ${told.interpretation}.${told.assumptions.length ? ` Assumed: ${told.assumptions.join("; ")}.` : ""}`);
  } catch (error) {
    if (number === asked) complain(error);
  }
};

const follow = async (project, id) => {
  job = id;
  $("play-start").hidden = true;
  $("play-cancel").hidden = false;
  $("play-state").className = "";
  $("play-state").textContent = "Searching for a launch that does it …";
  try {
    const ended = await project.follow(id, (event) => {
      if (event.event === "step" && event.state !== "done") $("play-state").textContent = `${event.name} …`;
    });
    if (ended.state !== "done") {
      $("play-state").textContent = ended.state === "cancelled" ? "Cancelled." : ended.problem || ended.state;
      if (ended.state === "failed") $("play-state").className = "bad";
    } else {
      const told = ended.result;
      $("play-state").className = told.state === "refused" ? "bad" : "";
      $("play-state").textContent = told.state === "refused" ? told.message : told.said;
      if (told.rollout) await list(project, told.rollout);
    }
    say($("play-state").textContent);
  } finally {
    job = null;
    $("play-start").hidden = false;
    $("play-cancel").hidden = true;
  }
};

const player = (project, rollout) => {
  const frame = element("iframe", { title: `Film of: ${rollout.goal}`, src: `${project.state.framed}rollouts/${rollout.number}/player.html`, class: "player" });
  const speed = element("input", { type: "range", min: 50, max: 150, step: 5, value: 100, "aria-label": "Speed of the launch, in percent" });
  const turn = element("input", { type: "range", min: -30, max: 30, step: 1, value: 0, "aria-label": "Direction of the launch, in degrees" });
  const told = element("output", { text: "as planned" });
  const words = () => { told.textContent = `${speed.value} % of the speed, turned by ${turn.value}°`; };
  for (const input of [speed, turn]) input.addEventListener("input", words);
  const again = element("button", { type: "button", text: "Play it so" });
  again.addEventListener("click", () => busy(again, async () => {
    const made = await ask("jobs", { kind: "vary", options: { rollout: rollout.number, speed: speed.value / 100, turn: Number(turn.value), slow: Number($("play-slow").value) } });
    await follow(project, made.id);
  }));
  const close = element("button", { type: "button", text: "Close", onclick: () => { shown = shown.filter((n) => n !== rollout.number); draw(project); } });
  return element("div", { class: "rollout", "data-number": rollout.number },
    rollout.film ? frame : element("p", { class: "quiet", text: "It was not filmed." }),
    element("div", { class: "vary", role: "group", "aria-label": "Play it in another way" },
      element("label", {}, "Speed ", speed), element("label", {}, "Direction ", turn), told, again, close));
};

const draw = (project) => {
  const rollouts = play.rollouts.filter((r) => shown.includes(r.number));
  const there = new Map([...$("shown").children].map((e) => [Number(e.dataset.number), e]));
  $("shown").replaceChildren(...shown.map((n) => there.get(n) || player(project, rollouts.find((r) => r.number === n))));
  $("shown").classList.toggle("several", shown.length > 1);
  for (const button of $("rollouts").querySelectorAll("button[data-number]")) button.setAttribute("aria-pressed", String(shown.includes(Number(button.dataset.number))));
};

const list = async (project, open = null) => {
  play.rollouts = (await ask("rollouts")).rollouts;
  $("rollouts-title").hidden = !play.rollouts.length;
  if (open !== null) shown = [...shown.filter((n) => n !== open), open].slice(-MOST_SHOWN);
  shown = shown.filter((n) => play.rollouts.some((r) => r.number === n));
  $("rollouts").replaceChildren(...play.rollouts.map((r) => element("li", {}, element("button", {
    type: "button", class: "card", "data-number": r.number,
    onclick: () => { shown = shown.includes(r.number) ? shown.filter((n) => n !== r.number) : [...shown, r.number].slice(-MOST_SHOWN); draw(project); },
  },
  r.film ? element("img", { src: `rollouts/${r.number}/film.png`, alt: "", loading: "lazy" }) : null,
  element("span", { class: "name" }, element("bdi", { text: r.goal })),
  element("span", { class: r.met ? "good" : "bad", text: r.met ? "met" : "not met" })))));
  draw(project);
};

export const play = {
  rollouts: [],
  begin(project) {
    $("goal").addEventListener("input", () => {
      clearTimeout(wait);
      wait = setTimeout(understand, WAIT_MS);
    });
    $("play-form").addEventListener("submit", (e) => {
      e.preventDefault();
      const goal = $("goal").value.trim();
      if (!goal) return $("goal").focus();
      busy($("play-start"), async () => {
        const made = await ask("jobs", { kind: "play", options: { goal, slow: Number($("play-slow").value), samples: Number($("play-samples").value), ...($("play-model").value.trim() ? { model: $("play-model").value.trim() } : {}) } });
        await follow(project, made.id);
      });
    });
    $("play-cancel").addEventListener("click", (e) => busy(e.currentTarget, () => ask(`jobs/${job}/cancel`, {})));
    const running = project.state.jobs.find((j) => ["play", "vary"].includes(j.kind) && ["queued", "running"].includes(j.state));
    if (running) follow(project, running.id).catch(complain);
  },
  async shown(project) {
    $("play-none").hidden = project.state.scene;
    $("play-work").hidden = !project.state.scene;
    if (!project.state.scene) return;
    const { suggestions } = await ask("goals/menu");
    $("suggestions").replaceChildren(...suggestions.map((words) => element("button", { type: "button", text: words, onclick: () => {
      $("goal").value = words;
      $("goal").focus();
      understand();
    } })));
    await list(project);
  },
};
