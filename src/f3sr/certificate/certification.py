"""certify: a package released in every engine that is found, checked by every validator, and the page that says so."""

from __future__ import annotations

import json
import os
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from f3sr.certificate.certificate_document import (
    KIND,
    Certificate,
    CertifiedObject,
    EngineRow,
    ValidatorRow,
    as_plain,
)
from f3sr.certificate.certificate_page import certificate_page
from f3sr.certificate.client_answers import Finding, FindingsAnswer, ReleaseAnswer
from f3sr.certificate.client_run import ClientOutcome, require_programs, run_client
from f3sr.certificate.clients_table import CLIENTS, ENGINES, VALIDATORS, Client
from f3sr.certificate.rest_rule import PASSING, CertificateConfig, Released, judged
from f3sr.errors import F3srError, InputError, OutputError, require_kind, require_known, require_names
from f3sr.exporters.export_names import export_name
from f3sr.files import limited_file
from f3sr.goals.scene_layout import SceneLayout
from f3sr.play.goal_loop import scene_sha
from f3sr.runtime.atomic_folder import claimed
from f3sr.runtime.progress import Progress, silent, timed, words_to
from f3sr.scene_export import export_package, exporters_of
from f3sr.scene_package.package import Package
from f3sr.scene_package.package_folder import placed
from f3sr.scene_package.scene_json import dump_json

DOCUMENT, PAGE = "certificate.json", "certificate.html"
LARGEST_DOCUMENT = 64_000_000
"""Bytes of an older certificate that is read before it is replaced."""
INTERVAL = 0.1
"""Time between samples of a release [s]: what comes and goes in between is a vibration, not a drift."""
FORMATS = ("mjcf", "sdf", "urdf", "usd")


def certify(
    package: Package,
    out: str | Path,
    *,
    clients: Sequence[str] = (),
    programs: Mapping[str, str] | None = None,
    config: CertificateConfig | None = None,
    deadline: float = 600.0,
    overwrite: bool = False,
    progress: Progress = silent,
) -> Certificate:
    """Write ``certificate.json`` and ``certificate.html`` of a package to the folder ``out``.

    ``clients``: names of engines and validators, all where none is named. ``programs``: by name of a client, the Python
    interpreter of its environment (for ``gltf``, node); without one, this Python. ``deadline``: of each client, wall
    time [s]. A client that is missing, crashes, hangs or answers nonsense is a row that says so. Raises InputError for
    an unknown name and OutputError if ``out`` may not be written.
    """
    require_kind("package", package, Package, accepted="f3sr.read_package(...)")
    require_names("clients", clients)
    require_known("--engines", clients, list(CLIENTS))
    require_programs(programs or {}, list(CLIENTS))
    if not 1 <= deadline <= 86_400:
        raise InputError("--deadline", found=f"{deadline:g}", accepted="1 to 86400 seconds")
    place = placed(out)
    with claimed(place, lambda out: _require_replaceable(out, overwrite=overwrite)) as claim:
        certificate = _certificate(
            package, clients, programs or {}, config or CertificateConfig(), deadline=deadline, progress=progress
        )
        claim.write(DOCUMENT, dump_json(as_plain(certificate)))
        claim.write(PAGE, certificate_page(certificate))
        claim.replace()
    return certificate


def beside(package: Path) -> Path:
    """Where a certificate goes unless a user names a place: ``table_certificate`` beside ``table``."""
    whole = Path(package).absolute()
    return whole.with_name(f"{whole.name}_certificate")


def prepare_certificate(out: str | Path, *, overwrite: bool = False) -> Path:
    """The full path of ``out``, or the OutputError that certifying to it would begin with."""
    place = placed(out)
    with claimed(place, lambda out: _require_replaceable(out, overwrite=overwrite)):
        return place


def _certificate(
    package: Package,
    clients: Sequence[str],
    programs: Mapping[str, str],
    config: CertificateConfig,
    *,
    deadline: float,
    progress: Progress,
) -> Certificate:
    asked = list(dict.fromkeys(clients)) or list(CLIENTS)
    released = _released(package)
    with tempfile.TemporaryDirectory(prefix="f3sr-certify-") as folder:
        files, lacking = _files(package, Path(folder) / "exports", [CLIENTS[name] for name in asked], progress)

        def ask(client: Client, kind: Any, request: Mapping[str, Any]) -> tuple[ClientOutcome[Any], float]:
            if client.format in lacking:
                return ClientOutcome(missing=lacking[client.format]), 0.0
            began = time.monotonic()
            with timed(f"certify {client.name}", progress):
                outcome = run_client(
                    client,
                    kind,
                    {"file": files[client.given][0], "files": files[client.given], **request},
                    program=programs.get(client.name),
                    deadline=deadline,
                    told=lambda words: words_to(progress)(f"{client.title}: {words}"),
                )
            return outcome, time.monotonic() - began

        release = {"names": list(released), "seconds": config.seconds, "interval": INTERVAL}
        engines = [
            _engine_row(ENGINES[name], *ask(ENGINES[name], ReleaseAnswer, release), package, released, config)
            for name in asked
            if name in ENGINES
        ]
        validators = [
            _validator_row(VALIDATORS[name], ask(VALIDATORS[name], FindingsAnswer, {})[0], Path(folder), package)
            for name in asked
            if name in VALIDATORS
        ]
    return Certificate(
        package=package.folder.resolve().name,
        scene_sha256=scene_sha(package),
        config=config,
        engines=engines,
        validators=validators,
        named=list(clients),
    )


def _released(package: Package) -> dict[str, Released]:
    """The objects by their exported names, in the order of their ids."""
    layout = SceneLayout(package.scene)
    return {
        export_name(o.id, o.label): Released(
            body=layout.body(o.id), round=layout.can_roll(o.id), size=layout.size(o.id)
        )
        for o in package.scene
    }


def _files(
    package: Package, exports: Path, clients: Sequence[Client], progress: Progress
) -> tuple[dict[str, list[str]], dict[str, str]]:
    """The files that clients are given, by format; and the formats that cannot be written, with the reason."""
    whole = package.folder.resolve()
    files = {"scene.xml": [str(whole / "scene.xml")], "scene.glb": [str(whole / "scene.glb")]}
    lacking = dict[str, str]()
    wanted = list[str]()
    for name in sorted({client.format for client in clients} & set(FORMATS)):
        try:
            exporters_of([name])
            wanted.append(name)
        except F3srError as error:
            lacking[name] = str(error)
    if wanted:
        export_package(package, exports, wanted, progress=progress)
    names = [export_name(o.id, o.label) for o in package.scene]
    files["urdf"] = [str(exports / "urdf/poses.json")]
    files["sdf"] = [str(exports / "sdf/scene.sdf")]
    files["mjcf"] = [str(exports / "mjcf/scene.xml"), *(str(exports / f"mjcf/{n}/scene.xml") for n in names)]
    files["usd props"] = [str(exports / f"usd/{n}/simready_usd/{n}.usda") for n in names]
    files["usd"] = [str(exports / "usd/scene.usda"), *files["usd props"]]
    return files, lacking


def _engine_row(
    client: Client,
    outcome: ClientOutcome[ReleaseAnswer],
    seconds: float,
    package: Package,
    released: Mapping[str, Released],
    config: CertificateConfig,
) -> EngineRow:
    answer = outcome.answer
    if answer is None:
        state = "not installed" if outcome.missing else "no answer"
        return EngineRow(client=client, state=state, reason=outcome.missing or outcome.problem, seconds=seconds)
    moving = [name for name, o in released.items() if not o.body.fixed]
    if fault := answer.fault(list(released), moving, round(config.seconds / INTERVAL) + 1):
        return EngineRow(client=client, state="no answer", reason=f"its answer has {fault}", seconds=seconds)
    rows = [
        CertifiedObject(
            id=o.id,
            label=o.label,
            name=name,
            fixed=released[name].body.fixed,
            verdict=judged(released[name], [s[name] for s in answer.samples], answer.bodies.get(name), config),
            penetration=None if answer.penetrations is None else answer.penetrations[name],
        )
        for name, o in zip(released, package.scene, strict=True)
    ]
    passed = all(row.verdict.verdict in PASSING for row in rows)
    return EngineRow(
        client=client,
        state="passed" if passed else "failed",
        versions=answer.versions,
        settings=answer.settings,
        timestep=answer.timestep,
        seconds=seconds,
        notes=answer.notes,
        objects=rows,
    )


def _validator_row(
    client: Client, outcome: ClientOutcome[FindingsAnswer], folder: Path, package: Package
) -> ValidatorRow:
    answer = outcome.answer
    if answer is None:
        state = "not installed" if outcome.missing else "no answer"
        return ValidatorRow(client=client, state=state, reason=outcome.missing or outcome.problem)
    severities = {finding.severity for finding in answer.findings}
    state = "failed" if "error" in severities else "warned" if "warning" in severities else "passed"
    return ValidatorRow(
        client=client,
        state=state,
        versions=answer.versions,
        checked=answer.checked,
        findings=[_placeless(finding, (folder / "exports", package.folder.resolve())) for finding in answer.findings],
    )


def _placeless(finding: Finding, folders: Sequence[Path]) -> Finding:
    """The finding with paths relative to the export or to the package: a certificate names no place of a machine."""
    file, text = finding.file, finding.text
    for folder in folders:
        file, text = (words.replace(f"{folder}{os.sep}", "") for words in (file, text))
    return Finding(severity=finding.severity, file=file, text=text)


def _require_replaceable(out: Path, *, overwrite: bool) -> None:
    """Raises OutputError unless a certificate may take the place ``out``."""
    if not os.path.lexists(out) or (out.is_dir() and not any(out.iterdir())):
        return
    if not _is_certificate(out):
        raise OutputError(f"{out}: is there already and no certificate; give a new or empty folder with -o")
    if strangers := sorted(p.name for p in out.iterdir() if p.name not in (DOCUMENT, PAGE)):
        raise OutputError(f"{out}: holds {strangers[0]}, which f3sr did not write; move it away first")
    if not overwrite:
        raise OutputError(f"{out}: holds a certificate; it is replaced only with --overwrite")


def _is_certificate(out: Path) -> bool:
    file = out / DOCUMENT
    try:
        if file.is_symlink() or not file.is_file():
            return False
        tree = json.loads(limited_file.read(file, most=LARGEST_DOCUMENT))
    except (OSError, InputError, ValueError, RecursionError):
        return False
    return isinstance(tree, dict) and tree.get("kind") == KIND
