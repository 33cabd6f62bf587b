"""Options of a test device: one dataclass field is one command line option."""

from __future__ import annotations

import argparse
from dataclasses import field, fields
from typing import Any, TypeVar

T = TypeVar("T")


def option(default: object, text: str, kind: type = str, choices: tuple[str, ...] = ()) -> Any:
    return field(default=default, metadata={"help": text, "kind": kind, "choices": choices})


def parse(kind: type[T], about: str, arguments: list[str] | None = None) -> T:
    """The command line as a `kind`, every field of which is an `option`."""
    parser = argparse.ArgumentParser(description=about, allow_abbrev=False)
    for item in fields(kind):  # type: ignore[arg-type]
        parser.add_argument(
            "--" + item.name.replace("_", "-"),
            type=item.metadata["kind"],
            default=item.default,
            choices=item.metadata["choices"] or None,
            help=item.metadata["help"] + " (default: %(default)s)",
        )
    try:
        return kind(**vars(parser.parse_args(arguments)))
    except ValueError as error:
        parser.error(str(error))
