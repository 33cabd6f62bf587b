"""What a package can get wrong, and that nobody pays for it who does not ask for its profile."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest
from click.testing import CliRunner

from roclog.cli import cli
from roclog.config import load, warnings
from roclog.config.profiles import TABLES
from roclog.devices import PROFILES
from roclog.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from click.testing import Result

MAP = """
from dataclasses import replace
from decimal import Decimal
from roclog.register_map import *
FLOW = Block(
    name="flow", table=Table.HOLDING_REGISTERS, address=100, count=2,
    points=(Point(name="rate", offset=0, type=WordType.F32, unit="L/min"),),
)
REGISTER_MAP = RegisterMap(
    name="acme-flow", title="ACME flow meter", source="made up", unit=7,
    serial=SerialDefaults(baudrate=9600), answer_limit=500_000_000, samples=(FLOW,),
)
"""
FLAGGED = (
    MAP
    + """
FLAG = FlagAndClear(flag=2, payload=((0, 2),))
REGISTER_MAP = replace(REGISTER_MAP, samples=(replace(FLOW, count=3, trigger=FLAG),))
"""
)
BROKEN = {
    "raises": (
        "raise RuntimeError('no\\nlicence')",
        "cannot be imported: RuntimeError: no licence",
    ),
    "ends": ("import sys; sys.exit(9)", "cannot be imported: SystemExit: 9"),
    "needs": ("import surely_not_there", "cannot be imported: ModuleNotFoundError: No module"),
    "typo": ("REGISTER_MAP = (", "cannot be imported: SyntaxError: '(' was never closed"),
    "nothing": ("", "cannot be imported: AttributeError: module"),
    "colours": ("raise RuntimeError('\\x1b[31m')", "RuntimeError: \\x1b[31m"),
    "dictionary": ("REGISTER_MAP = {}", "is a dict, not a roclog.register_map.RegisterMap"),
    "function": (
        f"{MAP}\ndef REGISTER_MAP(): ...",
        "is a function, not a roclog.register_map.RegisterMap",
    ),
    "name": (
        f"{MAP}\nREGISTER_MAP = replace(REGISTER_MAP, name='acme')",
        "name: the register map is called 'acme', not 'acme-flow'",
    ),
    "flaw": (
        f"{MAP}\nREGISTER_MAP = replace(REGISTER_MAP, samples=(replace(FLOW, count=1),))",
        "block flow: point rate: offset 0 with 2 words is outside the block",
    ),
    "float": (
        MAP.replace('unit="L/min"', 'unit="L/min", scale=0.1'),
        "samples[0].points[0].scale: 0.1 (float), not Decimal or None",
    ),
    "list": (
        MAP.replace("samples=(FLOW,)", "samples=[FLOW]"),
        "(list), not a tuple",
    ),
    "word": (
        MAP.replace("WordType.F32", "'float32'"),
        "samples[0].points[0].type: 'float32' (str), not WordType",
    ),
    "number": (MAP.replace("unit=7", "unit='7'"), "unit: '7' (str), not int"),
    "trigger": (
        f"{MAP}\nREGISTER_MAP = replace(REGISTER_MAP, samples=(replace(FLOW, trigger=1),))",
        "samples[0].trigger: 1 (int), not FlagAndClear or ClearOnRead or Counter or Change or None",
    ),
}


def invoke(*arguments: str | Path) -> Result:
    return CliRunner().invoke(cli, [str(each) for each in arguments], prog_name="roclog")


@pytest.fixture
def config(tmp_path: Path) -> Callable[..., Path]:
    def write(profile: str, more: str = "") -> Path:
        path = tmp_path / "roclog.toml"
        path.write_text(
            "[connections.plant]\ntransport = 'tcp'\nhost = '127.0.0.1'\n"
            f"[devices.meter]\nprofile = '{profile}'\nconnection = 'plant'\n{more}\n"
        )
        path.chmod(0o644)
        return path

    return write


@pytest.mark.parametrize("kind", BROKEN)
def test_a_broken_package_is_one_clear_error(
    kind: str, package: Callable[..., None], config: Callable[..., Path]
) -> None:
    code, text = BROKEN[kind]
    module, fine = f"acme_{kind}", f"fine_{kind}"
    package("roclog-acme", {"acme-flow": f"{module}:REGISTER_MAP"}, module, code)
    package(
        "fine",
        {"fine-flow": f"{fine}:M"},
        fine,
        f"{MAP}\nM = replace(REGISTER_MAP, name='fine-flow')",
    )
    path = config("acme-flow")
    where = f"roclog-acme 1.2, entry point acme-flow = {module}:REGISTER_MAP: "
    for command in (["check"], ["record", "--for", "1s"]):
        result = invoke(*command, path)
        assert result.exit_code == 3
        (line,) = result.stderr.splitlines()
        assert line.startswith(f"roclog: {path}: devices.meter.profile: {where}")
        assert text in line
    shown = invoke("profiles", "acme-flow")
    assert shown.exit_code == 3
    assert shown.stderr.startswith(f"roclog: register map acme-flow: {where}")
    listed = invoke("profiles")
    assert listed.exit_code == 0
    (line,) = listed.stderr.splitlines()
    assert line.startswith(f"roclog: warning: profile acme-flow: {where}")
    names = [row.split()[0] for row in listed.stdout.splitlines()[1:]]
    assert names[-1] == "fine-flow"
    assert set(PROFILES) < set(names)
    assert "acme-flow" not in names
    found = json.loads(invoke("profiles", "--json").stdout)
    assert [each["name"] for each in found["broken"]] == ["acme-flow"]
    assert found["profiles"][-1]["package"] == {"name": "fine", "version": "1.2"}


def test_all_flaws_are_told(package: Callable[..., None], config: Callable[..., Path]) -> None:
    code = f"{MAP}\nREGISTER_MAP = replace(REGISTER_MAP, unit=300, answer_limit=0)"
    package("acme", {"acme-flow": "acme_all:REGISTER_MAP"}, "acme_all", code)
    with pytest.raises(ConfigError) as caught:
        load(config("acme-flow"))
    texts = [problem.text.rpartition("REGISTER_MAP: ")[2] for problem in caught.value.problems]
    assert texts == ["unit: 300 is not 0 to 255", "answer_limit: must be longer than nothing"]
    assert {problem.key for problem in caught.value.problems} == {"devices.meter.profile"}
    assert " (and 1 more, see roclog profiles acme-flow)\n" in invoke("profiles").stderr


def test_two_packages_with_one_profile(
    package: Callable[..., None], config: Callable[..., Path]
) -> None:
    package("acme", {"acme-flow": "acme_one:REGISTER_MAP"}, "acme_one", MAP)
    package("bcme", {"acme-flow": "acme_two:REGISTER_MAP"}, "acme_two", MAP)
    text = (
        "acme 1.2, entry point acme-flow = acme_one:REGISTER_MAP and bcme 1.2, entry point "
        "acme-flow = acme_two:REGISTER_MAP: have the same name, remove all but one"
    )
    path = config("acme-flow")
    result = invoke("check", path)
    assert result.exit_code == 3
    assert result.stderr == f"roclog: {path}: devices.meter.profile: {text}\n"
    assert invoke("profiles").stderr == f"roclog: warning: profile acme-flow: {text}\n"
    assert invoke("profiles", "acme-flow").exit_code == 3


@pytest.mark.parametrize("profile", TABLES)
def test_a_built_in_profile_wins_and_the_collision_is_told(
    profile: str, package: Callable[..., None], config: Callable[..., Path]
) -> None:
    package("acme", {profile: "acme_never:REGISTER_MAP"}, "acme_never", "raise RuntimeError")
    entry = f"acme 1.2, entry point {profile} = acme_never:REGISTER_MAP: "
    warned = invoke("profiles")
    assert warned.exit_code == 0
    assert warned.stderr == (
        f"roclog: warning: profile {profile}: {entry}has the name of a built-in profile, "
        "which is used\n"
    )
    assert "acme" not in warned.stdout
    if profile in PROFILES:
        settings = load(config(profile))
        assert settings.devices["meter"].profile.title == PROFILES[profile].title
        told = [str(each) for each in warnings(settings)]
        assert f"devices.meter.profile: {entry}has this name too; the built-in profile is used" in (
            told
        )
        assert "acme" not in invoke("profiles", profile).stdout
    assert "acme_never" not in sys.modules


def test_nothing_is_imported_that_is_not_asked_for(
    tmp_path: Path, package: Callable[..., None], config: Callable[..., Path]
) -> None:
    """In processes of their own; the package leaves a file when it is imported."""
    mark = tmp_path / "imported"
    code = f"open({str(mark)!r}, 'w').close()\n{MAP}"
    package("acme", {"acme-flow": "acme_lazy:REGISTER_MAP"}, "acme_lazy", code)
    package(
        "bcme",
        {"bcme-flow": "bcme_lazy:M"},
        "bcme_lazy",
        f"{MAP}\nM = replace(REGISTER_MAP, name='bcme-flow')",
    )
    environment = os.environ | {"PYTHONPATH": str(tmp_path / "site")}

    def run(*arguments: object) -> int:
        command = [sys.executable, "-m", "roclog", *map(str, arguments)]
        return subprocess.run(command, env=environment, capture_output=True, check=False).returncode

    assert run("check", config("hiac-roc")) == 0
    assert run("check", config("bcme-flow")) == 0
    assert run("check", config("bcme-flo")) == 3
    assert run("profiles", "hiac-roc") == 0
    assert not mark.exists()
    assert run("check", config("acme-flow")) == 0
    assert mark.exists()


def test_a_built_in_profile_does_not_look_at_what_is_installed(
    monkeypatch: pytest.MonkeyPatch, config: Callable[..., Path]
) -> None:
    monkeypatch.setattr("importlib.metadata.entry_points", lambda **_: 1 / 0)
    monkeypatch.syspath_prepend("nowhere at all")
    assert load(config("hiac-roc")).devices["meter"].profile is PROFILES["hiac-roc"]
    with pytest.raises(ZeroDivisionError):
        load(config("acme-flow"))


def test_what_a_package_prints_is_no_data(package: Callable[..., None]) -> None:
    package("acme", {"acme-flow": "acme_loud:REGISTER_MAP"}, "acme_loud", f"print('hi')\n{MAP}")
    result = invoke("profiles", "acme-flow", "--json")
    assert json.loads(result.stdout)["profiles"][0]["name"] == "acme-flow"
    assert result.stderr == "hi\n"


def test_unknown_profiles_are_compared_with_plugins(
    package: Callable[..., None], config: Callable[..., Path]
) -> None:
    package("acme", {"acme-flow": "acme_near:REGISTER_MAP"}, "acme_near", "raise RuntimeError")
    with pytest.raises(ConfigError, match='no profile "acme_flow", did you mean "acme-flow"'):
        load(config("acme_flow"))
    with pytest.raises(ConfigError, match=r"known: hiac-roc, .*, registers, acme-flow$"):
        load(config("weather"))
    result = invoke("profiles", "acme_flow")
    assert result.exit_code == 2
    assert "did you mean 'acme-flow'?" in result.stderr


KEYS = {
    "unknown": (MAP, "acknowlege = true", 'acknowlege: unknown key, did you mean "acknowledge"?'),
    "no flag": (MAP, "acknowledge = false", "acknowledge: acme-flow has no flag that is cleared"),
    "no cycle": (MAP, "cycle = '5s'", "cycle: acme-flow has no flag that is cleared"),
    "word order": (MAP, "word_order = 'ABDC'", 'word_order: "ABDC" is not '),
    "poll": (MAP, "poll = 5", "poll: 5 is not a duration"),
    "unit": (
        "from roclog.modbus.dialect import MSX_E\n"
        + MAP.replace("unit=7", "unit=1, dialect=MSX_E"),
        "unit = 3",
        "unit: 3 is not a unit of acme-flow, 0 to 1",
    ),
}


@pytest.mark.parametrize("kind", KEYS)
def test_keys_that_do_not_fit(
    kind: str, package: Callable[..., None], config: Callable[..., Path]
) -> None:
    code, more, text = KEYS[kind]
    module = f"acme_keys_{kind.replace(' ', '_')}"
    package("acme", {"acme-flow": f"{module}:REGISTER_MAP"}, module, code)
    with pytest.raises(ConfigError) as caught:
        load(config("acme-flow", more))
    (problem,) = map(str, caught.value.problems)
    assert problem.startswith(f"devices.meter.{text}")


def test_keys_that_fit(package: Callable[..., None], config: Callable[..., Path]) -> None:
    package("acme", {"acme-flow": "acme_fit:REGISTER_MAP"}, "acme_fit", FLAGGED)
    keys = "unit = 9\npoll = '2s'\nword_order = 'CDAB'\nacknowledge = false\ncycle = '30s'"
    device = load(config("acme-flow", keys)).devices["meter"]
    assert (device.unit, device.poll, device.word_order) == (9, 2 * 10**9, "CDAB")
    assert (device.acknowledge, device.cycle) == (False, 30 * 10**9)
    plain = load(config("acme-flow")).devices["meter"]
    assert (plain.unit, plain.poll, plain.word_order) == (7, 10**9, "ABCD")
    assert plain.clears
