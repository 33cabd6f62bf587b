"""1000 TCP devices at 1 Hz recorded on one core, beside pymodbus that reads and does no more."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

from rich.console import Console

sys.path.insert(0, str(Path(__file__).parent / "lib"))

from yardstick import punctuality, recorded_samples, report
from yardstick.fleet import BLOCK
from yardstick.processes import MALLOC, Peer, choose_malloc, run_on_client_core
from yardstick.punctuality import Punctuality

PERIOD = 10**9


@dataclass
class Run:
    """One client over all devices. polls: answered requests, by the devices' count."""

    polls: int
    cost: dict[str, Any]
    devices_say: Punctuality
    drift_ppm: float
    recording_says: Punctuality | None = None
    recorded: recorded_samples.Recorded | None = None
    loop_share: float = 1.0

    @property
    def cpu_us(self) -> float:
        """Of the whole process for a sample that is in the files, or a poll that was answered."""
        count = self.recorded.samples if self.recorded is not None else self.polls
        return float(self.cost["cpu"]) / count * 1e6


def once(client: str, devices: int, seconds: float, place: Path | None) -> Run:
    module = {"roclog": "yardstick.recording_run", "pymodbus": "yardstick.bare_polls"}[client]
    with tempfile.TemporaryDirectory(dir=place, prefix="record-") as name:
        folder = Path(name)
        arrivals_file = folder / "arrivals"
        with Peer("yardstick.tcp_devices", "--arrivals", str(arrivals_file)) as peer:
            arguments = (str(folder), peer.ready[0], str(devices), str(seconds))
            output = json.loads(run_on_client_core("-m", module, *arguments))
        if peer.seen["unexpected"]:
            raise RuntimeError(f"{client} sent {peer.seen['unexpected']} other requests")
        arrivals = punctuality.read_arrivals(arrivals_file).values()
        run = Run(
            polls=peer.seen["answered"],
            cost=output["whole"],
            devices_say=punctuality.seen_by_devices(arrivals, PERIOD),
            drift_ppm=punctuality.drift_ppm(arrivals, PERIOD),
            loop_share=output["whole"]["loop"] / output["whole"]["cpu"],
        )
        if client == "roclog":
            run.recorded = recorded_samples.read(folder / "recordings", BLOCK)
            run.recording_says = _said(output["turns"], run.recorded.asked)
        return run


def _said(turns: dict[str, list[tuple[int, int]]], asked: dict[str, list[int]]) -> Punctuality:
    found = Punctuality()
    for device, its_turns in turns.items():
        one = punctuality.said_by_recording(its_turns, asked.get(device, []), PERIOD)
        found.late += one.late
        found.missing += one.missing
    return found


def show(console: Console, runs: dict[str, list[Run]], devices: int) -> None:
    made = report.table(
        f"{devices} devices, each once a second, 27 registers",
        "client",
        "polls",
        "in files",
        "broken",
        "CPU us each",
        "of pymodbus",
        "core",
        "RSS MiB",
        "in 50 ms: devices",
        "recorded",
        "late ms p50 / p99 / max",
        "drift ppm",
    )
    bare = median(run.cpu_us for run in runs["pymodbus"])
    for client, done in runs.items():
        for number, run in enumerate(done):
            recorded, said = run.recorded, run.recording_says
            late = said or run.devices_say
            made.add_row(
                f"{client}, round {number + 1}",
                str(run.polls),
                str(recorded.samples) if recorded else "-",
                str(recorded.broken) if recorded else "-",
                f"{run.cpu_us:.1f}",
                f"{run.cpu_us / bare:.2f}",
                f"{run.cost['cpu'] / run.cost['wall']:.0%}",
                f"{run.cost['most_memory'] / 2**20:.0f}",
                f"{run.devices_say.share_in_time:.3%}",
                f"{said.share_in_time:.3%}" if said else "-",
                f"{late.late_ms(0.5):.1f} / {late.late_ms(0.99):.1f} / {late.late_ms(1):.1f}",
                f"{run.drift_ppm:.1f}",
            )
    console.print(made)
    for run in runs["roclog"]:
        assert run.recorded is not None
        others = ", ".join(f"{n} {name}" for name, n in sorted(run.recorded.others.items()))
        console.print(
            f"roclog: {run.loop_share:.0%} of its CPU in the event loop's thread; "
            f"files of {run.recorded.octets / max(1, run.recorded.samples):.0f} octets a sample; "
            f"other messages: {others or 'none'}"
        )
    ours = median(run.cpu_us for run in runs["roclog"])
    console.print(f"median CPU for a recorded sample / for a bare read: {ours / bare:.2f}")


def as_figures(run: Run) -> dict[str, Any]:
    figures = {
        "polls": run.polls,
        "cpu_us": run.cpu_us,
        "cost": run.cost,
        "loop_share": run.loop_share,
        "in_time_devices": run.devices_say.share_in_time,
        "drift_ppm": run.drift_ppm,
    }
    if run.recording_says is not None and run.recorded is not None:
        figures["in_time_recorded"] = run.recording_says.share_in_time
        figures["samples"] = run.recorded.samples
        figures["broken"] = run.recorded.broken
        figures["others"] = run.recorded.others
    return figures


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--devices", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--quick", action="store_true", help="one round of ten seconds")
    parser.add_argument("--dir", type=Path, help="a folder on the disk to record to")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--malloc", choices=MALLOC, default="equal", help="of the clients; README")
    given = parser.parse_args()
    choose_malloc(given.malloc)
    seconds, rounds = (10.0, 1) if given.quick else (given.seconds, given.rounds)
    talk, console = Console(stderr=True), report.console()
    machine = {**report.machine(), "malloc": given.malloc}
    console.print(*(f"{key} {value}" for key, value in machine.items()), sep=", ")
    runs: dict[str, list[Run]] = {"roclog": [], "pymodbus": []}
    for number in range(rounds):
        for client, done in runs.items():
            with talk.status(f"round {number + 1} of {rounds}, {client}"):
                done.append(once(client, given.devices, seconds, given.dir))
    show(console, runs, given.devices)
    if given.json is not None:
        figures = {client: [as_figures(run) for run in done] for client, done in runs.items()}
        given.json.write_text(json.dumps({"machine": machine, **figures}, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
