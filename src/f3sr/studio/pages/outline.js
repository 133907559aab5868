// The step in which objects are outlined: the page of `f3sr segment` in a frame, or a picture of masks that are given.
import { $ } from "./ask.js";

export const outline = {
  begin(project) {
    addEventListener("message", async (e) => {
      if (e.origin !== location.origin || e.source !== $("outline-frame").contentWindow || e.data !== "f3sr: outlined") return;
      await project.refresh();
      project.go("run");
    });
  },
  shown(project) {
    const drawn = project.state.photo;
    $("outline-frame").hidden = !drawn;
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
