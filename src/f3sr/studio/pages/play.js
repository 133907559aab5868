// The step in which goals are played: words, what they are understood as, the film, and what was played before.
import { $, ask, busy, complain, element, say, waiting } from "./ask.js";

const WAIT_MS = 250; // after the last key, before the words are read
const MOST_SHOWN = 2; // rollouts beside each other
const WORDS = { "search for a launch that does it": "Searching for a launch that does it", "film it": "Filming", "play it": "Playing", "play in the samples": "Playing in the samples" };
let job = null, wait = 0, asked = 0, shown = [];

const understand = async () => {
  const words = $("goal").value.trim(), number = ++asked;
  $("play-state").textContent = "";
  play.refused = false;
  if (!words) return void ($("understood").textContent = "");
  try {
    const told = await ask("goals/understand", { goal: words });
    if (number !== asked) return;
    play.refused = Boolean(told.refused);
    $("understood").className = told.refused ? "bad" : "quiet";
    $("understood").replaceChildren(told.refused || `Understood as: ${told.interpretation}.${told.assumptions.length ? ` Assumed: ${told.assumptions.join("; ")}.` : ""}`);
  } catch (error) {
    if (number === asked) complain(error);
  }
};

const follow = async (project, id, kept = []) => {
  job = id;
  $("play-start").hidden = true;
  $("play-cancel").hidden = false;
  $("play-state").className = "";
  let still = waiting($("play-state"), "Waiting for its turn");
  $("play-state").scrollIntoView({ block: "nearest" });
  try {
    const ended = await project.follow(id, (event) => {
      if (event.event !== "step" || event.state === "done") return;
      still();
      still = waiting($("play-state"), WORDS[event.name] || event.name);
    });
    still();
    if (ended.state !== "done") {
      $("play-state").textContent = ended.state === "cancelled" ? "Cancelled." : ended.problem || ended.state;
      if (ended.state === "failed") $("play-state").className = "bad";
    } else {
      const told = ended.result;
      $("play-state").className = told.state === "refused" ? "bad" : "";
      $("play-state").textContent = told.state === "refused" ? told.message : "";
      if (told.said) say(told.said);
      if (told.rollout) await list(project, [...kept, told.rollout]);
    }
    if ($("play-state").textContent) say($("play-state").textContent);
  } finally {
    still();
    job = null;
    $("play-start").hidden = false;
    $("play-cancel").hidden = true;
  }
};

const title = ({ goal, variation }) => `${goal}${variation ? ` (${Math.round(100 * variation.speed)} % of the speed, turned by ${variation.turn}°)` : ""}`;
const player = (project, rollout) => {
  const frame = element("iframe", { title: `Film of: ${rollout.goal}`, src: `${project.state.framed}rollouts/${rollout.number}/player.html`, class: "player" });
  const speed = element("input", { type: "range", min: 50, max: 150, step: 5, value: 100, "aria-label": "Speed of the launch, in percent" });
  const turn = element("input", { type: "range", min: -30, max: 30, step: 1, value: 0, "aria-label": "Direction of the launch, in degrees" });
  if (rollout.variation) [speed.value, turn.value] = [100, 0];
  const told = element("output", { text: "as this one" });
  const words = () => { told.textContent = `${speed.value} % of the speed, turned by ${turn.value}°`; };
  for (const input of [speed, turn]) input.addEventListener("input", words);
  const again = element("button", { type: "button", text: "Play it so" });
  again.addEventListener("click", () => busy(again, async () => {
    const made = await ask("jobs", { kind: "vary", options: { rollout: rollout.number, speed: speed.value / 100, turn: Number(turn.value), slow: Number($("play-slow").value) } });
    await follow(project, made.id, [rollout.number]);
  }));
  const close = element("button", { type: "button", text: "Close", onclick: () => { shown = shown.filter((n) => n !== rollout.number); draw(project); } });
  const film = rollout.film ? element("a", { href: `rollouts/${rollout.number}/film.mp4`, download: `${project.state.name} ${rollout.number}.mp4`, text: "Download the film" }) : null;
  return element("div", { class: "rollout", "data-number": rollout.number },
    element("h3", {}, element("bdi", { text: title(rollout) }), " ", element("span", { class: rollout.met ? "good" : "bad", text: rollout.met ? "met" : "not met" })),
    element("p", { class: "fine", text: rollout.said }),
    rollout.stale ? element("p", { class: "fine" }, element("b", { class: "fallback", text: "Played in an earlier state of the scene." })) : null,
    rollout.film ? frame : element("p", { class: "quiet", text: "It was not filmed." }),
    element("div", { class: "vary", role: "group", "aria-label": "Play it in another way" },
      rollout.stale ? null : element("label", {}, "Speed ", speed), rollout.stale ? null : element("label", {}, "Direction ", turn), rollout.stale ? null : told, rollout.stale ? null : again, film, close));
};

const draw = (project) => {
  const rollouts = play.rollouts.filter((r) => shown.includes(r.number));
  const there = new Map([...$("shown").children].map((e) => [Number(e.dataset.number), e]));
  $("shown").replaceChildren(...shown.map((n) => there.get(n) || player(project, rollouts.find((r) => r.number === n))));
  $("shown").classList.toggle("several", shown.length > 1);
  $("play-photo").hidden = shown.length > 0;
  if (!shown.length) $("play-photo").querySelector("img").src = `photo.jpg?${project.state.version}`;
  for (const button of $("rollouts").querySelectorAll("button[data-number]")) button.setAttribute("aria-pressed", String(shown.includes(Number(button.dataset.number))));
};

const list = async (project, open = []) => {
  play.rollouts = (await ask("rollouts")).rollouts;
  $("rollouts-title").hidden = !play.rollouts.length;
  if (open.length) shown = open;
  shown = shown.filter((n) => play.rollouts.some((r) => r.number === n));
  $("rollouts").replaceChildren(...play.rollouts.map((r) => element("li", {}, element("button", {
    type: "button", class: "card", "data-number": r.number,
    onclick: () => { shown = shown.includes(r.number) ? shown.filter((n) => n !== r.number) : [...shown, r.number].slice(-MOST_SHOWN); draw(project); },
  },
  r.film ? element("img", { src: `rollouts/${r.number}/film.png`, alt: "", loading: "lazy" }) : null,
  element("span", { class: "name" }, element("bdi", { text: title(r) })),
  element("span", { class: r.met ? "good" : "bad", text: r.met ? "met" : "not met" }), r.stale ? element("span", { class: "fine", text: "an earlier state of the scene" }) : null))));
  draw(project);
  if (open.length) $("shown").scrollIntoView({ block: "start", behavior: "smooth" });
};

export const play = {
  rollouts: [],
  refused: false,
  begin(project) {
    $("goal").addEventListener("input", () => {
      complain(null);
      clearTimeout(wait);
      wait = setTimeout(understand, WAIT_MS);
    });
    $("play-form").addEventListener("submit", (e) => {
      e.preventDefault();
      const goal = $("goal").value.trim();
      if (!goal) complain(new Error("Say what is to happen, or take a suggestion."));
      if (!goal || (play.refused && !$("play-model").value.trim())) return $("goal").focus();
      busy($("play-start"), async () => {
        const made = await ask("jobs", { kind: "play", options: { goal, slow: Number($("play-slow").value), samples: Number($("play-samples").value), ...($("play-model").value.trim() ? { model: $("play-model").value.trim() } : {}) } });
        await follow(project, made.id);
      });
    });
    $("play-cancel").addEventListener("click", (e) => busy(e.currentTarget, () => ask(`jobs/${job}/cancel`, {})));
    const running = project.state.jobs.find((j) => ["play", "vary"].includes(j.kind) && ["queued", "running"].includes(j.state));
    if (running) {
      $("goal").value = running.options.goal || "";
      follow(project, running.id).catch(complain);
    }
    addEventListener("message", (e) => { // a player says how high it is
      const frame = [...document.querySelectorAll("iframe.player")].find((f) => f.contentWindow === e.source), height = e.data?.height;
      if (frame && height > 0 && height < 20_000) frame.style.height = `${Math.ceil(height)}px`;
    });
  },
  async shown(project) {
    $("play-none").hidden = project.state.scene;
    $("play-work").hidden = !project.state.scene;
    if (!project.state.scene) return;
    if (!$("suggestions").childElementCount) $("suggestions").replaceChildren(element("span", { class: "wait", text: "Looking what the scene allows" }));
    const { suggestions } = await ask("goals/menu");
    $("suggestions").replaceChildren(...suggestions.map((words) => element("button", { type: "button", text: words, onclick: () => {
      $("goal").value = words;
      $("goal").focus();
      understand();
    } })));
    await list(project);
  },
};
