// The step in which the scene is taken away: downloads, other formats, the certificate.
import { $, ask, busy, element, say } from "./ask.js";

const checks = (place, names, chosen) => $(place).replaceChildren(...names.map((c) => element("label", { class: "check", title: c.found || "" },
  element("input", { type: "checkbox", name: place, value: c.name, checked: c.met && chosen(c.name), disabled: !c.met }), ` ${c.name}`, element("small", { text: c.found }))));
const chosen = (place) => [...$(place).querySelectorAll("input:checked")].map((c) => c.value);

const follow = async (project, kind, options, done) => {
  const state = $(`${kind}-state`);
  if (!Object.values(options)[0].length) throw new Error(`Tick at least one ${kind === "export" ? "format" : "engine"}.`);
  state.className = "";
  state.textContent = "…";
  const ended = await project.job(kind, options, (event) => {
    if (event.event === "step" && event.state !== "done") state.textContent = `${event.name} …`;
  });
  state.className = ended.state === "failed" ? "bad" : "";
  state.textContent = ended.state === "done" ? done(ended.result) : ended.problem || ended.state;
  say(state.textContent);
};

export const take = {
  begin(project) {
    checks("formats", project.state.choices.formats, (name) => ["usd", "urdf", "sdf", "mjcf"].includes(name));
    const engines = project.state.choices.engines, absent = engines.filter((c) => !c.met);
    checks("engines", engines.filter((c) => c.met), () => true);
    $("engines-absent").replaceChildren(...absent.map((c) => element("li", { text: `${c.name}: ${c.found}` })));
    $("engines-more").hidden = !absent.length;
    $("take-package").href = "package.zip";
    $("take-export").href = "export.zip";
    $("export-form").addEventListener("submit", (e) => {
      e.preventDefault();
      busy($("export-start"), () => follow(project, "export", { formats: chosen("formats") }, () => "The export is ready to be downloaded."));
    });
    $("certify-form").addEventListener("submit", (e) => {
      e.preventDefault();
      busy($("certify-start"), () => follow(project, "certify", { engines: chosen("engines") }, () => "The certificate is below."));
    });
  },
  changed(project) {
    $("take-none").hidden = project.state.scene;
    $("take-work").hidden = !project.state.scene;
    $("take-export").hidden = !project.state.exported;
    $("certificate-frame").hidden = !project.state.certified;
    if (project.state.certified) $("certificate-frame").src = `${project.state.framed}certificate/certificate.html`;
  },
};
