"""``python -m roclog.simulators.serial_line``."""

from __future__ import annotations

import os
import re
import select
import signal
import sys
from contextlib import closing, suppress
from pathlib import Path
from typing import Final, Self

import click

from roclog.quantities import parse_duration
from roclog.simulators.serial_line.line import SerialLine
from roclog.simulators.serial_line.wire import LineSettings

_STANDARD_INPUT: Final = 0
_PARITIES: Final = "NEOMS"


def _duration(_: click.Context, parameter: click.Parameter, text: str) -> int:
    try:
        return parse_duration(text)
    except ValueError as error:
        raise click.BadParameter(str(error), param=parameter) from error


def _silence(
    context: click.Context, parameter: click.Parameter, text: str
) -> tuple[float, int | None]:
    match = re.fullmatch(r"(\d{1,4}(?:\.\d{1,9})?) ?chars?", text, re.ASCII)
    return (float(match[1]), None) if match else (0.0, _duration(context, parameter, text))


def _bits(_: click.Context, parameter: click.Parameter, text: str) -> int:
    match = re.fullmatch(f"([5-8])([{_PARITIES}])([12])", text.upper())
    if match is None:
        raise click.BadParameter(f"{text!r} is not like 8N1, 8E1 or 8N2", param=parameter)
    return 1 + int(match[1]) + (match[2] != "N") + int(match[3])


@click.command()
@click.option("--baud", type=click.IntRange(1, 10_000_000), help="None: octets take no time.")
@click.option(
    "--format",
    "character_bits",
    default="8N1",
    show_default=True,
    callback=_bits,
    help="Data bits, parity and stop bits; only their number matters.",
)
@click.option("--link-a", type=click.Path(path_type=Path), help="Link to the client's terminal.")
@click.option("--link-b", type=click.Path(path_type=Path), help="Link to the server's terminal.")
@click.option(
    "--turnaround",
    default="0ms",
    show_default=True,
    callback=_duration,
    help="From the end of a request to the beginning of its answer.",
)
@click.option(
    "--usb-latency",
    default="0ms",
    show_default=True,
    callback=_duration,
    help="The client sees octets at ticks this far apart only.",
)
@click.option(
    "--silence",
    default="3.5 chars",
    show_default=True,
    callback=_silence,
    help="Requests that begin sooner after the last octet are counted.",
)
@click.option(
    "--fifo",
    type=click.IntRange(min=1),
    default=1,
    show_default=True,
    help="Deliver in groups of so many octets, as a UART with FIFO.",
)
def main(
    *,
    baud: int | None,
    character_bits: int,
    link_a: Path | None,
    link_b: Path | None,
    turnaround: int,
    usb_latency: int,
    silence: tuple[float, int | None],
    fifo: int,
) -> None:
    """Lay a half-duplex serial line between two terminals.

    Prints the name of the client's terminal and that of the server's, a line each. Ends with
    SIGTERM, with SIGINT or when standard input is closed, and then prints what the line has seen
    as one line of JSON.
    """
    settings = LineSettings(
        baud=baud,
        character_bits=character_bits,
        turnaround_ns=turnaround,
        usb_latency_ns=usb_latency,
        silence_characters=silence[0],
        silence_ns=silence[1],
        fifo=fifo,
    )
    with _Signals() as signals:
        try:
            line = SerialLine(link_a, link_b, settings=settings)
        except OSError as error:
            raise click.UsageError(str(error)) from error
        with closing(line):
            print(line.client_port, line.server_port, sep="\n", flush=True)  # noqa: T201
            signals.wait_for_one_or_the_end_of_input()
        print(line.statistics().to_json(), flush=True)  # noqa: T201


class _Signals:
    """SIGINT and SIGTERM as something that can be waited for together with standard input."""

    def __enter__(self) -> Self:
        self._arrived, self._arrival = os.pipe()
        os.set_blocking(self._arrival, False)
        self._former = {
            number: signal.signal(number, lambda _number, _frame: None)
            for number in (signal.SIGINT, signal.SIGTERM)
        }
        signal.set_wakeup_fd(self._arrival)
        return self

    def __exit__(self, *_: object) -> None:
        signal.set_wakeup_fd(-1)
        for number, handler in self._former.items():
            signal.signal(number, handler)
        os.close(self._arrived)
        os.close(self._arrival)

    def wait_for_one_or_the_end_of_input(self) -> None:
        watched = [self._arrived]
        if sys.stdin is not None:
            watched.append(_STANDARD_INPUT)
        while True:
            ready, _, _ = select.select(watched, [], [])
            if self._arrived in ready:
                return
            with suppress(InterruptedError):
                if not os.read(_STANDARD_INPUT, 4096):
                    return


if __name__ == "__main__":
    main(prog_name="python -m roclog.simulators.serial_line")
