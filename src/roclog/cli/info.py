"""``roclog info``."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from roclog.cli import output

if TYPE_CHECKING:
    from roclog.info import Info
    from roclog.recording.records import Device, Offset

_SEGMENT: tuple[str, ...] = ("number", "state", "size", "records", "first", "last", "file")
_CHANNEL: tuple[str, ...] = ("channel", "records", "first", "last", "message type")
_ABREAST = 4
_RIGHT: tuple[str, ...] = ("number", "size", "records", "gaps", "samples", "count")


@click.command()
@output.paths_argument
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout.")
def info(paths: tuple[str, ...], *, as_json: bool) -> None:
    """Show what recordings hold: segments, channels, gaps, copies, damage, devices, events.

    PATH is a segment, a directory, or a quoted glob of them. Everything is read and checked.

    \b
    Example:
      roclog info recordings
    """
    from roclog.info import as_object, summarize  # noqa: PLC0415
    from roclog.recording.objects import to_json  # noqa: PLC0415

    found = summarize(output.open_paths(paths))
    if as_json:
        click.echo(to_json(as_object(found)))
    else:
        _print_counts(found)
        _print_devices(found)
        _print_problems(found)


def _print_counts(found: Info) -> None:
    samples = found.samples
    span = f" from {output.instant(samples.first)} to {output.instant(samples.last)}"
    segments = f"{len(found.segments)} segment{'s' * (len(found.segments) != 1)}"
    click.echo(f"{samples.count} samples in {segments}{span * bool(samples.count)}")
    rows = [
        (
            "" if segment.number is None else str(segment.number),
            segment.state,
            output.size(segment.size),
            str(extent.count),
            output.instant(extent.first),
            output.instant(extent.last),
            segment.path.name,
        )
        for segment, extent in found.segments
    ]
    output.print_table("segments", _SEGMENT, rows, _RIGHT)
    channels = [
        (
            topic,
            str(found.channels[topic].count) if topic in found.channels else "0",
            output.instant(found.channels[topic].first) if topic in found.channels else "",
            output.instant(found.channels[topic].last) if topic in found.channels else "",
            channel.problem or ", ".join(channel.schemas),
        )
        for topic, channel in sorted(found.recording.channels.items())
    ]
    output.print_table("channels", _CHANNEL, channels, _RIGHT)


def _print_devices(found: Info) -> None:
    """A column for each device, a table for each few of them."""
    devices = sorted(found.recording.devices.values(), key=lambda device: device.name)
    for first in range(0, len(devices), _ABREAST):
        shown = devices[first : first + _ABREAST]
        facts = [_facts(device) for device in shown]
        names = dict.fromkeys(name for one in facts for name in one)
        rows = [(*name, *(one.get(name, "") for one in facts)) for name in names]
        output.print_table("devices", ("", "", *(device.name for device in shown)), rows)
    rows = [
        (device, *_clock(clock), output.instant(clock.log_time))
        for device, clock in sorted(found.clocks.items())
    ]
    output.print_table("clocks", ("device", "ahead of the host by", "drift", "at"), rows)


def _clock(clock: Offset) -> tuple[str, str]:
    """Seconds, then ppm; where the drift is not known, nothing."""
    values = clock.values
    ahead = f"{values['offset']:+.3f} s, to {values['uncertainty']:.3f} s"
    drift = f"{values['drift']:+.1f} ppm, to {values['drift_uncertainty']:.1f} ppm"
    return ahead, "" if values["drift"] != values["drift"] else drift


def _facts(device: Device) -> dict[tuple[str, str], str]:
    found = {("device", k): str(getattr(device, k)) for k in ("profile", "connection", "unit")}
    found |= {("identity", name): str(value) for name, value in device.identity.items()}
    return found | {("configuration", k): str(v) for k, v in device.configuration.items()}


def _print_problems(found: Info) -> None:
    recording = found.recording
    rows = [
        (device, block, f"{reason}, perhaps" if possible else reason, str(count), str(expected))
        for (device, block, reason, possible), (count, expected) in sorted(found.gaps.items())
    ]
    output.print_table("gaps", ("device", "block", "reason", "gaps", "samples"), rows, _RIGHT)
    events = [
        (device, kind, level, str(count))
        for (device, kind, level), count in sorted(found.events.items())
    ]
    output.print_table("events", ("device", "kind", "level", "count"), events, _RIGHT)
    lines = [str(problem) for problem in recording.damage]
    lines += [
        f"samples {first} to {last} of {t} are missing" for t, _, first, last in recording.missing
    ]
    lines += [f"two samples {c.seq} of {c.topic} differ" for c in recording.conflicts]
    output.print_table("damage", ("what",), [(line,) for line in lines])
    if recording.dropped:
        copies = recording.dropped
        what = "copy of a sample" if copies == 1 else "copies of samples"
        click.echo(f"\n{copies} {what} left out")
