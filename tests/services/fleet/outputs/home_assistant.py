"""
A subscriber that knows of this package only what Home Assistant publishes about MQTT discovery.

The tables are those of its pages: https://www.home-assistant.io/integrations/mqtt/, those of the
components (sensor.mqtt, number.mqtt, ...), and the units of device classes on that of sensors.
"""

import asyncio
import json
import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

import aiomqtt
from jinja2.sandbox import ImmutableSandboxedEnvironment

from tests.services.fleet.outputs.brokers import Broker

TOPIC = re.compile(
    "homeassistant/(?P<component>[a-z_]+)/([a-zA-Z0-9_-]+/)?[a-zA-Z0-9_-]+/config", re.ASCII
)

COMMON = """
availability availability_mode default_entity_id device enabled_by_default encoding entity_category
icon json_attributes_topic name origin qos unique_id value_template
"""

REQUIRED = {
    "sensor": {"state_topic"},
    "binary_sensor": {"state_topic"},
    "switch": {"command_topic"},
    "number": {"command_topic"},
    "select": {"command_topic", "options"},
    "text": {"command_topic"},
}

OF_COMMANDS = f"{COMMON} command_template optimistic retain state_topic"

OTHERS = {
    "sensor": f"{COMMON} device_class expire_after options state_class unit_of_measurement",
    "binary_sensor": f"{COMMON} device_class expire_after payload_on payload_off",
    "switch": f"{OF_COMMANDS} payload_on payload_off state_on state_off device_class",
    "number": f"{OF_COMMANDS} min max step mode device_class unit_of_measurement payload_reset",
    "select": OF_COMMANDS,
    "text": f"{OF_COMMANDS} min max mode pattern",
}

DEVICE = """
configuration_url connections hw_version identifiers manufacturer model model_id name serial_number
suggested_area sw_version via_device
"""

ORIGIN = "name sw_version support_url"

AVAILABILITY = "topic payload_available payload_not_available value_template"

UNITS = {
    "apparent_power": "mVA VA kVA",
    "conductivity": "S/cm mS/cm µS/cm",
    "current": "A mA µA",
    "distance": "km m cm mm mi nmi yd in",
    "duration": "d h min s ms µs",
    "energy": "J kJ MJ GJ mWh Wh kWh MWh GWh TWh cal kcal Mcal Gcal",
    "frequency": "mHz Hz kHz MHz GHz",
    "illuminance": "lx",
    "irradiance": "W/m² BTU/(h⋅ft²)",
    "power": "mW W kW MW GW TW",
    "pressure": "mPa Pa hPa kPa bar cbar mbar mmHg inHg inH₂O psi",
    "reactive_power": "mvar var kvar",
    "signal_strength": "dB dBm",
    "speed": "ft/s in/d in/h in/s km/h kn m/s mph mm/d mm/s",
    "temperature": "°C °F K",
    "voltage": "V mV µV kV MV",
    "volume": "L mL gal m³ ft³ CCF MCF",
    "volume_flow_rate": "m³/h m³/min m³/s ft³/min L/h L/min L/s gal/d gal/h gal/min mL/s",
    "weight": "kg g mg µg oz lb st",
}

# Those that a class may have; others only "measurement".
STATE_CLASSES = {
    "energy": "total total_increasing",
    "volume": "total total_increasing",
    "distance": "measurement total total_increasing",
    "duration": "measurement total total_increasing",
    "weight": "measurement total total_increasing",
    None: "measurement total total_increasing",
}

JINJA = ImmutableSandboxedEnvironment()


def words(text: str) -> set[str]:
    return {*text.split()}


def check(topic: str, config: dict[str, Any]) -> str:
    """Return the component of a configuration that the schema allows; else raise."""
    match = TOPIC.fullmatch(topic)
    assert match is not None, topic
    component = match["component"]
    required = REQUIRED[component]
    assert required <= config.keys() <= required | words(OTHERS[component]), config
    assert config["device"].keys() <= words(DEVICE)
    assert config["device"]["identifiers"]  # the least that a device needs
    assert "name" in config["origin"]
    assert config["origin"].keys() <= words(ORIGIN)
    assert config["availability_mode"] in ("all", "any", "latest")
    for source in config["availability"]:
        assert {"topic"} <= source.keys() <= words(AVAILABILITY)
    topics = [source["topic"] for source in config["availability"]]
    topics += [config[key] for key in ("state_topic", "command_topic") if key in config]
    assert not any(set("+#\0") & set(topic) for topic in topics)
    unit, kind = config.get("unit_of_measurement"), config.get("device_class")
    if kind == "enum":
        assert config["options"]
        assert not {"state_class", "unit_of_measurement"} & config.keys()
    elif kind == "timestamp":
        assert "state_class" not in config
    elif kind is not None:
        assert unit in words(UNITS[kind]), (kind, unit)
    if "state_class" in config:
        assert config["state_class"] in words(STATE_CLASSES.get(kind, "measurement")), config
    if component == "number":
        assert config["min"] < config["max"]
        assert config["step"] >= 0.001
    if component == "text":
        assert 0 <= config.get("min", 0) <= config["max"] <= 255
    for key in config.keys() & {"value_template", "command_template"}:
        JINJA.from_string(config[key])
    return component


@dataclass
class HomeAssistant:
    """What a subscriber makes of what it hears."""

    client: aiomqtt.Client
    # Topic of a configuration -> component and configuration; topic -> last payload.
    entities: dict[str, tuple[str, dict[str, Any]]] = field(default_factory=dict)
    payloads: dict[str, str] = field(default_factory=dict)
    # Configurations that came, and those that were deleted.
    added: list[str] = field(default_factory=list)
    removed: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)

    def hear(self, topic: str, payload: str) -> None:
        if not (topic.startswith("homeassistant/") and topic.endswith("/config")):
            self.payloads[topic] = payload
        elif not payload:
            self.removed.append(topic)
            self.entities.pop(topic, None)
        else:
            config = json.loads(payload)
            self.added.append(topic)
            self.entities[topic] = check(topic, config), config
            ids = [(entry, entity["unique_id"]) for entry, entity in self.entities.values()]
            assert len(set(ids)) == len(ids), "two entities with one id"

    @property
    def names(self) -> set[str]:
        """The entities, as "component: device: name"."""
        return {
            f"{component}: {config['device']['name']}: {config['name']}"
            for component, config in self.entities.values()
        }

    def entity(self, name: str, device: str = "") -> tuple[str, dict[str, Any]]:
        (pair,) = [
            (component, config)
            for component, config in self.entities.values()
            if config["name"] == name and device in ("", config["device"]["name"])
        ]
        return pair

    def is_available(self, name: str, device: str = "") -> bool:
        _, config = self.entity(name, device)
        assert config["availability_mode"] == "all"
        states = [self.payloads.get(source["topic"]) for source in config["availability"]]
        return all(state == "online" for state in states)

    def state(self, name: str, device: str = "") -> Any:
        """The state of an entity: None if it is unknown."""
        component, config = self.entity(name, device)
        payload = self.payloads.get(config["state_topic"])
        if payload is None:
            return None
        template = JINJA.from_string(config["value_template"])
        text = template.render(value=payload, value_json=json.loads(payload))
        if text == "None":
            return None
        match component:
            case "binary_sensor":
                return {config["payload_on"]: True, config["payload_off"]: False}[text]
            case "switch":
                return {config["state_on"]: True, config["state_off"]: False}[text]
            case "number":
                return float(text)
        if "options" in config:
            assert text in config["options"]
        elif config.get("device_class") == "timestamp":
            assert datetime.fromisoformat(text).tzinfo is not None
        elif "state_class" in config:
            return float(text)
        return text

    async def set(self, name: str, value: Any, device: str = "") -> None:
        """Send a command, as the component does."""
        component, config = self.entity(name, device)
        if component == "switch":
            payload = config["payload_on"] if value else config["payload_off"]
        else:
            template = JINJA.from_string(config.get("command_template", "{{ value }}"))
            payload = template.render(value=value)
        await self.client.publish(config["command_topic"], payload)


@asynccontextmanager
async def home_assistant(broker: Broker) -> AsyncIterator[HomeAssistant]:
    """Listen to a broker."""
    async with aiomqtt.Client("127.0.0.1", broker.port) as client:
        home = HomeAssistant(client)

        async def listen() -> None:
            async for message in client.messages:
                assert isinstance(message.payload, bytes)
                home.hear(str(message.topic), message.payload.decode())

        await client.subscribe("#")
        task = asyncio.create_task(listen())
        try:
            yield home
        finally:
            task.cancel()
            outcomes = await asyncio.gather(task, return_exceptions=True)
        assert isinstance(outcomes[0], asyncio.CancelledError), outcomes
