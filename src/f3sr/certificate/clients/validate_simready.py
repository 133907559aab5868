"""NVIDIA's simready-validate: every prop against the profile Robotics-Prop 4.0.0."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from client_job import ClientJob

PROFILE, VERSION = "Robotics-Prop", "4.0.0"
PASSED = f"[PASSED] {PROFILE} v{VERSION}"
OPTIONAL = "optional feature"


def main() -> None:
    job = ClientJob.from_arguments()
    program = Path(sys.executable).with_name("simready-validate")
    if not program.exists():
        job.end_without("No program simready-validate beside its Python")
    assets = job.folder / "assets.txt"
    assets.write_text("\n".join(job.files))
    job.say(f"{len(job.files)} props")
    options = ["--profile", PROFILE, "--version", VERSION, "--asset_list", str(assets)]
    done = subprocess.run([str(program), *options], capture_output=True, text=True, cwd=job.folder, check=False)
    sections = done.stdout.split("Asset: ")[1:]
    told = {section.splitlines()[0].strip(): section.splitlines()[1:] for section in sections}
    findings = list[dict[str, str]]()
    for file in job.files:
        lines = told.get(file)
        if lines is None:
            findings.append({"severity": "error", "file": file, "text": f"no verdict: {done.stderr.strip()[-150:]}"})
        elif not any(PASSED in line for line in lines):
            unmet = [line.strip() for line in lines if line.strip() and OPTIONAL not in line]
            findings.append({"severity": "error", "file": file, "text": "; ".join(unmet)[:190] or "not passed"})
    job.answer_findings(
        packages=["simready-validate", "simready-foundation-tier-core", "usd-core"],
        findings=findings,
        checked=len(job.files),
    )


if __name__ == "__main__":
    main()
