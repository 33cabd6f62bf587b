"""CSV and NDJSON: exact text, safe text, nothing half written."""

from __future__ import annotations

import csv
import json
import warnings
from pathlib import Path
from typing import Any

import mcapfiles as files
import pytest
from mcapfiles import SECOND, T0

from roclog.errors import StorageError
from roclog.export import Style, TargetExistsError, export
from roclog.recording.reader import open_recording

HERE = Path(__file__).parent
ITEMS = [
    files.event(T0, message="=cmd|' /C calc'!A0", name="roc1.note"),
    files.sample(1, count_1=0.1, temperature=float("nan"), doubtful=0b10001, time_flags=1),
    files.sample(2, count_1=1e300, device_time=T0 + 500_000_000, origin=2, redelivered=True),
    files.sample(3, at=T0 + 3 * SECOND + 120_000_000, count_1=float("inf"), alarms=2**32 - 1),
    files.gap(T0 + 4 * SECOND, T0, T0 + SECOND, 7, 3),
    files.clear(3, T0 + 5 * SECOND),
    files.link(T0 + 60 * SECOND),
]


def recording(tmp_path: Path, items: list[files.Item] | None = None) -> Any:
    return open_recording(files.write_sealed(tmp_path / "r.mcap", items or ITEMS))


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file, strict=True))


def test_csv_is_exactly_this(tmp_path: Path) -> None:
    export(recording(tmp_path), tmp_path / "out")
    found = {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()}
    golden = {path.name: path.read_bytes() for path in (HERE / "golden").iterdir()}
    assert found == golden


def test_columns_follow_the_documented_order(tmp_path: Path) -> None:
    export(recording(tmp_path), tmp_path)
    header = (tmp_path / "roc1.sample.csv").read_text().partition("\n")[0].strip().split(",")
    assert header == [
        *("log_time", "device_time", "seq", "origin"),
        *files.POINTS.split(","),
        "laser_low",
        *("previous_read_at", "redelivered", "doubtful", "time_flags"),
    ]


def test_integer_times(tmp_path: Path) -> None:
    export(recording(tmp_path), tmp_path, style=Style(times="ns"))
    first, second, _ = rows(tmp_path / "roc1.sample.csv")
    assert (first["log_time"], first["device_time"]) == (str(T0 + SECOND), "")
    assert second["device_time"] == str(T0 + 500_000_000)
    (gap,) = rows(tmp_path / "roc1.gap.csv")
    assert (gap["from"], gap["to"], gap["expected"]) == (str(T0), str(T0 + SECOND), "7")


@pytest.mark.parametrize("start", ["=1+1", "+1", "-1+1", "@SUM(A1)", "\tx", "\rx"])
def test_text_that_a_spreadsheet_would_run(tmp_path: Path, start: str) -> None:
    items = [files.event(T0, message=start)]
    export(recording(tmp_path, items), tmp_path / "safe")
    export(recording(tmp_path, items), tmp_path / "raw", style=Style(raw_text=True))
    assert rows(tmp_path / "safe" / "log.csv")[0]["message"] == f"'{start}"
    assert rows(tmp_path / "raw" / "log.csv")[0]["message"] == start


def test_numbers_are_never_defused(tmp_path: Path) -> None:
    export(recording(tmp_path, [files.sample(1, count_1=-5.5, nas_class=-2)]), tmp_path)
    (row,) = rows(tmp_path / "roc1.sample.csv")
    assert (row["count_1"], row["nas_class"]) == ("-5.5", "-2")


@pytest.mark.parametrize("text", ['a,"b"', "two\r\nlines", "\n", "naïve ☃", "nul\0nul", ""])
def test_any_text_survives(tmp_path: Path, text: str) -> None:
    export(recording(tmp_path, [files.event(T0, message=text)]), tmp_path)
    assert rows(tmp_path / "log.csv")[0]["message"] == text


def test_pandas_reads_numbers_booleans_and_times(tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import pandas as pd  # noqa: PLC0415

    export(recording(tmp_path), tmp_path)
    frame = pd.read_csv(
        tmp_path / "roc1.sample.csv",
        parse_dates=["log_time", "device_time", "previous_read_at"],
        date_format="ISO8601",
    )
    assert list(frame["seq"]) == [1, 2, 3]
    assert list(frame["count_1"]) == [0.1, 1e300, float("inf")]
    assert list(frame["temperature"].isna()) == [True, False, False]
    assert frame["laser_low"].dtype == bool
    assert frame["log_time"].iloc[2].value == T0 + 3 * SECOND + 120_000_000
    assert frame["device_time"].isna().sum() == 2
    assert frame["alarms"].iloc[2] == 2**32 - 1


def test_ndjson(tmp_path: Path) -> None:
    export(recording(tmp_path), tmp_path, form="ndjson")
    text = (tmp_path / "roc1.sample.ndjson").read_text()
    lines = [json.loads(line) for line in text.splitlines()]
    assert [line["schema"] for line in lines] == ["roclog.record/1"] * 3
    assert lines[0]["values"]["temperature"] is None
    assert lines[2]["values"]["count_1"] is None
    assert lines[0]["doubtful"] == ["count_1", "temperature"]
    assert lines[0]["raw"] == "0001000700fa"
    assert (lines[0]["device_time"], lines[0]["log_time"]) == (None, T0 + SECOND)


def test_nothing_is_overwritten_unless_asked(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "roc1.sample.csv").write_text("precious")
    with pytest.raises(TargetExistsError, match=r"roc1\.sample\.csv exists"):
        export(recording(tmp_path), out)
    assert [path.name for path in out.iterdir()] == ["roc1.sample.csv"]
    assert (out / "roc1.sample.csv").read_text() == "precious"
    export(recording(tmp_path), out, force=True)
    assert len(rows(out / "roc1.sample.csv")) == 3


def test_a_failure_leaves_no_file_behind(tmp_path: Path) -> None:
    def fail(_done: int, _total: int) -> None:
        raise OSError(28, "No space left on device")

    with pytest.raises(StorageError, match="No space left"):
        export(recording(tmp_path), tmp_path / "out", progress=fail)
    assert list((tmp_path / "out").iterdir()) == []
    (tmp_path / "file").touch()
    with pytest.raises(StorageError, match="file"):
        export(recording(tmp_path), tmp_path / "file" / "out")


def test_slices_and_choice_of_channels(tmp_path: Path) -> None:
    written = export(
        recording(tmp_path), tmp_path / "out", channels=["/roc1/[sg]*"], end=T0 + 3 * SECOND
    )
    assert [(file.path.name, file.records) for file in written] == [
        ("roc1.gap.csv", 0),
        ("roc1.sample.csv", 2),
    ]
    with pytest.raises(ValueError, match="no channel"):
        export(recording(tmp_path), tmp_path / "other", channels=["/nothing"])
    assert not (tmp_path / "other").exists()


def test_names_out_of_files_lead_nowhere_else(tmp_path: Path) -> None:
    evil = {"device": "../../etc", "block": "pass\0wd/.."}
    same = {"device": "/./ETC", "block": "pass wd.."}
    topics = [files.Topic("/a", files.SAMPLE, evil), files.Topic("/b", files.SAMPLE, same)]
    path = files.write_sealed(tmp_path / "r.mcap", [files.sample(1, "/a")], topics=topics)
    out = tmp_path / "x" / "y" / "out"
    written = export(open_recording(path), out)
    assert [file.path.parent for file in written] == [out, out]
    assert [file.path.name for file in written] == ["_etc.pass_wd_.csv", "_ETC.pass_wd_-2.csv"]


def test_progress_ends_where_it_should(tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    export(
        recording(tmp_path),
        tmp_path / "out",
        progress=lambda done, total: told.append((done, total)),
    )
    assert told[-1][0] == told[-1][1] == (tmp_path / "r.mcap").stat().st_size
