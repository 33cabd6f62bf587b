"""Power cuts: a file system in an image file is shut down under the recorder, nothing flushed."""

from __future__ import annotations

import fcntl
import os
import shutil
import signal
import struct
import subprocess
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING

from bench.judge import check_gaps, compare
from bench.peer import Roc
from bench.process import until
from bench.recorder import Recorder
from bench.recording import csv_rows, gaps

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

_SHUTDOWN = 0x8004587D
_NOTHING_FLUSHED = 2


@dataclass
class Report:
    cuts: int = 0
    cleared: int = 0
    kept: int = 0
    lost: int = 0
    violations: list[str] = field(default_factory=list)

    def summary(self) -> str:
        return (
            f"{self.cuts} cuts, {self.cleared} cleared, {self.kept} kept, "
            f"{self.lost} cleared but lost, {len(self.violations)} violations"
        )


def possible() -> bool:
    """Whether this host lets one mount an image and shut its file system down."""
    return os.geteuid() == 0 and Path("/dev/loop-control").exists() and bool(which("mkfs.ext4"))


def which(name: str) -> str | None:
    return shutil.which(name, path=os.environ.get("PATH", "") + ":/usr/sbin:/sbin")


class Image:
    """An ext4 file system in a file. ``cut`` is the power cut, ``mount`` the next start."""

    def __init__(self, folder: Path) -> None:
        self._file = folder / "disk.img"
        self.root = folder / "disk"
        self.root.mkdir()
        with self._file.open("wb") as file:
            file.truncate(64 << 20)
        _run("mkfs.ext4", "-q", "-F", str(self._file))

    def mount(self) -> None:
        _run("mount", "-o", "loop", str(self._file), str(self.root))

    def cut(self) -> None:
        handle = os.open(self.root, os.O_RDONLY)
        try:
            fcntl.ioctl(handle, _SHUTDOWN, struct.pack("I", _NOTHING_FLUSHED))
        finally:
            os.close(handle)

    def unmount(self) -> None:
        """Until nobody has it mounted any more.

        A network namespace that another test makes just then has a copy of every mount; a file
        system that was shut down and is still held by it would be mounted again as it is, dead.
        """
        _run("umount", str(self.root))
        until(lambda: not _run("losetup", "-j", str(self._file)), "the release of the image", 60)


def _run(*command: str) -> str:
    program = which(command[0]) or command[0]
    done = subprocess.run([program, *command[1:]], capture_output=True, text=True, check=False)
    if done.returncode:
        raise OSError(f"{' '.join(command)}: {done.stderr.strip()}")
    return done.stdout


@contextmanager
def mounted(image: Image) -> Iterator[None]:
    image.mount()
    try:
        yield
    finally:
        image.unmount()


def run(
    folder: Path, cuts: int, seed: int, *, under: Sequence[str] = (), segment: str = "2s"
) -> Report:
    """under: a command around the recorder; with eatmydata every cut must lose something."""
    random = Random(seed)
    report = Report()
    image = Image(folder)
    with Roc(folder, cycle=0.2, samples=10**6, seed=seed) as roc:
        device = roc.toml(device='poll = "50ms"\ncycle = "200ms"')
        recorder = Recorder(folder, device, segment=segment, directory=image.root / "recordings")
        for number in range(cuts):
            with mounted(image), recorder.start(under=under) as child:
                more = len(roc.truth.cleared) + random.randint(1, 15)

                def enough(more: int = more) -> bool:
                    return len(roc.truth.cleared) >= more

                child.while_it_runs(enough, f"{more} clears")
                image.cut()  # whatever is cleared from here on, rests on what was written before
                child.send(signal.SIGKILL)
                child.wait()
            report.cuts += 1
            with mounted(image):
                _check(folder / f"csv{number}", recorder, roc, report)
        truth = roc.end()
    report.cleared = len(truth.cleared)
    return report


def _check(out: Path, recorder: Recorder, roc: Roc, report: Report) -> None:
    truth = roc.truth
    if not any(recorder.directory.rglob("*.mcap")):
        report.lost = len(truth.cleared)
        return
    try:
        comparison = compare(csv_rows(recorder.directory, out), truth)
    except (AssertionError, OSError) as error:
        report.violations.append(f"{out.name}: export: {error}")
        return
    kept = set(comparison.found)
    report.kept = len(kept)
    report.lost = len([k for k in truth.cleared if k not in kept])
    if report.lost:
        report.violations.append(f"{out.name}: {report.lost} cleared samples are not there")
    report.violations += [f"{out.name}: twice: {k}" for k in comparison.twice]
    report.violations += [f"{out.name}: wrong: {text}" for text in comparison.wrong]
    missing = [k for k in comparison.missing if k < comparison.found[-1]] if kept else []
    check = check_gaps(missing, truth, gaps(recorder.directory, "roc1"))
    report.violations += [f"{out.name}: sample {k} is in no gap" for k in check.uncovered]
