"""The instruments of examples/ as their manuals print them, served and recorded."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.recorder import Recorder
from bench.recording import export, files, gaps, items, metadata, nanoseconds, read_csv
from bench.registers import HOLDING, INPUT, Block, Cell, Device

if TYPE_CHECKING:
    from datetime import datetime

ROOT = Path(__file__).parents[2]
MANUALS = tomllib.loads((ROOT / "tests/vectors/registers/manuals.toml").read_text(encoding="utf-8"))


def printed(beginning: str, kind: str = "value") -> dict[str, Any]:
    """The one entry whose source begins like this."""
    (entry,) = (e for e in MANUALS[kind] if e["source"].startswith(beginning))
    found: dict[str, Any] = entry
    return found


def raw(name: str, at: int, *samples: list[int]) -> Cell:
    """Words as the manual has them, at an offset of their block."""
    return Cell(f"{name}@{at}", "words", samples)


def u32(name: str, at: int, *samples: int) -> Cell:
    return Cell(f"{name}@{at}", "u32", samples, order="1234")


def block(name: str, area: int, at: int, count: int, *cells: Cell, **group: Any) -> Block:
    places = {cell.name: int(cell.name.rpartition("@")[2]) for cell in cells}
    return Block(name, area, at, cells, group=group, at_of=places, count=count)


def record(folder: Path, example: str, device: Device, samples: dict[str, int]) -> Path:
    """The example as it is, but for the port and a shorter poll."""
    text = (ROOT / "examples" / f"{example}.toml").read_text(encoding="utf-8")
    text, ports = re.subn(r'port = "/dev/[^"]+"', f'port = "{device.address}"', text)
    text, polls = re.subn(r'poll = "\w+"', 'poll = "200ms"', text)
    assert (ports, polls) == (1, 1)
    recorder = Recorder(folder, text)
    with recorder.start() as child:
        child.while_it_runs(
            lambda: all(device.read(name) >= k for name, k in samples.items()), "samples", 30
        )
        assert child.stop() == 0, child.talk()
    assert device.end().count("write") == 0
    export(recorder.directory, folder / "csv")
    return recorder.directory


def facts(directory: Path, device: str, name: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(
        metadata(files(directory)[-1])[f"roclog.device.{device}"][name]
    )
    return found


def utc(moment: datetime) -> int:
    return int(moment.replace(microsecond=0).timestamp()) * 10**9 + moment.microsecond * 1000


def test_met_one_6000(tmp_path: Path) -> None:
    stamp = printed("Hach Met One 6000, A.4, 300-303", "time")
    model = printed("Hach Met One 6000, Appendix A.1, note 1")
    day = printed("Hach Met One 6000, A.4, 301")
    later = [*stamp["words"][:3], 0x1E10]
    device = Device(
        tmp_path,
        block(
            "sample", HOLDING, 500, 48,
            raw("time", 0, stamp["words"], later),
            raw("period", 4, [0, 0x0100], [0, 0x0100]),
            u32("count", 11, 70000, 65536),
            raw("temperature", 44, [215], [0xFFFD]),
            every=1.0, at_once=True,
        ),
        block(
            "identity", HOLDING, 0, 40,
            raw("model", 15, model["words"]),
            raw("calibration", 34, [2025, *day["words"], 2026, *day["words"], 1, 102]),
        ),
        line="pty", unit=1,
    )  # fmt: skip
    with device:
        directory = record(tmp_path, "met-one-6000", device, {"sample": 2})
    first, second = read_csv(tmp_path / "csv/met1.sample.csv")[:2]
    assert nanoseconds(first["device_time"]) == utc(stamp["utc"])
    assert nanoseconds(second["device_time"]) == utc(stamp["utc"]) + 10**9
    assert [row["time"] for row in (first, second)] == ["1815", "1816"]
    assert (first["year"], first["day"], first["hour"]) == ("2026", "1123", "6")
    assert (first["period"], first["count_1"], second["count_1"]) == ("60", "70000", "65536")
    assert [row["temperature"] for row in (first, second)] == ["21.5", "-0.3"]
    said = facts(directory, "met1", "identity")
    assert said["model"] == model["value"]
    assert (said["calibration_year"], said["calibration_day"]) == (2025, day["value"])
    assert (said["firmware_version"], said["hardware_version"]) == (0.01, 1.02)


def test_lighthouse_rlpc(tmp_path: Path) -> None:
    stamp = printed("Algodue UPM309, p. 99", "time")  # the same form: high word first, from 1970
    version = printed("Lighthouse RLPC manual")
    tells = {"how": "read", "area": HOLDING, "at": 2, "mask": 4, "up": 4, "reads": [INPUT, 0, 998]}
    device = Device(
        tmp_path,
        block(
            "record", INPUT, 0, 16,
            raw("time", 0, stamp["words"]),
            u32("number", 2, 1, 2, 3, 4),
            raw("status", 6, [0, 0x0041]),
            u32("channel", 8, 2**32 - 1, 7),
            every=0.5, tells=tells,
        ),
        block(
            "identity", HOLDING, 0, 24,
            raw("version", 3, version["words"]),
            raw("product", 6, [0x524C, 0x5043, 0]),
        ),
        line="pty", unit=1,
    )  # fmt: skip
    with device:
        directory = record(tmp_path, "lighthouse-rlpc", device, {"record": 4})
    rows = read_csv(tmp_path / "csv/rlpc.record.csv")
    assert [row["sample_time"] for row in rows[:4]] == ["1", "2", "3", "4"]
    assert [row["channel_1"] for row in rows[:2]] == ["4294967295", "7"]
    assert {nanoseconds(row["device_time"]) for row in rows} == {utc(stamp["utc"])}
    assert (rows[0]["laser_alert"], rows[0]["flow_alert"], rows[0]["sampler_error"]) == (
        "true",
        "false",
        "true",
    )
    assert gaps(directory, "rlpc") == []
    assert all(item.values.raw[4:8] != bytes(4) for item in items(directory, "/rlpc/record"))
    said = facts(directory, "rlpc", "identity")
    assert (said["firmware_version"], said["product"]) == (version["value"], "RLPC")


def test_rmf_cms_2(tmp_path: Path) -> None:
    device = Device(
        tmp_path,
        block(
            "result", INPUT, 24, 40,
            u32("date", 0, 100, 200),
            raw("flags", 7, [0x0001], [0x0000]),
            raw("temperature", 9, [2534], [0xFF9C]),
            u32("count", 16, 123456, 123456),
            raw("code", 32, [0xFFFF], [22]),
            every=0.6, at_once=True,
        ),
        block(
            "settings", INPUT, 0, 24,
            raw("product", 0, [0xD3DD]),
            raw("reference", 10, [0x5465, 0x7374, 0x2031, 0, 0x5858]),
        ),
        line="pty", unit=204,
    )  # fmt: skip
    with device:
        directory = record(tmp_path, "rmf-cms-2", device, {"result": 2})
    valid, other = read_csv(tmp_path / "csv/cms.result.csv")[:2]
    assert (valid["count_1"], valid["code_1"], valid["result_valid"]) == ("123456", "-1", "true")
    assert (other["count_1"], other["code_1"], other["result_valid"]) == ("", "", "false")
    assert (valid["temperature"], other["temperature"]) == ("25.34", "-1.0")
    first, second = items(directory, "/cms/result")[:2]
    assert (first.values.missing, second.values.missing) == (0, 0xFFFF << 7)
    said = facts(directory, "cms", "settings")
    assert (said["product"], said["test_reference"]) == (0xD3DD, "Test 1")
