// The first page: a photo, the example or a folder becomes a project; projects are listed.
import { $, ask, busy, complain, element, note, send } from "./ask.js";

const enter = (id) => location.assign(`p/${id}/`);

const take = async (file) => {
  if (!file) return;
  complain(null);
  $("sent").hidden = false;
  try {
    const made = await send(`projects/photo?name=${encodeURIComponent(file.name)}`, file, (share) => { $("sent").value = share; });
    enter(made.id);
  } catch (error) {
    complain(error);
    $("sent").hidden = true;
  }
};

$("photo").addEventListener("change", (e) => take(e.target.files[0]));
const drop = $("drop");
for (const name of ["dragenter", "dragover"]) document.addEventListener(name, (e) => {
  e.preventDefault();
  drop.classList.add("over");
});
document.addEventListener("dragleave", (e) => { if (!e.relatedTarget) drop.classList.remove("over"); });
document.addEventListener("drop", (e) => {
  e.preventDefault();
  drop.classList.remove("over");
  take(e.dataTransfer.files[0]);
});
$("example").addEventListener("click", (e) => busy(e.currentTarget, async () => enter((await ask("projects/example", {})).id)));
$("open").addEventListener("submit", (e) => {
  e.preventDefault();
  busy(e.submitter || e.target.querySelector("button"), async () => enter((await ask("projects/folder", { folder: $("folder").value })).id));
});

// --- the list ---------------------------------------------------------------------------------------------------

const STATES = { photo: "photo: to be outlined", outlined: "outlined: to be made", scene: "scene", damaged: "cannot be read" };

const SURE_MS = [1000, 6000]; // after the first click, in which a second one deletes
const date = (seconds) => new Date(1000 * seconds).toLocaleString([], { dateStyle: "medium", timeStyle: "short" });
const card = (project) => {
  const name = element("bdi", { text: project.name }), facts = [project.job || STATES[project.state], project.rollouts ? `${project.rollouts} played` : "", project.created ? date(project.created) : ""];
  const inside = [
    project.picture ? element("img", { src: `p/${project.id}/thumb.jpg`, alt: "", loading: "lazy" }) : element("span", { class: "blank", "aria-hidden": "true" }),
    element("span", { class: "name" }, name),
    element("span", { class: "fine", text: facts.filter(Boolean).join(" · ") }),
  ];
  const remove = element("button", { type: "button", class: "quiet-button", text: "Delete", "aria-label": `Delete ${project.name}` });
  let asked = -Infinity; // when the first click was
  remove.addEventListener("click", () => {
    const since = performance.now() - asked;
    if (since < SURE_MS[0]) return; // a double click is no second thought
    if (since < SURE_MS[1]) return busy(remove, async () => {
      await ask(`p/${project.id}/delete`, {});
      await list();
      note(`${project.name} is deleted.`);
    });
    asked = performance.now();
    remove.textContent = `Delete it${project.rollouts ? ", its films" : ""}${project.job ? ", and end its job" : ""}?`;
    setTimeout(() => { remove.textContent = "Delete"; }, SURE_MS[1]);
  });
  const link = project.state === "damaged" ? element("div", { class: "card" }, ...inside, element("span", { class: "bad", text: project.problem }))
    : element("a", { class: "card", href: `p/${project.id}/` }, ...inside);
  return element("li", {}, link, remove);
};

const list = async () => {
  const { projects } = await ask("projects");
  $("projects").replaceChildren(...projects.map(card));
  $("none").hidden = projects.length > 0;
};
list().catch(complain);
window.studio = { list };
