"""
Names of devices and points as levels of NATS subjects and MQTT topics, and topics that contain them
and labels of devices.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from urllib.parse import unquote

from ....maps.point_checks import MAX_NAME
from ....protocol.mistakes import WrongType, WrongValue
from ..config import LONGEST_NAME, DeviceConfig

__all__ = ["Levels", "Topic", "plain_topic"]


_LONGEST = max(MAX_NAME, LONGEST_NAME)


class Levels:
    """Spells names as levels, with the `special` characters, among them %, as %2F and so on."""

    def __init__(self, special: str) -> None:
        self._special = re.compile(special, re.ASCII)

    def spell(self, name: str) -> str:
        """Return the level of a name."""
        return self._special.sub(lambda found: f"%{ord(found[0]):02X}", name)

    def read(self, level: str) -> str | None:
        """
        Return the name of a level; None if `spell` returns no such level.

        A broker compares levels, not names: if ``n%6Frth`` were taken for ``north``, a rule that
        denies ``north`` would not hold.
        """
        if len(level) > 12 * _LONGEST:
            return None
        name = unquote(level)
        is_name = 1 <= len(name) <= _LONGEST and name.isprintable()
        return name if is_name and self.spell(name) == level else None


_LEVELS = Levels(r"[/+#%\0]")

_PART = re.compile(r"(\{[^{}]*\})")

_LABEL = "label."

UNKNOWN = "unknown"
"""The level of a label of a device that was removed, while its last readings waited."""


class Topic:
    """
    A topic with names and labels, such as "plant/{label.site}/{device}/{name}".

    Args:
        key: the argument, for errors.
        template: the topic. Each level holds one name or label at most.
        names: the names that it must hold, each once: "device" and "name", or "device".

    Attributes:
        labels: the names of the labels that it holds.
        filter: the topic filter that matches all topics.
    """

    def __init__(self, key: str, template: object, names: tuple[str, ...]) -> None:
        self.template: str = plain_topic(key, template)
        self._key = key
        self._parts = _PART.split(self.template)
        held = [part[1:-1] for part in self._parts[1::2]]
        self.labels: list[str] = [
            each.removeprefix(_LABEL) for each in held if each.startswith(_LABEL)
        ]
        if sorted(each for each in held if not each.startswith(_LABEL)) != sorted(names):
            wanted = " and ".join(f"{{{name}}}" for name in names)
            raise WrongValue(key, f"must hold {wanted} once, not {template!r}")
        if "" in self.labels:
            raise WrongValue.about(key, f"{{label.}} names no label: {template!r}")
        if set("{}") & set("".join(self._parts[::2])):
            raise WrongValue.about(key, f"a brace belongs to no name: {template!r}")
        levels = self.template.split("/")
        if any(len(_PART.findall(level)) > 1 for level in levels):
            # "{device}-{name}" would be a-b-c for c of a-b and for b-c of a.
            reason = f"{', '.join(f'{{{each}}}' for each in held)} must stand apart, with / between"
            raise WrongValue.about(key, f"{reason} them: {template!r}")
        self.filter: str = "/".join("+" if "{" in level else level for level in levels)
        self._pattern = re.compile(
            "".join(
                re.escape(part) if at % 2 == 0 else _group(part[1:-1])
                for at, part in enumerate(self._parts)
            )
        )

    def check(self, devices: Mapping[str, DeviceConfig]) -> None:
        """Raise ValueError if a device lacks a label of this topic."""
        for device, each in devices.items():
            for name in self.labels:
                if not each.labels.get(name):
                    reason = f"{{label.{name}}}: the device {device!r} has no label {name!r}"
                    raise WrongValue.about(self._key, reason)

    def of(self, labels: Mapping[str, str], **names: str) -> str:
        """Return the topic of a device, or of one of its points."""
        held = {
            **names,
            **{f"{_LABEL}{each}": labels.get(each) or UNKNOWN for each in self.labels},
        }
        return "".join(
            part if at % 2 == 0 else _LEVELS.spell(held[part[1:-1]])
            for at, part in enumerate(self._parts)
        )

    def read(self, topic: str) -> dict[str, str] | None:
        """
        Return the names in a topic; None if it is not one that `of` returns for some labels.

        Labels are not compared.
        """
        found = self._pattern.fullmatch(topic)
        if found is None:
            return None
        names: dict[str, str] = {}
        for key, level in found.groupdict().items():
            name = _LEVELS.read(level)
            if name is None:
                return None
            names[key] = name
        return names

    def can_be(self, topic: str) -> bool:
        """Return True if this is another topic, or template of topics, for some names."""
        levels, others = self.template.split("/"), topic.split("/")
        return len(levels) == len(others) and all(
            level == each or "{" in level or "{" in each
            for level, each in zip(levels, others, strict=True)
        )


def plain_topic(key: str, topic: object) -> str:
    """Return a topic; TypeError or ValueError if it is none, or holds + or #."""
    if not isinstance(topic, str):
        raise WrongType(key, f"must be text, not {type(topic).__name__}")
    if set("+#\0") & set(topic) or len(topic.encode()) > 1000 or topic.startswith("$"):
        raise WrongValue(key, f"must be a topic without + and #, not {topic!r}")
    return topic


def _group(name: str) -> str:
    return "[^/]+" if name.startswith(_LABEL) else f"(?P<{name}>[^/]+)"
