"""`teleop config`: values with their sources, and a page of keys that is the loader's."""

import json
import re

import pytest

from teleop.cli import commands
from teleop.cli.config import keys, reference, show
from teleop.config.loading import ConfigDocument
from teleop.config.overrides import Override
from teleop.errors import UsageError
from teleop.launch.config import SessionConfig
from tests.root import ROOT

CONFIGS = sorted({*(ROOT / "configs").rglob("*.yaml")} - {ROOT / "configs/endoscope-pair.yaml"})
DEMO = ROOT / "configs" / "demo.yaml"
ROW = re.compile(r"^\| `(?P<key>\w+)` \|(?P<cells>.*)\|$")
REQUIRED = {  # a value for each key without a default
    **dict.fromkeys(("name", "port", "file"), "x"),
    **dict.fromkeys(("length", "scale", "counts_per_turn"), 1.0),
    "pulley_radius": 0.01,
    "id": 1,
    "motors": {"type": "microcontroller", "port": "x"},
}
ALSO = {"elongation_error": {"effective_friction": 0.5}}  # what a key needs beside it
REQUIRED["motor"] = {k: REQUIRED[k] for k in ("id", "pulley_radius", "counts_per_turn")}
REQUIRED["cell"] = {k: REQUIRED[k] for k in ("id", "scale")}
REQUIRED["tendons"] = [{k: REQUIRED[k] for k in ("motor", "cell")}]
REQUIRED["joints"] = [{"tendons": REQUIRED["tendons"]}]


def run(capsys, *words):
    code = commands.main(["config", *map(str, words)])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_what_is_shown_is_a_config_file_with_the_same_values(path):
    document = ConfigDocument.read(path, ["link.insecure=true"])
    config = document.load(SessionConfig)
    text = show.format_values(list(show.list_values(document, config)))
    assert ConfigDocument(text=text).load(SessionConfig) == config


def test_every_value_has_its_line_its_override_or_is_a_default(capsys, tmp_path):
    words = ["--set", "slave.rig.joints.0.body.mass=0.5", "--set", "health={jitter: 0.1}"]
    code, out, _ = run(capsys, "show", DEMO, *words, "--json", tmp_path / "out.json")
    assert code == 0
    assert re.search(r"^ +mass: 0\.5 +# --set slave\.rig\.joints\.0\.body\.mass; 0 to", out, re.M)
    lines = DEMO.read_text().splitlines()
    defaults = ConfigDocument().load(SessionConfig)
    built_in = {v.keys: v.value for v in show.list_values(ConfigDocument(), defaults)}
    sources = {}
    for each in json.loads((tmp_path / "out.json").read_text())["values"]:
        path, source = tuple(each["key"].split(".")), each["source"]
        sources[each["key"]] = source
        if source.startswith("demo.yaml:"):
            assert path[-1] in lines[int(source.partition(":")[2]) - 1]
        elif source == "default" and path in built_in and "joints" not in path:
            assert each["value"] == json.loads(json.dumps(show._to_finite(as_list(built_in[path]))))
    assert sources["health.jitter"] == "--set health"
    assert sources["health.loss"] == "default"
    assert {s.partition(":")[0] for s in sources.values()} == {
        *("default", "demo.yaml", "--set health", "--set slave.rig.joints.0.body.mass")
    }


def as_list(value):
    return [as_list(item) for item in value] if isinstance(value, tuple) else value


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        (["show", "--section", "slave.rgi"], "did you mean 'rig'?"),
        (["show", "--set", "slave.gate.speed_max=0"], "must be above 0"),
        (["reference", "--section", "slave.gat"], "did you mean 'slave.gate'?"),
    ],
)
def test_a_wrong_section_or_value_is_one_line(refused, words, hint):
    assert hint in refused("config", *words)


def parse_page(page):
    """Return the rows of each section of the Markdown page, by its anchor."""
    sections = {}
    for line in page.splitlines():
        if line.startswith("## "):
            anchor = re.search(r"\{#(.+)\}$", line)[1]
            assert anchor not in sections
            sections[anchor] = {}
        elif row := ROW.match(line):
            cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", row["cells"])]
            sections[anchor][row["key"]] = cells
    return sections


def list_places(section, keys_above):
    """Yield each place of a section in a config: its anchor, its keys, the tree around it."""

    def build_tree(inner):
        for key, is_list, tag, needed in reversed(keys_above):
            body = {**needed, **({"type": tag} if tag else {}), **inner}
            inner = {key: [body] if is_list else body}
        return inner

    yield section, build_tree
    for key in keys.describe_keys(section.config):
        for inner in reference.list_inner_sections(section, key):
            tag = keys.find_tag(inner.config)
            needed = {
                k.name: REQUIRED[k.name]
                for k in keys.describe_keys(inner.config)
                if k.default is keys.REQUIRED
            }
            place = (key.name, key.is_list, tag, needed)
            yield from list_places(inner, [*keys_above, place])


def test_the_page_has_exactly_the_keys_that_the_loader_allows_everywhere():
    page = parse_page(reference.render_markdown(""))
    anchors = {s.config: s.anchor for s in reference.list_sections() if s.same_as is None}
    seen = set()
    for section, build_tree in list_places(reference.Section("", (), SessionConfig), []):
        tree = build_tree({"no_such_key": 1})
        overrides = tuple(Override.from_value(key, value) for key, value in tree.items())
        with pytest.raises(UsageError) as caught:
            ConfigDocument(overrides=overrides).load(SessionConfig)
        allowed = re.search(r"unknown key.*\(allowed: (.*)\)", str(caught.value))
        assert allowed, f"{section.title}: {caught.value}"
        anchor = anchors[section.config]
        assert set(allowed[1].split(", ")) == set(page[anchor]), section.title
        seen.add(anchor)
    assert seen == set(page)
    assert len(seen) > 90


def test_every_key_has_a_meaning_and_every_link_its_section():
    text = reference.render_markdown("")
    page = parse_page(text)
    for anchor, rows in page.items():
        for key, (type_, default, _, meaning, _, *_) in rows.items():
            assert len(meaning) > 2, (anchor, key)
            assert type_, (anchor, key)
            assert default or "section" in type_, (anchor, key)
    assert set(re.findall(r"\]\(#([^)]+)\)", text)) <= set(page)


def test_a_stated_range_is_the_one_that_is_enforced_everywhere():
    checked = set()
    for section, build_tree in list_places(reference.Section("", (), SessionConfig), []):
        for key in keys.describe_keys(section.config):
            allowed = re.sub(r"(?<=\d) (?=\d{3})", "", key.allowed)
            number = r"(-?\d[\d.e+-]*)"
            stated = re.match(rf"(?:above )?{number} (?:to|and at most) {number}(?: |,|$)", allowed)
            is_new = (section.config, key.name) not in checked
            if stated is None or key.type not in ("number", "integer") or not is_new:
                continue
            low, high = map(float, stated.groups())
            is_whole = key.type == "integer"
            step = 1 if is_whole else 1e-3 * (high - low)
            for beyond in (low - step, high + step, *[low] * allowed.startswith("above")):
                value = int(beyond) if is_whole else beyond
                tree = build_tree(ALSO.get(key.name, {}) | {key.name: value})
                overrides = tuple(Override.from_value(top, inner) for top, inner in tree.items())
                with pytest.raises(UsageError, match=rf"{key.name}.*(must be|allowed)"):
                    ConfigDocument(overrides=overrides).load(SessionConfig)
            checked.add((section.config, key.name))
    assert len(checked) > 250


EXTENSION = '''
from dataclasses import dataclass
from slave.rigs.extension import RigExtension

@dataclass(frozen=True)
class Spring(RigExtension):
    """A spring of a laboratory."""

    stiffness: float = 10.0  # [N/m] of the spring

    def __post_init__(self):
        if not 1.0 <= self.stiffness <= 99.0:
            raise ValueError("stiffness: must be within 1 ... 99 [N/m]")
'''


def test_an_installed_extension_is_on_the_page_and_its_defaults_are_called_so(
    tmp_path, monkeypatch, capsys
):
    info = tmp_path / "lab-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: lab\nVersion: 1\n")
    points = "[teleop.rigs]\nspring = lab_rig:Spring\nlost = no_such_module:Rig\n"
    (info / "entry_points.txt").write_text(points)
    (tmp_path / "lab_rig.py").write_text(EXTENSION)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(reference, "list_sections", reference.list_sections.__wrapped__)  # a cache
    monkeypatch.setenv("COLUMNS", "100")
    for words in (
        ["reference", "--section", "slave.rig"],
        ["show", "--set", "slave.rig={type: spring}", "--section", "slave.rig"],
    ):
        assert commands.main(["config", *words]) == 0
    text = capsys.readouterr().out
    assert "slave.rig (spring): A spring of a laboratory" in text
    assert "default 10.0 N/m\n      of the spring. Allowed: 1 to 99 N/m" in text
    assert "slave.rig (lost): no_such_module:Rig: no module 'no_such_module'" in text
    assert re.search(r"stiffness: 10.0 +# default of spring; 1 to 99 N/m", text)
    assert re.search(r"type: spring +# --set slave.rig; one of .*spring", text)
