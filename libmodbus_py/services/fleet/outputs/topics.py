"""
Names of devices and points as levels of NATS subjects and MQTT topics, and topics that contain them
and labels of devices.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from urllib.parse import unquote

from ....maps.point_checks import TEXTS
from ....protocol.mistakes import WrongType, WrongValue
from ..config import LONGEST_NAME, DeviceConfig

_LONGEST = max(TEXTS["name"][1], LONGEST_NAME)


class Levels:
    """Spells names as levels, with the `special` characters, among them %, as %2F and so on."""

    def __init__(self, special: str) -> None:
        self._special = re.compile(special, re.ASCII)

    def spell(self, name: str) -> str:
        return self._special.sub(lambda match: f"%{ord(match[0]):02X}", name)

    def read(self, level: str) -> str | None:
        """
        Return the name of a level; None if `spell` returns no such level: if ``n%6Frth`` were taken
        for ``north``, a rule of a broker that denies ``north`` would not hold.
        """
        if len(level) > 12 * _LONGEST:
            return None
        name = unquote(level)
        is_name = 1 <= len(name) <= _LONGEST and name.isprintable()
        return name if is_name and self.spell(name) == level else None


_LEVELS = Levels(r"[/+#%\0]")

# A level of a topic: text, and one name or label at most. "{device}-{name}" would be a-b-c for c of
# a-b and for b-c of a.
_LEVEL = re.compile(r"([^{}]*)(?:\{([^{}]*)\}([^{}]*))?")

_LABEL = "label."

UNKNOWN = "unknown"
"""The level of a label of a device that was removed, while its last readings waited."""


class Topic:
    """
    A topic with `names`, each on a level of its own, and with labels of devices, such as
    "plant/{label.site}/{device}/{name}".

    `labels` are the names of these labels, `filter` is the topic filter that matches all topics.
    """

    def __init__(self, key: str, template: object, names: tuple[str, ...]) -> None:
        self.template: str = plain_topic(key, template)
        self._key = key
        levels = [_LEVEL.fullmatch(level) for level in self.template.split("/")]
        self._levels = [level.groups("") for level in levels if level is not None]
        fields = [name for _, name, _ in self._levels]
        self.labels: list[str] = [
            field.removeprefix(_LABEL) for field in fields if field.startswith(_LABEL)
        ]
        others = [field for field in fields if field and not field.startswith(_LABEL)]
        if None in levels or "" in self.labels or "{}" in self.template:
            reason = "each level must have one {name} at most, and text without braces"
            raise WrongValue.about(key, f"{reason}: {template!r}")
        if sorted(others) != sorted(names):
            texts = " and ".join(f"{{{name}}}" for name in names)
            raise WrongValue(key, f"must hold {texts} once, not {template!r}")
        self.filter: str = "/".join("+" if name else text for text, name, _ in self._levels)
        self._pattern = re.compile(
            "/".join(
                f"{re.escape(before)}{_group(name)}{re.escape(behind)}"
                for before, name, behind in self._levels
            )
        )

    def check(self, devices: Mapping[str, DeviceConfig]) -> None:
        """Raise ValueError if a device lacks a label of this topic."""
        for device, config in devices.items():
            for name in self.labels:
                if not config.labels.get(name):
                    reason = f"{{label.{name}}}: the device {device!r} has no label {name!r}"
                    raise WrongValue.about(self._key, reason)

    def of(self, labels: Mapping[str, str], **names: str) -> str:
        """Return the topic of a device, or of one of its points."""
        fields = {"": "", **names}
        fields |= {f"{_LABEL}{label}": labels.get(label) or UNKNOWN for label in self.labels}
        return "/".join(
            f"{begin}{_LEVELS.spell(fields[name])}{end}" for begin, name, end in self._levels
        )

    def read(self, topic: str) -> dict[str, str] | None:
        """Return the names in a topic that `of` returns for some labels; None for others."""
        match = self._pattern.fullmatch(topic)
        if match is None:
            return None
        names = {key: _LEVELS.read(level) for key, level in match.groupdict().items()}
        valid = {key: name for key, name in names.items() if name is not None}
        return valid if len(valid) == len(names) else None

    def can_be(self, topic: str) -> bool:
        """Return True if this is another topic, or template of topics, for some names."""
        levels, others = self.template.split("/"), topic.split("/")
        return len(levels) == len(others) and all(
            level == other or "{" in level or "{" in other
            for level, other in zip(levels, others, strict=True)
        )


def plain_topic(key: str, topic: object) -> str:
    """Return a topic; TypeError or ValueError if it is none, or holds + or #."""
    if not isinstance(topic, str):
        raise WrongType(key, f"must be text, not {type(topic).__name__}")
    if set("+#\0") & set(topic) or len(topic.encode()) > 1000 or topic.startswith("$"):
        raise WrongValue(key, f"must be a topic without + and #, not {topic!r}")
    return topic


def _group(name: str) -> str:
    if name.startswith(_LABEL):
        return "[^/]+"
    return f"(?P<{name}>[^/]+)" if name else ""
