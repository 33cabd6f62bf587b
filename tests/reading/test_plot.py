"""The figure is drawn without a display, without state and without warnings."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import mcapfiles as files
import pytest
from click.testing import CliRunner
from mcapfiles import SECOND, T0

from roclog.cli.plot import plot
from roclog.plot import _gather, _with_gaps, plot_samples
from roclog.recording.reader import open_recording

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
