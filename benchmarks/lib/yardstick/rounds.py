"""Rounds in turns: every client once, then all again."""

from __future__ import annotations

from typing import TYPE_CHECKING

from yardstick.processes import NotInstalled

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from typing import TypeVar

    Result = TypeVar("Result")


def in_turns(
    clients: Sequence[str],
    rounds: int,
    once: Callable[[str, int], Result],
    tell: Callable[[str], None],
    what: str,
) -> dict[str, list[Result]]:
    """``once(client, round)`` for all; an empty list for a client that is not installed."""
    results: dict[str, list[Result]] = {client: [] for client in clients}
    missing: set[str] = set()
    for number in range(rounds):
        for client in clients:
            if client in missing:
                continue
            tell(f"{what}, round {number + 1} of {rounds}, {client}")
            try:
                results[client].append(once(client, number))
            except NotInstalled:
                missing.add(client)
    return results
