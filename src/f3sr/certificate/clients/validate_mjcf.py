"""mjcf-doctor: the scene and every object's model, loaded and simulated."""

from __future__ import annotations

from client_job import ClientJob

SEVERITY = {"ERROR": "error", "WARN": "warning", "INFO": "note"}


def main() -> None:
    job = ClientJob.from_arguments()
    doctor, mujoco = job.library("mjcf_doctor"), job.library("mujoco")
    findings = list[dict[str, str]]()
    for file in job.files:
        report = doctor.diagnose(mujoco.MjModel.from_xml_path(file))
        for finding in report.findings:
            level = SEVERITY.get(finding.level.name, "warning")
            text = f"{finding.code}: {finding.subject}, {finding.message}"
            findings.append({"severity": level, "file": file, "text": text})
    job.answer_findings(packages=["mjcf-doctor", "mujoco"], findings=findings, checked=len(job.files))


if __name__ == "__main__":
    main()
