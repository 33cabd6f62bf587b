"""The figure is drawn without a display, without state and without warnings."""

from __future__ import annotations

import dataclasses
import sys
from typing import TYPE_CHECKING

import mcapfiles as files
import pytest
from click.testing import CliRunner
from mcapfiles import SECOND, T0

from roclog.cli.plot import plot
from roclog.plot import _columns, _gaps_of, _gather, _with_gaps, plot_samples
from roclog.recording.reader import open_recording
from roclog.recording.records import Channel, Sample

if TYPE_CHECKING:
    from pathlib import Path

ITEMS = [
    *(files.sample(seq, count_1=10.0**seq, iso_code_1=float(seq)) for seq in range(1, 5)),
    files.gap(T0 + 5 * SECOND, T0 + 2 * SECOND, T0 + 3 * SECOND),
]


def test_a_recording_becomes_a_png(tmp_path: Path) -> None:
    recording = open_recording(files.write_sealed(tmp_path / "a.mcap", ITEMS))
    path = plot_samples(recording, tmp_path / "a.png")
    octets = path.read_bytes()
    assert octets.startswith(b"\x89PNG")
    assert int.from_bytes(octets[16:20]) > 1000
    assert "matplotlib.pyplot" not in sys.modules


def test_panels_by_unit_and_name_iso_codes_first(tmp_path: Path) -> None:
    recording = open_recording(files.write_sealed(tmp_path / "a.mcap", ITEMS))
    panels, gaps = _gather(recording.records(), recording.channels)
    assert [panel.key for panel in panels] == [
        ("iso_code", ""),
        ("count", "1/mL"),
        ("temperature", "Cel"),
    ]
    assert list(panels[1].lines) == ["count_1", "count_2"]
    assert list(panels[1].lines["count_1"]) == [10.0, 100.0, 1000.0, 10000.0]
    assert [len(panel.times) for panel in panels] == [4, 4, 4]
    assert (panels[1].is_logarithmic, panels[0].is_logarithmic) == (True, False)
    assert len(gaps) == 1


def test_gaps_are_shaded_where_the_block_is_theirs_or_the_whole_device(tmp_path: Path) -> None:
    names = ("sample", "other", "")
    gaps = [files.gap_of_block(T0 + 9 * SECOND, T0, T0 + SECOND, name) for name in names]
    path = files.write_sealed(tmp_path / "a.mcap", [*ITEMS[:4], *gaps], topics=files.WITH_BLOCKS)
    recording = open_recording(path)
    panels, found = _gather(recording.records(), recording.channels)
    assert [[gap.block for gap in _gaps_of(panel, found)] for panel in panels] == [
        ["sample", ""]
    ] * 3
    elsewhere = dataclasses.replace(panels[0], device="roc2")
    assert _gaps_of(elsewhere, found) == []


def test_samples_on_their_own(tmp_path: Path) -> None:
    recording = open_recording(files.write_sealed(tmp_path / "a.mcap", ITEMS))
    assert plot_samples(recording.samples(), tmp_path / "b.png").stat().st_size > 10_000


def test_nothing_to_draw(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no samples"):
        plot_samples([], tmp_path / "a.png")


def test_one_channel_with_the_gaps_of_its_device(tmp_path: Path) -> None:
    recording = open_recording(files.write_sealed(tmp_path / "a.mcap", ITEMS))
    assert sorted(_with_gaps(recording, "/roc1/s*") or ()) == ["/roc1/gap", "/roc1/sample"]
    with pytest.raises(ValueError, match="no channel"):
        plot_samples(recording, tmp_path / "a.png", channel="/roc9/*")


def test_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = files.write_sealed(tmp_path / "a.mcap", ITEMS)
    picture = tmp_path / "a.png"
    command = [str(source), "--out", str(picture)]
    done = CliRunner().invoke(plot, command)
    assert (done.exit_code, done.stdout) == (0, f"{picture}\n")
    assert picture.read_bytes().startswith(b"\x89PNG")
    done = CliRunner().invoke(plot, command)
    assert done.exit_code == 2
    assert "exists; --force replaces it" in done.stderr
    assert CliRunner().invoke(plot, [*command, "--force"]).exit_code == 0
    early = [*command, "--force", "--to", "2001-01-01"]
    assert "no samples with numbers" in CliRunner().invoke(plot, early).stderr
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    done = CliRunner().invoke(plot, [*command, "--force"])
    assert done.exit_code == 2
    assert "pip install 'roclog[plot]' brings it" in done.stderr


def channel(device: str, block: str, units: dict[str, str]) -> Channel:
    return Channel(
        topic=f"/{device}/{block}",
        device=device,
        block=block,
        profile="registers",
        kind="sample",
        fields=(),
        units=units,
        flagged=False,
        schema="a",
    )


def read(device: str, block: str, **values: object) -> Sample:
    topic = f"/{device}/{block}"
    return Sample(
        topic=topic, device=device, block=block, log_time=T0, publish_time=T0, seq=1, values=values
    )


def gathered(units: dict[str, str], **values: float) -> list[tuple[str, str]]:
    channels = {"/a/b": channel("a", "b", units)}
    return [panel.key for panel in _gather([read("a", "b", **values)], channels)[0]]


def test_what_has_a_unit_comes_before_what_has_none() -> None:
    assert gathered({"flow": "L/min"}, flow=1.0, state=2) == [("flow", "L/min")]
    # A code like 19.2 has no unit; in a map of a user it stands beside what has one.
    assert gathered({"oil": "Cel"}, oil=40.1, iso_4=19.2, state=2) == [("iso", ""), ("oil", "Cel")]
    assert gathered({}, flow=1.0, state=2) == [("flow", ""), ("state", "")]
    # Seconds and microseconds of a clock are no measurement.
    assert gathered({"seconds": "s", "rest": "us"}, seconds=1, rest=2, state=3) == [("state", "")]
    both = {"/a/b": channel("a", "b", {}), "/a/c": channel("a", "c", {"flow": "L/min"})}
    panels, _ = _gather([read("a", "b", state=1), read("a", "c", flow=1.0)], both)
    assert [panel.key for panel in panels] == [("flow", "L/min")]


def test_what_the_first_sample_has_not_is_drawn_from_the_others() -> None:
    first, then = read("a", "b", temperature=1.0), read("a", "b", temperature=2.0, flow=3.0)
    first.values["flow"] = None
    first.values["key"] = then.values["key"] = None
    channels = {"/a/b": channel("a", "b", {"temperature": "Cel", "flow": "L/min", "key": "1"})}
    panels, _ = _gather([first, then], channels)
    assert [panel.key[0] for panel in panels] == ["flow", "temperature"]
    assert str(list(panels[0].lines["flow"])) == "[nan, 3.0]"


def test_what_comes_up_later_is_drawn_from_then_on() -> None:
    """A channel that got another sensor, a message type that got another field."""
    samples = [read("a", "b", orp=1.0), read("a", "b", ph=7.0, count_1=2.0)]
    samples += [read("a", "b", ph=7.5, count_1=3.0, count_2=4.0)]
    channels = {"/a/b": channel("a", "b", {"orp": "mV", "ph": "[pH]", "count_1": "1/mL"})}
    channels["/a/b"].units["count_2"] = "1/mL"  # type: ignore[index]
    panels, _ = _gather(samples, channels)
    found = {panel.key[0]: {n: str(list(v)) for n, v in panel.lines.items()} for panel in panels}
    assert found == {
        "count": {"count_1": "[2.0, 3.0]", "count_2": "[nan, 4.0]"},
        "orp": {"orp": "[1.0, nan, nan]"},
        "ph": {"ph": "[7.0, 7.5]"},
    }


def test_a_decimal_without_unit_that_was_missing_at_first() -> None:
    first = read("a", "b", oil=40.0)
    first.values["iso_4"] = None
    channels = {"/a/b": channel("a", "b", {"oil": "Cel"})}
    panels, _ = _gather([first, read("a", "b", oil=41.0, iso_4=19.2)], channels)
    assert [panel.key[0] for panel in panels] == ["iso", "oil"]


def test_panels_of_one_quantity_say_of_which_block_they_are() -> None:
    units = {"dissolved_oxygen": "[ppm]", "orp": "mV"}
    channels = {f"/a/channel_{n}": channel("a", f"channel_{n}", units) for n in (1, 2)}
    samples = [read("a", f"channel_{n}", dissolved_oxygen=8.0) for n in (2, 1)]
    panels, _ = _gather([*samples, read("a", "channel_2", orp=1.0)], channels)
    assert [panel.label for panel in panels] == [
        "channel 1\ndissolved oxygen\n(ppm)",
        "channel 2\ndissolved oxygen\n(ppm)",
        "orp\n(mV)",
    ]
    panels, _ = _gather(samples[:1], channels)
    assert panels[0].label == "dissolved oxygen\n(ppm)"


def test_a_column_for_each_device_those_alike_side_by_side() -> None:
    units = {"/a/b": "bar", "/m/b": "V", "/z/b": "bar"}
    channels = {topic: channel(topic[1], "b", {"x": unit}) for topic, unit in units.items()}
    panels, _ = _gather([read(topic[1], "b", x=1.0) for topic in units], channels)
    assert [[panel.device for panel in column] for column in _columns(panels)] == [
        ["a"],
        ["m"],
        ["z"],
    ]
    many = {f"/{name}/b": channel(name, "b", {"x": "bar"}) for name in "abcde"}
    panels, _ = _gather([read(name, "b", x=1.0) for name in "abcde"], many)
    assert [len(column) for column in _columns(panels)] == [5]


def test_the_title_says_what_was_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    titles = []
    monkeypatch.setattr("roclog.plot._draw", lambda *found: titles.append(found[2]))
    values = {f"x{chr(97 + n)}": 1.0 for n in range(15)}
    plot_samples([read("a", "b", **values)], tmp_path / "a.png")
    assert titles == ["a  ·  12 of 15 quantities"]
