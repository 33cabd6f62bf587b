"""A figure of a recording: what a person wants to see first. Needs the extra ``plot``."""

from __future__ import annotations

import re
from array import array
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from roclog.recording.reader import Recording
from roclog.recording.records import Gap, Sample

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from roclog.recording.records import Channel, Record

_NUMBERED: Final = re.compile(r"(.+)_(\d+)")
_COLOURS: Final = ("#1d3557", "#2a7f9e", "#e9a23b", "#c8553d", "#6b8e4e", "#7d5ba6")
_GAP: Final = "#d1495b"
_INK: Final = "#33393f"
_UNITS: Final = {"Cel": "°C", "1/mL": "particles per mL", "[ppm]": "ppm", "s": "s"}
_NAMES: Final = {"iso_code": "ISO 4406 code", "count": "count"}
_MOST_PANELS: Final = 12
_MARKERS_BELOW: Final = 120
_DECADES: Final = 30.0
"""Values whose greatest is so many times their least get a logarithmic axis."""


@dataclass
class Panel:
    """Lines that share an axis. key: (name of the quantity, unit)."""

    device: str
    key: tuple[str, str]
    lines: dict[str, array[float]] = field(default_factory=dict)
    times: array[int] = field(default_factory=lambda: array("q"))

    @property
    def label(self) -> str:
        name, unit = self.key
        text = _NAMES.get(name, name.replace("_", " "))
        shown = _UNITS.get(unit, unit)
        return f"{text}\n({shown})" if shown else text

    @property
    def is_logarithmic(self) -> bool:
        """Counts of particles span decades; everything else is drawn as it is."""
        if self.key[1] != "1/mL":
            return False
        positive = [value for values in self.lines.values() for value in values if value > 0]
        return bool(positive) and max(positive) / min(positive) > _DECADES


def plot_samples(source: Recording | Iterable[Record], path: Path | str) -> Path:
    """Draw numbers over time, a panel for each device and quantity, as a PNG.

    Of a recording: ISO codes and counts of devices with a flag, then whatever has a unit; gaps are
    shaded. Samples on their own have no units; then numbered points make the panels.

    Raises:
        ValueError: there is nothing to draw.
        ImportError: matplotlib is not installed; ``pip install 'roclog[plot]'``.
    """
    channels: Mapping[str, Channel] = {}
    records = source
    if isinstance(source, Recording):
        channels = source.channels
        records = source.records(kinds=("sample", "gap"))
    panels, gaps = _gather(records, channels)
    if not panels:
        raise ValueError("no samples with numbers that could be drawn")
    _draw(panels, gaps, _title(panels, source), Path(path))
    return Path(path)


def _gather(
    records: Iterable[Record], channels: Mapping[str, Channel]
) -> tuple[list[Panel], list[Gap]]:
    panels: dict[tuple[str, tuple[str, str]], Panel] = {}
    plans: dict[str, dict[str, tuple[str, str]]] = {}
    gaps: list[Gap] = []
    for record in records:
        if isinstance(record, Gap):
            gaps.append(record)
        if not isinstance(record, Sample):
            continue
        if record.topic not in plans:
            plans[record.topic] = _plan(record, channels.get(record.topic))
        touched: dict[int, Panel] = {}
        for name, key in plans[record.topic].items():
            panel = panels.setdefault((record.device, key), Panel(record.device, key))
            missing = array("d", [float("nan")]) * len(panel.times)
            value = record.values.get(name)
            if id(panel) not in touched:
                touched[id(panel)] = panel
                panel.times.append(record.log_time)
                for values in panel.lines.values():
                    values.append(float("nan"))
            line = panel.lines.setdefault(name, missing + array("d", [float("nan")]))
            line[-1] = float(value) if isinstance(value, int | float) else float("nan")
    drawn = sorted(panels.values(), key=lambda panel: (panel.device, *_rank(panel)))
    return drawn[:_MOST_PANELS], gaps


def _plan(sample: Sample, channel: Channel | None) -> dict[str, tuple[str, str]]:
    """Which values go to which panel: ISO codes, and what has a unit (or a number, without units)."""
    units: Mapping[str, str] = channel.units if channel is not None else {}
    plan: dict[str, tuple[str, str]] = {}
    for name, value in sample.values.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            continue
        match = _NUMBERED.fullmatch(name)
        unit = units.get(name, "")
        if unit == "s" or (not unit and units and not name.startswith("iso_code")):
            continue
        if unit or match or not units:
            plan[name] = (match[1] if match else name, unit)
    return plan


def _rank(panel: Panel) -> tuple[int, int, str]:
    order = {"iso_code": 0, "count": 1}
    return order.get(panel.key[0], 2), -len(panel.lines), panel.key[0]


def _title(panels: list[Panel], source: object) -> str:
    """The device with its serial number, where there is one device only."""
    names = sorted({panel.device for panel in panels})
    if len(names) != 1 or not isinstance(source, Recording):
        return ", ".join(names)
    device = source.devices.get(names[0])
    if device is None:
        return names[0]
    identity = [str(device.identity.get(k, "")) for k in ("manufacturer", "model", "serial_number")]
    return "  ·  ".join(
        part for part in (names[0], device.profile, " ".join(identity).strip()) if part
    )


def _draw(panels: list[Panel], gaps: list[Gap], title: str, path: Path) -> None:
    from matplotlib import rc_context  # noqa: PLC0415
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415
    from matplotlib.figure import Figure  # noqa: PLC0415

    style = {
        "font.size": 10,
        "axes.edgecolor": "#b8bec4",
        "axes.labelcolor": _INK,
        "xtick.color": _INK,
        "ytick.color": _INK,
        "text.color": _INK,
        "path.simplify": True,
    }
    with rc_context(style):
        heights = [1.3 if len(panel.lines) > 1 else 0.8 for panel in panels]
        figure = Figure(figsize=(11, 1.4 + 2.3 * sum(heights)), dpi=130, layout="constrained")
        FigureCanvasAgg(figure)
        grid: Any = figure.subplots(
            len(panels), 1, sharex=True, squeeze=False, gridspec_kw={"height_ratios": heights}
        )
        axes = list(grid[:, 0])
        several = len({panel.device for panel in panels}) > 1
        for axis, panel in zip(axes, panels, strict=True):
            _draw_panel(axis, panel, [gap for gap in gaps if gap.device == panel.device])
            if several:
                axis.set_title(panel.device, loc="left", fontsize=10, fontweight="bold")
        _draw_time(axes[-1], panels)
        figure.suptitle(title, x=0.01, ha="left", fontsize=13, fontweight="bold")
        figure.savefig(path, format="png")


def _draw_panel(axis: Any, panel: Panel, gaps: list[Gap]) -> None:
    from numpy import datetime64  # noqa: PLC0415
    from numpy import array as numbers  # noqa: PLC0415

    times = numbers(panel.times, dtype="datetime64[ns]")
    breaks = _breaks(panel.times, gaps)
    for number, (name, values) in enumerate(panel.lines.items()):
        shown = numbers(values, dtype="float64")
        if panel.is_logarithmic:
            shown[shown <= 0] = float("nan")
        for first, last in breaks:
            axis.plot(
                times[first:last],
                shown[first:last],
                color=_COLOURS[number % len(_COLOURS)],
                linewidth=1.4,
                marker="o" if len(times) < _MARKERS_BELOW or last - first == 1 else "",
                markersize=3,
                label=_line_label(panel, name) if first == 0 else None,
            )
    for number, gap in enumerate(gaps):
        axis.axvspan(
            datetime64(gap.start, "ns"),
            datetime64(max(gap.end, gap.start + 1), "ns"),
            facecolor=_GAP,
            alpha=0.16,
            edgecolor=_GAP,
            linewidth=0.8,
            label="gap: samples missing" if number == 0 else None,
        )
    if panel.is_logarithmic:
        axis.set_yscale("log")
    axis.set_ylabel(panel.label)
    axis.grid(visible=True, which="major", color="#e3e7ea", linewidth=0.8)
    axis.set_axisbelow(True)
    axis.spines[["top", "right"]].set_visible(False)
    if len(panel.lines) > 1 or gaps:
        axis.legend(loc="upper left", bbox_to_anchor=(1.005, 1), frameon=False, borderaxespad=0)


def _breaks(times: array[int], gaps: list[Gap]) -> list[tuple[int, int]]:
    """Ranges of samples between which no line is drawn, because a gap ends between them."""
    from bisect import bisect_left  # noqa: PLC0415

    cuts = sorted({bisect_left(times, gap.end) for gap in gaps})
    edges = [0, *(cut for cut in cuts if 0 < cut < len(times)), len(times)]
    return list(zip(edges, edges[1:], strict=False))


def _line_label(panel: Panel, name: str) -> str:
    match = _NUMBERED.fullmatch(name)
    return f"channel {match[2]}" if match and len(panel.lines) > 1 else name.replace("_", " ")


def _draw_time(axis: Any, panels: list[Panel]) -> None:
    from matplotlib.dates import AutoDateLocator, ConciseDateFormatter  # noqa: PLC0415

    locator = AutoDateLocator(minticks=5, maxticks=10)
    axis.xaxis.set_major_locator(locator)
    axis.xaxis.set_major_formatter(ConciseDateFormatter(locator))
    axis.set_xlabel("time (UTC)")
    if max(len(panel.times) for panel in panels) > 1:
        axis.margins(x=0.01)
