// What is drawn: objects with box and strokes, strokes on the ground, and the steps that led there. No page in it.
const marksOf = (selection) => {
  "use strict";
  let next = 1;
  const strokesOf = (p) => ({ inside: p.inside, outside: p.outside });
  const object = (p) => ({ key: next++, label: p.label, box: p.box, ...strokesOf(p) });
  let now = { objects: selection.prompts.map(object), ground: strokesOf(selection.ground) };
  const past = [], future = [];
  const commit = (state) => {
    past.push(now);
    future.length = 0;
    now = state;
  };
  const changed = (key, change) => ({
    ...now,
    ...(key === "ground" ? { ground: { ...now.ground, ...change(now.ground) } } : {}),
    objects: now.objects.map((o) => (o.key === key ? { ...o, ...change(o) } : o)),
  });
  return {
    get objects() { return now.objects; },
    get ground() { return now.ground; },
    get canUndo() { return past.length > 0; },
    get canRedo() { return future.length > 0; },
    of: (key) => (key === "ground" ? now.ground : now.objects.find((o) => o.key === key)),
    add(box) {
      const made = object({ label: "", box, inside: [], outside: [] });
      commit({ ...now, objects: [...now.objects, made] });
      return made.key;
    },
    move(key, box) { commit(changed(key, () => ({ box }))); },
    draw(key, side, stroke) { commit(changed(key, (o) => ({ [side]: [...o[side], stroke] }))); },
    name(key, label) { if (this.of(key).label !== label) commit(changed(key, () => ({ label }))); },
    remove(key) {
      if (key === "ground") commit({ ...now, ground: { inside: [], outside: [] } });
      else commit({ ...now, objects: now.objects.filter((o) => o.key !== key) });
    },
    undo() {
      if (!past.length) return;
      future.push(now);
      now = past.pop();
    },
    redo() {
      if (!future.length) return;
      past.push(now);
      now = future.pop();
    },
    selection: () => ({
      ...selection,
      prompts: now.objects.map(({ label, box, inside, outside }) => ({ label, box, inside, outside })),
      ground: { label: "", box: null, ...now.ground },
    }),
  };
};
