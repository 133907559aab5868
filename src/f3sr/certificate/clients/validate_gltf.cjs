// Khronos' glTF validator on scene.glb. Node finds gltf-validator beside the working folder or by NODE_PATH.
"use strict";
const fs = require("fs");
const path = require("path");
const job = process.argv[process.argv.indexOf("--job") + 1];
const request = JSON.parse(fs.readFileSync(path.join(job, "request.json"), "utf8"));

function answer(value) {
  fs.writeFileSync(path.join(job, "answer.part"), JSON.stringify(value));
  fs.renameSync(path.join(job, "answer.part"), path.join(job, "answer.json"));
}

let validator;
try {
  validator = require("gltf-validator");
} catch (error) {
  answer({ missing: "node finds no gltf-validator" });
  process.exit(0);
}
const SEVERITY = ["error", "warning", "note", "note"];
Promise.all(
  request.files.map((file) =>
    validator.validateBytes(new Uint8Array(fs.readFileSync(file))).then((report) =>
      report.issues.messages.map((m) => ({ severity: SEVERITY[m.severity], file, text: `${m.code}: ${m.message}` })),
    ),
  ),
).then(
  (found) => answer({
    versions: { node: process.versions.node, "gltf-validator": validator.version() },
    findings: found.flat(),
    checked: request.files.length,
  }),
  (error) => { console.error(String(error)); process.exit(1); },
);
