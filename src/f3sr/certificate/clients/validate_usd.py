"""OpenUSD's own validators, all that it ships, on the scene and on every prop."""

from __future__ import annotations

from client_job import ClientJob


def main() -> None:
    job = ClientJob.from_arguments()
    usd, validation = job.library("pxr.Usd"), job.library("pxr.UsdValidation")
    validators = validation.ValidationRegistry().GetOrLoadAllValidators()
    context = validation.ValidationContext(validators)
    findings = list[dict[str, str]]()
    for file in job.files:
        stage = usd.Stage.Open(file)
        for error in context.Validate(stage):
            severity = "error" if "Error" in str(error.GetType()) else "warning"
            findings.append({"severity": severity, "file": file, "text": f"{error.GetName()}: {error.GetMessage()}"})
    job.answer_findings(packages=["usd-core"], findings=findings, checked=len(job.files))


if __name__ == "__main__":
    main()
