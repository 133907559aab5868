"""Laws of datasets: the index is what records say, conditions select as Python would, shards and pages are whole."""

from __future__ import annotations

import io
import json
import random
import re
import shutil
import tarfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from f3sr.cli.main import main
from f3sr.dataset.columns import COLUMNS, Kind
from f3sr.dataset.index import read_index, write_index
from f3sr.dataset.layout import INDEX, STALE, UNFINISHED, Dataset, failure_of, scene_of
from f3sr.dataset.prune import prune
from f3sr.dataset.record import Record, contents_of, to_bytes
from f3sr.dataset.row_selection import refer, scenes_with, selected
from f3sr.dataset.shards import export
from f3sr.dataset.storage import RECORD
from f3sr.dataset.summary import grouped, summary, told
from f3sr.errors import F3srError, InputError, OutputError
from f3sr.runtime import signals

pytest.importorskip("pyarrow", reason="no pyarrow: pip install 'f3sr[dataset]'")
HOSTILE = '<script>alert(1)</script>"\u202e'


def write_dataset(folder: Path, count: int = 12) -> Dataset:
    """Scenes 0, 1, 2 ...; every fourth failed. Measures, labels and goals follow from the number."""
    dataset = Dataset.made(folder)
    dataset.begin()
    jobs: list[dict[str, str]] = []
    for k in range(count):
        key = f"{k:02x}" + "0" * 62
        jobs.append({"name": f"scene-{k:03d}", "source": f"/in/{k}", "key": key})
        shared = {"key": key, "inputs": "i", "code": "c", "versions": {"f3sr": "1"}}
        if k % 4 == 3:
            record = Record(**shared, status="failed", failure="bad input", reason=f"no assets {HOSTILE}")
            dataset.storage.write(failure_of(key), to_bytes(record))
            continue
        package = folder / scene_of(key) / "package"
        (package / "pictures").mkdir(parents=True)
        (package / "masks").mkdir()
        Image.new("RGB", (800, 600), (k, 100, 100)).save(package / "pictures" / "overlay_after.png")
        Image.new("RGB", (8, 6), (k, 100, 100)).save(package / "photo.png")
        Image.new("L", (8, 6)).save(package / "masks" / "0.png")
        (package / "scene.json").write_text(json.dumps({"k": k}))
        (package / "report.html").write_text("")
        record = Record(
            **shared,
            status="done",
            package=contents_of(package),
            scene={"n": 2, "mIoU_visible": k / count, "unknown later": 7, "K_max_J": None},
            objects=({"id": 0, "label": "mug", "mass": 0.1 * k}, {"id": 1, "label": f"ball {k}", "mass": "heavy"}),
            goals=({"number": 1, "goal": f"roll {HOSTILE}", "state": "met" if k % 2 else "refused"},),
        )
        (package.parent / RECORD).write_bytes(to_bytes(record))
    dataset.storage.write("jobs.jsonl", "".join(json.dumps(job) + "\n" for job in jobs).encode())
    return dataset


@pytest.fixture
def dataset(tmp_path: Path) -> Dataset:
    return write_dataset(tmp_path / "ds")


# --- the index ---------------------------------------------------------------------------------------------------


def test_the_index_has_a_row_of_every_scene_object_and_goal(dataset: Dataset) -> None:
    rows = read_index(dataset).to_pylist()
    kinds = [row["kind"] for row in rows]
    assert (kinds.count("scene"), kinds.count("object"), kinds.count("goal")) == (12, 18, 9)
    scene = next(r for r in rows if r["kind"] == "scene" and r["name"] == "scene-002")
    assert scene["mIoU_visible"] == 2 / 12 and scene["n"] == 2 and scene["K_max_J"] is None
    assert scene["package"] == f"{scene_of(scene['key'])}/package" and scene["package_files"] == 5
    failed = next(r for r in rows if r["name"] == "scene-003")
    assert failed["failure"] == "bad input" and failed["package"] is None
    heavy = next(r for r in rows if r["label"] == "ball 2")
    assert heavy["mass"] is None and heavy["name"] == "scene-002"  # a value of another type is no value


def test_an_index_is_derived_again_where_a_run_has_begun_since(dataset: Dataset) -> None:
    write_index(dataset)
    first = dataset.storage.read(INDEX)
    dataset.storage.write(INDEX, b"old")
    with pytest.raises(InputError, match="delete it to derive it"):
        read_index(dataset)
    dataset.storage.write(STALE, b"")
    assert read_index(dataset).num_rows == 39 and dataset.storage.read(INDEX) == first
    assert not dataset.storage.has(STALE)


def test_a_listed_job_without_a_record_waits(dataset: Dataset) -> None:
    key = next(dataset.listed()).key
    dataset.storage.remove(f"{scene_of(key)}/{RECORD}")
    assert selected(dataset, ["status = 'waiting'"]).column("name").to_pylist() == ["scene-000"]


def test_no_column_comes_twice() -> None:
    names = [column.name for column in COLUMNS]
    assert len(set(names)) == len(names)


@pytest.mark.parametrize("data", [b"", b"{}", b"[1]", b'{"format": "f3sr dataset", "version": 2}', b"\xff"])
def test_what_is_no_dataset_is_refused(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "dataset.json").write_bytes(data)
    with pytest.raises(InputError, match="accepted: a dataset that `f3sr batch` wrote"):
        Dataset.read(tmp_path)


@pytest.mark.parametrize("key", ["../../etc", "0" * 63, "A" * 64, 7, None])
def test_a_key_leads_nowhere_else(dataset: Dataset, tmp_path: Path, key: object) -> None:
    dataset.storage.write("jobs.jsonl", json.dumps({"name": "a", "source": "", "key": key}).encode())
    with pytest.raises(InputError, match=r"accepted: (64 hexadecimal digits|a dataset that `f3sr batch` wrote)"):
        list(dataset.listed())


def test_links_are_no_files_of_a_package(dataset: Dataset, tmp_path: Path) -> None:
    job = next(dataset.listed())
    (tmp_path / "ds" / scene_of(job.key) / "package" / "secret.png").symlink_to("/etc/passwd")
    (tmp_path / "ds" / scene_of(job.key) / "package" / "more").symlink_to("/etc")
    export(dataset, [job], tmp_path / "shards", megabytes=1, files=("*",))
    assert not [name for name in samples(tmp_path / "shards")[job.key[:32]] if "secret" in name or "more" in name]


# --- conditions --------------------------------------------------------------------------------------------------

CASES: dict[str, Callable[[dict[str, Any]], bool]] = {
    "mIoU_visible > .5": lambda r: r["mIoU_visible"] is not None and r["mIoU_visible"] > 0.5,
    "not (n = 2) or status != 'done'": lambda r: (r["n"] is not None and r["n"] != 2) or r["status"] != "done",
    "mIoU_visible >= 1e-1 and mIoU_visible < .6": lambda r: r["n"] is not None and 0.1 <= r["mIoU_visible"] < 0.6,
    "status = failed": lambda r: False,
    "name contains 'SCENE-00'": lambda r: "scene-00" in r["name"],
    "name in ('scene-001', \"scene-004\")": lambda r: r["name"] in ("scene-001", "scene-004"),
    "mIoU_visible is null": lambda r: r["mIoU_visible"] is None,
    "mIoU_visible is not null and (n == 2 and n in (1, 2))": lambda r: r["mIoU_visible"] is not None,
}


@pytest.mark.parametrize("text", CASES)
def test_a_condition_selects_as_python_would(dataset: Dataset, text: str) -> None:
    if text == "status = failed":
        with pytest.raises(InputError, match="found 'failed' in 'status = failed'; accepted: a text in quotes"):
            selected(dataset, [text])
        return
    rows = selected(dataset, []).to_pylist()
    expected = [row["name"] for row in rows if CASES[text](row)]
    assert [job.name for job in scenes_with(dataset, [text])] == expected and 0 < len(expected) <= 12


@pytest.mark.parametrize(
    ("text", "kind", "has"), [("label = 'apple'", "scene", "object"), ("IoU > .5 and n = 2", "object", "scene")]
)
def test_a_column_of_other_rows_is_refused_with_the_kind_that_has_it(text: str, kind: Kind, has: str) -> None:
    from f3sr.dataset.where import condition

    with pytest.raises(InputError, match=f"which rows of {kind}s do not have.*; or --of {has}"):
        condition(text, kind)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "found the end in ''; accepted: a column"),
        ("n", "found the end in 'n'; accepted: one of = =="),
        ("n >", "accepted: a number"),
        ("n > 'a'", "accepted: a number"),
        ("colour = 1", "found 'colour' in 'colour = 1'; accepted: a column: kind"),
        ("n = 1 1", "accepted: and, or, or the end"),
        ("(n = 1", "accepted: )"),
        ("n contains 'a'", "accepted: one of"),
        ("n in ()", "accepted: a number"),
        ("n is 1", "accepted: null"),
        ("__import__('os') = 1", "accepted: a column"),
        ("n = 1; n", "found '; n'; accepted: columns"),
        ("n = 1e999", "accepted: a number"),
        ("(" * 3000, "found 3000 characters"),
        ("(" * 300, "nested too deeply"),
        ("not " * 300 + "n = 1", "nested too deeply"),
    ],
)
def test_a_wrong_condition_says_where_and_what_is_accepted(text: str, said: str) -> None:
    from f3sr.dataset.where import condition

    with pytest.raises(InputError) as caught:
        condition(text)
    assert said in str(caught.value) and str(caught.value).startswith("--where: found ")


def test_no_text_is_more_than_a_condition() -> None:
    """Random words of the grammar: an expression, or one error."""
    from f3sr.dataset.where import condition

    words = ["n", "=", "1", "and", "not", "(", ")", "in"]
    rng, good = random.Random(0), 0
    for _ in range(2000):
        try:
            condition(" ".join(rng.choices(words, k=rng.randint(1, 9))))
            good += 1
        except InputError:
            pass
    assert 0 < good < 1000


def test_conditions_on_objects_select_their_scenes(dataset: Dataset) -> None:
    assert [j.name for j in scenes_with(dataset, ["label = 'ball 4'"], "object")] == ["scene-004"]
    assert len(scenes_with(dataset, ["state = 'met'"], "goal")) == 3


# --- what is made of it ------------------------------------------------------------------------------------------


def test_a_dataset_by_reference_serves_like_its_base(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(signals, "_kept", [])
    (tmp_path / "moved").mkdir()
    out = str(tmp_path / "some")
    call = ["dataset", "filter", str(tmp_path / "ds"), "--where", "mIoU_visible > .3"]
    assert main([*call, "--where", "n = 2", "-o", out]) == 0
    assert main([*call, "-o", out]) == 0  # again, in its place
    for name in ("ds", "some"):
        (tmp_path / name).rename(tmp_path / "moved" / name)
    found = Dataset.read(tmp_path / "moved" / "some")
    assert summary(found)["status"] == {"done": 6} and len(list(found.listed())) == 6
    assert export(found, list(found.listed()), tmp_path / "shards", megabytes=1, files=["*"]).is_dir()
    assert main(["batch", str(tmp_path), "-o", str(tmp_path / "moved" / "some")]) != 0


def test_figures_count_each_scene_once(dataset: Dataset) -> None:
    told = summary(dataset)
    assert told["status"] == {"done": 9, "failed": 3} and told["failures"] == {"bad input": 3}
    assert told["objects"] == 18 and told["labels"]["mug"] == 9 and told["goals"] == {"met": 3, "refused": 6}
    values = [k / 12 for k in range(12) if k % 4 != 3]
    assert told["measures"]["mIoU_visible"]["median"] == sorted(values)[4]
    assert told["measures"]["mIoU_visible"]["least"] == 0 and "K_max_J" not in told["measures"]
    assert summary(dataset, ["n = 2"])["objects"] == 18 and summary(dataset, ["status = 'failed'"])["objects"] == 0


def test_reasons_count_as_one_where_paths_of_the_input_or_numbers_differ() -> None:
    rows = [
        {"source": f"/in/{k}", "failure": "bad input", "reason": f"/in/{k}/image.jpg: found {k}.5 MB; accepted: 1 MB"}
        for k in range(3)
    ]
    other = {"source": "/in/7", "failure": "crash", "reason": "killed"}
    assert grouped(map(told, [other, *rows])) == {
        "bad input: image.jpg: found 0.5 MB; accepted: 1 MB": 3,
        "crash: killed": 1,
    }
    assert told({"source": "/in/7", "failure": "", "reason": ""}) == ""
    assert told({"source": None, "failure": "lost", "reason": None}) == "lost"


def samples(shards: Path) -> dict[str, dict[str, bytes]]:
    """What a reader of WebDataset finds: members by the key before the first dot of their name."""
    found: dict[str, dict[str, bytes]] = {}
    for file in sorted(shards.glob("*.tar")):
        with tarfile.open(file) as tar:
            last, closed = "", set[str]()
            for member in tar:
                key, _, extension = member.name.partition(".")
                assert key not in closed and member.mtime == 0 and (member.uid, member.gid) == (0, 0)
                closed |= {last} - {key}
                last = key
                stream = tar.extractfile(member)
                assert stream is not None
                found.setdefault(key, {})[extension] = stream.read()
    return found


def test_shards_hold_whole_samples_with_equal_bytes(dataset: Dataset, tmp_path: Path) -> None:
    jobs = list(dataset.listed())
    for name in ("a", "b"):
        export(dataset, jobs, tmp_path / name, megabytes=0.01, files=("photo.png", "masks/*", "scene.json"))
    files = sorted(p.name for p in (tmp_path / "a").iterdir())
    assert len(files) > 3 and files[-1] == "shards.json"
    assert all((tmp_path / "a" / f).read_bytes() == (tmp_path / "b" / f).read_bytes() for f in files)
    found = samples(tmp_path / "a")
    assert len(found) == 9 and all(len(s) == 4 for s in found.values())
    for job in jobs[:3]:
        sample = found[job.key[:32]]
        package = tmp_path / "ds" / scene_of(job.key) / "package"
        assert sample["masks.0.png"] == (package / "masks" / "0.png").read_bytes()
        assert Image.open(io.BytesIO(sample["photo.png"])).size == (8, 6)
        assert json.loads(sample["record.json"])["key"] == job.key
    told = json.loads((tmp_path / "a" / "shards.json").read_text())["shards"]
    assert sum(s["samples"] for s in told) == 9
    with pytest.raises(F3srError, match="is not empty"):
        export(dataset, jobs, tmp_path / "a", megabytes=1, files=("*",))


def test_a_page_shows_every_scene_and_runs_nothing_of_its_texts(dataset: Dataset, tmp_path: Path) -> None:
    out = tmp_path / "sheet"
    for _ in range(2):  # the second replaces the first
        assert main(["dataset", "sheet", str(tmp_path / "ds"), "-o", str(out)]) == 0
    page = (out / "index.html").read_text()
    assert page.count("<article") == 12 and page.count('loading="lazy"') == 9
    assert page.count('data-state="failed"') == 3 and "Why 3 failed" in page and page.count("mug, ball") == 9
    assert "<script>alert" not in page and "\u202e" not in page and "&lt;script&gt;alert(1)" in page
    pictures = re.findall(r'src="(pictures/[0-9a-f]+\.jpg)"', page)
    assert len(pictures) == 9 and all(Image.open(out / p).size == (320, 240) for p in pictures)
    reports = re.findall(r'href="([^"]+report\.html)"', page)
    assert len(reports) == 9 and all((out / r).exists() for r in reports)
    assert "img-src data: &#39;self&#39; file:;" in page and "default-src &#39;none&#39;" in page


def test_the_commands_tell_in_text_and_json(
    dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    place = str(tmp_path / "ds")
    assert main(["dataset", "stats", place]) == 0
    said = capsys.readouterr().out
    assert "12 scenes: 9 done, 3 failed" in said and "mIoU_visible" in said and "\u202e" not in said
    assert main(["dataset", "stats", place, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["scenes"] == 12
    assert main(["dataset", "filter", place, "--where", "name contains '1'", "--json"]) == 0
    lines = [json.loads(line)["name"] for line in capsys.readouterr().out.splitlines()]
    assert lines == ["scene-001", "scene-010", "scene-011"]
    assert main(["dataset", "filter", place]) == 2 and "--where: found no condition" in capsys.readouterr().err
    assert main(["dataset", "export", place, "-o", str(tmp_path / "s"), "--size", "0"]) == 2
    assert main(["dataset", "stats", str(tmp_path)]) == 2
    assert f"{tmp_path}: found no dataset.json; accepted: a dataset" in capsys.readouterr().err


def tree(folder: Path) -> set[str]:
    return {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.name != ".lock"}


@pytest.mark.parametrize("scheme", ["", "file://"])
def test_what_no_job_has_is_counted_then_removed(
    dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str], scheme: str
) -> None:
    if scheme:
        pytest.importorskip("fsspec", reason="no fsspec: pip install 'f3sr[ray]'")
    folder, jobs = tmp_path / "ds", list(dataset.listed())
    place = f"{scheme}{folder}"
    assert main(["dataset", "filter", str(folder), "--where", "name = 'scene-000'", "-o", str(tmp_path / "ref")]) == 0
    dataset.list_jobs(jobs[4:])  # scenes 0, 1, 2 and the failure 3 belong to no job
    write_index(dataset)
    size = sum(p.stat().st_size for k in (1, 2) for p in (folder / scene_of(jobs[k].key)).rglob("*") if p.is_file())
    (folder / "work" / jobs[3].key).mkdir(parents=True)
    before, call = tree(folder), ["dataset", "prune", place, "--keep", str(tmp_path / "ref")]
    capsys.readouterr()
    assert main([*call, "--dry-run"]) == 0
    assert capsys.readouterr().out == f"would remove 2 packages of {size / 1e6:.1f} MB, 1 record of failures\n"
    assert tree(folder) == before
    assert main([*call, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told == {"dry_run": False, "packages": 2, "failures": 1, "bytes": size}
    gone = (*(scene_of(jobs[k].key) for k in (1, 2)), failure_of(jobs[3].key), *(["work"] if not scheme else []))
    assert {p for p in before - tree(folder) if not p.startswith(gone)} == set() and tree(folder) < before
    assert all(not (folder / path).exists() for path in gone)
    assert main([*call, "--json"]) == 0 and json.loads(capsys.readouterr().out)["packages"] == 0


def test_a_prune_that_is_cut_off_leaves_no_package_in_part(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    jobs = list(dataset.listed())
    dataset.list_jobs(jobs[1:])

    def cut_off(folder: Path, **_: Any) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(shutil, "rmtree", cut_off)
        prune(dataset)
    assert not (tmp_path / "ds" / scene_of(jobs[0].key)).exists()
    prune(dataset)
    assert not (tmp_path / "ds" / "work").exists()


def test_nothing_is_removed_while_the_list_may_lack_jobs(dataset: Dataset, tmp_path: Path) -> None:
    before = tree(tmp_path / "ds")
    with dataset.storage.claimed(), pytest.raises(OutputError, match="another run is writing it right now"):
        prune(Dataset.read(tmp_path / "ds"))
    dataset.storage.write(UNFINISHED, b"")
    with pytest.raises(OutputError, match="goes on or was cut off, so that its list may lack jobs; run the same"):
        prune(dataset)
    dataset.storage.remove(UNFINISHED)
    refer(dataset, list(dataset.listed()), tmp_path / "ref")
    with pytest.raises(OutputError, match=f"holds no packages; give {tmp_path}/ds"):
        prune(Dataset.read(tmp_path / "ref"))
    dataset.storage.remove("jobs.jsonl")
    with pytest.raises(InputError, match=r"found no jobs\.jsonl"):
        prune(dataset)
    assert tree(tmp_path / "ds") == before - {"jobs.jsonl"}


def test_without_pyarrow_one_line_says_how_to_get_it(
    dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert main(["dataset", "stats", str(tmp_path / "ds")]) == 1
    error = capsys.readouterr().err
    assert error == (
        "f3sr: the index of a dataset needs pyarrow, which is not installed: pip install 'f3sr[dataset]'\n"
    )
    (tmp_path / "in" / "a").mkdir(parents=True)
    assert main(["batch", str(tmp_path / "in"), "-o", str(tmp_path / "out")]) == 1
    assert "needs pyarrow" in capsys.readouterr().err and not (tmp_path / "out").exists()
