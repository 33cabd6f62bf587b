"""``roclog init``."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import click

_BY_ID: Final = Path("/dev/serial/by-id")

_TEXT: Final = """\
#:schema config.schema.json
# Completion in editors: python -m roclog.config > config.schema.json
#
# Try it without hardware:
#   roclog simulate hiac-roc --tcp 127.0.0.1:5020      (in another terminal)
#   roclog check --probe {name}
#   roclog record {name} --for 1min
#   roclog info recordings
#
# Durations: us, ms, s, min, h, d. Sizes: B, KiB, MiB, GiB, TiB.

[recording]
directory = "recordings"        # relative to this file
segment = {{ duration = "1h", size = "64 MiB" }}
# keep = {{ age = "90d", size = "20 GiB" }}       # default: keep everything

# The simulated device. Replace it by what you have.
[connections.simulator]
transport = "tcp"               # or "udp": one frame in each datagram, with the same keys
host = "127.0.0.1"
port = 5020                     # default 502
# timeout = "1s"

[devices.roc1]
profile = "hiac-roc"            # roclog profiles lists what there is
connection = "simulator"
unit = 138                      # 1-247 on serial lines, 0-255 on TCP and UDP
poll = "1s"                     # shorter than the time between two samples of the device
# word_order = "ABCD"           # of 32-bit values; or CDAB
# acknowledge = true            # false: never write, tell samples apart by change
# cycle = "15s"                 # time between samples; default: what the device says

# A serial line. {ports}
# [connections.hydraulics]
# transport = "rtu"
# port = "{port}"
# baudrate = 9600               # bytesize = 8, parity = "N", stopbits = 1
# timeout = "500ms"             # for an answer to begin and end, from the end of the request
# late_answer = "1s"            # after a time-out nothing is sent until the late answer came or
#                               # this has passed since the request; default 2 x timeout
# silence = "5 chars"           # before every request; default: what the devices ask
# low_latency = true            # ask the driver to hand octets over as they come
# rs485 = {{ rts_on_send = true }}    # direction control by the driver, for ports that do not
#                               # switch by themselves; most USB adapters do
#
# [devices.roc2]
# profile = "hiac-roc"
# connection = "hydraulics"

# A serial line behind a gateway that passes octets through (raw TCP, not Modbus TCP).
# [connections.gateway]
# transport = "rtu-over-tcp"
# host = "192.168.1.40"
# port = 4001                   # always needed: the one that the gateway has for this line
# baudrate = 9600               # of the line; the gateway has its own setting
# timeout = "500ms"             # late_answer and silence as on a serial line
#
# [devices.roc3]
# profile = "hiac-roc"
# connection = "gateway"

# Any other device: its registers are described here, with addresses counted from 0.
# [devices.meter]
# profile = "registers"
# connection = "simulator"
# unit = 9
# [[devices.meter.blocks]]
# name = "flow"
# table = "holding_registers"   # or input_registers, coils, discrete_inputs
# address = 100
# points = [
#   {{ name = "rate", offset = 0, type = "float32", word_order = "CDAB", unit = "L/min" }},
#   {{ name = "total", offset = 2, type = "uint32", scale = 0.01, unit = "m3" }},
#   {{ name = "state", offset = 4, type = "uint16" }},
# ]
"""


@click.command()
@click.argument("file", default="roclog.toml", type=click.Path(path_type=Path, allow_dash=True))
@click.option("--force", is_flag=True, help="Overwrite FILE.")
def init(file: Path, *, force: bool) -> None:
    """Write a commented configuration.

    It records a simulated device as it is, and lists the serial ports of this computer. FILE is
    roclog.toml where it is not given; - is stdout.

    \b
    Example:
      roclog init
      roclog simulate hiac-roc --tcp 127.0.0.1:5020 &
      roclog record roclog.toml
    """
    if file == Path("-"):
        click.echo(configuration("roclog.toml", serial_ports()), nl=False)
        return
    text = configuration(str(file), serial_ports())
    try:
        with file.open("w" if force else "x", encoding="utf-8") as target:
            target.write(text)
    except FileExistsError as error:
        raise click.UsageError(f"{file} is there already; --force overwrites it") from error
    click.echo(f"wrote {file}; its first lines say how to try it without hardware", err=True)


def configuration(name: str, ports: list[str]) -> str:
    """The text; ``name`` is that of the file, for the commands in its comments."""
    if not ports:
        note = f"None is below {_BY_ID} at present."
    else:
        note = "\n".join(["Found at present:", *(f"#   {port}" for port in ports)])
    port = ports[0] if ports else f"{_BY_ID}/usb-..."
    # A comment ends with its line.
    name = name if name.isprintable() else "roclog.toml"
    return _TEXT.format(name=name, ports=note, port=port)


def serial_ports(directory: Path = _BY_ID) -> list[str]:
    """Names of serial ports that stay when adapters are plugged in another order."""
    try:
        ports = sorted(str(link) for link in directory.iterdir())
    except OSError:
        return []
    return [port for port in ports if port.isprintable()]
