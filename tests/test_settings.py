"""Laws of the settings: what is shown reads back, what is out of range never runs, errors say where and what."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Callable
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any, cast

import pytest

from f3sr import settings
from f3sr.cli.main import main
from f3sr.errors import InputError
from f3sr.options import SKIPPABLE
from f3sr.physics.contact_margin import ContactMargin
from f3sr.physics.mujoco_model import PhysicsConfig
from f3sr.pipeline_config import Config, with_shared_settings
from f3sr.stages.align import AlignConfig
from f3sr.stages.align.config import CameraConfig, SearchConfig

PAGE = Path(__file__).parents[1] / "docs" / "settings.toml"


def written(folder: Path, text: str) -> Path:
    file = folder / "settings.toml"
    file.write_text(text)
    return file


def test_the_printed_defaults_read_back_as_the_defaults(tmp_path: Path) -> None:
    assert settings.read(written(tmp_path, settings.describe(Config())), Config()) == Config()


def test_the_page_of_settings_is_what_the_program_prints(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["config"]) == 0
    assert PAGE.read_text() == capsys.readouterr().out, "f3sr config > docs/settings.toml"


def test_the_tables_come_in_the_order_of_the_stages() -> None:
    tables = [f.name for f in fields(cast(Any, Config))]
    assert tables == ["assemble", *(stage for stage in SKIPPABLE if stage in tables)]


def test_a_file_changes_what_it_names_and_nothing_else(tmp_path: Path) -> None:
    file = written(tmp_path, "[align]\nmax_yaw = 1\n[align.camera_step]\nfocal = true\n")
    config = settings.read(file, Config())
    assert config == replace(Config(), align=AlignConfig(max_yaw=1.0, camera_step=CameraConfig(focal=True)))
    assert settings.changed(config, Config()) == {"align.max_yaw": 1.0, "align.camera_step.focal": True}


def test_constants_belong_to_keys_but_to_no_file_of_settings(tmp_path: Path) -> None:
    varied = replace(Config(), align=AlignConfig(search=SearchConfig(yaw_seeds=(0.0,))))
    assert settings.changed(varied, Config()) == {"align.search.yaw_seeds": [0.0]}  # as JSON has it
    assert asdict(varied) != asdict(Config()) and settings.describe(varied) == settings.describe(Config())
    assert settings.read(written(tmp_path, "[align]\nmax_yaw = 1\n"), varied).align.search == varied.align.search


def test_settings_fit_on_two_screens() -> None:
    text = settings.describe(Config())
    assert len(leaves(tomllib.loads(text))) <= 42 and text.count("\n") <= 120


def leaves(tree: dict[str, Any], path: str = "") -> list[tuple[str, str]]:
    tables = [(name, value) for name, value in tree.items() if isinstance(value, dict)]
    own = [(path, name) for name, value in tree.items() if not isinstance(value, dict)]
    return own + [leaf for name, value in tables for leaf in leaves(value, f"{path}.{name}".strip("."))]


@pytest.mark.parametrize("value", ['"1"', "1e999", "-1e9", "nan", "[]", "{ a = 1 }", "1979-05-27"])
def test_no_setting_takes_nonsense(tmp_path: Path, value: str) -> None:
    for table, name in leaves(tomllib.loads(settings.describe(Config()))):
        with pytest.raises(InputError) as caught:
            settings.read(written(tmp_path, f"[{table}]\n{name} = {value}\n"), Config())
        message = str(caught.value)
        assert f"{table}.{name} = " in message and "accepted: " in message and "\n" not in message


def test_every_setting_says_its_meaning_and_its_range() -> None:
    lines = settings.describe(Config()).splitlines()
    for k, line in enumerate(lines):
        if " = " in line and not line.startswith("#"):
            meaning, _, accepted = lines[k - 1].removeprefix("# ").rpartition(". (")
            assert meaning and accepted.endswith(")"), line
            assert all(len(sentence.split()) <= 20 for sentence in meaning.split(". ")), meaning


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[align]\nmaxyaw = 1", "unknown align.maxyaw; accepted: in [align] resolution, camera"),
        ("[aling]\nmax_yaw = 1", "unknown aling; accepted: the tables assemble, level"),
        ("[align.facets]\nmost = 0.1", "unknown align.facets; accepted: in [align] resolution, camera"),
        ("[relate]\ncells = 48", "unknown relate; accepted: the tables assemble, level"),
        ("[refine.align]\nmax_yaw = 0.1", "unknown refine.align; accepted: in [refine] rounds"),
        ("align = 3", "align = 3; accepted: a table [align]"),
        ("[align]\nmax_yaw = 9", "align.max_yaw = 9; accepted: a number > 0 and <= 3.1415927"),
        ("[align]\nfreedom = 'air'", 'align.freedom = "air"; accepted: one of "image", "support"'),
        ("[align]\ncamera = 1", "align.camera = 1; accepted: true or false"),
        ("[settle.physics]\ntimestep = 0.005", "accepted: solref whose first value is at least two time steps"),
        ("[align]\nmax_yaw = 1\nmax_yaw = 2", "no TOML"),
        ("\x00", "no TOML"),
        ("a = " + "[" * 100_000, "no TOML"),
        ("a" + ".a" * 5_000 + " = 1", "no TOML (nested too deeply)"),
        ("[align]\nmax_yaw" + ".a" * 5_000 + " = 1", "no TOML (nested too deeply)"),
        ("[align]\nmax_yaw = " + "1" * 5_000, "no TOML"),
        ("[align]\nmax_yaw = '" + "x" * 5_000 + "'", "accepted: a number"),
        ("# " + "x" * 1_000_001, "bytes; accepted: at most 1,000,000"),
    ],
)
def test_an_error_names_file_key_value_and_what_is_accepted(tmp_path: Path, text: str, said: str) -> None:
    file = written(tmp_path, text)
    with pytest.raises(InputError) as caught:
        settings.read(file, Config())
    assert str(caught.value).startswith(f"{file}: found ") and said in str(caught.value)


def pipe(path: Path) -> None:
    os.mkfifo(path)


def long(path: Path) -> None:
    """A file of a gigabyte that takes no room."""
    with path.open("wb") as file:
        file.truncate(1_000_000_000)


@pytest.mark.parametrize(
    ("make", "found"),
    [
        (lambda path: None, "no such file"),
        (Path.mkdir, "a folder"),
        (lambda path: path.symlink_to("/dev/zero"), "a device"),
        (lambda path: path.symlink_to(path.name), "too many levels"),
        (pipe, "a pipe"),
        (long, "1,000,000,000 bytes"),
    ],
)
def test_what_is_no_file_of_settings_is_refused_at_once(
    tmp_path: Path, make: Callable[[Path], None], found: str
) -> None:
    make(tmp_path / "settings.toml")
    with pytest.raises(InputError, match=rf"settings\.toml: found {found}"):
        settings.read(tmp_path / "settings.toml", Config())


def test_settings_made_in_python_are_checked_too() -> None:
    with pytest.raises(ValueError, match="max_yaw"):
        AlignConfig(max_yaw=9.0)
    with pytest.raises(ValueError, match="max_yaw"):
        replace(AlignConfig(), max_yaw=-1.0)


@pytest.mark.parametrize("margin", [None, 1e-4])
def test_every_stage_has_the_margin_of_physics(margin: float | None) -> None:
    """By default, and where it is set; clearance, reach and the rest grow in this order."""
    physics = PhysicsConfig() if margin is None else PhysicsConfig(contact=ContactMargin(body=margin))
    given = replace(Config(), settle=replace(Config().settle, physics=physics))
    config = given if margin is None else with_shared_settings(given)
    stages = (config.relate, config.separate, config.close, config.refine, config.coarsen)
    assert {stage.contact for stage in stages} == {config.settle.physics.contact}
    found = config.separate.contact
    assert config.separate.clearance == found.clearance == 2 * physics.margin
    assert physics.margin < found.clearance < found.reach < found.loose < found.apart
    assert "margin" not in settings.describe(Config()).partition("[settle.physics]")[2].partition("[close")[0]
