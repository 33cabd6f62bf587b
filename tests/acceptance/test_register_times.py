"""The device's own time of a sample, from every time source a register map can name."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any

from bench.recorder import Recorder
from bench.recording import read_csv
from bench.registers import HOLDING, OCTETS, Block, Cell, Device
from bench.registers_judge import Judge, check_requests

if TYPE_CHECKING:
    from pathlib import Path

BERLIN = 'poll = "50ms"\ntimezone = "Europe/Berlin"'
NUMBER = Cell("number", "u16", (), 'type = "uint16"', counts=(1, 65535, 1))
U32 = OCTETS["CDAB"][4]


def ns(text: str) -> int:
    """Of an instant with milliseconds; never through a float."""
    moment = datetime.fromisoformat(text)
    whole = int(moment.replace(microsecond=0).timestamp())
    return whole * 10**9 + moment.microsecond * 1000


SUMMER, WINTER = ns("2024-07-01T12:30:15.250+02:00"), ns("2024-01-15T23:59:59.999+01:00")
SHOWN = ([2024, 7, 1, 12, 30, 15250, 1], [2024, 1, 15, 23, 59, 59999, 0])
"""What the device's clock in Berlin shows: minute, then milliseconds of it, then summer time."""
BAD = [2024, 13, 1, 12, 30, 0, 0]


def stamped(name: str, at: int, source: str, cells: tuple[Cell, ...], times: Any) -> Block:
    toml = f'trigger = {{ counter = "number", first = 1 }}\ntime = {{ {source} }}'
    group = {"every": 0.2, "at_once": True}
    return Block(name, HOLDING, at, (NUMBER, *cells), toml, group, tuple(times))


def words(*names: str, values: tuple[tuple[Any, ...], ...], kind: str = "u16") -> tuple[Cell, ...]:
    """A word of the calendar each, or two octets."""
    columns = zip(*values, strict=True)
    pairs = zip(names, columns, strict=True)
    return tuple(Cell(n, "pair" if isinstance(c[0], list) else kind, c) for n, c in pairs)


def blocks() -> tuple[Block, ...]:
    seconds = SUMMER // 10**9, 0, 1, 4294967295
    spoken = SUMMER // 10**9 * 10**9, 0, 10**9, 4294967295 * 10**9
    since_2000 = tuple(s - 946684800 if s > 946684800 else 0 for s in seconds[:2])
    micros = 250000, 999999, 0, 1000000
    both = SUMMER // 10**9 * 10**9 + 250_000_000, 10**9 + 999_999_000, 0, 0
    whole = SUMMER // 10**9 * 10**9, WINTER // 10**9 * 10**9, 0, 0
    stamps = (*SHOWN, None, BAD)
    exact = SUMMER, WINTER, 0, 0
    return (
        stamped("unix", 0, 'source = "unix", offset = 1, word_order = "CDAB"',
                (Cell("stamp", "u32", seconds, order=U32),), spoken),
        stamped("epoch", 10, 'source = "unix", offset = 1, epoch = 946684800',
                (Cell("stamp", "u32", since_2000, order="1234"),), spoken[:2]),
        stamped("micros", 20, 'source = "unix_us", microseconds = 1, seconds = 3, '
                'word_order = "DCBA"',
                (Cell("us", "u32", micros, order="4321"),
                 Cell("s", "u32", (seconds[0], 1, 0, 5), order="4321")), both),
        stamped("cp56", 30, 'source = "cp56", offset = 1', (Cell("t", "cp56", stamps),), exact),
        stamped("cp56_low", 40, 'source = "cp56", offset = 1, word_order = "BADC"',
                (Cell("t", "cp56", stamps, order="21"),), exact),
        stamped("cp56_last", 50, 'source = "cp56", offset = 1, word_order = "DCBA"',
                (Cell("t", "cp56", stamps, order="87654321"),), exact),
        stamped("split", 60, 'source = "calendar", year = 1, month_day = 2, hour = 3, '
                'minute_second = 4',
                words("y", "md", "h", "ms", values=(
                    (2024, [7, 1], 12, [30, 15]), (2024, [1, 15], 23, [59, 59]),
                    (0, [0, 0], 0, [0, 0]), (2024, [2, 30], 1, [0, 0]))), whole),
        stamped("each", 70, 'source = "calendar", second = 1, minute = 2, hour = 3, day = 4, '
                'month = 5, year = 6, millisecond = 7, year_base = 2000',
                words("s", "mi", "h", "d", "mo", "y", "ms", values=(
                    (15, 30, 12, 1, 7, 24, 250), (59, 59, 23, 15, 1, 24, 999),
                    (0, 0, 0, 0, 0, 0, 0), (60, 0, 0, 1, 1, 24, 0))), exact),
        stamped("of_minute", 80, 'source = "calendar", millisecond_of_minute = 1, hour_minute = 2, '
                'month_day = 3, year = 4',
                words("ms", "hm", "md", "y", values=(
                    (15250, [12, 30], [7, 1], 2024), (59999, [23, 59], [1, 15], 2024),
                    (0, [0, 0], [0, 0], 0), (60000, [1, 1], [1, 1], 2024))), exact),
        stamped("by_month", 90, 'source = "calendar", year_month = 1, day_hour = 2, '
                'minute_second = 3, millisecond = 4, year_base = 2000',
                words("ym", "dh", "ms", "mm", values=(
                    ([24, 7], [1, 12], [30, 15], 250), ([24, 1], [15, 23], [59, 59], 999),
                    ([0, 0], [0, 0], [0, 0], 0), ([24, 1], [1, 24], [0, 0], 0))), exact),
    )  # fmt: skip


def judged(folder: Path, device: Device, toml: str, samples: int = 6) -> Judge:
    recorder = Recorder(folder, device.toml(toml))
    with recorder.start() as child:
        names = [block.name for block in device.blocks]
        child.while_it_runs(lambda: min(map(device.read, names)) > samples, "the samples", 30)
        assert child.stop() == 0, child.talk()
    assert check_requests(device.end(), device.blocks) == []
    judge = Judge(recorder.directory, folder / "csv", device)
    for block in device.blocks:
        found = judge.block(block)
        assert found.wrong == [], block.name
        assert found.samples[:samples] == list(range(1, samples + 1)), block.name
    return judge


def flags(folder: Path, device: str, block: str) -> list[str]:
    rows = read_csv(folder / f"csv/{device}.{block}.csv")
    return [row["time_flags"] for row in rows[:4]]


def test_every_time_source(tmp_path: Path) -> None:
    with Device(tmp_path, *blocks()) as device:
        judged(tmp_path, device, BERLIN)
    for name in ("cp56", "cp56_low", "cp56_last"):
        assert flags(tmp_path, "dev", name) == ["su", "", "no_time", "date_invalid"], name
    for name in ("split", "each", "of_minute", "by_month"):
        assert flags(tmp_path, "dev", name) == ["", "", "no_time", "date_invalid"], name
    assert flags(tmp_path, "dev", "unix") == ["", "no_time", "", ""]
    assert flags(tmp_path, "dev", "micros") == ["", "", "no_time", "date_invalid"]


def test_a_stamp_without_a_date_gets_the_one_of_the_host(tmp_path: Path) -> None:
    """An hour ago, to the millisecond, by a clock that runs on UTC.

    Of the first stamp nobody knows since when it stands there, and so not on which day it was made.
    """
    ago = datetime.now(UTC).replace(microsecond=0) - timedelta(hours=1)
    moments = [ago + timedelta(milliseconds=1001 * n) for n in range(5)]
    shown = tuple(
        [m.year, m.month, m.day, m.hour, m.minute, m.second * 1000 + m.microsecond // 1000, 0]
        for m in moments
    )
    times = (0, *(ns(moment.isoformat()) for moment in moments[1:]))
    cells = (Cell("t", "cp32", shown, order="21"),)
    block = stamped("short", 0, 'source = "cp32", offset = 1, word_order = "BADC"', cells, times)
    block = replace(block, group={**block.group, "samples": 5})
    with Device(tmp_path, block) as device:
        judged(tmp_path, device, 'poll = "50ms"', 4)
    assert flags(tmp_path, "dev", "short") == ["date_unknown", *["date_inferred"] * 3]
