"""The config loader: what it accepts, and the one line it says about everything else."""

import dataclasses
import math
import re
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from teleop.config import strict_yaml
from teleop.config.loading import SESSION_KEYS, ConfigDocument, as_tree, load
from teleop.config.overrides import Override
from teleop.config.ranges import MAY_BE_INFINITE
from teleop.errors import UsageError
from teleop.launch.config import SessionConfig
from teleop.link import LinkConfig
from teleop.session.config import RunConfig


@dataclass(frozen=True)
class Simulated:
    type: Literal["simulated"] = "simulated"
    seed: int = 0
    noise: float = 0.1  # [N]

    def __post_init__(self):
        if self.noise < 0:
            raise ValueError("noise: is below 0; allowed is 0 or more")


@dataclass(frozen=True)
class Replayed:
    file: Path
    type: Literal["replayed"] = "replayed"


@dataclass(frozen=True)
class Section:
    length: float  # [m]
    radius: float = field(default=math.inf, metadata=MAY_BE_INFINITE)  # [m]


@dataclass(frozen=True)
class Force:
    scale: float = 1.0
    limit: float = 5.0  # [N]


@dataclass(frozen=True)
class Everything:
    rig: Simulated | Replayed = field(default_factory=Simulated)
    sections: tuple[Section, ...] = (Section(0.5), Section(0.2, 0.04))
    force: Force = field(default_factory=lambda: Force(scale=3.0))
    gains: tuple[float, ...] = ()
    span: tuple[float, int] = (0.0, 1)
    spans: tuple[tuple[float, float], ...] = field(default=(), metadata=MAY_BE_INFINITE)
    gain: float | tuple[float, ...] = 1.0
    mode: Literal["position", "rate", 1] = "position"
    name: str = "left"
    folder: Path | None = None
    tendons: int = 2
    pretension: float = 2.0  # [N]
    enabled: bool = True
    optional: Force | None = None

    def __post_init__(self):
        if self.tendons < 1:
            raise ValueError("tendons: allowed are 1 to 16")
        if self.force.limit > 50:
            raise ValueError("force.limit: allowed is up to 50 N")
        if self.pretension == 13:
            raise ValueError("an unlucky combination")


def write(folder, text):
    path = folder / "config.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def of(folder, text, *overrides):
    """Load `text` as the section `slave`."""
    indented = "".join(f"  {line}\n" for line in text.splitlines())
    return load(write(folder, "slave:\n" + indented), Everything, "slave", overrides)


def refusal(folder, text, *overrides):
    """Return the line a bad section is refused with, checked to be one line that names the file."""
    with pytest.raises(UsageError) as caught:
        of(folder, text, *overrides)
    line = str(caught.value)
    assert "\n" not in line
    assert overrides or line.startswith(str(folder / "config.yaml"))
    return line


def test_defaults_without_a_file_and_from_an_empty_one(tmp_path):
    assert load(None, Everything, "slave") == Everything()
    for text in ("", "# nothing\n", "slave:\n", "master:\n"):
        assert load(write(tmp_path, text), Everything, "slave") == Everything()
    built = load(None, Everything, "slave", ["slave.sections.1.radius=0.03", "slave.rig.seed=2"])
    assert built == Everything(Simulated(seed=2), (Section(0.5), Section(0.2, 0.03)))


def test_every_kind_of_value(tmp_path):
    built = of(
        tmp_path,
        """
rig: {type: replayed, file: data/run.csv}
sections:
  - {length: 1, radius: .inf}
  - {length: 2e-1, radius: inf}
  - {length: 0.3}
gains: [1, 2.5, 1e-3]
span: [0.5, 3]
spans: [[0.5, .inf]]
gain: [1, 2]
mode: 1
name: "12"
folder: /abs
tendons: 4
enabled: false
optional: {limit: 2}
""",
    )
    assert built.rig == Replayed(tmp_path / "data/run.csv")
    assert built.sections == (Section(1.0), Section(0.2), Section(0.3))
    assert built.gains == (1.0, 2.5, 1e-3)
    assert all(type(g) is float for g in built.gains)
    assert built.span == (0.5, 3)
    assert built.spans == ((0.5, math.inf),)
    assert built.gain == (1.0, 2.0)
    assert (built.mode, built.name, built.tendons, built.enabled) == (1, "12", 4, False)
    assert built.folder == Path("/abs")
    assert built.optional == Force(limit=2.0)


def test_what_a_nested_mapping_leaves_out_keeps_the_default_of_its_field(tmp_path):
    assert of(tmp_path, "force: {limit: 7}").force == Force(scale=3.0, limit=7.0)
    assert of(tmp_path, "force:").force == Force(scale=3.0)


@pytest.mark.parametrize(
    ("text", "key", "says"),
    [
        ("tendon: 3", "slave.tendon", "did you mean 'tendons'?"),
        ("force: {scael: 2}", "slave.force.scael", "did you mean 'scale'?"),
        ("zzz: 1", "slave.zzz", "allowed: enabled, folder"),
        ("tendons: two", "slave.tendons", "'two' is not a whole number"),
        ("tendons: 2.0", "slave.tendons", "2.0 is not a whole number"),
        ("tendons: true", "slave.tendons", "true is not a whole number"),
        ("tendons:", "slave.tendons", "null is not a whole number"),
        ("tendons: 0", "slave.tendons", "0: allowed are 1 to 16"),
        ("pretension: true", "slave.pretension", "true is not a number"),
        ("pretension: '1.5'", "slave.pretension", "'1.5' is not a number"),
        ("pretension: .nan", "slave.pretension", "not a finite number"),
        ("pretension: 1e999", "slave.pretension", "not a finite number"),
        ("pretension: 1" + "0" * 400, "slave.pretension", "not a finite number"),
        ("pretension: 13", "slave", "an unlucky combination"),
        ("enabled: 1", "slave.enabled", "1 is not true or false"),
        ("enabled: yes", "slave.enabled", "'yes' is not true or false"),
        ("name: 12", "slave.name", "12 is not text; put it in quotes"),
        ("folder: 3", "slave.folder", "3 is not a path"),
        ("mode: rat", "slave.mode", "one of 'position', 'rate', 1"),
        ("mode: true", "slave.mode", "true is not one of"),
        ("gains: 3", "slave.gains", "3 is not a list"),
        ("gains: [1, x]", "slave.gains.1", "'x' is not a number"),
        ("gains: {a: 1}", "slave.gains.a", "counted from 0"),
        ("span: [1]", "slave.span", "has 1 items, 2 are needed"),
        ("gain: [1, x]", "slave.gain.1", "'x' is not a number"),
        ("sections: [{length: 1}, {radius: 1}]", "slave.sections.1.length", "is missing"),
        ("sections: [{length: 1, radius: .nan}]", "slave.sections.0.radius", "not a finite"),
        ("sections: [{length: 1, radius: straight}]", "slave.sections.0.radius", "(or .inf)"),
        ("force: 3", "slave.force", "3 is not a mapping"),
        ("force: {limit: 60}", "slave.force.limit", "allowed is up to 50 N"),
        ("rig: {type: simulatd}", "slave.rig.type", "did you mean 'simulated'?"),
        ("rig: {type: replayed}", "slave.rig.file", "is missing; it is a path"),
        ("rig: {type: replayed, seed: 1}", "slave.rig.seed", "unknown key"),
        ("rig: {noise: -1}", "slave.rig.noise", "-1.0: is below 0; allowed is 0 or more"),
        ("rig: 3", "slave.rig", "3 is not {type: ..., ...}"),
        ("rig: replayed", "slave.rig", "{type: replayed, ...} is wanted"),
        ("sections: {type: bent}", "slave.sections", "[{type: bent, ...}] is wanted"),
    ],
)
def test_a_wrong_value_is_named_by_file_key_value_and_remedy(tmp_path, text, key, says):
    line = refusal(tmp_path, text)
    assert f": {key}: " in line
    assert says in line


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"slave: {tendons: 1, tendons: 2}", "line 1: the key 'tendons' occurs twice"),
        (b"slave:\n  1: 2\n", "line 2: the key 1 is not text"),
        (b"slave: {tendons: 1", "line 1"),
        (b"slave:\n\ttendons: 1\n", "line 2"),
        (b"a: 1\n---\nb: 2\n", "line 2"),
        (b"slave: !!python/object:os.system {}\n", "line 1"),
        (b"- 1\n- 2\n", "the top level is not a mapping"),
        (b"\xff\xfe\x00", "is not UTF-8 text"),
        (b"slave: \x00\n", "not YAML"),
        (b"[" * 1200, "nested too deeply"),
        (b"slave: {tendons: " + b"9" * 5000 + b"}\n", "config.yaml: "),
        (b"slav: {}\n", "slav: unknown key; did you mean 'slave'?"),
        (b"slave: 3\n", "slave: 3 is not a mapping"),
        (b"columns: {}\nbend: x\n", "columns: is no key of a session: this is the columns of a"),
        (b"columns: {}\ndecimal: point\n", "teleop data show TABLE --mapping FILE"),
        (b"rig: bench\ntendons: []\n", "rig: is no key of a session: this is a calibration: name"),
        (b"base: {K: 1}\n", "name it as model_file in slave.tendons"),
        (b"signs: []\n", "name it as signs in master.device"),
    ],
)
def test_a_file_that_is_no_config_is_refused_in_one_line(tmp_path, content, says):
    path = tmp_path / "config.yaml"
    path.write_bytes(content)
    with pytest.raises(UsageError) as caught:
        load(path, Everything, "slave")
    line = str(caught.value)
    assert line.startswith(str(path))
    assert "\n" not in line
    assert says in line


@pytest.mark.parametrize(
    ("written", "value"),
    [
        *(("1e-3", 1e-3), ("1E3", 1e3), (".5", 0.5), ("5.", 5.0), ("-2", -2.0), ("+1.5e+2", 150.0)),
        *((text, None) for text in ("012", "1:30", "1_000", "0x10", "on", "2024-01-01")),
    ],
)
def test_numbers_are_read_as_one_expects_and_yaml_1_1_s_surprises_are_text(
    tmp_path, written, value
):
    if value is not None:
        assert of(tmp_path, f"pretension: {written}").pretension == value
    else:
        assert of(tmp_path, f"name: {written}").name == written
        assert "is not a number" in refusal(tmp_path, f"pretension: {written}")


def test_overrides_are_laid_over_the_file_in_order(tmp_path):
    built = of(
        tmp_path,
        "tendons: 3\nsections: [{length: 1}, {length: 2}]",
        "slave.tendons=5",
        "slave.force.scale=2",
        "slave.sections.1.length=9",
        "slave.gains=[1, 2]",
        "slave.rig={type: replayed, file: x.csv}",
        "slave.tendons=6",
    )
    assert built.tendons == 6
    assert built.force == Force(scale=2.0)
    assert [s.length for s in built.sections] == [1.0, 9.0]
    assert built.gains == (1.0, 2.0)
    assert built.rig == Replayed(Path("x.csv"))  # typed on the command line: from where one stands


@pytest.mark.parametrize(
    "sections",
    ["[&a {length: 1}, *a, *a]", "&all [{length: 1}, {length: 1}, {length: 1}]\nspans: []"],
)
def test_an_override_changes_only_what_it_names_where_the_file_has_aliases(tmp_path, sections):
    built = of(tmp_path, f"sections: {sections}", "slave.sections.1.length=9")
    assert [s.length for s in built.sections] == [1.0, 9.0, 1.0]
    line = refusal(tmp_path, f"sections: {sections}", "slave.sections.1.length=x")
    assert "slave.sections.1.length: 'x' is not a number" in line
    assert "sections.2.lenth: unknown key" in refusal(
        tmp_path, f"sections: {sections}", "slave.sections.2.lenth=1"
    )


@pytest.mark.parametrize(
    ("override", "says"),
    [
        ("slave.tendons", "expected dotted.key=value"),
        ("=3", "expected dotted.key=value"),
        (
            "slave.tendons=x",
            "--set slave.tendons=x: slave.tendons: 'x' is not a whole number",
        ),
        ("slave.tendon=3", "did you mean 'tendons'?"),
        ("slav.tendons=3", "did you mean 'slave'?"),
        ("slave.force.limit=60", "--set slave.force.limit=60: slave.force.limit: 60.0: allowed"),
        ("slave.sections.7.length=1", "counted from 0"),
        ("slave.gains=[1", "--set slave.gains=[1, line 1"),
        ("slave=3", "3 is not a mapping"),
    ],
)
def test_a_wrong_override_is_named_as_such(tmp_path, override, says):
    line = refusal(tmp_path, "sections: [{length: 1}]", override)
    assert line.startswith("--set ")
    assert says in line


def test_an_address_of_ipv6_needs_no_quotes():
    assert load(None, LinkConfig, "link", ["link.slave=[::1]:7452"]).slave == "[::1]:7452"


def test_another_section_s_content_is_left_to_its_owner(tmp_path):
    path = write(tmp_path, "session: a\nmaster: {whatever: 1}\nslave: {tendons: 3}\n")
    assert load(path, Everything, "slave").tendons == 3
    assert load(path, RunConfig, None).session == "a"


def test_the_keys_of_a_session_are_those_of_its_config():
    assert {f.name for f in dataclasses.fields(SessionConfig)} == set(SESSION_KEYS)


def test_a_snapshot_is_the_config_as_it_was_when_it_was_read(tmp_path):
    path = write(tmp_path, "slave: {tendons: 3, folder: 'Größe\u2028\U0001f600'}\n")
    document = ConfigDocument.read(path, ["slave.pretension=2e-1", "rate_hz=.inf"])
    document = document.override(
        Override.from_value("slave.rig", {"type": "replayed", "file": "x.csv"})
    )
    (tmp_path / "scratch").mkdir()
    snapshot = document.save_snapshot(tmp_path / "scratch" / "a")
    path.write_text("slave: {tendons: 4}\n")
    found = ConfigDocument.read(snapshot, ["slave.name=b"])
    assert replace(found, overrides=found.overrides[:-1]) == document
    assert found.load(Everything, "slave") == replace(document.load(Everything, "slave"), name="b")
    for wrong in (found, document):
        with pytest.raises(UsageError, match=r"^--set rate_hz=\.inf: rate_hz: inf is not a finite"):
            wrong.load(RunConfig)


@pytest.mark.parametrize("text", ["", "{}", "[1]", "session: a", '{"path": 1}', "[" * 100_000])
def test_what_is_no_snapshot_is_one_line(tmp_path, text):
    (tmp_path / "a.snapshot").write_text(text)
    with pytest.raises(UsageError, match=r"is no snapshot of a session's config$"):
        ConfigDocument.read(tmp_path / "a.snapshot")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("session: Demo", "session: 'Demo': allowed are 1 to 40 of a-z 0-9 _ -"),
        ("session: '*'", "session: '*': allowed"),
        ("rate_hz: 99", "rate_hz: 99.0: must be 100 to 4000 Hz"),
        ("rate_hz: 4001", "rate_hz: 4001.0: must be 100 to 4000 Hz"),
        (
            "link: {master: udp/127.0.0.1:1}",
            "link.master: 'udp/127.0.0.1:1': write 127.0.0.1:1 without udp/",
        ),
    ],
)
def test_shared_keys_are_checked(tmp_path, text, says):
    with pytest.raises(UsageError) as caught:
        load(write(tmp_path, text), RunConfig, None)
    assert says in str(caught.value)


@pytest.mark.parametrize("index", ["x", "²", "٣", "00", "9" * 5000])
def test_what_is_no_index_of_a_list_is_one_line(tmp_path, index):
    for text in ("slave: {sections: [{length: 1}, {length: 2}]}", ""):
        with pytest.raises(UsageError, match="counted from 0"):
            load(write(tmp_path, text), Everything, "slave", [f"slave.sections.{index}.length=1"])


DOCUMENTED = (Path(__file__).parents[2] / "docs" / "reference" / "configuration.md").read_text()


@pytest.mark.parametrize("text", re.findall(r"```yaml\n(.*?)```", DOCUMENTED, re.DOTALL))
def test_the_examples_in_the_docs_are_accepted(tmp_path, text):
    (tmp_path / "certificates").mkdir()
    for name in ("ca.pem", "own.pem", "own.key"):
        (tmp_path / "certificates" / name).touch()
    assert isinstance(load(write(tmp_path, text), RunConfig, None), RunConfig)


def test_the_mistake_in_the_docs_is_what_the_loader_says(tmp_path):
    path = tmp_path / "demo.yaml"
    path.write_text("link: {slav: x}")
    with pytest.raises(UsageError) as caught:
        load(path, RunConfig, None)
    assert str(caught.value).replace(str(path), "demo.yaml") in DOCUMENTED


def test_a_field_of_a_type_the_loader_cannot_check_is_a_defect_of_ours():
    @dataclass(frozen=True)
    class Bad:
        table: Any = None

    with pytest.raises(TypeError, match=r"slave\.table"):
        load(None, Bad, "slave", ["slave.table=3"])


NUMBER = st.floats(-1e6, 1e6).filter(lambda x: x != 13)
EVERYTHING = st.builds(
    Everything,
    rig=st.one_of(
        st.builds(Simulated, seed=st.integers(), noise=st.floats(0, 10)),
        st.builds(Replayed, file=st.just(Path("/a/b.csv"))),
    ),
    sections=st.lists(
        st.builds(Section, length=NUMBER, radius=st.one_of(NUMBER, st.just(math.inf))), max_size=3
    ).map(tuple),
    force=st.builds(Force, scale=NUMBER, limit=st.floats(-50, 50)),
    gains=st.lists(NUMBER, max_size=3).map(tuple),
    gain=st.one_of(NUMBER, st.lists(NUMBER, max_size=3).map(tuple)),
    mode=st.sampled_from(["position", "rate", 1]),
    name=st.text()
    | st.sampled_from(["1e3", "no", "012", "1:30", "null", "0.5", "=", "<<", "a\x85"]),
    folder=st.one_of(st.none(), st.just(Path("/x"))),
    tendons=st.integers(1, 100),
    pretension=NUMBER,
    enabled=st.booleans(),
    optional=st.one_of(st.none(), st.builds(Force, scale=NUMBER)),
)


@given(EVERYTHING)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=25)
def test_what_as_tree_writes_load_reads_back(tmp_path, built):
    path = tmp_path / "config.yaml"
    path.write_text(strict_yaml.format_document({"slave": as_tree(built)}))
    assert load(path, Everything, "slave") == built


@given(st.text(max_size=60))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=100)
def test_whatever_is_in_the_file_the_outcome_is_a_config_or_one_line(tmp_path, text):
    path = tmp_path / "config.yaml"
    path.write_bytes(("slave: " + text).encode("utf-8", "surrogatepass"))
    said = ""
    try:
        assert isinstance(load(path, Everything, "slave"), Everything)
    except UsageError as error:
        said = str(error)
    assert "\n" not in said
