"""A figure of a recording: what a person wants to see first. Needs the extra ``plot``."""

from __future__ import annotations

import re
from array import array
from bisect import bisect_left
from collections import Counter
from dataclasses import dataclass, field
from glob import escape
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeGuard

from roclog.recording.reader import Recording
from roclog.recording.records import Gap, Sample

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from roclog.recording.reader import Instant, Patterns
    from roclog.recording.records import Channel, Record

_NUMBERED: Final = re.compile(r"(.+)_(\d+)")
_COLOURS: Final = ("#1d3557", "#2a7f9e", "#e9a23b", "#c8553d", "#6b8e4e", "#7d5ba6")
_GAP: Final = "#d1495b"
_GAPS: Final = {False: "gap: samples missing", True: "perhaps missing"}
_INK: Final = "#33393f"
_UNITS: Final = {
    "Cel": "°C",
    "1/mL": "particles per mL",
    "[ppm]": "ppm",
    "[pH]": "",
    "s": "s",
    "1": "",
}
_NAMES: Final = {"iso_code": "ISO 4406 code", "count": "count"}
_TIMES: Final = frozenset({"s", "us", "ms", "min", "h"})
_MOST_PANELS: Final = 12
_MOST_COLUMNS: Final = 4
_MARKERS_BELOW: Final = 120
_NAN: Final = float("nan")
_DECADES: Final = 30.0
"""Values whose greatest is so many times their least get a logarithmic axis."""


@dataclass
class Panel:
    """Lines of a block that share an axis. key: (name of the quantity, unit).

    has_twin: another block of the device has the same quantity.
    """

    device: str
    block: str
    key: tuple[str, str]
    lines: dict[str, array[float]] = field(default_factory=dict)
    times: array[int] = field(default_factory=lambda: array("q"))
    is_fraction: bool = False
    has_twin: bool = False

    @property
    def label(self) -> str:
        name, unit = self.key
        text = _NAMES.get(name, name.replace("_", " "))
        shown = _UNITS.get(unit, unit)
        lines = [self.block.replace("_", " ")] * self.has_twin + [
            text,
            *[f"({shown})"] * bool(shown),
        ]
        return "\n".join(lines)

    def add(self, time: int, values: Mapping[str, object]) -> None:
        self.times.append(time)
        for name, line in self.lines.items():
            value = values.get(name)
            line.append(float(value) if _is_number(value) else _NAN)

    def take_in(self, other: Panel) -> None:
        """Lines that came up later; before, they have no values."""
        self.is_fraction |= other.is_fraction
        for name in other.lines:
            if name not in self.lines:
                self.lines[name] = array("d", [_NAN]) * len(self.times)

    @property
    def has_numbers(self) -> bool:
        """Whether there is anything to draw; missing values are NaN."""
        return any(value == value for values in self.lines.values() for value in values)  # noqa: PLR0124

    @property
    def is_measured(self) -> bool:
        """A quantity, not a state or a number of something."""
        name, unit = self.key
        return name == "iso_code" or bool(unit) or self.is_fraction

    @property
    def is_logarithmic(self) -> bool:
        """Counts of particles span decades; everything else is drawn as it is."""
        if self.key[1] != "1/mL":
            return False
        positive = [value for values in self.lines.values() for value in values if value > 0]
        return bool(positive) and max(positive) / min(positive) > _DECADES


def plot_samples(
    source: Recording | Iterable[Record],
    path: Path | str,
    *,
    channel: Patterns = None,
    start: Instant = None,
    end: Instant = None,
) -> Path:
    """Draw numbers over time, a panel for each device and quantity, as a PNG.

    Of a recording: ISO codes and counts of devices with a flag, then whatever has a unit, and only
    where there is none of these, other numbers; gaps are shaded. Samples on their own have no
    units; then numbered points make the panels. The title says it when not all could be drawn.

    channel, start, end: as of ``Recording.samples``; of a recording only.

    Raises:
        ValueError: there is nothing to draw, or no such channel.
        ImportError: matplotlib is not installed; ``pip install 'roclog[plot]'``.
    """
    channels: Mapping[str, Channel] = {}
    records = source
    if isinstance(source, Recording):
        channels = source.channels
        topics = _with_gaps(source, channel)
        records = source.records(topics, start=start, end=end, kinds=("sample", "gap"))
    panels, gaps = _gather(records, channels)
    if not panels:
        raise ValueError("no samples with numbers that could be drawn")
    shown = panels[:_MOST_PANELS]
    title = _title(shown, source)
    if len(panels) > len(shown):
        title += f"  ·  {len(shown)} of {len(panels)} quantities"
    _draw(shown, gaps, title, Path(path))
    return Path(path)


def _with_gaps(recording: Recording, channel: Patterns) -> list[str] | None:
    """Topics of the channels and of the gaps of their devices; None = all."""
    if channel is None:
        return None
    chosen = recording.chosen_channels(channel)
    gaps = {f"/{found.device}/gap" for found in chosen.values()} & recording.channels.keys()
    return [escape(topic) for topic in (*chosen, *sorted(gaps - chosen.keys()))]


def _gather(
    records: Iterable[Record], channels: Mapping[str, Channel]
) -> tuple[list[Panel], list[Gap]]:
    panels: dict[str, dict[tuple[str, str], Panel]] = {}
    shapes: set[tuple[str, frozenset[str]]] = set()
    gaps: list[Gap] = []
    for record in records:
        if isinstance(record, Gap):
            gaps.append(record)
        elif isinstance(record, Sample):
            known = panels.setdefault(record.topic, {})
            measured = frozenset(name for name, value in record.values.items() if value is not None)
            if (record.topic, measured) not in shapes:
                shapes.add((record.topic, measured))
                for panel in _panels(record, channels.get(record.topic)):
                    known.setdefault(panel.key, panel).take_in(panel)
            for panel in known.values():
                panel.add(record.log_time, record.values)
    found = [panel for of_topic in panels.values() for panel in of_topic.values()]
    found = [panel for panel in found if panel.has_numbers]
    best = [panel for panel in found if panel.is_measured] or found
    count = Counter((panel.device, panel.key) for panel in best)
    for panel in best:
        panel.has_twin = count[panel.device, panel.key] > 1
    return sorted(best, key=lambda panel: (panel.device, *_rank(panel), panel.block)), gaps


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _panels(sample: Sample, channel: Channel | None) -> list[Panel]:
    """Empty ones: for ISO codes, what has a unit other than of time, and beside it numbers with
    decimals, which are measurements without a unit. Without units: what is numbered, or all.

    None for changes of inputs, whose numbers are those of another input from message to message,
    and for clock offsets, which are about the device and not what it measures.
    """
    is_change = sample.values.keys() >= {"address", "change", "time_octets"}
    if is_change or (channel is not None and channel.schema == "roclog.ClockOffset"):
        return []
    given: Mapping[str, str] = channel.units if channel is not None else {}
    units = {name: unit for name, unit in given.items() if unit not in _TIMES}
    panels: dict[tuple[str, str], Panel] = {}
    for name, value in sample.values.items():
        unit = units.get(name, "")
        can_be_drawn = value is None or _is_number(value)  # None: not measured this time
        is_time = name in given and not unit
        is_fraction = isinstance(value, float) and bool(units) and not is_time
        wanted = unit or name.startswith("iso_code") or is_fraction or not (units or is_time)
        if can_be_drawn and wanted:
            match = _NUMBERED.fullmatch(name)
            key = (match[1] if match else name, unit)
            panel = panels.setdefault(
                key, Panel(sample.device, sample.block, key, is_fraction=is_fraction)
            )
            panel.lines[name] = array("d")
    series = [panel for panel in panels.values() if len(panel.lines) > 1]
    return series if series and not units else list(panels.values())


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
    identity = (device.identity.get(key) for key in ("manufacturer", "model", "serial_number"))
    known = " ".join(str(text) for text in identity if text)
    return "  ·  ".join(part for part in (names[0], device.profile, known) if part)


def _draw(panels: list[Panel], gaps: list[Gap], title: str, path: Path) -> None:
    from matplotlib import rc_context  # noqa: PLC0415
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415
    from matplotlib.figure import Figure  # noqa: PLC0415

    style: Any = {
        "font.size": 10,
        "axes.edgecolor": "#b8bec4",
        "axes.labelcolor": _INK,
        "xtick.color": _INK,
        "ytick.color": _INK,
        "text.color": _INK,
        "path.simplify": True,
    }
    columns = _columns(panels)
    alike = len({tuple(panel.key for panel in column) for column in columns}) == 1
    several = len({panel.device for panel in panels}) > 1
    deepest = max(columns, key=len)
    heights = [1.3 if len(panel.lines) > 1 else 0.8 for panel in deepest]
    size = (3.5 + 7.5 * min(len(columns), 2.2), 1.4 + 2.3 * sum(heights))
    with rc_context(style):
        figure = Figure(figsize=size, dpi=130, layout="constrained")
        FigureCanvasAgg(figure)
        grid: Any = figure.subplots(
            len(deepest),
            len(columns),
            sharex=True,
            sharey="row" if len(columns) > 1 and alike else False,
            squeeze=False,
            gridspec_kw={"height_ratios": heights},
        )
        explained: set[bool] = set()
        # From the right, where a legend takes no room between columns.
        for column, axes, beside in [*zip(columns, grid.T, [*columns[1:], []], strict=True)][::-1]:
            for row, (panel, axis) in enumerate(zip(column, axes, strict=False)):
                explains = _draw_panel(axis, panel, _gaps_of(panel, gaps), explained)
                is_repeated = row < len(beside) and beside[row].key == panel.key
                if is_repeated and not explains and axis.get_legend() is not None:
                    axis.get_legend().remove()
                if several and len(columns) == 1:
                    axis.set_title(panel.device, loc="left", fontsize=10, fontweight="bold")
            for axis in axes[len(column) :]:
                axis.set_axis_off()
            _draw_time(axes[len(column) - 1], column)
            if len(columns) > 1:
                axes[0].set_title(column[0].device, loc="left", fontsize=10, fontweight="bold")
        figure.suptitle(title, x=0.01, ha="left", fontsize=13, fontweight="bold")
        figure.savefig(path, format="png")


def _columns(panels: list[Panel]) -> list[list[Panel]]:
    """A column for each device while these are few, else all in one. Those alike side by side."""
    devices: dict[str, list[Panel]] = {}
    for panel in panels:
        devices.setdefault(panel.device, []).append(panel)
    if len(devices) > _MOST_COLUMNS:
        return [panels]
    return sorted(devices.values(), key=lambda column: [_rank(panel) for panel in column])


def _gaps_of(panel: Panel, gaps: list[Gap]) -> list[Gap]:
    """Of its block, and of its whole device."""
    return [g for g in gaps if g.device == panel.device and g.block in {"", panel.block}]


def _draw_panel(axis: Any, panel: Panel, gaps: list[Gap], explained: set[bool]) -> bool:
    """Whether its legend explains a shading that none before has explained.

    explained: the shadings that were; added to.
    """
    import numpy as np  # noqa: PLC0415
    from matplotlib.ticker import FuncFormatter  # noqa: PLC0415

    times = np.array(panel.times, dtype="datetime64[ns]")
    breaks = _breaks(panel.times, gaps)
    for number, (name, values) in enumerate(panel.lines.items()):
        shown = np.array(values, dtype="float64")
        if panel.is_logarithmic:
            shown[shown <= 0] = _NAN
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
    is_news = any(gap.possible not in explained for gap in gaps)
    for gap in gaps:
        axis.axvspan(
            np.datetime64(gap.start, "ns"),
            np.datetime64(max(gap.end, gap.start + 1), "ns"),
            facecolor=(_GAP, 0.05 if gap.possible else 0.16),
            edgecolor=(_GAP, 0.45),
            linewidth=0.9,
            linestyle=":" if gap.possible else "-",
            zorder=0.9,
            label=None if gap.possible in explained else _GAPS[gap.possible],
        )
        explained.add(gap.possible)
    if panel.is_logarithmic:
        axis.set_yscale("log")
        axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.10g}"))
    axis.set_ylabel(panel.label)
    axis.grid(visible=True, which="major", color="#e3e7ea", linewidth=0.8)
    axis.set_axisbelow(True)
    axis.spines[["top", "right"]].set_visible(False)
    if len(panel.lines) > 1 or is_news:
        axis.legend(loc="upper left", bbox_to_anchor=(1.005, 1), frameon=False, borderaxespad=0)
    return is_news


def _breaks(times: array[int], gaps: list[Gap]) -> list[tuple[int, int]]:
    """Ranges of samples between which no line is drawn, because a gap ends between them."""
    cuts = sorted({bisect_left(times, gap.end) for gap in gaps})
    edges = [0, *(cut for cut in cuts if 0 < cut < len(times)), len(times)]
    return list(pairwise(edges))


def _line_label(panel: Panel, name: str) -> str:
    match = _NUMBERED.fullmatch(name)
    if match and len(panel.lines) > 1 and match[1] in _NAMES:
        return f"channel {match[2]}"
    return name.replace("_", " ")


def _draw_time(axis: Any, panels: list[Panel]) -> None:
    from matplotlib.dates import AutoDateLocator, ConciseDateFormatter  # noqa: PLC0415

    make_locator: Any = AutoDateLocator
    make_formatter: Any = ConciseDateFormatter
    locator = make_locator(minticks=5, maxticks=10)
    axis.xaxis.set_major_locator(locator)
    axis.xaxis.set_major_formatter(make_formatter(locator))
    axis.set_xlabel("time (UTC)", loc="left")  # the date is on the right
    if max(len(panel.times) for panel in panels) > 1:
        axis.margins(x=0.01)
