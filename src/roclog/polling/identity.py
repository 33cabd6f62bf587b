"""Is it still the same device? Asked at the start, after an outage, after a power-up."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from roclog.config.settings import Device
    from roclog.decode import Value
    from roclog.recording.writer import Writer
    from roclog.register_map import RegisterMap

    Facts = Mapping[str, Mapping[str, Value | None]]


def identity_topic(device: str) -> str:
    """Under which a later run finds who answered last; no channel has this name."""
    return f"/{device}"


def identity(profile: RegisterMap, facts: Facts) -> dict[str, str]:
    """What tells the device from another one, by point; empty where it does not say.

    A device that names nothing (blank text, zero) may not be ready yet: that compares with nothing.
    """
    found = {
        f"{block}.{name}": value
        for block, name in profile.identity
        if (value := facts.get(block, {}).get(name)) is not None
    }
    known = any(value.strip() if isinstance(value, str) else value for value in found.values())
    return {name: str(value).strip() for name, value in found.items()} if known else {}


def difference(before: Mapping[str, str], now: Mapping[str, str]) -> str:
    """What changed, for people; empty where nothing did that both tell."""
    names = [name for name in now if name in before and before[name] != now[name]]
    return ", ".join(f"{name} {now[name]!r} instead of {before[name]!r}" for name in names)


class Succession:
    """Who answers for a device, in this run and in earlier ones.

    topics: of the channels whose messages are numbered. carried: what ``identity_topic`` says.
    """

    def __init__(
        self,
        device: Device,
        topics: Sequence[str],
        carried: Mapping[str, object],
        writer: Writer,
    ) -> None:
        self._device = device
        self._topics = topics
        self._writer = writer
        known = carried.get("identity")
        self._known: dict[str, str] = dict(known) if isinstance(known, dict) else {}

    @property
    def is_known(self) -> bool:
        """Whether a device has told who it is."""
        return bool(self._known)

    def see(self, facts: Facts) -> str:
        """What tells the device that answers now from the one before; empty where nothing does."""
        found = identity(self._device.profile, facts)
        changed = difference(self._known, found)
        if changed:
            self._known = found
        elif not found.keys() <= self._known.keys():
            self._known |= found  # a block that was refused, a point that was missing
            self._writer.carry(identity_topic(self._device.name), self._carry())
        return changed

    def begin(self, metadata: Mapping[str, str]) -> None:
        """From now on another device answers: a new segment, that knows nothing of the last one."""
        forgotten: dict[str, Mapping[str, object] | None] = dict.fromkeys(self._topics)
        forgotten[identity_topic(self._device.name)] = self._carry()
        self._writer.begin(f"roclog.device.{self._device.name}", metadata, forgotten)

    def _carry(self) -> Mapping[str, object]:
        return {"seq": 0, "identity": dict(self._known)}
