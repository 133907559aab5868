// The step in which objects are outlined: the page of `f3sr segment` in a frame, or a picture of masks that are given.
import { $, ask, complain, element } from "./ask.js";

const NAMES = { grabcut: "GrabCut, without a network" };

export const outline = {
  begin(project) {
    const there = project.state.choices.segmenters.filter((c) => c.met);
    $("segmenter").append(...there.map((c) => element("option", { value: c.name, text: NAMES[c.name] || c.name, selected: c.name === (project.state.segmenter || "grabcut") })));
    $("segmenter").addEventListener("change", async () => {
      try {
        complain(null);
        await ask("outline/segmenter", { segmenter: $("segmenter").value });
        $("outline-frame").src = "outline/";
      } catch (error) {
        complain(error);
      }
    });
    addEventListener("message", async (e) => {
      if (e.origin !== location.origin || e.source !== $("outline-frame").contentWindow || e.data !== "f3sr: outlined") return;
      await project.refresh();
      project.go("run");
    });
  },
  shown(project) {
    const drawn = project.state.photo;
    $("outline-frame").hidden = !drawn;
    $("outline-with").hidden = !drawn || $("segmenter").length < 2;
    $("outline-given").hidden = drawn;
    if (!drawn) $("outline-picture").src = "masks.jpg";
    else if (!$("outline-frame").src || outline.done) {
      $("outline-wait").hidden = false;
      $("outline-frame").addEventListener("load", () => { $("outline-wait").hidden = true; }, { once: true });
      $("outline-frame").src = "outline/";
    }
  },
  changed(project) {
    outline.done = project.state.outlined;
  },
};
