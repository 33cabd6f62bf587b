"""Is everything there, and is it what was written? Read-only."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from roclog.errors import DamagedFile
from roclog.quantities import format_instant
from roclog.recording.records import Gap, Sample
from roclog.recording.summary import check_sums

if TYPE_CHECKING:
    from collections.abc import Iterator

    from roclog.recording.reader import Recording
    from roclog.recording.records import Conflict

VERIFY_SCHEMA: Final = "roclog.verify/1"


@dataclass(slots=True)
class Report:
    """missing: topic, epoch, first and last seq that no gap explains and no file holds."""

    segments: int = 0
    samples: int = 0
    dropped: int = 0
    damage: list[DamagedFile] = field(default_factory=list)
    missing: list[tuple[str, bytes, int, int]] = field(default_factory=list)
    conflicts: list[Conflict] = field(default_factory=list)
    gaps: list[Gap] = field(default_factory=list)

    @property
    def is_good(self) -> bool:
        return not (self.damage or self.missing or self.conflicts or self.gaps)


def verify_recording(recording: Recording) -> Report:
    """Read everything, then the checksums that cover whole files."""
    report = Report()
    for segment, records in recording.by_segment():
        report.segments += 1
        for record in records:
            if isinstance(record, Sample):
                report.samples += 1
            elif isinstance(record, Gap):
                report.gaps.append(record)
        if segment.state == "sealed":
            try:
                report.damage += check_sums(segment.path)
            except OSError as error:
                reason = f"cannot be read ({error.strerror or error})"
                report.damage.append(DamagedFile(segment.path, 0, reason))
    report.damage = recording.damage + report.damage
    report.missing = recording.missing
    report.conflicts = recording.conflicts
    report.dropped = recording.dropped
    return report


def lines(report: Report) -> Iterator[str]:
    """For people: one line for each finding, then the sum."""
    for problem in report.damage:
        yield f"damage: {problem}"
    for topic, _, first, last in report.missing:
        what = f"sample {first} is" if first == last else f"samples {first} to {last} are"
        yield f"missing: {topic}: {what} not in the files"
    for conflict in report.conflicts:
        yield f"conflict: {conflict.topic}: two different samples {conflict.seq}"
    for gap in report.gaps:
        span = f"{format_instant(gap.start)} to {format_instant(gap.end)}"
        doubt = "perhaps " if gap.possible else ""
        what = f"{doubt}{gap.expected} samples ({gap.reason})"
        place = f"{gap.device}/{gap.block}" if gap.block else gap.device or gap.topic
        yield f"gap: {place}: {span}, {what}"
    copies = f", {report.dropped} copies left out" if report.dropped else ""
    verdict = (
        "complete and undamaged"
        if report.is_good
        else f"{len(report.damage)} damaged parts, {len(report.missing)} holes, "
        f"{len(report.conflicts)} conflicts, {len(report.gaps)} gaps"
    )
    segments = f"{report.segments} segment{'s' * (report.segments != 1)}"
    yield f"{report.samples} samples in {segments}{copies}: {verdict}"


def as_object(report: Report) -> dict[str, object]:
    """For ``--json``."""
    return {
        "schema": VERIFY_SCHEMA,
        "good": report.is_good,
        "segments": report.segments,
        "samples": report.samples,
        "copies_dropped": report.dropped,
        "damage": [
            {"path": str(d.path), "offset": d.offset, "reason": d.reason} for d in report.damage
        ],
        "missing": [
            {"topic": topic, "epoch": epoch.hex(), "first_seq": first, "last_seq": last}
            for topic, epoch, first, last in report.missing
        ],
        "conflicts": [
            {"topic": c.topic, "epoch": c.epoch.hex(), "seq": c.seq} for c in report.conflicts
        ],
        "gaps": [
            {
                "topic": gap.topic,
                "device": gap.device,
                "block": gap.block,
                "from": format_instant(gap.start),
                "to": format_instant(gap.end),
                "expected": gap.expected,
                "reason": gap.reason,
                "possible": gap.possible,
            }
            for gap in report.gaps
        ],
    }
