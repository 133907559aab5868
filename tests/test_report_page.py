"""Laws of report.html: one file that says what the result says, whatever its labels are, and works in a browser."""

from __future__ import annotations

import base64
import hashlib
import html
import io
import json
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import fields, replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jinja2 import TemplateNotFound, UndefinedError
from PIL import Image

import f3sr.film as film
import f3sr.report_page as page
from f3sr.core.mesh import Material as Appearance
from f3sr.core.mesh import Mesh
from f3sr.core.transforms import pose, rotation_about
from f3sr.io import inputs
from f3sr.metrics.measures import IMAGE_MEASURES, Measures, full_silhouette, measure, measure_with_details
from f3sr.metrics.penetration import penetration
from f3sr.physics.contact_margin import ContactMargin
from f3sr.pipeline import SKIPPABLE, Reconstruction, reconstruct
from f3sr.pipeline_config import Config
from f3sr.report import Decision, Outcome
from f3sr.report_page import LARGEST_PAGE, report_page
from f3sr.report_page.formatting import number
from f3sr.report_page.graph_drawing import levels
from f3sr.report_page.mask_comparison import cards
from f3sr.report_page.object_table import Move, moves
from f3sr.report_page.page_data import PageData
from f3sr.report_page.scores import MAIN, OTHERS
from f3sr.runtime.result_store import Store
from f3sr.scene import GROUND, Excluded, Node, Relation, Scene, SceneGraph, Support
from f3sr.stages.assemble import Assembled
from f3sr.stages.evaluate import evaluate
from f3sr.stages.relate import GraphOutcome, Related
from f3sr.stages.settle import Settled
from f3sr.web.document import WEB, clean, environment
from f3sr.web.light_mesh import lightened
from scenes import box, box_stack_scene, scene_of

SECTIONS = ["measures", "compare", "masks", "view", "objects", "supports", "stages", "decisions"]
HOSTILE = "</script></title><img src=x onerror=alert(1)>\"' style='x' \u202e\0\ud800 {{7*7}} $policy"


@pytest.fixture(scope="module")
def result(given: inputs.Inputs, stages: Store) -> Reconstruction:
    return reconstruct(given, skip=["refine"], store=stages)


@pytest.fixture(scope="module")
def text(result: Reconstruction) -> str:
    return report_page(result).decode()


def bare(scene: Scene, **changes: Any) -> Reconstruction:
    """A result that no stage has touched but the first."""
    outcomes = (Assembled(),)
    values: dict[str, Any] = {"scene": scene, "direct": scene, "scenes": {"assemble": scene}, "outcomes": outcomes}
    return Reconstruction(**{**values, "seconds": {}, "resumed": (), "config": Config(), "provenance": {}, **changes})


class Tags(HTMLParser):
    """Every start tag with its attributes, what is left open, and the text inside each kind of tag."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in {"img", "meta", "br"}:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def of(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]


# --- what the page holds --------------------------------------------------------------------------------------


def test_all_sections_are_there_and_every_element_is_closed(text: str):
    tags = Tags(text)
    assert tags.open == []
    assert [s["id"] for s in tags.of("section")] == SECTIONS
    assert {a["href"] for a in tags.of("a")} >= {f"#{s}" for s in SECTIONS}
    ids = [a["id"] for _, a in tags.tags if "id" in a]
    assert len(ids) == len(set(ids))
    assert {a["href"][1:] for a in tags.of("a")} <= set(ids)  # type: ignore[index]


def test_the_page_asks_for_nothing_outside(text: str):
    tags = Tags(text)
    for _, attributes in tags.tags:
        assert not {"srcset", "style", "action", "onload", "onerror", "onclick"} & attributes.keys()
        assert (attributes.get("src") or "data:").startswith("data:")
        assert (attributes.get("href") or "#").startswith("#")
    assert not tags.of("link") and not tags.of("iframe") and "@import" not in text and "url(" not in text


def test_the_policy_allows_exactly_this_style_and_script(text: str):
    policy = next(m["content"] for m in Tags(text).of("meta") if m.get("http-equiv") == "Content-Security-Policy")
    assert policy is not None and "default-src 'none'" in policy and "unsafe" not in policy
    style = re.search(r"<style>(.*?)</style>", text, re.S)
    script = re.search(r"<script>(.*?)</script>", text, re.S)
    assert style and script
    for source in (style[1], script[1]):
        assert f"'sha256-{base64.b64encode(hashlib.sha256(source.encode()).digest()).decode()}'" in policy


def test_numbers_are_those_of_the_evaluation(result: Reconstruction, text: str):
    assert result.evaluation and result.evaluation.direct
    section = text[text.index('id="measures"') : text.index('id="compare"')]
    shown = [float(v) for v in re.findall(r'<data value="([^"]+)"', section)]
    fields_ = [s.field for s in (*MAIN, *OTHERS)]
    evaluation, fitted = result.evaluation, result.evaluation.direct_fitted
    assert fitted and evaluation.direct and evaluation.result_fitted is None
    expected: list[float] = []
    for f in fields_:
        columns = evaluation.direct, *([fitted.measures] if f in IMAGE_MEASURES else []), evaluation.result
        expected += [float(getattr(m, f)) for m in columns]
    assert shown == expected
    assert html.unescape(section).count(fitted.decision.reason.replace(" -> ", " → ")) == 1


def test_a_result_that_was_not_aligned_has_a_second_column_of_its_own(given: inputs.Inputs, stages: Store):
    result = reconstruct(given, skip=["align", "settle", "refine"], store=stages)
    text = report_page(result).decode()
    section = text[text.index('id="measures"') : text.index('id="compare"')]
    assert section.count("fitted <data") == 2 * len(IMAGE_MEASURES)
    masks = text[text.index('id="masks"') : text.index('id="view"')]
    assert "not aligned either" in masks and "after align" not in masks


def test_every_object_has_its_panels_worst_first_with_the_numbers_they_show(result: Reconstruction, text: str):
    m = PageData(result, page.SIZES[0])
    section = text[text.index('id="masks"') : text.index('id="view"')]
    found = {c.id: c.panels for c in cards(m)}
    ordered = sorted(found, key=lambda id: found[id].ious[1])
    alts = re.findall(r'alt="(\d+) [^"]*, (input|ours): IoU ([\d.]+)"', section)
    expected = [(str(i), s, f"{found[i].ious[k]:.3f}") for i in ordered for k, s in enumerate(("input", "ours"))]
    assert alts == expected
    shown = [float(v) for v in re.findall(r'<data value="([^"]+)"', section)]
    assert set(shown) >= {x for p in found.values() for x in p.ious[:2]}


def test_an_object_that_fits_worse_than_it_came_is_marked():
    given = scene_of(box(0), box(3, at=(0.3, 0, 0.05)))
    given = given.with_objects(*(replace(o, mask=full_silhouette(o, given.camera)) for o in given))
    moved = given.with_objects(given[3].moved(pose(t=(0.03, 0, 0)), stage="settle", reason="pushed"))
    text = report_page(bare(moved, direct=given)).decode()
    section = text[text.index('id="masks"') : text.index('id="view"')]
    assert section.count("▼ worse") == 1 and section.index("3 box") < section.index("▼ worse") < section.index("0 box")


def test_many_objects_have_small_panels_and_fold():
    """Sixty objects: the first twelve are open, the rest folds; no panel is larger than its share."""
    columns = [box(k, at=(0.13 * (k % 10) - 0.6, 0.2 * (k // 10), 0.05), textured=True) for k in range(60)]
    result = bare(scene_of(*columns))
    text = report_page(result)
    assert len(text) <= LARGEST_PAGE
    section = text.decode()
    section = section[section.index('id="masks"') : section.index('id="view"')]
    assert section.count('class="panel"') == 60 and section.index("<details>") > section.index('class="panel"')
    assert section[: section.index("<details>")].count('class="panel"') == 12 and "48 more objects" in section
    sides = [max(p.shape) for c in cards(PageData(result, page.SIZES[0])) for p in c.panels.pictures]
    assert len(sides) == 120 and max(sides) ** 2 * len(sides) <= 1.01 * page.SIZES[0].panels
    panels = section[section.index("Every object alone") :]
    assert len(panels) < 2.5 * page.SIZES[0].panels / 4  # even noise, the worst photo, stays bounded


def test_every_measure_has_a_row():
    assert {s.field for s in (*MAIN, *OTHERS)} == {f.name for f in fields(Measures)}
    assert [s.title for s in MAIN] == ["mIoU", "PSNR", "R_pen", "K_max", "D_max"]


def test_every_decision_is_told(result: Reconstruction, text: str):
    plain = html.unescape(re.sub(r"<[^>]+>", "", text[text.index('id="decisions"') :]))
    for report in result.reports:
        for d in report.decisions:
            assert all(t.replace(" -> ", " → ") in plain for t in (d.choice, d.reason))


def test_moves_are_what_each_stage_did(result: Reconstruction, text: str):
    m = PageData(result, page.SIZES[0])
    for o in result.scene:
        found = moves(m, o.id)
        assert [x.stage for x in found] == list(dict.fromkeys(x.stage for x in o.motion))
        assert np.prod([x.scale for x in found]) == pytest.approx(o.scale / result.direct[o.id].scale)
        settled = next(x for x in found if x.stage == "settle")
        told = next(x for x in result.outcomes if isinstance(x, Settled))
        assert settled.turn == pytest.approx(told.turns[o.id], abs=1e-8)
    id, aligned = result.scene.objects[0].id, result.scenes["align"]
    again = aligned[id].moved(np.eye(4), stage="refine", reason="from where alignment had it")
    scenes = {k: result.scenes[k] for k in ("align", "settle")}
    back = replace(result, scenes={**scenes, "refine": result.scene.with_objects(again)})
    assert [x.stage for x in moves(PageData(back, page.SIZES[0]), id)] == ["settle", "refine"]
    still = Move(stage="settle", shift=0, turn=0, scale=1, reasons=())
    assert still.amount == "under 0.10\u00a0mm" and replace(still, turn=0.1, scale=1.04).amount == "5.7°, ×1.040"
    section = text[text.index('id="objects"') : text.index('id="supports"')]
    assert section.count("<dt>") == sum(len(moves(m, o.id)) for o in result.scene) > 0


@pytest.mark.parametrize(
    ("value", "digits", "written"),
    [
        (0.0, 4, "0"), (7.0, 4, "7"), (0.70681, 4, "0.7068"), (11.0928, 4, "11.09"), (5.0182, 2, "5.0"),
        (8.0559e-8, 3, "8.1·10⁻⁸"), (-24.018, 3, "−24.0"), (123456.7, 4, "1.2·10⁵"), (float("nan"), 4, "–"),
    ],
)  # fmt: skip
def test_numbers_are_written_for_people(value: float, digits: int, written: str):
    assert number(value, digits=digits) == written


# --- the same bytes -------------------------------------------------------------------------------------------


def test_two_runs_give_the_same_bytes_also_from_the_store(given: inputs.Inputs, text: str, tmp_path: Path):
    store = Store(tmp_path)
    first = reconstruct(given, skip=["refine"], store=store)
    again = reconstruct(given, skip=["refine"], store=store)
    assert not first.resumed and "evaluate" in again.resumed
    assert report_page(first) == report_page(again) == text.encode()


def test_nothing_of_this_machine_or_time_is_on_the_page(result: Reconstruction, text: str):
    slow = replace(
        result, seconds=dict.fromkeys(result.seconds, 1234.5), resumed=("level",), provenance={"config": "0" * 64}
    )
    assert report_page(slow) == text.encode()
    assert str(Path.cwd()) not in text and str(Path.home()) + "/" not in text


# --- hostile and unusual results ------------------------------------------------------------------------------


def hostile(scene: Scene) -> Scene:
    relations = tuple(replace(r, evidence=HOSTILE) for r in scene.graph.relations)
    nodes = tuple(Node(id=o.id, label=HOSTILE, description=HOSTILE, visibility=0.5) for o in scene)
    return replace(
        scene.with_objects(*(replace(o, label=HOSTILE, mask_name=HOSTILE + ".png") for o in scene)),
        excluded=(Excluded(mask=HOSTILE, reason=HOSTILE),),
        graph=replace(scene.graph, relations=relations, nodes=nodes),
    )


def test_hostile_labels_names_and_texts_stay_text(result: Reconstruction):
    decision = Decision(choice=HOSTILE, reason=HOSTILE, about=2, fallback=True)
    wrong = replace(
        result,
        scene=hostile(result.scene),
        scenes={k: hostile(s) for k, s in result.scenes.items()},
        outcomes=(replace(result.outcomes[0], decisions=(decision,)), *result.outcomes[1:]),
    )
    text = report_page(wrong).decode()
    tags = Tags(text)
    assert tags.open == [] and len(tags.of("script")) == 2 and len(tags.of("title")) == 1 + len(result.scene.objects)
    assert all((i["src"] or "").startswith("data:image/jpeg") and "onerror" not in i for i in tags.of("img"))
    assert "\u202e" not in text and "\0" not in text
    data = re.search(r'<script type="application/json" id="scene-data">(.*?)</script>', text, re.S)
    assert data and "<" not in data[1]
    assert json.loads(data[1])["objects"][0]["label"] == clean(HOSTILE)
    assert "Fallback" in text[: text.index("<section")]


def test_the_scene_graph_is_told_with_what_is_given_and_refused():
    scene = box_stack_scene(3)
    lean = Relation(
        subject=2, predicate="leaning_on", object=0, confidence=0.625, evidence="it says so", source="given"
    )
    nodes = tuple(Node(id=o.id, label=o.label, description=f"red box {o.id}", visibility=0.25) for o in scene)
    graph = SceneGraph(relations=(*scene.graph.relations, lean), source="scene_graph.json", nodes=nodes)
    refused = Decision(choice="given inside object 1 not followed", reason="30% of the directions", about=0)
    told = replace(scene, graph=graph)
    outcomes = (Assembled(), Related(decisions=(refused,), disagreements=(refused,)))
    page = report_page(bare(told, scenes={"assemble": scene, "relate": told}, outcomes=outcomes)).decode()
    section = page[page.index('id="supports"') : page.index('id="stages"')]
    assert section.count("</details>") == 2 and section.count('class="tag"') == 1
    for words in ("supported by: 2", "leaning on: 1", "it says so", "0.625", "red box 2", "30% of the directions"):
        assert words in section
    assert section.count("stroke-dasharray") == 1


def test_edges_of_the_drawing_swing_around_boxes_in_their_way():
    scene = box_stack_scene(2)
    both = (Support(id=0, share=0.7), Support(id=GROUND, share=0.3))
    page = report_page(bare(scene.with_objects(replace(scene[1], supports=both)))).decode()
    paths = re.findall(r'<path d="M ([\d.]+) [\d.]+ C ([\d.]+) ', page)
    assert [a == b for a, b in paths] == [True, True, False]


FOLDERS = [*(Path(m.__file__ or "").parent / "templates" for m in (page, film)), WEB / "templates"]


def test_templates_escape_and_clean_every_text():
    """In an element, an attribute, a macro's argument and JSON, also after what other filters make of it."""
    source = """{% macro told(text) %}<b title="{{ text }}">{{ text|replace("7", "<") }}</b>{% endmacro %}
{{ told(x) }}<i title='{{ x }}'>{{ x }}{{ x|join(", ") }}{{ "%s"|format(x) }}</i>
<script type="application/json">{{ {x: [x]}|tojson }}</script>"""
    for folder in FOLDERS:
        text = environment(folder).from_string(source).render(x=HOSTILE)
        tags = Tags(text)
        assert tags.open == [] and [t for t, _ in tags.tags] == ["b", "i", "script"]
        assert tags.tags[1] == ("i", {"title": clean(HOSTILE)})
        data = text[text.index("json") + 6 : text.rindex("</script>")]
        assert "<" not in data and json.loads(data) == {HOSTILE: [HOSTILE]}
        assert not {"\u202e", "\0", "\ud800"} & set(text)
    assert len(clean("x" * 10_000)) < 700


def test_what_templates_print_unescaped_is_made_here():
    texts = [t.read_text() for f in FOLDERS for t in f.iterdir()]
    marked = Counter(x for text in texts for x in re.findall(r"(\S+)\s*\|\s*safe", text.replace("{{", " ")))
    assert marked == dict.fromkeys(("style", "script", "jpeg_uri(picture)", "film", "path"), 1)
    assert not any("autoescape" in text for text in texts)


@pytest.mark.parametrize("source", ["{{ missing }}", "{{ x.missing }}", "{{ nothing }}", "{{ number|tojson }}"])
def test_a_value_that_is_not_there_is_an_error(source: str):
    template = environment(WEB / "templates").from_string(source)
    with pytest.raises((UndefinedError, AssertionError, ValueError)):
        template.render(x=1, nothing=None, number=float("nan"))


@pytest.mark.parametrize("name", ["../page.css", "/etc/hostname", "templates/../../page.css"])
def test_templates_are_read_from_their_folders_only(name: str):
    with pytest.raises(TemplateNotFound):
        environment(WEB / "templates").get_template(name)


@pytest.mark.slow
def test_without_evaluation_and_with_any_stage_skipped(given: inputs.Inputs, stages: Store):
    for skip in [s for s in SKIPPABLE if s not in ("refine", "evaluate")]:
        text = report_page(reconstruct(given, skip=[skip, "refine", "evaluate"], store=stages)).decode()
        assert Tags(text).open == [] and "Not measured" in text and "evaluate" in text[: text.index("<section")]
        (told,) = re.findall(r"<b>Skipped</b>: ([^<]*)", text)
        closing = {"close", "coarsen"} if skip == "settle" else set[str]()
        assert set(re.split(", | and ", told)) == {s for s in (skip, "refine", "evaluate", *closing) if "-" not in s}
    silent = bare(reconstruct(given, skip=SKIPPABLE).scene, outcomes=())
    assert "No stage had anything to decide" in report_page(silent).decode()


def test_one_object_without_ground_geometry_or_parts():
    o = replace(box(7, label=""), supports=(), supported_by=None, parts=(), mobility="fixed")
    text = report_page(bare(scene_of(o))).decode()
    assert "1 object, rest not measured" in text and "Dashed" in text and "Fixed: " in text


def test_every_stage_has_its_sheet():
    scene = scene_of(box(0))
    outcomes = tuple(
        kind()
        for base in (Outcome, GraphOutcome)
        for kind in base.__subclasses__()
        if hasattr(kind, "stage") and kind.__module__.startswith("f3sr.")
    )
    text = report_page(bare(scene, outcomes=outcomes)).decode()
    sheets = re.findall(r'<article class="stage">\s*<h3>\d+ (\w+)</h3>\s*<p class="fine">[A-Z]', text)
    assert sheets == [o.stage for o in outcomes] and {*SKIPPABLE} - {*sheets} == {
        "align-camera",
        "align-objects",
        "evaluate",
    }


def test_the_clearance_is_that_of_the_run():
    scene = scene_of(box(0, at=(0.0, 0.0, 0.06)), box(1, at=(0.5, 0.0, 0.05)))
    config = Config()
    chosen = replace(
        config, settle=replace(config.settle, physics=replace(config.settle.physics, contact=ContactMargin(body=5e-4)))
    )
    for c, clearance in ((config, "0.34"), (chosen, "1")):
        text = report_page(bare(scene, evaluation=evaluate(scene, scene), config=c)).decode()
        assert f"rest {clearance}\u00a0mm apart" in text


def test_a_circle_of_supports_ends():
    a, b = box(1), box(2, at=(0.3, 0, 0.05))
    scene = scene_of(replace(a, supports=(Support(id=2),)), replace(b, supports=(Support(id=1),)))
    assert set(levels(scene)) == {1, 2}
    assert Tags(report_page(bare(scene)).decode()).open == []


# --- places of gaps and crossings --------------------------------------------------------------------------------


def test_gaps_name_what_is_nearest_and_where():
    scene = scene_of(
        box(0),
        box(1, at=(0.0, 0.0, 0.162)),
        box(2, at=(0.5, 0.0, 0.08), R=rotation_about([1, 0, 0], 0.3)),
        box(3, at=(-0.5, 0.0, 0.04)),
    )
    measures, details = measure_with_details(scene)
    assert measures == measure(scene)
    gaps = {g.id: g for g in details.gaps}
    assert (gaps[0].nearest, gaps[1].nearest, gaps[2].nearest, gaps[3].nearest) == (GROUND, 0, GROUND, GROUND)
    assert gaps[1].distance == pytest.approx(0.012)
    assert gaps[1].start[2] == pytest.approx(0.112) and gaps[1].end[2] == pytest.approx(0.1)
    assert gaps[2].end[2] == 0 and gaps[2].distance == pytest.approx(gaps[2].start[2])
    assert gaps[3].below == pytest.approx(0.01) and gaps[3].lowest[2] == pytest.approx(-0.01)
    assert measures.gap_pct == pytest.approx(100 * max(g.distance / g.size for g in details.gaps))
    assert measures.below_pct == pytest.approx(100 * 0.01 / scene[3].size)


def test_overlaps_lie_where_surfaces_cross():
    scene = scene_of(box(4), box(9, at=(0.08, 0.01, 0.06), R=rotation_about([0, 0, 1], 0.2)), box(11, at=(1, 0, 0.05)))
    measures, details = measure_with_details(scene)
    (overlap,) = details.overlaps
    assert (overlap.a, overlap.b, overlap.crossings) == (4, 9, measures.N_cross) and measures.N_cross > 10
    low, high = np.array(overlap.low), np.array(overlap.high)
    assert np.all(low >= scene[9].bounds_world[0] - 1e-6) and np.all(high <= scene[4].bounds_world[1] + 1e-6)
    assert low[0] < high[0] <= 0.05 + 1e-6 and low[1] < high[1] and low[2] < high[2]


def test_apart_surfaces_have_no_pairs():
    surfaces = [(o.vertices_world, o.mesh.faces) for o in (box(0), box(1, at=(0.3, 0, 0.05)))]
    assert penetration(surfaces).pairs == ()


def test_boxes_tell_what_is_wrong():
    scene = scene_of(box(0), box(3, at=(0.5, 0, 0.092), label="red mug"), box(5, at=(0.08, 0.01, 0.06), label="lid"))
    text = report_page(bare(scene, evaluation=evaluate(scene, scene))).decode()
    section = re.sub(r"<[^>]+>", "", text[text.index('id="compare"') : text.index('id="view"')])
    assert re.search(r"gap 42.mm below 3 red mug", section) and "0 and 5 overlap" in section
    assert "1 pair penetrates" in text and "worst gap 42\u00a0mm" in text


# --- size and light meshes ------------------------------------------------------------------------------------


def seamed_sphere(n: int) -> Mesh:
    """A sphere of 2 n n faces cut along a meridian, its texture coordinates longitude and latitude, its colour too."""
    u, v = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0.02, 0.98, n + 1))
    a, b = 2 * np.pi * u.ravel(), np.pi * v.ravel()
    points = np.stack([np.cos(a) * np.sin(b), np.sin(a) * np.sin(b), -np.cos(b)], axis=1)
    points[np.isclose(u.ravel(), 1)] = points[np.isclose(u.ravel(), 0)]
    i = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    faces = np.concatenate([np.stack([i, i + 1, i + n + 2], 1), np.stack([i, i + n + 2, i + n + 1], 1)])
    texture = np.random.default_rng(0).integers(0, 256, (64, 64, 3), np.uint8)
    uv = np.stack([u.ravel(), v.ravel()], 1)
    return Mesh(vertices=points, faces=faces.astype(np.int32), uv=uv, materials=(Appearance(texture=texture),))


def test_a_lighter_mesh_keeps_its_shape_and_its_texture_in_place():
    mesh = seamed_sphere(120)
    light = lightened(mesh, 2000)
    assert 1000 < len(light.faces) <= 2000 and light.uv is not None
    assert np.linalg.norm(light.vertices, axis=1) == pytest.approx(1, abs=0.02)
    a = 2 * np.pi * light.uv[:, 0]
    expected = np.stack([np.cos(a), np.sin(a)], 1)
    across = light.vertices[:, :2] / np.linalg.norm(light.vertices[:, :2], axis=1, keepdims=True)
    away_from_poles = np.abs(light.vertices[:, 2]) < 0.9
    assert np.abs(across - expected)[away_from_poles].max() < 0.05
    spans = np.ptp(light.uv[light.faces], axis=1)
    assert spans[:, 0].max() < 0.7  # none reaches across the seam (0.99); around a pole they are wide
    welded, _ = light.welded
    assert len(welded) < len(light.vertices)  # the seam is still closed: both its sides share their places


def test_a_light_mesh_is_left_alone():
    mesh = seamed_sphere(10)
    assert lightened(mesh, 200) is mesh


def test_a_page_too_large_is_made_of_smaller_parts(result: Reconstruction, monkeypatch: pytest.MonkeyPatch):
    whole = len(report_page(result))
    assert whole < LARGEST_PAGE
    monkeypatch.setattr(page, "LARGEST_PAGE", whole - 1)
    monkeypatch.setattr(page, "SIZES", (page.SIZES[0], replace(page.SIZES[0], picture=96)))
    assert len(report_page(result)) < whole


def test_heavy_scenes_stay_under_the_limit():
    mesh = seamed_sphere(150)
    noise = np.random.default_rng(0).integers(0, 256, (1024, 1024, 3), np.uint8)  # nothing compresses worse
    boxes = [box(k, at=(0.25 * k, 0, 0.1), scale=0.1) for k in range(12)]
    objects = [replace(o, mesh=replace(mesh, materials=(Appearance(texture=noise + k),))) for k, o in enumerate(boxes)]
    text = report_page(bare(scene_of(*objects)))
    assert len(text) <= LARGEST_PAGE
    data = re.search(rb'id="scene-data">(.*?)</script>', text, re.S)
    assert data and len(json.loads(data[1])["textures"]) == 12


# --- in a browser ---------------------------------------------------------------------------------------------


@pytest.fixture
def opened(browser: Any, text: str, tmp_path: Path) -> Iterator[Any]:
    """The page on a desktop; at the end nothing has been asked for or complained about."""
    file = tmp_path / "report.html"
    file.write_text(text)
    view = browser.new_page(viewport={"width": 1280, "height": 900})
    said: list[str] = []
    asked: list[str] = []
    view.on("console", lambda m: said.append(m.text))
    view.on("pageerror", lambda e: said.append(str(e)))
    view.on("request", lambda r: asked.append(r.url))
    view.goto(file.as_uri())
    view.wait_for_timeout(500)
    yield view
    view.close()
    assert said == []
    assert [u for u in asked if not u.startswith("data:")] == [file.as_uri()]


def picture(view: Any) -> np.ndarray[Any, Any]:
    view.wait_for_timeout(300)
    return np.asarray(Image.open(io.BytesIO(view.locator("#view-stage").screenshot())).convert("RGB"), int)


@pytest.mark.timeout(120)
def test_the_view_draws_turns_switches_and_comes_back(opened: Any):
    assert opened.locator("#view-live").is_visible() and not opened.locator("#view-still").is_visible()
    opened.click("#photo-behind")
    start = picture(opened)
    assert len(np.unique(start.reshape(-1, 3), axis=0)) > 50
    place = opened.locator("#view-stage canvas").bounding_box()
    x, y = place["x"] + place["width"] / 2, place["y"] + place["height"] / 2
    opened.mouse.move(x, y)
    opened.mouse.down()
    opened.mouse.move(x + 120, y - 40, steps=4)
    opened.mouse.up()
    turned = picture(opened)
    assert np.abs(turned - start).mean() > 2
    opened.keyboard.press("ArrowLeft")
    assert np.abs(picture(opened) - turned).mean() > 0.5
    opened.mouse.wheel(0, 400)
    opened.click("#mode-proxies")
    assert opened.get_attribute("#mode-proxies", "aria-pressed") == "true"
    proxies = picture(opened)
    opened.click("#mode-ours")
    assert np.abs(picture(opened) - proxies).mean() > 0.5
    opened.click("#photo-view")
    assert np.abs(picture(opened) - start).mean() < 0.5


@pytest.mark.timeout(120)
def test_fingers_turn_and_pinch(browser: Any, text: str, tmp_path: Path):
    (tmp_path / "report.html").write_text(text)
    context = browser.new_context(viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True)
    view = context.new_page()
    view.goto((tmp_path / "report.html").as_uri())
    view.locator("#view-stage").scroll_into_view_if_needed()
    view.click("#photo-behind")
    hand = context.new_cdp_session(view)
    place = view.locator("#view-stage canvas").bounding_box()
    x, y = place["x"] + place["width"] / 2, place["y"] + place["height"] / 2

    def drag(*ways: tuple[float, float, float, float]) -> None:
        for kind, k in (("touchStart", 0.0), ("touchMove", 0.5), ("touchMove", 1.0)):
            points = [{"x": a + k * (c - a), "y": b + k * (d - b), "id": i} for i, (a, b, c, d) in enumerate(ways)]
            hand.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
        hand.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})

    start, top = picture(view), view.evaluate("scrollY")
    drag((x, y, x + 80, y - 20))
    turned = picture(view)
    assert np.abs(turned - start).mean() > 2 and view.evaluate("scrollY") == top
    drag((x - 20, y, x - 90, y), (x + 20, y, x + 90, y))
    near = picture(view)
    assert np.abs(near - turned).mean() > 2
    context.close()


@pytest.mark.timeout(120)
def test_the_view_starts_where_the_photo_was_taken(opened: Any, result: Reconstruction):
    from f3sr.vision import rasterizer

    shown = picture(opened)
    opened.click("#photo-behind")
    alone = picture(opened)
    camera = result.scene.camera.resized(shown.shape[1], shown.shape[0])
    ids = rasterizer.render(result.scene.objects, camera).ids
    drawn = np.abs(shown - picture_of_photo(result, camera.width, camera.height)).max(2) > 60
    assert drawn[ids == rasterizer.EMPTY].mean() < 0.01  # the photo lies exactly behind
    colored = alone[..., :3].max(2) - alone[..., :3].min(2) > 60
    for o in result.scene:
        own = ids == o.id
        color = np.median(alone[own], axis=0)
        same = np.abs(alone - color).max(2) < 12
        assert same[own].mean() > 0.9 and colored.shape == ids.shape


def picture_of_photo(result: Reconstruction, width: int, height: int) -> np.ndarray[Any, Any]:
    photo = Image.fromarray(result.scene.photo.rgb).resize((width, height), Image.Resampling.BILINEAR)
    return np.asarray(photo, int)


@pytest.mark.timeout(120)
@pytest.mark.parametrize("width", [320, 390, 800, 1280])
def test_nothing_is_wider_than_the_screen(opened: Any, width: int):
    opened.set_viewport_size({"width": width, "height": 844})
    opened.wait_for_timeout(200)
    assert opened.evaluate("document.documentElement.scrollWidth") <= width
    wide = opened.evaluate(
        """w => [...document.querySelectorAll('main *, header *')].filter(e => !e.closest('.scroll, #view-stage, svg')
            && e.getBoundingClientRect().right > w + 1).map(e => e.outerHTML.slice(0, 80))""",
        width,
    )
    assert wide == []


@pytest.mark.timeout(120)
@pytest.mark.parametrize("width", [320, 390, 1280])
def test_both_panels_of_an_object_stand_beside_each_other_and_are_large_enough(opened: Any, width: int):
    opened.set_viewport_size({"width": width, "height": 844})
    for k in range(opened.locator(".panel").count()):
        left, right = (opened.locator(".panel").nth(k).locator("img").nth(i).bounding_box() for i in (0, 1))
        assert left["y"] == right["y"] and left["x"] + left["width"] <= right["x"]
        assert left["width"] == pytest.approx(right["width"], abs=1) and left["width"] > 0.37 * min(width, 390)


@pytest.mark.timeout(120)
def test_print_shows_a_still_and_opens_what_is_folded(opened: Any):
    opened.emulate_media(media="print")
    assert opened.locator("#view-still").is_visible() and not opened.locator("#view-live").is_visible()
    assert opened.pdf(prefer_css_page_size=True).startswith(b"%PDF")
    assert opened.evaluate("[...document.querySelectorAll('details')].every(d => d.open)")


@pytest.mark.timeout(120)
def test_without_scripts_a_still_and_a_sentence_stand_for_the_view(browser: Any, text: str, tmp_path: Path):
    (tmp_path / "report.html").write_text(text)
    context = browser.new_context(java_script_enabled=False)
    view = context.new_page()
    view.goto((tmp_path / "report.html").as_uri())
    assert view.locator("#view-still").is_visible() and "WebGL" in view.locator("#view-still").inner_text()
    assert not view.locator("#view-live").is_visible()
    context.close()


@pytest.mark.timeout(120)
def test_hostile_text_is_only_shown(browser: Any, tmp_path: Path):
    scene = hostile(box_stack_scene(3))
    (tmp_path / "report.html").write_bytes(report_page(bare(scene)))
    view = browser.new_page()
    alarms: list[str] = []
    view.on("dialog", lambda d: (alarms.append(d.message), d.dismiss()))
    view.on("console", lambda m: alarms.append(m.text))
    view.on("pageerror", lambda e: alarms.append(str(e)))
    view.goto((tmp_path / "report.html").as_uri())
    view.wait_for_timeout(500)
    assert alarms == [] and view.locator("img[src=x]").count() == 0
    assert "<img src=x onerror=alert(1)>" in view.locator("#objects").inner_text()
    view.close()
