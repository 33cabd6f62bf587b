"""Prints one JSON line for each message of the MCAP files named, without the logger's code.

Sealed files are read through their index, unfinished ones as a stream. Run it with ``python -I``.
"""

from __future__ import annotations

import json
import struct
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from google.protobuf.json_format import MessageToDict
from mcap.exceptions import EndOfFile
from mcap.reader import NonSeekingReader, make_reader
from mcap_protobuf.decoder import DecoderFactory

if TYPE_CHECKING:
    from mcap.reader import McapReader

sys.modules["roclog"] = None  # type: ignore[assignment]  # an import from here on would fail


def read(path: str) -> None:
    with Path(path).open("rb") as file:
        factories = [DecoderFactory()]
        reader: McapReader
        if "/hot/" in path:
            reader = NonSeekingReader(file, validate_crcs=True, decoder_factories=factories)
        else:
            reader = make_reader(file, validate_crcs=True, decoder_factories=factories)
        try:
            for _, channel, message, value in reader.iter_decoded_messages(log_time_order=False):
                fields = MessageToDict(
                    value,
                    preserving_proto_field_name=True,
                    always_print_fields_with_no_presence=True,
                )
                line = {"topic": channel.topic, "logTime": str(message.log_time), "value": fields}
                print(json.dumps(line))
        except (EndOfFile, struct.error):
            if "/hot/" not in path:
                raise


for name in sys.argv[1:]:
    read(name)
assert not [name for name in sys.modules if name.startswith("roclog.")], "the logger was used"
